"""Robots that are pushed over: told apart from those that are not, as plain MuJoCo moves them."""

import mujoco
import numpy as np
import pytest
import quickly

import jaxact as jx
from jaxact.simulation.falling import TILTED, fallen
from jaxact.status import Verdict

KP, KD, PUSHES, BEGIN, LASTS, SECONDS = 20.0, 0.5, (0.5, 3.0), 0.1, 0.05, 1.5
# A tall box on the ground that carries an arm.
BOX = """<mujoco><option timestep="0.002"/><worldbody>
<geom type="plane" size="5 5 1"/>
<body name="box" pos="0 0 0.3"><freejoint/><geom type="box" size="0.08 0.1 0.3" mass="1"/>
<body name="arm" pos="0 0 0.1"><joint name="arm" axis="0 1 0" armature="0.05"/>
<geom type="capsule" size="0.01" fromto="0 0 0 0 0 0.1" mass="0.05" contype="0" conaffinity="0"/>
</body></body></worldbody>
<actuator><motor joint="arm"/></actuator>
<keyframe><key name="stand" qpos="0 0 0.3 1 0 0 0 0"/></keyframe></mujoco>"""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("box") / "box.xml"
    path.write_text(BOX)
    return path


def _tilt(model, push):
    """Of the box in the end [rad], in plain MuJoCo with a PD controller of its own."""
    plain = mujoco.MjModel.from_xml_path(str(model))
    data = mujoco.MjData(plain)
    mujoco.mj_resetDataKeyframe(plain, data, 0)
    body = plain.body("box").id
    while data.time < SECONDS:
        data.ctrl[0] = -KP * data.qpos[7] - KD * data.qvel[6]
        pushed = BEGIN <= data.time < BEGIN + LASTS
        data.xfrc_applied[body, 0] = push / LASTS if pushed else 0.0
        mujoco.mj_step(plain, data)
    return float(np.arccos(np.clip(data.xmat[body].reshape(3, 3)[2, 2], -1.0, 1.0)))


# Edges of boxes on the ground are in MJX not quite those of MuJoCo, as it says.
@pytest.mark.filterwarnings("ignore::jaxact.errors.InexactWarning")
@pytest.mark.exhaustive
@pytest.mark.parametrize("engine", ["mujoco", "mjx"])
def test_a_robot_that_was_pushed_over_is_not_stable(model, engine):
    tilts = [_tilt(model, push) for push in PUSHES]
    assert tilts[0] < 0.1 and tilts[1] > 1.4
    with quickly.optimised_little():
        for push, wanted in zip(PUSHES, (Verdict.STABLE, Verdict.TOPPLES), strict=True):
            loop = jx.robot(
                model, keyframe="stand", kp=KP, kd=KD, control_rate=500.0,
                push={"body": "box", "impulse": [push, 0.0, 0.0], "time": BEGIN, "duration": LASTS},
            )  # fmt: skip
            assert int(jx.simulate(loop, duration=SECONDS, engine=engine).verdict) == wanted
            swept = jx.sweep(loop, kp=[KP], duration=SECONDS, engine=engine)
            assert swept.verdict.item() == wanted


def test_turning_is_no_fall():
    def about(axis, angle):
        return np.array([np.cos(0.5 * angle), *(np.sin(0.5 * angle) * np.eye(3)[axis])])

    up = about(2, 0.0)
    assert not fallen(0, up, about(2, np.pi)) and not fallen(0, about(2, 1.0), 2.0 * up)
    for axis in (0, 1):
        assert fallen(0, up, about(axis, 1.01 * TILTED)) and fallen(
            0, about(2, 2.0), about(axis, 2)
        )
        assert not fallen(0, up, about(axis, 0.99 * TILTED))
    assert not fallen(0, up, np.full(4, np.nan)) and fallen(None, up, up) is None
