"""Taking back the half step by which MuJoCo's integrator has positions ahead of velocities."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from exact import growth_rate as exact_growth_rate
from quickly import compiled_quickly as compiled_quickly
from robots import PENDULUM

from jaxact.drive import step as drives
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.step import Drive
from jaxact.errors import UserError
from jaxact.loops import loop, reading
from jaxact.loops.loop import Loop
from jaxact.loops.samples import expand
from jaxact.parameters import PRESETS
from jaxact.plants.mass import Mass
from jaxact.plants.mjx import plant as mjx
from jaxact.simulation import plans, single, spectra, trajectory
from jaxact.simulation.growth import rate as growth

SUBSTEPS = 4
OPTIONS = drives.options(Drive(Controller(1.0, 1.0), Actuator(delay=5e-3)), substeps=SUBSTEPS)
_run = jax.jit(trajectory.of_loop, static_argnums=(1, 2))


@pytest.fixture(scope="module")
def slide():
    with jax.enable_x64(True):
        return replace(mjx.load(), corrected=True).with_mass(0.7)


def _errors(slide, drive, options=OPTIONS, velocity=0.0):
    """Largest error of the positions, and of the velocities, in 0.3 s."""
    with jax.enable_x64(True):
        found, want = (
            _run(Loop(plant, drive), options, 300, Setpoint(0.1), velocity=velocity)
            for plant in (slide, Mass(0.7))
        )
    return [
        np.abs(np.asarray(getattr(found, name))[:, 0] - np.asarray(getattr(want, name))).max()
        for name in ("position", "velocity")
    ]


@pytest.mark.parametrize("delay", [0.0, 1.75e-3])
def test_a_joint_moves_exactly_under_forces_that_change_between_steps(slide, delay):
    drive = Drive(Controller(400.0, 20.0), Actuator(delay=delay))
    position, velocity = _errors(slide, drive, velocity=0.5)
    assert position < 1e-12 and velocity < 1e-10


@pytest.mark.exhaustive
def test_under_other_forces_the_error_is_of_second_order(slide):
    drive = Drive(Controller(400.0, 20.0), Actuator(110.0, 0.9, 1.3e-3))
    coarse = _errors(slide, drive, replace(OPTIONS, substeps=2))[0]
    fine = _errors(slide, drive)[0]
    assert coarse < 1e-4
    assert coarse / fine == pytest.approx(4.0, rel=0.2)


def _crossings(rates, values):
    """Where growth rates change sign, linear in the logarithm of the values."""
    places = np.flatnonzero((rates[1:] > 0.0) != (rates[:-1] > 0.0))
    share = rates[places] / (rates[places] - rates[places + 1])
    log = np.log(values)
    return np.exp(log[places] + share * (log[places + 1] - log[places]))


@pytest.fixture(scope="module")
def rates(slide):
    """Growth rates of the corrected slide joint, of shape (gains,), in float64."""

    def rate(kp, kd, wn, zeta, delay):
        built = Loop(slide, Drive(Controller(kp, kd), Actuator(wn, zeta, delay)))
        prepared = loop.prepare(built, OPTIONS)
        state = loop.init(prepared, OPTIONS, 0.0, 0.0)
        how = growth.GrowthOptions(dense=True)
        return growth.growth_rate(prepared, OPTIONS, state, Setpoint(0.0), how)

    return jax.jit(jax.vmap(rate, (0, 0, None, None, None)))


KP, KD = np.geomspace(1.0, 1e5, 100), np.geomspace(1e-3, 2000.0, 100)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("name", "delay"), [("ideal", 0.0), ("ideal", 1e-3), ("hyq", 5e-3), ("starleth", 1e-3)]
)
def test_the_whole_boundary_is_within_two_per_cent_of_the_exact_one(rates, name, delay):
    """Both its edges, along either gain: without the correction the lower one is 30 % off."""
    wn, zeta = PRESETS[name]
    kp = np.concatenate([KP, KP, np.full(100, 300.0)])
    kd = np.concatenate([np.full(100, 5.0), np.full(100, 40.0), KD])
    with jax.enable_x64(True):
        got = np.asarray(rates(jnp.asarray(kp), jnp.asarray(kd), wn, zeta, delay))
    want = exact_growth_rate(kp, kd, 0.7, wn, zeta, delay)
    edges = 0
    for place, varied in enumerate((KP, KP, KD)):
        line = slice(100 * place, 100 * (place + 1))
        found, exact = (_crossings(growth_rates[line], varied) for growth_rates in (got, want))
        assert found.shape == exact.shape
        np.testing.assert_allclose(found, exact, rtol=0.02)
        edges += exact.size
    assert edges >= 4


def _asked(folder, head, plant, rest):
    return reading.parse(f"{head}\nintegrator_correction = true\n[plant]\n{plant}\n{rest}", folder)


@pytest.mark.exhaustive
@pytest.mark.parametrize("engine", ["mjx", "mujoco"])
def test_growth_rates_of_a_robot_are_those_of_the_exact_loop(engine, tmp_path):
    """The slide joint as if it were a robot, in steps of 0.5 ms; and read back from its text."""
    (tmp_path / "slide.xml").write_text(mjx.SLIDE.read_text())
    asked = _asked(
        tmp_path,
        f'engine = "{engine}"\nduration = 0.02\nphysics_step = 0.0005',
        'model = "slide.xml"',
        "[parameters]\nkd = 20\n[axes]\nkp = [30.0, 400.0, 6000.0]",
    )
    assert reading.parse(asked.text, tmp_path) == asked
    samples = expand(asked)
    (plan,) = plans.groups(asked, samples)
    found = spectra.rates_batch(plan, asked, samples, np.resize(np.arange(3), plan.batch)).growth
    want = exact_growth_rate([30.0, 400.0, 6000.0], [20.0] * 3, 0.7, np.inf, 1.0, 0.0)
    np.testing.assert_allclose(found[:3], want, rtol=1e-3)


@pytest.mark.exhaustive
def test_the_robot_itself_is_where_mujoco_has_it(tmp_path):
    """What is drawn of it; only what its drives sense is corrected (both engines: test_robots)."""
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    asked = _asked(
        tmp_path,
        'engine = "mujoco"\nduration = 0.05\nprecision = "float64"',
        'model = "pendulum.xml"\nkeyframe = "home"',
        "[parameters]\nsetpoint = 0.2\ninitial_velocity = 0.3\n[axes]\nfeedforward = [0.0]",
    )
    found = single.simulate(asked).trajectory
    ahead = found.position + 0.5e-3 * found.velocity
    np.testing.assert_allclose(found.configuration, ahead, atol=1e-12)
    assert np.abs(found.velocity).max() > 0.3


def test_where_it_has_no_meaning_it_is_refused(tmp_path):
    with pytest.raises(UserError, match="^integrator_correction = 3"):
        reading.parse("integrator_correction = 3\n[axes]\nkp = [1]")
    text = PENDULUM.replace("<option", '<option integrator="RK4"')
    (tmp_path / "pendulum.xml").write_text(text)
    asked = _asked(
        tmp_path, 'engine = "mujoco"', 'model = "pendulum.xml"', "[axes]\nfeedforward = [0.0]"
    )
    with pytest.raises(UserError, match="integrates with RK4, which needs none"):
        plans.groups(asked, expand(asked))
