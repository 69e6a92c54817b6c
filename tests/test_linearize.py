"""A robot linearised: against difference quotients of MuJoCo in C, and of the closed loop."""

import copy

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from quickly import compiled_quickly as compiled_quickly
from robots import HOPPER, PENDULUM

from jaxact import Actuator, Controller, Drive, Loop, Sensor, Setpoint
from jaxact.drive import step as drive
from jaxact.loops import loop as loops
from jaxact.plants import linearize
from jaxact.plants.mjx import plant as mjx
from jaxact.robots import model, posture
from jaxact.simulation.growth import rate as growth

STEP = 1e-3


def _robot(folder, text, **options):
    path = folder / "robot.xml"
    path.write_text(text)
    return model.read(path, **options)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    robot = _robot(tmp_path_factory.mktemp("pendulum"), PENDULUM, keyframe="home")
    return robot, posture.settled(robot)


@pytest.fixture(scope="module")
def hopper(tmp_path_factory):
    robot = _robot(tmp_path_factory.mktemp("hopper"), HOPPER)
    return robot, posture.settled(robot)


def _transition(robot, start, step):
    """A and B of mjd_transitionFD, called here on its own."""
    c_model = robot.model
    c_model.opt.timestep = step
    c_model.opt.tolerance = 0.0
    data = mujoco.MjData(c_model)
    data.qpos, data.ctrl = start.qpos, start.ctrl
    data.ctrl[[joint.index for joint in robot.joints]] = start.force
    mujoco.mj_forward(c_model, data)
    size = 2 * c_model.nv
    A, B = np.zeros((size, size)), np.zeros((size, c_model.nu))
    mujoco.mjd_transitionFD(c_model, data, 1e-6, True, A, B, None, None)
    return A, B[:, [joint.index for joint in robot.joints]]


def test_a_step_with_rk4_is_linearised(pendulum):
    robot, start = pendulum
    model = copy.copy(robot.model)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    A, B, _ = linearize.linearise_c(robot, start, 0.02, model)
    model.opt.timestep = 0.02

    def after(deviation, force):
        data = mujoco.MjData(model)
        data.qpos, data.qvel = np.split(np.append(start.qpos, 0.0 * start.qpos) + deviation, 2)
        data.ctrl = start.force + force
        mujoco.mj_step(model, data)
        return np.append(data.qpos, data.qvel)

    none, small = np.zeros(model.nu), 1e-6
    columns = [(after(row, none) - after(-row, none)) / (2 * small) for row in small * np.eye(4)]
    forces = [(after(0.0, row) - after(0.0, -row)) / (2 * small) for row in small * np.eye(2)]
    np.testing.assert_allclose(A, np.transpose(columns), atol=1e-6)
    np.testing.assert_allclose(B, np.transpose(forces), atol=1e-6)


@pytest.mark.exhaustive
def test_jacobians_of_mjx_equal_difference_quotients_of_c(hopper):
    """On its contacts; a robot without any is linearised by the command line's tests."""
    robot, start = hopper
    A, B = _transition(robot, start, STEP)
    with jax.enable_x64(True):
        plant = mjx.place(robot, start).prepare(jnp.asarray(STEP))
        found = jax.jit(linearize.jacobians)(plant, jnp.asarray(start.force))
    np.testing.assert_allclose(found[0], A, atol=1e-5 * np.abs(A).max())
    np.testing.assert_allclose(found[1], B, atol=1e-5 * np.abs(B).max())


def test_a_floating_robot_is_the_same_anywhere_on_the_plane(hopper):
    robot, start = hopper
    found = linearize.linear_c(robot, start, STEP)
    # Two directions and the heading.
    assert found.neutral == 3
    assert found.plant.A.shape == (2 * robot.model.nv - 3,) * 2
    full, _, _ = linearize.linearise_c(robot, start, STEP)
    whole = np.sort(np.abs(np.linalg.eigvals(full)))
    kept = np.sort(np.abs(np.linalg.eigvals(np.asarray(found.plant.A))))
    # Nothing but eigenvalues of 1 has gone.
    ones = np.count_nonzero(np.abs(whole - 1.0) < 1e-9) - np.count_nonzero(np.abs(kept - 1) < 1e-9)
    assert ones == 3
    assert whole[-1] == pytest.approx(kept[-1], rel=1e-9)


def _loop(robot, start, linear):
    control = Controller(kp=jnp.array([80.0, 30.0]), kd=jnp.array([4.0, 1.0]))
    actuator = Actuator(jnp.array([150.0, 200.0]), 0.8, jnp.array([2.3e-3, 1.0e-3]))
    sensor = Sensor(delay=0.7e-3)
    servo = Drive(control, actuator, sensor, control_period=2 * STEP)
    options = drive.options(servo, substeps=2)
    if linear is None:
        plant = mjx.place(robot, start)
        rest = jnp.asarray(start.joints(robot))
    else:
        plant, rest = linear.plant, jnp.zeros(2)
    force = jnp.asarray(start.force) if linear is None else jnp.zeros(2)

    @jax.jit
    def begun(loop):
        prepared = loops.prepare(loop, options)
        return prepared, loops.init(prepared, options, rest, jnp.zeros(2), command=force)

    prepared, state = begun(Loop(plant, servo))
    return prepared, options, state, Setpoint(rest, force=force)


def _period(prepared, options, state, setpoint):
    """The map of the real leaves over one control period."""
    flat, unravel = ravel_pytree(state)

    def advance(vector):
        return ravel_pytree(loops.step(prepared, options, unravel(vector), setpoint)[0])[0]

    return flat, jax.jit(advance)


@pytest.mark.exhaustive
def test_the_closed_loop_equals_its_central_differences(pendulum):
    """Delays, force loops and the plant of the nonlinear loop against the linear plant's loop."""
    robot, start = pendulum
    with jax.enable_x64(True):
        linear = linearize.linear_c(robot, start, STEP)
        flat, advance = _period(*_loop(robot, start, None))
        size = 1e-6
        columns = [
            (advance(flat + size * unit) - advance(flat - size * unit)) / (2 * size)
            for unit in np.eye(flat.size)
        ]
        difference = np.stack(columns, axis=1)
        exact = np.asarray(jax.jacfwd(advance)(flat))
        np.testing.assert_allclose(exact, difference, atol=1e-5 * np.abs(exact).max())
        flat, advance = _period(*_loop(robot, start, linear))
        reduced = np.asarray(jax.jacfwd(advance)(flat))
    whole = np.sort(np.abs(np.linalg.eigvals(difference)))[::-1]
    kept = np.sort(np.abs(np.linalg.eigvals(reduced)))[::-1]
    # The nonlinear loop also carries warm starts and time, whose eigenvalues are 0 and 1.
    whole = whole[np.abs(whole - 1.0) > 1e-9]
    np.testing.assert_allclose(whole[:8], kept[:8], rtol=1e-5)


@pytest.mark.exhaustive
def test_growth_rate_of_the_linear_plant_is_the_spectral_radius(pendulum):
    robot, start = pendulum
    with jax.enable_x64(True):
        linear = linearize.linear_c(robot, start, STEP)
        prepared, options, state, setpoint = _loop(robot, start, linear)
        measure = growth.GrowthOptions(dimension=24)
        modes = jax.jit(growth.slow_modes, static_argnums=(1, 4))(
            prepared, options, state, setpoint, measure
        )
        rate = float(modes.growth) / (2 * STEP)
        flat, advance = _period(prepared, options, state, setpoint)
        radius = np.abs(np.linalg.eigvals(np.asarray(jax.jacfwd(advance)(flat)))).max()
    assert rate == pytest.approx(np.log(radius) / (2 * STEP), abs=0.02)


def test_a_settled_posture_is_an_equilibrium(hopper):
    robot, start = hopper
    assert start.residual < 1e-3
    data = mujoco.MjData(robot.model)
    data.qpos, data.ctrl = start.qpos, start.ctrl
    data.ctrl[[joint.index for joint in robot.joints]] = start.force
    mujoco.mj_forward(robot.model, data)
    assert np.abs(data.qacc).max() == pytest.approx(start.residual, abs=1e-9)
    # Gravity is carried: the arm leans forward, and its motor holds it.
    assert abs(start.force[0]) > 0.1


def test_inverse_dynamics_hold_a_keyframe_that_is_not_settled(pendulum):
    robot, _ = pendulum
    start = posture.given(robot)
    np.testing.assert_array_equal(start.qpos, [0.4, -0.7])
    assert start.residual < 1e-9


TRIPOD = """<mujoco><option timestep="0.0002"/><worldbody>
<geom type="plane" size="5 5 .1" solref="0.0004 1"/>
<body name="trunk" pos="0 0 .0499994"><freejoint/>
  <geom type="box" size=".2 .2 .02" mass="5" contype="0" conaffinity="0"/>
  <geom type="sphere" size=".02" pos=".2 0 -.03" mass=".1" solref="0.0004 1"/>
  <geom type="sphere" size=".02" pos="-.2 .2 -.03" mass=".1" solref="0.0004 1"/>
  <geom type="sphere" size=".02" pos="-.2 -.2 -.03" mass=".1" solref="0.0004 1"/>
  <body pos="0 0 .02"><joint name="arm" axis="0 1 0" damping=".1"/>
    <geom type="capsule" size=".01" fromto="0 0 0 0 0 .2" mass=".5"/></body></body></worldbody>
<actuator><motor joint="arm"/></actuator></mujoco>"""


def _own_transition(robot, start, size):
    """A by central differences of `mj_step` itself."""
    c_model, columns = robot.model, []
    ends = [mujoco.MjData(c_model), mujoco.MjData(c_model)]
    for column in np.eye(2 * c_model.nv):
        for end, sign in zip(ends, (size, -size), strict=True):
            mujoco.mj_resetData(c_model, end)
            end.qpos[:] = start.qpos
            mujoco.mj_integratePos(c_model, end.qpos, sign * column[: c_model.nv], 1.0)
            end.qvel[:] = sign * column[c_model.nv :]
            end.ctrl[:] = start.force
            mujoco.mj_step(c_model, end)
        moved = np.zeros(c_model.nv)
        mujoco.mj_differentiatePos(c_model, moved, 2.0 * size, ends[1].qpos, ends[0].qpos)
        columns.append(np.append(moved, (ends[0].qvel - ends[1].qvel) / (2.0 * size)))
    return np.transpose(columns)


def test_feet_pressed_less_deep_than_a_difference_moves_them_stay_on_the_ground(tmp_path):
    """Ground so stiff that a difference of 1e-6 rad lifts a foot off it."""
    robot = _robot(tmp_path, TRIPOD)
    robot.model.opt.tolerance, robot.model.opt.iterations = 0.0, 100
    start = posture.settled(robot)
    data = mujoco.MjData(robot.model)
    data.qpos = start.qpos
    mujoco.mj_forward(robot.model, data)
    assert len(data.contact) == 3
    assert -1e-6 < data.contact.dist.min() < 0.0
    A, _, _ = linearize.linearise_c(robot, start, 2e-4)
    size = 0.01 * np.abs(data.contact.dist).min()
    scale = np.abs(A).max()
    assert np.abs(A - _own_transition(robot, start, size)).max() < 1e-4 * scale
    # lifted off, it would be another robot
    assert np.abs(A - _own_transition(robot, start, 1e-6)).max() > scale


SLIDER = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
<body><joint name="x" type="slide" axis="1 0 0" range="0 1" limited="true"/>
<geom type="sphere" size=".1" mass="2"/></body></worldbody>
<actuator><motor joint="x"/></actuator>
<keyframe><key name="near" qpos="{gap}"/></keyframe></mujoco>"""


@pytest.mark.parametrize("gap", ["3e-7", "4e-9"])
def test_a_joint_just_before_its_limit_is_free_of_it(gap, tmp_path):
    robot = _robot(tmp_path, SLIDER.format(gap=gap), keyframe="near")
    A, B, _ = linearize.linearise_c(robot, posture.given(robot), 1e-3)
    np.testing.assert_allclose(A, [[1.0, 1e-3], [0.0, 1.0]], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(B, [[5e-7], [5e-4]], rtol=1e-5)
