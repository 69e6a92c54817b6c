"""The delay that a robot's gains bear: against rollouts in plain MuJoCo with the delay in them."""

import mujoco
import numpy as np
import pytest
import scipy.linalg
from quickly import compiled_quickly as compiled_quickly
from scipy.optimize import brentq

from jaxact.analysis.robot import limits as multiloop_limits
from jaxact.analysis.robot import multiloop
from jaxact.analysis.robot.delay import delay_borne
from jaxact.analysis.robot.modes import Robot
from jaxact.loops import reading
from jaxact.robot_margins import whole_robot

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


@pytest.mark.parametrize("delay", [0.3, 2.6])
def test_what_comes_back_changes_with_frequency_as_differences_say(tmp_path, delay):
    robot = _found(tmp_path).robot

    def back(angle):
        return multiloop_limits.feedback(robot.later_by, robot.period, angle, delay)

    vector = np.array([0.6 - 0.2j, 0.1 + 0.7j])
    differences = (back(0.2 + 1e-6).commands - back(0.2 - 1e-6).commands) @ vector / 2e-6
    np.testing.assert_allclose(back(0.2).slope(vector), differences, rtol=1e-7)


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


def _late(kp, kd, extra):
    """1 kg without a drive at 1 Hz; states q, v and the last command, `extra` of a second late."""
    A = np.array([[1.0, 1.0, extra * (1.0 - 0.5 * extra)], [0.0, 1.0, extra], [0.0, 0.0, 0.0]])
    N = np.array([[0.5 * (1.0 - extra) ** 2], [1.0 - extra], [1.0]])
    C = np.array([[-kp, -kd, 0.0]])
    return A + N @ C, N, C


def _critical(kp, kd):
    """The delay at which a root of one joint leaves the unit circle [s]."""

    def outside(delay):
        whole = int(delay)
        M, N, C = _late(kp, kd, delay - whole)
        line = np.zeros((3 + whole, 3 + whole))
        line[:3, :3] = M - N @ C if whole else M
        if whole:
            line[:3, -1:], line[3:4, :3], line[4:, 3:-1] = N, C, np.eye(whole - 1)
        return np.max(np.abs(np.linalg.eigvals(line))) - 1.0

    last = next(delay for delay in np.arange(0.5, 13.0, 0.5) if outside(delay) > 0.0)
    return brentq(outside, last - 0.5, last, xtol=1e-12)


@pytest.mark.parametrize(
    "gains",
    [
        ((2.647e-3, 0.828), (1.415e-4, 0.758)),
        ((0.0766, 0.6445), (0.085, 0.7061)),
        ((9.8e-3, 0.7608), (7.29e-3, 0.7506)),
        ((0.0014801, 0.1221439), (0.0014737, 0.1221499)),
        ((0.0133728, 0.2855889), (0.0134123, 0.2855088)),
    ],
)
def test_the_joint_that_loses_its_delay_margin_first_is_named(gains):
    """Two joints that know nothing of each other: at 0.7 rad a period, where a part of a period's
    delay is more than its phase, and two that are almost alike."""

    def later(extra):
        joints = zip(*(_late(*own, extra) for own in gains), strict=True)
        return tuple(scipy.linalg.block_diag(*parts) for parts in joints)

    rows = np.eye(6)
    robot = Robot(later(0.0), rows[[0, 3]], rows[[1, 4]], np.ones(2), ("a", "b"), 1.0, later)
    borne, alone = delay_borne(robot), [_critical(*own) for own in gains]
    assert borne.delay == pytest.approx(min(alone), rel=1e-7)
    np.testing.assert_allclose(borne.participation, np.eye(2)[np.argmin(alone)], atol=1e-6)
