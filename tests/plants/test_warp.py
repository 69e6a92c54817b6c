"""MJX-Warp as the engine of a plant, held against C MuJoCo; skipped where it is not installed."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly  # noqa: F401 - a fixture
from robots import HOPPER, PENDULUM, QUADRUPED

from jaxact.drive.step import Force
from jaxact.errors import UserError
from jaxact.plants import warp, warp_room
from jaxact.plants.mjx import plant as mjx
from jaxact.robots import model as models
from jaxact.robots import parity, posture
from jaxact.robots.findings import MJX, REFUSED

LACKING = warp.lacking()
needs_warp = pytest.mark.skipif(bool(LACKING), reason=LACKING or "MJX-Warp is there")


def _robot(tmp_path, text, **options):
    path = tmp_path / "robot.xml"
    path.write_text(text)
    return models.read(path, **options)


def _started(robot):
    """C MuJoCo's data at the posture that a plant starts from."""
    given = posture.given(robot)
    data = mujoco.MjData(robot.model)
    data.qpos, data.qvel, data.ctrl = given.qpos, given.qvel, given.ctrl
    mujoco.mj_forward(robot.model, data)
    return data


def _held(force):
    return Force(*(force for _ in dataclasses.fields(Force)))


def _simulated(robot, forces, velocity=0.0):
    """Configurations of a plant in MJX-Warp under forces (steps, batch, joints), batch second."""
    plant = mjx.place(robot, posture.given(robot), impl="warp")
    plant = plant.prepare(jnp.asarray(robot.model.opt.timestep, jnp.float32))
    start = jnp.asarray([robot.qpos[joint.qpos] for joint in robot.joints], jnp.float32)

    def one(forces, velocity):
        def step(state, force):
            state = plant.advance(state, _held(force))
            return state, state.qpos

        state = plant.init(start, velocity * jnp.ones_like(start))
        return jax.lax.scan(step, state, forces)[1]

    velocity = jnp.broadcast_to(jnp.asarray(velocity, jnp.float32), forces.shape[1])
    found = jax.jit(jax.vmap(one, in_axes=(1, 0), out_axes=1))
    return np.asarray(found(jnp.asarray(forces, jnp.float32), velocity))


def _in_c(robot, forces):
    data = _started(robot)
    found = []
    for force in forces:
        data.ctrl[[joint.index for joint in robot.joints]] = force
        mujoco.mj_step(robot.model, data)
        found.append(data.qpos.copy())
    return np.array(found)


@needs_warp
@pytest.mark.parametrize("text", [mjx.SLIDE.read_text(), PENDULUM, HOPPER])
def test_the_same_motion_as_in_c(text, tmp_path):
    """100 ms under forces that change; the slide joint and the pendulum have no contacts."""
    robot = _robot(tmp_path, text)
    steps = round(0.1 / robot.model.opt.timestep)
    rng = np.random.default_rng(3)
    forces = rng.normal(3.0, 2.0, (steps, 2, len(robot.joints)))
    found = _simulated(robot, forces)
    for number in range(2):
        want = _in_c(robot, forces[:, number])
        assert np.ptp(want, axis=0).max() > 1e-3
        np.testing.assert_allclose(found[:, number], want, rtol=0, atol=1e-5)


@needs_warp
def test_a_delay_of_the_model_is_lifted_and_acts_only_once(tmp_path):
    """MJX-Warp has native delays, which MJX ignores; none is left in what it simulates."""
    late = PENDULUM.replace('kp="80"', 'delay="0.005" nsample="8" kp="80"')
    robot = _robot(tmp_path, late, keyframe="home")
    assert robot.joints[0].setpoint_delay == 0.005
    plant = mjx.place(robot, posture.given(robot), impl="warp")
    assert plant.data.history.size == 0
    plain = _robot(tmp_path, PENDULUM, keyframe="home")
    forces = np.tile(np.random.default_rng(1).normal(0.0, 2.0, (20, 1, 1)), (1, 1, 2))
    np.testing.assert_array_equal(_simulated(robot, forces), _simulated(plain, forces))


@needs_warp
def test_contacts_for_which_there_is_no_room_end_the_simulation(tmp_path, monkeypatch, capfd):
    """A box that falls on its corners: four contacts, of which two find room, or their rows."""
    robot = _robot(
        tmp_path, HOPPER.replace('pos="0 0 0.1">\n      <free', 'pos="0 0 0.11">\n      <free')
    )
    forces = np.zeros((30, 2, 1))
    room = warp_room.room(robot.model, _started(robot))
    assert np.isfinite(_simulated(robot, forces)).all()
    for few in (warp_room.Room(2, room.rows), warp_room.Room(room.contacts, 4)):
        monkeypatch.setattr(warp_room, "room", lambda *_, few=few: few)
        lost = np.isnan(_simulated(robot, forces)).any(axis=2)
        assert lost[-1].all() and not lost[5].any()
    assert capfd.readouterr() == ("", "")


@needs_warp
def test_neighbours_do_not_matter_even_where_they_diverge(tmp_path):
    robot = _robot(tmp_path, HOPPER)
    forces = np.random.default_rng(5).normal(0.0, 3.0, (20, 1, 1))
    alone = _simulated(robot, np.repeat(forces, 2, axis=1), 0.3)[:, 0]
    wild = np.concatenate([1e9 * forces, forces, np.nan * forces, -1e5 * forces], axis=1)
    among = _simulated(robot, wild, [0.0, 0.3, 0.0, 1e4])
    np.testing.assert_array_equal(among[:, 1], alone)
    assert not np.isfinite(among[:, 2]).all()


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("file", ["hopper", "quadruped.xml"])
def test_there_is_room_for_every_contact_that_c_mujoco_finds(file, cone, tmp_path):
    """Postures thrown at random, from the ground up to deep in it."""
    (tmp_path / "hopper.xml").write_text(HOPPER)
    robot = models.read(tmp_path / "hopper.xml" if file == "hopper" else QUADRUPED / file)
    model = robot.model
    model.opt.cone = getattr(mujoco.mjtCone, f"mjCONE_{cone.upper()}")
    data = _started(robot)
    room = warp_room.room(model, data)
    rng = np.random.default_rng(2)
    most = 0
    for _ in range(200):
        data.qpos = robot.qpos + rng.normal(0.0, 0.3, model.nq)
        data.qpos[2] = rng.uniform(-0.2, 0.6)
        mujoco.mj_forward(model, data)
        assert data.ncon <= room.contacts and data.nefc <= room.rows
        most = max(most, data.ncon)
    assert most >= 4


def test_room_is_not_given_for_shapes_that_are_far_apart(tmp_path):
    balls = "".join(
        f'<body pos="{i} 0 0"><joint name="j{i}" type="slide"/><geom type="box" size=".1 .1 .1"/>'
        "</body>"
        for i in range(40)
    )
    robot = _robot(
        tmp_path,
        f'<mujoco><worldbody>{balls}</worldbody><actuator><motor joint="j0"/></actuator></mujoco>',
    )
    room = warp_room.room(robot.model, _started(robot))
    assert room.contacts == 64 and room.rows == 32 * 4, "of 780 pairs, none near"


@pytest.mark.parametrize(
    ("installed", "inside", "said"),
    [
        (False, None, "needs the package warp-lang, which is not installed: pip install"),
        (True, None, "does not fit mujoco-mjx"),
    ],
)
def test_what_is_missing_is_said_in_one_line(installed, inside, said, monkeypatch, tmp_path):
    from mujoco.mjx import warp as package

    monkeypatch.setattr(package, "WARP_INSTALLED", installed)
    monkeypatch.setattr(package, "mujoco_warp", inside)
    robot = _robot(tmp_path, PENDULUM)
    with pytest.raises(UserError, match=said) as caught:
        mjx.place(robot, posture.given(robot), impl="warp")
    assert "\n" not in str(caught.value) and "jaxact[warp]" in str(caught.value)


@needs_warp
def test_what_mjx_warp_refuses_is_named(tmp_path):
    flags = '<option timestep="0.001"><flag midphase="disable" override="enable"/></option>'
    robot = _robot(tmp_path, PENDULUM.replace('<option timestep="0.001"/>', flags))
    assert warp.refusal(robot.model) == "mjENBL_OVERRIDE is unsupported"
    with pytest.raises(UserError, match="robot.xml: option: give the contact parameters to the"):
        mjx.place(robot, posture.given(robot), impl="warp")
    robot = dataclasses.replace(robot, findings=())  # had nobody known of it
    with pytest.raises(UserError, match="robot.xml: MJX-Warp cannot simulate .*OVERRIDE"):
        mjx.place(robot, posture.given(robot), impl="warp")


# Fields that MJX ignores or refuses, by the name of the finding; each pendulum has one of them.
HINGE = """<body pos="0 {i} 0"><joint name="j{i}" axis="0 1 0" {joint}/>
  <geom size="0.05" pos="0.2 0 0" mass="1" {geom}/></body>"""
BALL = """<geom name="floor{i}" type="plane" size="2 2 .1" pos="0 0 -.0499" contype="0"
  conaffinity="{bit}" {floor}/><body gravcomp="{lift}">
  <joint name="x{i}" type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
  <geom name="ball{i}" size="0.05" mass="1" contype="{bit}" conaffinity="0" {ball}/></body>"""


def _model(bodies, *, option="", tendons="", joints=("j0",), contact=""):
    motors = "".join(f'<motor joint="{joint}"/>' for joint in joints)
    return (
        f"<mujoco><option {option}/><worldbody>{''.join(bodies)}</worldbody><tendon>{tendons}"
        f"</tendon><contact>{contact}</contact><actuator>{motors}</actuator></mujoco>"
    )


PENDULA = _model(
    [
        HINGE.format(i=0, joint='stiffness="1 5 5"', geom=""),
        HINGE.format(i=1, joint='damping="0.1 0.2 0.2"', geom=""),
        HINGE.format(i=2, joint="", geom=""),
        HINGE.format(i=3, joint="", geom=""),
    ],
    joints=("j0", "j1", "j2", "j3"),
    tendons='<fixed stiffness="1 5 5"><joint joint="j2" coef="1"/></fixed>'
    '<fixed damping="0.1 0.5 0.5"><joint joint="j3" coef="1"/></fixed>',
)
BALLS = _model(
    [
        BALL.format(i=0, bit=0, floor="", lift=1.2, ball=""),
        BALL.format(i=1, bit=2, floor="", lift=1.2, ball='adhesion="5"'),
        BALL.format(i=2, bit=4, floor='surfacevel="0.5 0 0 0 0 0"', lift=0, ball=""),
    ],
    option='gravity="1 0 -9"',
    joints=("x0", "x1", "x2"),
    contact='<pair geom1="ball0" geom2="floor0" adhesion="5"/>',
)
ELLIPSOIDS = 'fluidshape="ellipsoid"'
FLUID = _model(
    [HINGE.format(i=0, joint="", geom=ELLIPSOIDS)],
    option='density="100" viscosity="1" integrator="implicitfast"',
)
DISCRETE = _model(
    [HINGE.format(i=0, joint='damping="0.2"', geom="")], option='integrator="discrete"'
)
SIMULATED = {
    "joints and tendons": (
        PENDULA,
        {
            "stiffness (polynomial)", "damping (polynomial)", "tendon stiffness (polynomial)",
            "tendon damping (polynomial)",
        },
    ),
    "contacts": (BALLS, {"adhesion", "pair adhesion", "surfacevel"}),
    "fluid": (FLUID, {"density, viscosity", "fluidshape"}),
    "integrator": (DISCRETE, {"integrator"}),
}  # fmt: skip


def test_every_field_that_stops_mjx_alone_is_simulated_below():
    alone = {
        claim.field
        for claim in parity.CLAIMS
        if claim.action == REFUSED and claim.engines == (MJX,)
    }
    assert alone == {field for _, named in SIMULATED.values() for field in named}


@needs_warp
@pytest.mark.parametrize("name", SIMULATED)
def test_fields_that_stop_mjx_and_not_mjx_warp(name, tmp_path):
    """What `jaxact.robots.parity` lets MJX-Warp simulate it simulates as C MuJoCo does."""
    text, fields = SIMULATED[name]
    robot = _robot(tmp_path, text)
    stopped = [item for item in robot.findings if item.engines]
    assert {item.field for item in stopped} == fields
    assert all(item.engines == (MJX,) for item in stopped)
    forces = np.full((60, 2, len(robot.joints)), 0.4)
    want = _in_c(robot, forces[:, 0])
    np.testing.assert_allclose(_simulated(robot, forces)[:, 0], want, rtol=0, atol=1e-5)
