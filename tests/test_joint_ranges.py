"""Limits of a robot's joints that are not the same to both sides, beside C MuJoCo alone."""

import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.cli import _warnings
from jaxact.loops import conversion, joint_ranges, reading, robots, strength
from jaxact.simulation.clamping import tell_clamped

KP, KD, SETPOINTS = 60.0, 1.5, (0.4, 1.0)
SERVO = '<position name="A" joint="a" kp="60" kv="1.5" {}/>'
GEARED = '<position name="A" joint="a" kp="15" kv="0.375" gear="-2" {}/>'
# An actuator, its joint, and the ranges of force and setpoint that follow at the joint.
CASES = {
    "forcerange": (SERVO.format('forcerange="-1 2"'), "", (-1.0, 2.0), (-np.inf, np.inf)),
    "one-sided": (
        SERVO.format('forcerange="0 2" ctrlrange="-0.5 0.5"'), "", (0.0, 2.0), (-0.5, 0.5),
    ),
    "joint": (SERVO.format(""), 'actuatorfrcrange="-30 3"', (-30.0, 3.0), (-np.inf, np.inf)),
    "gear": (
        GEARED.format('forcerange="-1 2" ctrlrange="-1 0.8"'), "", (-4.0, 2.0), (-0.4, 0.5),
    ),
    "both sides": (
        SERVO.format('forcerange="-2 2" ctrlrange="-0.5 0.5"'), "", (-2.0, 2.0), (-0.5, 0.5),
    ),
}  # fmt: skip
MODEL = """<mujoco><option timestep="0.0005" gravity="0 0 0"/><worldbody><body>
<joint name="a" axis="0 1 0" armature="0.01" damping="0.05" {joint}/>
<geom size="0.03" mass="0.4" pos="0 0 -0.2" contype="0" conaffinity="0"/></body></worldbody>
<actuator>{actuator}</actuator></mujoco>"""


def _text(case):
    actuator, joint, *_ = CASES[case]
    return MODEL.format(actuator=actuator, joint=joint)


def _plain(case, setpoint, ticks=100, substeps=2):
    """Positions and forces of the physics steps, a period late, without any of this library."""
    *_, force, setpoints = CASES[case]
    model = mujoco.MjModel.from_xml_string(_text(case))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    data, waiting, rows = mujoco.MjData(model), 0.0, []
    for _ in range(ticks):
        acting = np.clip(waiting, *force)
        waiting = KP * (np.clip(setpoint, *setpoints) - data.qpos[0]) - KD * data.qvel[0]
        for _ in range(substeps):
            rows.append((data.qpos[0], acting))
            data.qfrc_applied[0] = acting
            mujoco.mj_step(model, data)
    return np.array(rows).T


def _loop(case, tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(_text(case))
    return jx.robot(path, delay=1e-3)


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore::jaxact.InexactWarning")
@pytest.mark.parametrize("case", CASES)
def test_the_force_that_is_reported_is_the_one_that_acts(tmp_path, case):
    loop = _loop(case, tmp_path)
    run = jx.simulate(loop, setpoint=list(SETPOINTS), duration=0.1, engine="mujoco")
    maps = jx.sweep(loop, setpoint=list(SETPOINTS), duration=0.1, engine="mujoco")
    for place, setpoint in enumerate(SETPOINTS):
        position, force = _plain(case, setpoint)
        np.testing.assert_allclose(run.position.values[place, :, 0], position, atol=1e-12)
        np.testing.assert_allclose(run.force.values[place, :, 0], force, atol=1e-10)
        for found, exact in ((run, 1e-10), (maps, 1e-5)):
            peak, rms = found.peak_force.values[place], found.rms_force.values[place]
            assert peak == pytest.approx(np.abs(force).max(), rel=exact)
            assert rms == pytest.approx(np.sqrt(np.mean(force**2)), rel=exact)
        aim = np.clip(setpoint, *CASES[case][3])
        np.testing.assert_array_equal(run.setpoint.values[place], aim)


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore::jaxact.InexactWarning")
def test_mjx_reports_the_same(tmp_path):
    run = jx.simulate(_loop("gear", tmp_path), setpoint=1.0, duration=0.1, engine="mjx")
    position, force = _plain("gear", 1.0)
    np.testing.assert_allclose(run.position.values[:, 0], position, atol=1e-12)
    np.testing.assert_allclose(run.force.values[:, 0], force, atol=1e-10)
    assert float(run.peak_force) == pytest.approx(np.abs(force).max(), rel=1e-10)


@pytest.mark.exhaustive
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_force_limit_that_is_given_takes_the_place_of_the_models(tmp_path, precision):
    """MuJoCo's model of the robot keeps none of its own that would act behind the report."""
    path = tmp_path / "arm.xml"
    path.write_text(_text("both sides").replace('"-2 2"', '"-2.1 2.1"'))
    loop = jx.robot(path, delay=1e-3)
    given = {"setpoint": 0.4, "duration": 0.05, "engine": "mujoco", "precision": precision}
    weak, strong = (jx.simulate(one, **given) for one in (loop, loop.replace(force_limit=9.0)))
    assert float(strong.peak_force) == 9.0
    assert float(weak.peak_force) == pytest.approx(2.1, rel=1e-7)
    # Behind the delay of a period, a constant torque on an inertia of 0.026064 with its damping.
    inertia, time = 0.01 + 0.4 * (0.2**2 + 0.4 * 0.03**2), 3e-3
    for run, force in ((weak, 2.1), (strong, 9.0)):
        speed = float(run.velocity.sel(time=1e-3 + time, method="nearest")[0])
        assert speed == pytest.approx(force / 0.05 * -np.expm1(-0.05 * time / inertia), rel=1e-3)


def test_a_drive_around_another_simulator_has_the_same_ranges(tmp_path):
    loop = _loop("gear", tmp_path)
    model = mujoco.MjModel.from_xml_string(_text("gear"))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    drive = jx.drive_around(
        lambda state, force: state + 0.0 * force, loop,
        measure=lambda state: (state, 0.0 * state), physics_step=5e-4,
    )  # fmt: skip
    state, peaks = drive.init(np.zeros(1)), []
    for _ in range(3):
        state, output = drive.step(state, np.array([1.0]))
        peaks.append((float(output.command[0]), float(output.peak_force[0])))
    assert peaks[-1] == pytest.approx((KP * 0.5, 2.0))


def test_a_force_limit_to_both_sides_needs_no_range(tmp_path):
    loop = _loop("both sides", tmp_path)
    own = robots.brought(robots.scene(loop.kind.plant))
    assert joint_ranges.LOWEST_FORCE not in own and own["force_limit"].tolist() == [2.0]


@pytest.mark.exhaustive
def test_setpoints_beyond_a_servos_range_are_said_to_be_clamped(tmp_path):
    said = r"setpoint: a is asked to go to 1, beyond .*\(-0.4 to 0.5, `ctrlrange`\).* clamped"
    loop = _loop("gear", tmp_path)
    with pytest.warns(jx.InexactWarning, match=said):
        jx.simulate(loop, setpoint=1.0, duration=0.1, engine="mujoco")
    with pytest.warns(jx.InexactWarning, match=said):
        jx.sweep(loop, setpoint=[0.1, 1.0], duration=0.1, engine="mujoco")
    jx.simulate(loop, setpoint=0.5, duration=0.1, engine="mujoco")  # no warning, an error here


PENDULUM = """<mujoco><worldbody><body><joint name="a" axis="0 1 0" {joint}/>
<geom size="0.03" mass="0.4" pos="0 0 -0.2" contype="0" conaffinity="0"/></body></worldbody>
<actuator><position joint="a" kp="60" kv="1.5" {force}/></actuator>
<keyframe><key name="k" qpos="{angle}"/></keyframe></mujoco>"""


def _said(tmp_path, capsys, joint="", force="", angle=0.0):
    path = tmp_path / "pendulum.xml"
    path.write_text(PENDULUM.format(joint=joint, force=force, angle=angle))
    text = '[plant]\nmodel = "pendulum.xml"\nkeyframe = "k"\nposture = "keyframe"\n'
    asked = reading.parse(text + "[axes]\ndelay = [0.0]\n", tmp_path)
    _warnings.posture(asked)
    return asked, capsys.readouterr().err


def test_a_posture_on_a_limit_of_the_force_is_said(tmp_path, capsys):
    _, said = _said(tmp_path, capsys, force='forcerange="0 2"')
    assert said.count("\n") == 1
    assert "a holds the posture with 0 N m, a limit of its force (0 to 2)" in said
    assert "one side only" in said
    weight = float(0.4 * 9.81 * 0.2 * np.sin(0.5))
    asked, said = _said(tmp_path, capsys, force=f'forcerange="-9 {weight!r}"', angle=0.5)
    assert strength.on_limits(robots.scene(asked.plant), {}) and said.count("\n") == 1
    assert _said(tmp_path, capsys, force='forcerange="-0.01 2"')[1] == ""


def test_a_posture_at_the_end_of_a_joints_range_is_said(tmp_path, capsys):
    _, said = _said(tmp_path, capsys, joint='range="0 60"')
    assert said.count("\n") == 1
    assert "a (0; range 0 to 1.05) is at the end of the range" in said and "one side only" in said
    assert _said(tmp_path, capsys, joint='range="-1 60"')[1] == ""
    _, said = _said(tmp_path, capsys, joint='range="2 60"')
    assert "is outside its range" in said and "at the end" not in said


def test_setpoints_that_are_clamped_are_told_where_some_loops_have_none_of_their_own(tmp_path):
    """NaN is a loop without a value of its own: there the value of all joints counts."""
    loop = _loop("both sides", tmp_path)
    asked = conversion.specification(loop)
    along = {name: np.array([value]) for name, value in asked.nominal.items()}
    own = {"setpoint@a": np.array([np.nan, 0.9])}
    with pytest.warns(jx.InexactWarning, match=r"asked to go to 0\.9"):
        tell_clamped(asked, along | own)
    own = {"setpoint@a": np.array([np.nan, 0.1])}
    with pytest.warns(jx.InexactWarning, match=r"asked to go to -0\.7"):
        tell_clamped(
            asked, along | {"setpoint": np.array([-0.7]), "setpoint@a": own["setpoint@a"] - 0.8}
        )
    tell_clamped(asked, along | {"setpoint": np.array([0.7]), "setpoint@a": np.array([0.1])})
