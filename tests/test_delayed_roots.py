"""Growth rates and verdicts of long delays, against SciPy's eigenvalues of the sampled loop."""

import importlib.util
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import quickly
from exact import growth_rate as exact_growth_rate

from jaxact.drive import step as drives
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.step import Drive
from jaxact.loops import loop, reading
from jaxact.loops.loop import Loop
from jaxact.loops.samples import expand, explicit
from jaxact.plants.linear import LinearPlant
from jaxact.simulation import execute, plans
from jaxact.simulation.growth import rate as growth
from jaxact.simulation.robot_loop import period_map
from jaxact.status import Verdict

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(autouse=True)
def quickly_compiled():
    with quickly.optimised_little():
        yield


@pytest.fixture(scope="module")
def campaign():
    path = ROOT / "tools" / "growth_campaign.py"
    spec = importlib.util.spec_from_file_location("growth_campaign", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.exhaustive
@pytest.mark.parametrize(("differenced", "precision"), [(False, "float64"), (True, "float32")])
def test_random_loops(campaign, monkeypatch, differenced, precision):
    monkeypatch.setattr(campaign, "LONGEST", 200)
    monkeypatch.setattr(
        campaign, "_DELAYS", ((0.5, 0.05, 3.0), (0.4, 3.0, 40.0), (0.1, 40.0, 200.0))
    )
    columns = campaign.draw(150, seed=7)
    found = campaign.swept(columns, differenced=differenced, precision=precision)
    counts = campaign.judge(columns, found, differenced=differenced)
    assert counts["stable"] > 20
    assert counts["wrong verdicts"] == counts["wrong growth rates"] == 0
    assert counts["not resolved"] == counts["NaN beside stable"] == 0


def _swept(text):
    specification = reading.parse(text)
    return execute.run(specification, expand(specification))


@pytest.mark.exhaustive
def test_gains_that_hardly_do_anything_at_the_end_of_a_long_line():
    """A short Krylov space saw one of these decay at 8.8 1/s: it grows at 5.7."""
    kp = np.geomspace(0.001, 0.03, 12)
    found = _swept(
        'engine = "mass"\nduration = 0.2\nprecision = "float64"\n[parameters]\nmass = 6.83e-5\n'
        "delay = 0.1333\ncontrol_rate = 2000\nkd = -0.00164\n"
        f"[axes]\nkp = {kp.tolist()}\n"
    )
    want = exact_growth_rate(kp, -0.00164, 6.83e-5, np.inf, 1.0, 0.1333, period=0.5e-3)
    np.testing.assert_allclose(found["growth_rate"], want, rtol=5e-3)
    assert np.all(found["verdict"] == Verdict.UNSTABLE)


@pytest.mark.exhaustive
def test_what_does_not_come_back_has_no_growth_rate_and_is_not_stable():
    """Without stiffness a joint stays wherever it was pushed: a root at z = 1."""
    for delay in (0.002, 0.03):
        found = _swept(
            f'engine = "mass"\nduration = 0.2\n[parameters]\nkp = 0\ndelay = {delay}\n'
            "[axes]\nkd = [0.0, 1.0, 20.0]\n"
        )
        np.testing.assert_allclose(found["growth_rate"], 0.0, atol=2e-6)
        assert np.all(found["verdict"] != Verdict.STABLE)


@pytest.mark.exhaustive
def test_slow_pairs_of_any_damping():
    """Close to their roots the open loop passes gain 1 twice in a narrow band of frequencies."""
    damping = np.linspace(0.4, 1.1, 36)
    kd = np.append(2.0 * 3.4 * damping, 6.8 * 0.7)
    delays = np.append(np.full(36, 0.0021), 0.02)
    columns = {"kd": kd, "delay": delays}
    specification = reading.parse(
        'engine = "mass"\nduration = 0.02\nprecision = "float64"\n[parameters]\nmass = 1.0\n'
        "kp = 11.56\nwn = 16000\nzeta = 0.0013\ncontrol_rate = 6200\n[axes]\nkd = [1.0]\n"
    )
    found = execute.run(specification, explicit(specification, columns))
    want = [
        exact_growth_rate(11.56, d, 1.0, 16000.0, 0.0013, delay, period=1 / 6200)
        for d, delay in zip(kd, delays, strict=True)
    ]
    np.testing.assert_allclose(found["growth_rate"], np.ravel(want), rtol=5e-3)


@pytest.mark.exhaustive
@pytest.mark.parametrize("rate", [1e3, 1e4])
def test_actuators_far_slower_than_the_control_period(rate):
    """Of a grid of gains, whose polynomials in z lose such modes."""
    text = (
        f'engine = "mass"\nduration = 0.02\n[parameters]\nwn = 1.0\nzeta = 0.7\n'
        f"control_rate = {rate}\ndelay = 0.0\n"
        "[axes]\nkp = [1e-3, 0.01, 0.05, 0.2, 1.0]\nkd = [0.003, 0.01, 0.1, 0.3]\n"
    )
    found = _swept(text)
    # The continuous loop: at these rates they differ by far less than the tolerance.
    kp, kd = (a.ravel() for a in np.meshgrid([1e-3, 0.01, 0.05, 0.2, 1.0], [0.003, 0.01, 0.1, 0.3],
                                             indexing="ij"))  # fmt: skip
    want = [np.roots([0.7, 0.7 * 1.4, 0.7, d, p]).real.max() for p, d in zip(kp, kd, strict=True)]
    np.testing.assert_allclose(found["growth_rate"], want, rtol=5e-3, atol=2e-3)


def _chain(rng, joints):
    """A random linear plant of some joints with stiffness and damping, over a step of 1 ms."""
    step = 1e-3
    root = rng.normal(size=(joints, joints))
    mass = root @ root.T + joints * np.eye(joints)
    stiffness = np.diag(rng.uniform(-2.0, 20.0, joints))
    damping = np.diag(rng.uniform(0.0, 1.0, joints))
    inverse = np.linalg.inv(mass)
    eye, none = np.eye(joints), np.zeros((joints, joints))
    velocity = np.hstack([-step * inverse @ stiffness, eye - step * inverse @ damping])
    A = np.vstack([np.hstack([eye, none]) + step * velocity, velocity])
    B = np.vstack([step * step * inverse, step * inverse])
    seen = np.hstack([eye, none]), np.hstack([none, eye])
    return LinearPlant(*(jnp.asarray(a) for a in (A, B, *seen)), step=jnp.asarray(step))


@pytest.mark.exhaustive
def test_robots_with_lines_of_tens_of_periods():
    """The Krylov space of a robot, against all eigenvalues of its whole period matrix."""
    rng = np.random.default_rng(3)
    measure = plans._growth(plans._ROBOT_GROWTH, 1000.0)
    with jax.enable_x64(True):
        for joints, delay in ((2, 0.012), (3, 0.0437), (4, 0.08)):
            plant = _chain(rng, joints)

            def at(scale, plant=plant, joints=joints, delay=delay):
                unit = jnp.ones(joints)
                return Loop(
                    plant,
                    Drive(
                        Controller(scale * 60.0 * unit, scale * 3.0 * unit),
                        Actuator(200.0 * unit, 0.6 * unit, delay * unit),
                        control_period=1e-3,
                    ),
                )

            options = drives.options(at(1.0).drive)

            @jax.jit
            def both(scale, at=at, options=options, joints=joints):
                built = at(scale)
                prepared = loop.prepare(built, options)
                rest = jnp.zeros(joints)
                state = loop.init(prepared, options, rest, rest)
                modes = growth.slow_modes(prepared, options, state, Setpoint(rest), measure)
                return modes.growth * 1000.0, period_map(built, options).M

            for scale in (0.03, 0.3, 1.0, 3.0):
                got, matrix = both(scale)
                want = np.log(np.abs(np.linalg.eigvals(np.asarray(matrix))).max()) * 1000.0
                assert abs(got - want) <= 0.01 * abs(want) + 0.02


@pytest.mark.exhaustive
def test_a_stable_loop_whose_numbers_overflow_is_invalid():
    """Its growth rate is negative, but the metrics of its rollout are not numbers."""
    text = (
        'engine = "mass"\nduration = 0.05\nprecision = "{}"\n[parameters]\nmass = 1e9\nkp = 1e9\n'
        "setpoint = 1e6\ngain_scale = 1e6\ndelay = 1e-5\ncontrol_rate = 1e4\n[axes]\nkd = [1.4e6]\n"
    )
    double, single = (_swept(text.format(kind)) for kind in ("float64", "float32"))
    assert double["growth_rate"][0] == single["growth_rate"][0] < 0.0
    assert double["verdict"][0] == Verdict.STABLE
    assert np.isfinite(double["control_effort"][0])
    assert np.isnan(single["control_effort"][0])
    assert single["verdict"][0] == Verdict.INVALID
