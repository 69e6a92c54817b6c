"""Verdicts of robots whose setpoints move on: following them is not a limit cycle."""

import mujoco
import numpy as np
import pytest

import jaxact as jx
from jaxact.status import Verdict

# A bar of 1 kg and 0.5 m that hangs.
MODEL = """
<mujoco><option timestep="0.001"/><worldbody><body><joint name="j" type="hinge" axis="0 1 0"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.5" mass="1" contype="0" conaffinity="0"/>
</body></worldbody><actuator><motor joint="j" ctrlrange="-50 50"/></actuator></mujoco>
"""
FREQUENCY, AMPLITUDE, KP, KD = 6.0, 0.2, 50.0, 3.0


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(MODEL)
    return path


def _angles(start, duration=2.0):
    """Of the arm in plain MuJoCo, whose PD control follows the sine, from this angle on."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    data.qpos[0] = start
    found = []
    for _ in range(round(duration / model.opt.timestep)):
        asked = AMPLITUDE * np.sin(2.0 * np.pi * FREQUENCY * data.time)
        data.ctrl[0] = KP * (asked - data.qpos[0]) - KD * data.qvel[0]
        mujoco.mj_step(model, data)
        found.append(data.qpos[0])
    return np.array(found)


@pytest.fixture(scope="module")
def sine():
    return {"setpoint": AMPLITUDE, "motion": {"kind": "sine", "frequency": FREQUENCY}}


def test_a_robot_that_follows_a_sine_is_stable(arm, sine):
    one, other = _angles(0.0), _angles(0.1)
    # Two starts come to the same motion, which swings on for ever: that is the sine's.
    assert np.abs(one - other)[-100:].max() < 1e-4 < 0.02 < np.ptp(one[-200:])
    run = jx.simulate(jx.robot(arm, kp=KP, kd=KD, **sine), duration=2.0)
    assert Verdict(int(run.verdict)) == Verdict.STABLE
    assert float(run.limit_cycle_amplitude) == 0.0 and np.isnan(run.limit_cycle_frequency)
    assert "the verdict is of small motions" in run.report


@pytest.mark.exhaustive
def test_a_sweep_of_robots_that_follow_a_sine_has_the_verdicts_of_small_motions(arm, sine):
    robot = jx.robot(arm, kd=KD, delay=0.02, **sine)
    swept = jx.sweep(robot, kp=[KP, 2000.0], duration=1.0)
    assert swept.growth_rate[0] < 0.0 < swept.growth_rate[1]
    assert swept.verdict.values.tolist()[0] == Verdict.STABLE
    # the force is limited: perturbations grow into a cycle
    assert swept.verdict.values.tolist()[1] in (Verdict.LIMIT_CYCLE, Verdict.UNSTABLE)


def test_a_motion_from_a_file_that_grows_is_no_loop_that_grows(arm, tmp_path):
    time = np.linspace(0.0, 2.0, 400)
    table = np.column_stack([time, 0.02 * np.exp(1.2 * time) * np.sin(6.0 * np.pi * time)])
    path = tmp_path / "grows.csv"
    np.savetxt(path, table, delimiter=",", header="time,j", comments="")
    motion = {"kind": "file", "file": str(path)}
    run = jx.simulate(jx.robot(arm, kp=200.0, kd=8.0, motion=motion), duration=2.0)
    assert Verdict(int(run.verdict)) == Verdict.STABLE
