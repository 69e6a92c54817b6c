"""What MJX is said to do with fields of a model, held against MJX and C MuJoCo."""

import dataclasses

import jax
import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.plants.mjx import refusals as mjx_refusals
from jaxact.plants.mjx.plant import mjx
from jaxact.robots import model as models
from jaxact.robots import parity
from jaxact.robots.findings import ASKED, EMULATED, HARMLESS, INEXACT, MJX, REFUSED, WARP

# One pendulum for each field of joints, tendons and actuators; `plain` has none.
PENDULA = {
    "plain": ("", "", ""),
    "stiffness (polynomial)": ('stiffness="1 5 5"', "", ""),
    "damping (polynomial)": ('damping="0.1 0.2 0.2"', "", ""),
    "tendon stiffness (polynomial)": ("", 'stiffness="1 5 5"', ""),
    "tendon damping (polynomial)": ("", 'damping="0.1 0.5 0.5"', ""),
    "armature": ("", "", '<motor {j} armature="0.1" gear="2"/>'),
    "damping": ("", "", '<motor {j} damping="0.1" gear="2"/>'),
    "actuator damping (polynomial)": ("", "", '<motor {j} damping="0 0.1 0.1"/>'),
    "delay": ("", "", '<motor {j} delay="0.02" nsample="12"/>'),
    "actearly": ("", "", '<general {j} dyntype="filter" dynprm="0.05" actearly="true"/>'),
    "actuatorgroupdisable": ("", "", '<motor {j} group="2"/>'),
    "forcerange": ("", "", '<velocity {j} kv="3" forcerange="-0.4 0.4"/>'),
}  # fmt: skip


def _pendula():
    bodies, tendons, actuators = [], [], []
    for name, (joint, tendon, actuator) in PENDULA.items():
        bodies.append(
            f'<body><joint name="{name}" axis="0 1 0" {joint}/>'
            '<geom size="0.05" pos="0.2 0 0" mass="1" contype="0" conaffinity="0"/></body>'
        )
        if tendon:
            tendons.append(
                f'<fixed name="{name}" {tendon}><joint joint="{name}" coef="1"/></fixed>'
            )
        at = f'name="{name}" joint="{name}"'
        actuators.append(actuator.format(j=at) if actuator else f"<motor {at}/>")
    ctrl = " ".join("0.4" for _ in actuators)
    return f"""<mujoco>
      <option integrator="implicitfast" actuatorgroupdisable="2"/>
      <worldbody>{"".join(bodies)}</worldbody>
      <tendon>{"".join(tendons)}</tendon>
      <actuator>{"".join(actuators)}</actuator>
      <keyframe><key name="start" ctrl="{ctrl}"/></keyframe></mujoco>"""


def in_c(model, robot=None, steps=60):
    data = mujoco.MjData(model)
    if robot is not None:
        data.ctrl = robot.ctrl
    elif model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(steps):
        mujoco.mj_step(model, data)
    return data.qpos.copy()


def in_mjx(model, robot=None, steps=60):
    start = mujoco.MjData(model)
    if robot is not None:
        start.ctrl = robot.ctrl
    elif model.nkey:
        mujoco.mj_resetDataKeyframe(model, start, 0)
    with jax.enable_x64(True), jax.numpy_rank_promotion("allow"):
        device = mjx.put_model(model, impl="jax")
        data = mjx.put_data(model, start, impl="jax")
        step = jax.jit(mjx.step, compiler_options={"xla_backend_optimization_level": 0})
        for _ in range(steps):
            data = step(device, data)
    return np.asarray(data.qpos)


def read(tmp_path, text, **options):
    path = tmp_path / "robot.xml"
    path.write_text(text)
    return models.read(path, **options)


def said(robot):
    return {item.field: item for item in robot.findings}


@pytest.mark.exhaustive
def test_fields_of_joints_tendons_and_actuators(tmp_path):
    text = _pendula()
    model = mujoco.MjModel.from_xml_string(text)
    apart = dict(zip(PENDULA, np.abs(in_mjx(model) - in_c(model)), strict=True))
    assert apart.pop("plain") < 1e-12
    for name, distance in apart.items():
        assert distance > 2e-4, f"MJX simulates {name} after all"

    robot = read(tmp_path, text, keyframe="start", joints=["plain"])
    robot.ctrl[0] = 0.4
    findings = said(robot)
    for name in apart:
        field = name.removeprefix("actuator ") if name.startswith("actuator d") else name
        assert field in findings, name
    ours = in_mjx(robot.model, robot)
    same_as_own = dict(zip(PENDULA, np.abs(ours - in_c(model)) < 1e-12, strict=True))
    for name, item in findings.items():
        assert item.action != EMULATED or same_as_own[name], f"{name} is not emulated"
        assert (item.action == REFUSED) == (MJX in item.engines)
    # What is left out is left out of both engines; a saturated servo is the only exception.
    same = np.abs(ours - in_c(robot.model, robot)) < 1e-12
    for name, alike in zip(PENDULA, same, strict=True):
        assert alike != (name == "forcerange" or "polynomial" in name), name


BALLS = """<mujoco><option gravity="1 0 -9"/><worldbody>
  {balls}
</worldbody>
<contact><pair geom1="ball1" geom2="floor1" adhesion="5"/></contact></mujoco>"""
BALL = """
  <geom name="floor{i}" type="plane" size="2 2 .1" pos="0 0 -.0499" contype="0" conaffinity="{bit}"
   {floor}/>
  <body gravcomp="{lift}"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
  <geom name="ball{i}" size="0.05" mass="1" contype="{bit}" conaffinity="0" {ball}/></body>"""


@pytest.mark.exhaustive
def test_fields_of_contacts():
    fields = {
        "plain": ("", ""),
        "pair adhesion": ("", ""),
        "adhesion": ("", 'adhesion="5"'),
        "surfacevel": ('surfacevel="0.5 0 0 0 0 0"', ""),
    }
    balls = [
        BALL.format(
            i=i,
            bit=0 if name == "pair adhesion" else 1 << i,
            floor=floor,
            ball=ball,
            lift=1.2 if "adhesion" in name else 0,  # adhesion holds what would leave the floor
        )  # fmt: skip
        for i, (name, (floor, ball)) in enumerate(fields.items())
    ]
    model = mujoco.MjModel.from_xml_string(BALLS.format(balls="".join(balls)))
    simulated = in_mjx(model)
    apart = np.abs(simulated - in_c(model)).reshape(-1, 2).max(axis=1)
    distances = dict(zip(fields, apart, strict=True))
    assert distances.pop("plain") < 1e-12
    for name, distance in distances.items():
        assert distance > 1e-6, name
    model.opt.noslip_iterations = 5  # MJX has no such option
    assert np.abs(simulated - in_c(model))[:2].max() > 1e-6
    findings = {item.field for item in parity.findings(model, ())}
    assert findings == {*distances, "noslip_iterations"}


ONE = """<mujoco><option {option}>{flag}</option><worldbody><body gravcomp="0.5">
  <joint name="j" axis="0 1 0" stiffness="2" damping="0.2"/>
  <geom size="0.05" pos="0.2 0 0" mass="1" {geom}/></body>{body}</worldbody>
  <actuator>{actuator}</actuator></mujoco>"""


LOOSE = (
    '<body pos="0 1 0"><joint type="slide"/><geom size="0.05" contype="0" conaffinity="0"/></body>'
)


def one(option="", flag="", geom="", body="", actuator='<motor joint="j"/>'):
    return ONE.format(option=option, flag=flag, geom=geom, body=body, actuator=actuator)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("field", "text"),
    [
        ("flag spring", one(flag='<flag spring="disable"/>')),
        ("flag damper", one(flag='<flag damper="disable"/>')),
        ("flag sleep", one('sleep_tolerance="9"', flag='<flag sleep="enable"/>', body=LOOSE)),
        ("fluidshape", one('density="100" viscosity="1"', geom='fluidshape="ellipsoid"')),
    ],
)
def test_fields_of_the_whole_model(tmp_path, field, text):
    model = mujoco.MjModel.from_xml_string(text)
    assert np.abs(in_mjx(model) - in_c(model)).max() > 1e-4
    robot = read(tmp_path, text)
    finding = said(robot)[field]
    assert set(said(robot)) == {field}
    if finding.action == EMULATED:
        np.testing.assert_allclose(in_c(robot.model), in_c(model), rtol=0, atol=1e-12)
        assert robot.model.opt.disableflags == mujoco.mjtDisableBit.mjDSBL_AUTORESET
    elif finding.action == HARMLESS:
        assert not robot.model.opt.enableflags
    else:
        assert finding.engines == (MJX,)


FOOT = """<mujoco><option timestep="0.001"/><worldbody>
  <geom name="floor" type="plane" size="5 5 .1"/><body pos="0 0 {height}" euler="2 1 0"><freejoint/>
  <geom name="foot" type="{shape}" size=".12 .06 .02" mass="20" {foot}/>
  <body pos="0 0 .1"><joint name="j" axis="0 1 0"/>
  <geom size=".02" mass=".1" contype="0" conaffinity="0"/></body></body></worldbody>
  <actuator><motor joint="j"/></actuator></mujoco>"""
LINKS = """<mujoco><option timestep="0.001"/><worldbody>
  <body name="a"><joint name="a" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.4"
  size=".02" contype="0" conaffinity="0"/><body name="b" pos="0 0 -.4"><joint name="b"
  axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" contype="0"
  conaffinity="0"/></body></body>
  <body name="c" pos=".3 0 .2"><joint name="c" axis="0 1 0"/><geom type="capsule"
  fromto="0 0 0 0 0 -.6" size=".02" contype="0" conaffinity="0"/></body></worldbody>
  <equality>{held}</equality><actuator><motor joint="a"/></actuator>
  <keyframe><key qvel="6 -6 4"/></keyframe></mujoco>"""


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("field", "text"),
    [
        ("contact corners", FOOT.format(height=".016", shape="box", foot="")),
        ("contact margin", FOOT.format(height=".026", shape="box", foot='margin=".01"')),
        ("equality", LINKS.format(held='<connect body1="b" body2="c" anchor=".3 0 0"/>')),
        ("equality", LINKS.format(held='<weld body1="b" body2="c"/>')),
    ],
)
def test_what_mjx_simulates_otherwise_is_said_and_left_to_c_mujoco(tmp_path, field, text):
    model = mujoco.MjModel.from_xml_string(text)
    assert np.abs(in_mjx(model, steps=10) - in_c(model, steps=10)).max() > 1e-6
    robot = read(tmp_path, text)
    assert said(robot)[field].action == INEXACT
    assert models.suits(robot, MJX) and not models.exact(robot, MJX)
    assert models.exact(robot, "mujoco")


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "text",
    [
        FOOT.format(height=".016", shape="ellipsoid", foot=""),
        FOOT.format(height=".016", shape="box", foot='contype="0" conaffinity="0"'),
        LINKS.format(held='<joint joint1="a" joint2="c"/>'),
    ],
)
def test_what_mjx_simulates_alike_is_not_said(tmp_path, text):
    model = mujoco.MjModel.from_xml_string(text)
    assert np.abs(in_mjx(model, steps=10) - in_c(model, steps=10)).max() < 1e-6
    assert models.exact(read(tmp_path, text), MJX)


def test_a_solver_that_a_model_ends_early_finishes(tmp_path):
    """C MuJoCo with as many iterations as it needs, though the file allows one."""
    text = LINKS.format(held='<weld body1="b" body2="c"/>')
    early = text.replace("timestep", 'iterations="1" ls_iterations="2" timestep')
    assert said(read(tmp_path, early))["iterations"].action == EMULATED
    assert "iterations" not in said(read(tmp_path, text))
    option = read(tmp_path, early).model.opt
    assert (option.iterations, option.ls_iterations) == (100, 50)


FLEX = """<mujoco><worldbody><flexcomp name="f" type="grid" count="2 2 2" spacing=".1 .1 .1"
  radius=".01" dim="3" mass="1"/><body><joint name="j"/><geom size=".1"/></body></worldbody>
  <actuator><motor joint="j"/></actuator></mujoco>"""
REFUSED_BY_MJX = [
    ("flag energy", one(flag='<flag energy="enable"/>')),
    ("flag fwdinv", one(flag='<flag fwdinv="enable"/>')),
    ("flag override", one(flag='<flag override="enable"/>')),
    ("flag diagexact", one(flag='<flag diagexact="enable"/>')),
    ("integrator", one('integrator="implicit"')),
    ("integrator", one('integrator="discrete"')),
    ("solver", one('solver="PGS"')),
    ("density, viscosity", one('integrator="implicitfast" density="9"')),
    ("actuator type", one(actuator='<motor joint="j"/><pid name="pid" joint="j" kp="1" ki="1"/>')),
    ("actuator type", one(actuator='<motor joint="j"/><dcmotor name="dc" joint="j" '
                                   'motorconst="0.1" resistance="1"/>')),
    ("flex", FLEX),
]  # fmt: skip


@pytest.mark.parametrize(("field", "text"), REFUSED_BY_MJX)
def test_what_mjx_refuses(tmp_path, field, text):
    def simulate(model):
        with jax.numpy_rank_promotion("allow"):
            device = mjx.put_model(model, impl="jax")
            jax.eval_shape(mjx.step, device, mjx.put_data(model, mujoco.MjData(model), impl="jax"))

    with pytest.raises(NotImplementedError):
        simulate(mujoco.MjModel.from_xml_string(text))
    joints = ["actuator 0"] if field == "actuator type" else [".*"]
    robot = read(tmp_path, text, joints=joints)
    finding = said(robot)[field]
    if finding.action == REFUSED:
        assert finding.engines in ((MJX,), (MJX, WARP))
    else:
        simulate(robot.model)


def test_every_claim_is_tested():
    tested = {
        *PENDULA, *(field for field, _ in REFUSED_BY_MJX), "pair adhesion", "adhesion",
        "contact corners", "contact margin", "equality", "iterations",
        "surfacevel", "noslip_iterations", "flag spring", "flag damper", "flag sleep", "fluidshape",
        "flag actuation",
    }  # fmt: skip
    # sensors move nothing; plugins: MJX has no field for them
    untested = {claim.field for claim in parity.CLAIMS} - tested
    assert untested == {"sensor delay", "plugin"}
    fields = {field.name for field in dataclasses.fields(mjx.Model)}
    assert not {"sensor_delay", "sensor_interval", "sensor_history", "body_plugin"} & fields


def test_geoms_that_mjx_cannot_bring_into_contact_are_named():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody>
        <geom name="box" type="box" size=".1 .1 .1"/><geom name="far" type="box" size=".1 .1 .1"/>
        <body name="foot"><freejoint/><geom type="cylinder" size=".1 .1"/>
        <geom name="egg" type="ellipsoid" size=".1 .1 .2"/>
        <geom name="bare" type="cylinder" size=".1 .1" contype="0" conaffinity="0"/></body>
        </worldbody></mujoco>"""
    )
    found = {item.value: item for item in mjx_refusals.find(model)}
    cylinder = found["cylinder and box"]
    assert cylinder.where == "geom 'box' and geom 2 of body 'foot' (and 1 more such pairs)"
    assert cylinder.engines == (MJX,) and "contype" in cylinder.advice
    assert set(found) == {"cylinder and box", "ellipsoid and box"}
    for geom in range(model.ngeom):
        model.geom_contype[geom] = model.geom_conaffinity[geom] = 0
    assert mjx_refusals.find(model) == []


def test_warnings_of_mjx_are_findings_and_not_on_the_screen():
    turns = np.arange(24) * 2.0 * np.pi / 24
    rim = [(np.cos(turn), np.sin(turn), height) for height in (-1.0, 1.0) for turn in turns]
    corners = " ".join(f"{value:.6f}" for point in rim for value in point)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><asset><mesh name="drum" vertex="{corners}"/></asset><worldbody>
        <geom type="plane" size="1 1 1"/><body><freejoint/><geom type="mesh" mesh="drum"/></body>
        </worldbody></mujoco>"""
    )
    (finding,) = mjx_refusals.find(model)
    assert finding.action == HARMLESS and finding.value.startswith('Mesh "drum" has a coplanar')


TWO = """<mujoco><option timestep="0.001">{flag}</option><worldbody>
  <body><joint name="driven" axis="0 1 0"/><geom size="0.05" pos="0.2 0 0" mass="1"/></body>
  <body pos="0 1 0"><joint name="left" axis="0 1 0"/><geom size="0.05" pos="0.2 0 0" mass="1"/>
  </body></worldbody>
  <actuator><position name="a" joint="driven" kp="30" kv="1"/><motor name="b" joint="left"/>
  </actuator>
  <keyframe><key name="start" ctrl="0.4 0.4"/></keyframe></mujoco>"""


def test_a_flag_that_switches_all_actuators_off_is_lifted_for_those_that_are_driven(tmp_path):
    """Held against plain rollouts of C MuJoCo with the flag and without."""
    flagged = TWO.format(flag='<flag actuation="disable"/>')
    robot = read(tmp_path, flagged, keyframe="start", joints=["driven"])
    item = said(robot)["flag actuation"]
    assert (item.where, item.value, item.action, item.engines) == ("option", "disable", ASKED, ())
    off = in_c(mujoco.MjModel.from_xml_string(flagged))
    on = in_c(mujoco.MjModel.from_xml_string(TWO.format(flag="")))
    assert np.all(np.abs(on - off) > 1e-4)  # both actuators count where they are on
    # the drive, as the servo's own law
    (joint,) = robot.joints
    data = mujoco.MjData(robot.model)
    data.ctrl = robot.ctrl
    for _ in range(60):
        force = joint.kp * (joint.setpoint - data.qpos[0]) - joint.kd * data.qvel[0]
        data.ctrl[joint.index] = force
        mujoco.mj_step(robot.model, data)
    assert data.qpos[0] == pytest.approx(on[0], rel=0.03)  # whose damping is implicit
    assert data.qpos[1] == pytest.approx(off[1], abs=1e-12)
    plain = read(tmp_path, TWO.format(flag=""), keyframe="start", joints=["driven"])
    assert "flag actuation" not in said(plain)
