"""Robots that are pushed over: told apart from those that are not, as plain MuJoCo moves them."""

from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest
import quickly

import jaxact as jx
from jaxact.robots.base import Base
from jaxact.simulation import envelope
from jaxact.simulation.falling import SUNK, TILTED, fall
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


# A slab on four legs that slide, each of which can exert so many N.
SLAB = """<mujoco><option timestep="0.002"/><worldbody>
<geom type="plane" size="5 5 1"/>
<body name="slab" pos="0 0 0.42"><freejoint/><geom type="box" size="0.3 0.3 0.03" mass="4"/>
{legs}</body></worldbody><actuator>{servos}</actuator>
<keyframe><key name="stand" qpos="0 0 0.42 1 0 0 0 0 0 0 0"/></keyframe></mujoco>"""
LEG = """<body name="leg{0}" pos="{1} {2} 0"><joint name="leg{0}" type="slide" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 -0.05 0 0 -0.4" size="0.02" mass="0.2"/></body>"""
SERVO = '<position joint="leg{0}" kp="3000" kv="100" forcerange="-{1} {1}"/>'


def _slab(force):
    places = [(x, y) for x in (-0.25, 0.25) for y in (-0.25, 0.25)]
    legs = "".join(LEG.format(i, *place) for i, place in enumerate(places))
    return SLAB.format(legs=legs, servos="".join(SERVO.format(i, force) for i in range(4)))


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


def _height(text):
    """Of the slab after a second, in plain MuJoCo."""
    plain = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(plain)
    mujoco.mj_resetDataKeyframe(plain, data, 0)
    while data.time < 1.0:
        mujoco.mj_step(plain, data)
    return float(data.qpos[2])


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore::jaxact.errors.InexactWarning")
def test_a_robot_whose_legs_fold_is_not_stable(tmp_path):
    """Each leg bears 10 N; told to, it may be as low as that."""
    high, low = _height(_slab(30)), _height(_slab(7))
    assert high > 0.4 and low < 0.25
    with quickly.optimised_little():
        for force, wanted in ((30, Verdict.STABLE), (7, Verdict.TOPPLES)):
            path = tmp_path / f"slab_{force}.xml"
            path.write_text(_slab(force))
            loop = jx.robot(path, keyframe="stand", control_rate=500.0)
            assert int(jx.simulate(loop, duration=1.0, engine="mujoco").verdict) == wanted
            swept = jx.sweep(loop, gain_scale=[1.0], duration=1.0, engine="mujoco")
            assert swept.verdict.item() == wanted
        told = jx.robot(tmp_path / "slab_30.xml", keyframe="stand", control_rate=500.0)
        run = jx.simulate(told, setpoint=0.25, duration=1.0, engine="mujoco")
    assert int(run.verdict) == Verdict.STABLE


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore::jaxact.errors.InexactWarning")
def test_a_robot_whose_legs_fold_is_not_stable_in_mjx_either(tmp_path):
    """With the limits as parameters: a model of its own for each would be compiled anew."""
    path, forces, wanted = tmp_path / "slab.xml", [30.0, 7.0], [Verdict.STABLE, Verdict.TOPPLES]
    path.write_text(_slab(100))
    loops = [
        jx.robot(path, keyframe="stand", control_rate=500.0, force_limit=force) for force in forces
    ]
    with quickly.optimised_little():
        runs = [jx.simulate(loop, duration=1.0, engine="mjx") for loop in loops]
        swept = jx.sweep(loops[0], force_limit=forces, duration=1.0, engine="mjx")
        told = jx.simulate(loops[0], setpoint=0.25, duration=1.0, engine="mjx")
    assert [int(run.verdict) for run in runs] == swept.verdict.values.tolist() == wanted
    assert int(told.verdict) == Verdict.STABLE


def test_turning_is_no_fall():
    def about(axis, angle):
        return np.array([0, 0, 0, np.cos(0.5 * angle), *(np.sin(0.5 * angle) * np.eye(3)[axis])])

    bases = (Base(0, 0.5, (0.0, 0.0, 1.0)),)

    def over(start, end):
        return bool(fall(bases, start, end).over)

    up = about(2, 0.0)
    assert not over(up, about(2, np.pi)) and not over(about(2, 1.0), 2.0 * up)
    for axis in (0, 1):
        assert over(up, about(axis, 1.01 * TILTED)) and over(about(2, 2.0), about(axis, 2))
        assert not over(up, about(axis, 0.99 * TILTED))
    assert not over(up, np.full(7, np.nan)) and fall((), up, up) is None


def test_what_is_lower_has_sunk_unless_it_was_told_to():
    def at(*place):
        return np.array([*place, 1, 0, 0, 0], float)

    up = np.array([0.6, 0.0, 0.8])  # on a slope: gravity elsewhere than down
    bases = (Base(0, 0.5, tuple(up)),)
    start = at(0, 0, 1)
    low, high = (at(*(start[:3] - part * SUNK * up)) for part in (0.51, 0.49))
    fell = fall(bases, start, low)
    assert fell.lower and not fell.over and not fall(bases, start, high).lower
    assert not fall(bases, start, low, told=True).lower
    away, asked, zero = np.array([0.0, 0.3]), np.array([0.0, 0.2]), np.zeros(2)
    still = replace(envelope.init(zero), lowest=away, highest=away)
    still = jax.tree.map(lambda leaf: leaf[None], still)
    assert fell.happened(still, zero, asked) and not fell.happened(still, zero, 2.0 * asked)
