"""The delay that a robot's gains bear: against rollouts in plain MuJoCo with the delay in them."""

import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact import multiloop, multiloop_limits
from jaxact.sweep import reading, whole_robot

ARM = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
<body><joint name="shoulder" axis="0 1 0" armature=".02"/>
<geom size="0.05" pos="0 0 -0.35" mass="1.2"/>
<body pos="0 0 -0.35"><joint name="elbow" axis="0 1 0" armature=".004"/>
<geom size="0.04" pos="0 0 -0.3" mass="0.1"/></body></body></worldbody>
<actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator></mujoco>"""
KP, KD = np.array([150.0, 40.0]), np.array([9.0, 2.0])


def _found(folder, *overrides):
    (folder / "arm.xml").write_text(ARM)
    document = """engine = "mujoco"
    plant.model = "arm.xml"
    [parameters]
    control_rate = 500
    "kp@shoulder" = 150
    "kd@shoulder" = 9
    "kp@elbow" = 40
    "kd@elbow" = 2
    [axes]
    feedforward = [0.0]"""
    (found,) = whole_robot.evaluate(reading.parse(document, folder, overrides))
    return found


def _rollout(ticks, steps=3000):
    """Velocities of both joints after a small kick, the command late by whole ticks of 2 ms."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    data.qvel[:] = 1e-9
    late, path = [np.zeros(2)] * ticks, []
    for _ in range(steps):
        late.append(-KP * data.qpos - KD * data.qvel)
        data.ctrl = late.pop(0)
        mujoco.mj_step(model, data, 2)
        path.append(data.qvel.copy())
        if np.abs(path[-1]).max() > 1e-3:
            break
    return np.array(path)


def test_one_tick_less_decays_one_tick_more_grows(tmp_path):
    found = _found(tmp_path)
    borne = found.delay_borne
    assert borne.stable and borne.growth_rate == pytest.approx(found.margins.growth_rate)
    assert borne.delay == pytest.approx(found.margins.whole.delay_margin, rel=1e-9)
    ticks = int(borne.delay / 0.002)
    assert ticks >= 2 and np.abs(_rollout(ticks)[-100:]).max() < 1e-10
    grows = _rollout(ticks + 1)
    assert np.abs(grows[-1]).max() > 1e-3

    # The joint that is named is the one that moves: shares of the kinetic energy on this inertia.
    last = grows[-200:] / np.abs(grows[-1]).max()
    energy = np.asarray(found.robot.inertias) * np.mean(last**2, axis=0)
    np.testing.assert_allclose(borne.participation, energy / energy.sum(), atol=0.05)
    turns = np.flatnonzero(np.diff(np.sign(grows[-200:, np.argmax(borne.participation)])))
    frequency = np.pi / (0.002 * np.diff(turns).mean())
    assert frequency < borne.frequency < 1.12 * frequency  # it is lower at the later tick


def test_joints_that_cross_alike_bear_what_one_of_them_does(tmp_path):
    """Joints of left and right may cross at the very same place, to the last bit."""
    robot = _found(tmp_path).robot
    loop = multiloop.multiloop(*robot.matrices, robot.period)
    grid = multiloop.grid(loop)
    followed = multiloop_limits.followed(multiloop.sensitivity(loop, grid))
    once = multiloop_limits.crossings(grid, followed, lambda s: s.real - 0.5)
    twice = [each for each in once for _ in range(2)]
    limits = [multiloop_limits.delay_limit(robot.later_by, robot.period, candidates)
              for candidates in (once, twice)]  # fmt: skip
    assert once and np.isfinite(limits[0]).all() and limits[0] == limits[1]


def test_a_loop_that_shakes_as_it_is_bears_none(tmp_path):
    delay = _found(tmp_path).delay_borne.delay
    borne = _found(tmp_path, f"delay={1.05 * delay}").delay_borne
    assert not borne.stable and borne.growth_rate > 0.0 and np.isnan(borne.delay)
    assert borne.participation.sum() == pytest.approx(1.0)
    just = _found(tmp_path, f"delay={0.999 * delay}").delay_borne
    assert just.stable and just.delay == pytest.approx(0.001 * delay, rel=1e-3)


def test_joints_that_creep_bear_a_quarter_of_their_turn(tmp_path):
    """c q' = -kp q(t - delay) is stable up to pi c / (2 kp)."""
    gains = [f"{gain}@{joint}={value}" for gain, value in (("kp", 1e-3), ("kd", 0.0))
             for joint in ("shoulder", "elbow")]  # fmt: skip
    borne = _found(tmp_path, *gains, "joint_damping=5").delay_borne
    assert borne.stable and borne.delay == pytest.approx(0.5 * np.pi * 5.0 / 1e-3, rel=1e-4)
