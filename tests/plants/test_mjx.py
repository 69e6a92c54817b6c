"""The MJX plant: against the spectral radius of its own step, the exact mass, and C MuJoCo."""

import jax
import jax.flatten_util
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from exact import growth_rate as exact_growth_rate
from quickly import compiled_quickly as compiled_quickly

from jaxact.drive import step as drives
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.step import Drive
from jaxact.errors import UserError
from jaxact.loops import loop
from jaxact.loops.loop import Loop
from jaxact.parameters import PRESETS
from jaxact.plants.mass import Mass
from jaxact.plants.mjx import plant as mjx
from jaxact.simulation import trajectory
from jaxact.simulation.growth import rate as growth

SUBSTEPS = 4
KP, KD = (a.ravel() for a in np.meshgrid(np.geomspace(10, 1e5, 32), np.geomspace(0.1, 2000, 32)))
OPTIONS = drives.options(Drive(Controller(1.0, 1.0), Actuator(delay=5e-3)), substeps=SUBSTEPS)


@pytest.fixture(scope="module")
def slide():
    """Growth rate and one-period Jacobian of the slide joint, compiled once, in float64."""
    with jax.enable_x64(True):
        plant = mjx.load()

    def start(kp, kd, wn, zeta, delay):
        built = Loop(plant.with_mass(0.7), Drive(Controller(kp, kd), Actuator(wn, zeta, delay)))
        prepared = loop.prepare(built, OPTIONS)
        return prepared, loop.init(prepared, OPTIONS, 0.0, 0.0)

    def rate(*values):
        prepared, state = start(*values)
        measure = growth.GrowthOptions(dense=True)
        return growth.growth_rate(prepared, OPTIONS, state, Setpoint(0.0), measure)

    def jacobian(*values):
        prepared, state = start(*values)
        flat, back = jax.flatten_util.ravel_pytree(state)

        def period(vector):
            after = loop.step(prepared, OPTIONS, back(vector), Setpoint(0.0))[0]
            return jax.flatten_util.ravel_pytree(after)[0]

        return jax.jacfwd(period)(flat)

    each = (0, 0, None, None, None)
    return jax.jit(jax.vmap(rate, each)), jax.jit(jax.vmap(jacobian, each))


@pytest.mark.exhaustive
@pytest.mark.parametrize(("name", "delay"), [("ideal", 1e-3), ("hyq", 5e-3), ("starleth", 1e-3)])
def test_verdicts_equal_the_spectral_radius_of_the_same_step(slide, name, delay):
    rate, jacobian = slide
    with jax.enable_x64(True):
        arguments = (jnp.asarray(KP), jnp.asarray(KD), *PRESETS[name], delay)
        got = np.asarray(rate(*arguments))
        matrices = np.asarray(jacobian(*arguments))
    radius = np.abs(np.linalg.eigvals(matrices)).max(axis=1)
    decided = np.abs(radius - 1.0) > 1e-3
    assert np.all((got > 0.0) == (radius > 1.0), where=decided)
    np.testing.assert_allclose(got, np.log(radius) / 1e-3, atol=0.02, rtol=0.01)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("name", "delay"), [("ideal", 1e-3), ("hyq", 5e-3), ("starleth", 1e-3)])
def test_boundary_in_gain_is_near_the_exact_one(slide, name, delay):
    """Gain factor at the boundary of MJX at 0.25 ms against that of the exact sampled loop."""
    rate, _ = slide
    wn, zeta = PRESETS[name]

    def crossing(unstable):
        low, high = 1.0, 300.0
        ladder = np.geomspace(low, high, 64)
        for _ in range(3):
            first = int(np.argmax(unstable(ladder)))
            ladder = np.linspace(ladder[first - 1], ladder[first], 64)
        return ladder.mean()

    def simulated(factors):
        with jax.enable_x64(True):
            return np.asarray(rate(400.0 * factors, 20.0 * factors, wn, zeta, delay)) > 0.0

    def exact(factors):
        return exact_growth_rate(400.0 * factors, 20.0 * factors, 0.7, wn, zeta, delay) > 0.0

    assert crossing(simulated) == pytest.approx(crossing(exact), rel=0.02)


@pytest.mark.exhaustive
def test_positions_approach_the_exact_mass_with_the_step():
    drive = Drive(Controller(400.0, 20.0), Actuator(110.0, 0.9, 1.3e-3))
    errors = []
    with jax.enable_x64(True):
        plant = mjx.load().with_mass(0.7)
        run = jax.jit(trajectory.of_loop, static_argnums=(1, 2))
        for substeps in (2, 4):
            options = drives.options(drive, substeps=substeps)
            simulated = run(Loop(plant, drive), options, 300, Setpoint(0.1)).position[:, 0]
            exact = run(Loop(Mass(0.7), drive), options, 300, Setpoint(0.1)).position
            errors.append(float(np.max(np.abs(np.asarray(simulated) - np.asarray(exact)))))
    assert errors[0] < 2e-3
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


def _c_model(delay_steps, step):
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{step}" gravity="0 0 0"/>
        <worldbody><body><joint name="j" type="slide" axis="1 0 0"/>
        <geom type="sphere" size="0.05" mass="0.7" contype="0" conaffinity="0"/></body></worldbody>
        <actuator><motor joint="j" delay="{delay_steps * step}" nsample="{delay_steps + 2}"/>
        </actuator></mujoco>"""
    )


@pytest.mark.parametrize("steps", [1, 5, 19])
def test_c_mujoco_with_its_own_delay_is_the_referee(steps):
    drive = Drive(Controller(400.0, 20.0), Actuator(delay=steps * 1e-3))
    options = drives.options(drive)
    run = jax.jit(trajectory.of_loop, static_argnums=(1, 2))
    path = run(Loop(mjx.load(), drive), options, 2000, Setpoint(0.1))
    model = _c_model(steps, 1e-3)
    data = mujoco.MjData(model)
    want = []
    for _ in range(2000):
        want.append(data.qpos[0])
        data.ctrl[0] = 400.0 * (0.1 - data.qpos[0]) - 20.0 * data.qvel[0]
        mujoco.mj_step(model, data)
    want = np.array(want)
    np.testing.assert_allclose(np.asarray(path.position)[:, 0], want, atol=2e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco><worldbody/></mujoco>", "has no actuators"),
        ("<mujoco><wrong/></mujoco>", "MuJoCo cannot read"),
        (
            """<mujoco><worldbody><body><joint name="j" type="ball"/><geom size="0.1"/></body>
            </worldbody><actuator><motor name="p" joint="j"/></actuator></mujoco>""",
            "ball",
        ),
        (
            """<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>
            <actuator><motor name="p" joint="j" gear="0"/></actuator></mujoco>""",
            "gear",
        ),
    ],
)
def test_models_that_cannot_be_driven_say_why(tmp_path, text, message):
    path = tmp_path / "model.xml"
    path.write_text(text)
    with pytest.raises(UserError, match=message) as caught:
        mjx.load(path)
    assert "\n" not in str(caught.value)
    with pytest.raises(UserError, match="no such model file"):
        mjx.load(tmp_path / "missing.xml")


def test_gears_turn_forces_into_controls(tmp_path):
    path = tmp_path / "geared.xml"
    path.write_text(mjx.SLIDE.read_text().replace('joint="slide"/>', 'joint="slide" gear="50"/>'))
    drive = Drive(Controller(400.0, 20.0), Actuator(110.0, 0.9, 1e-3))
    options = drives.options(drive)
    run = jax.jit(trajectory.of_loop, static_argnums=(1, 2))
    paths = [run(Loop(mjx.load(p), drive), options, 100, Setpoint(0.1)) for p in (path, mjx.SLIDE)]
    np.testing.assert_allclose(paths[0].position, paths[1].position, rtol=1e-5)
