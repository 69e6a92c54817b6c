"""What dry friction holds, against plain C MuJoCo loops with the actuator written out."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import scipy.linalg
from quickly import compiled_quickly as compiled_quickly

from jaxact.loops import reading, toml
from jaxact.robot_margins import whole_robot
from jaxact.simulation import single
from jaxact.status import Verdict

STEP = 1e-3
WN, ZETA = 110.0, 0.9  # StarLETH's actuator
KP, KD = 80.0, 2.0
INERTIA = 0.02
HINGE = """<mujoco><option gravity="0 0 0"/><worldbody><body>
<joint name="j" axis="0 1 0" armature="0.02" frictionloss="{loss}"/>
<geom size="0.01" mass="1e-6"/></body></worldbody>
<actuator><position joint="j" kp="80" kv="2" {limit}/></actuator></mujoco>"""


def held_of(asked):
    return whole_robot.nominal(asked).stiction


def specification(path, text, **parameters):
    path.write_text(text, encoding="utf-8")
    document = {
        "engine": "mujoco", "plant": {"model": str(path)}, "axes": {"feedforward": [0.0]},
        "parameters": {"actuator": "starleth", "control_rate": 1000.0, **parameters},
    }  # fmt: skip
    return reading.parse(toml.dumps(document))


def actuator():
    """Exact response of the actuator's force and its rate to a command held for a step."""
    A = np.array([[0.0, 1.0], [-WN * WN, -2.0 * ZETA * WN]])
    augmented = np.zeros((3, 3))
    augmented[:2, :2], augmented[1, 2] = A, WN * WN
    return scipy.linalg.expm(augmented * STEP)[:2]


def plain(loss, limit, push, duration=5.0):
    """Positions after a push of 50 ms: mj_step, a PD law and the actuator, nothing of jaxact."""
    model = mujoco.MjModel.from_xml_string(HINGE.format(loss=loss, limit=""))
    model.opt.timestep = STEP
    model.actuator_gainprm[:], model.actuator_biasprm[:] = 0.0, 0.0
    data, response, force = mujoco.MjData(model), actuator(), np.zeros(2)
    positions = []
    for step in range(round(duration / STEP)):
        before = force[0]
        command = -KP * data.qpos[0] - KD * data.qvel[0]
        force = response @ [*force, command]
        mean = float(np.clip(0.5 * (before + force[0]), -limit, limit))
        data.qfrc_applied[0] = mean + (push if 0.05 <= step * STEP < 0.0995 else 0.0)
        mujoco.mj_step(model, data)
        positions.append(data.qpos[0])
    return np.array(positions)


def amplitude_and_frequency(positions):
    last = positions[-1500:] - positions[-1500:].mean()
    up = np.flatnonzero((last[:-1] < 0.0) & (last[1:] >= 0.0))
    return 0.5 * np.ptp(last), 2.0 * np.pi * (len(up) - 1) / ((up[-1] - up[0]) * STEP)


def test_growth_is_that_of_the_sampled_loop_without_friction(tmp_path):
    asked = specification(tmp_path / "hinge.xml", HINGE.format(loss=0.3, limit=""))
    found = whole_robot.evaluate(asked)[0]
    # State q, v, f, f' at the ticks; MuJoCo moves q with the new v; f acts by its mean.
    fine = actuator()
    A = np.array([[0.0, 1.0, 0.0], [-WN * WN, -2.0 * ZETA * WN, WN * WN], [0.0, 0.0, 0.0]])
    integral = scipy.linalg.expm(STEP * np.block([[A, np.eye(3)], [np.zeros((3, 6))]]))[:3, 3:]
    mean = integral[0] / STEP
    command = np.array([-KP, -KD, 0.0, 0.0])
    M = np.zeros((4, 4))
    force = np.array([0.0, 0.0, mean[0], mean[1]]) + mean[2] * command
    M[1] = np.array([0.0, 1.0, 0.0, 0.0]) + STEP / INERTIA * force
    M[0] = np.array([1.0, 0.0, 0.0, 0.0]) + STEP * M[1]
    M[2:] = np.hstack([np.zeros((2, 2)), fine[:, :2]]) + np.outer(fine[:, 2], command)
    expected = np.log(np.abs(np.linalg.eigvals(M)).max()) / STEP
    assert found.margins.growth_rate == pytest.approx(expected, rel=1e-3)
    assert found.margins.growth_rate == pytest.approx(5.97, abs=0.1)
    assert found.left_out == 0.3


@pytest.mark.exhaustive
@pytest.mark.parametrize("limit", [20.0, 60.0])
def test_push_amplitude_and_frequency_are_those_of_plain_mujoco(tmp_path, limit):
    text = HINGE.format(loss=0.3, limit=f'forcerange="-{limit} {limit}"')
    held = held_of(specification(tmp_path / "hinge.xml", text))
    assert held.joint == held.shaking == "j"
    assert np.ptp(plain(0.3, limit, 0.95 * held.push)[-1500:]) < 1e-6
    amplitude, frequency = amplitude_and_frequency(plain(0.3, limit, 1.05 * held.push))
    assert held.amplitude == pytest.approx(amplitude, rel=0.05)
    assert held.frequency == pytest.approx(frequency, rel=0.05)
    assert "stands still only because of dry friction" in held.sentence
    assert "N m" in held.sentence and "rad/s" in held.sentence


@pytest.mark.exhaustive
def test_without_a_limit_of_force_the_shaking_grows(tmp_path):
    held = held_of(specification(tmp_path / "h.xml", HINGE.format(loss=0.3, limit="")))
    assert held.amplitude == np.inf
    assert "without bound" in held.sentence


@pytest.mark.exhaustive
def test_friction_that_holds_any_push_is_said_so(tmp_path):
    text = HINGE.format(loss=0.3, limit='forcerange="-0.35 0.35"')
    held = held_of(specification(tmp_path / "hinge.xml", text))
    assert held.push == np.inf and held.amplitude == 0.0
    assert "stands still because dry friction holds it: no push" in held.sentence
    assert np.ptp(plain(0.3, 0.35, held.strongest, 12.0)[-1500:]) < 1e-6


def test_nothing_is_said_of_robots_that_do_not_shake(tmp_path):
    text = HINGE.format(loss=0.3, limit="")
    assert held_of(specification(tmp_path / "a.xml", text, kp=10.0, kd=0.5)) is None
    assert held_of(specification(tmp_path / "b.xml", HINGE.format(loss=0, limit=""))) is None


@pytest.mark.exhaustive
def test_friction_of_the_parameters_counts(tmp_path):
    text = HINGE.format(loss=0.0, limit='forcerange="-20 20"')
    held = held_of(specification(tmp_path / "a.xml", text, joint_friction=0.3))
    own = held_of(
        specification(tmp_path / "b.xml", HINGE.format(loss=0.3, limit='forcerange="-20 20"'))
    )
    assert held.push == pytest.approx(own.push, rel=0.05)
    assert held.amplitude == pytest.approx(own.amplitude, rel=0.01)


@pytest.mark.exhaustive
@pytest.mark.parametrize("duration", [1.0, 4.0])
def test_what_friction_ends_is_no_limit_cycle_however_short_the_look(tmp_path, duration):
    text = HINGE.format(loss=0.3, limit='forcerange="-2 2"')
    asked = specification(tmp_path / "hinge.xml", text, setpoint=0.3)
    run = single.simulate(replace(asked, duration=duration))
    assert run.results["verdict"] == Verdict.UNSTABLE
    assert not any(start.moving for start in run.starts)
    assert np.isnan(run.results["limit_cycle_amplitude"])


def two_joints(loss, limit):
    """The hinge, and another one whose loop is stable and which has friction of its own."""
    other = """<body pos="1 0 0"><joint name="k" axis="0 1 0" armature="0.02" frictionloss="0.3"/>
    <geom size="0.01" mass="1e-6"/></body></worldbody><actuator>
    <position joint="k" kp="5" kv="0.5"/>"""
    text = HINGE.format(loss=loss, limit=f'forcerange="-{limit} {limit}"')
    return text.replace("</worldbody>\n<actuator>", other)


@pytest.mark.exhaustive
def test_a_joint_that_friction_does_not_act_on_is_not_said_to_be_held(tmp_path):
    held = held_of(specification(tmp_path / "two.xml", two_joints(0.0, 20.0)))
    assert held.push == 0.0 and held.joint == held.shaking == "j"
    assert "is not held by its dry friction" in held.sentence
    amplitude, frequency = amplitude_and_frequency(plain(0.0, 20.0, 1e-3))
    assert held.amplitude == pytest.approx(amplitude, rel=0.05)
    assert held.frequency == pytest.approx(frequency, rel=0.05)


@pytest.mark.exhaustive
def test_a_joint_at_rest_does_not_make_a_limit_cycle_of_another_unstable(tmp_path):
    asked = specification(tmp_path / "two.xml", two_joints(0.3, 20.0), initial_velocity=5.0)
    run = single.simulate(replace(asked, duration=6.0))
    assert run.results["verdict"] == Verdict.LIMIT_CYCLE
    amplitude, frequency = amplitude_and_frequency(plain(0.3, 20.0, 4.0))
    assert run.results["limit_cycle_amplitude"] == pytest.approx(amplitude, rel=0.05)
    assert run.results["limit_cycle_frequency"] == pytest.approx(frequency, rel=0.05)
