"""The layers below: exact figures and slopes, smooth figures, descent and polish of anything."""

import exact
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import scipy.linalg
import theory
from quickly import compiled_quickly as compiled_quickly

from jaxact.analysis.joint.frequency import JointLoop
from jaxact.tuning.goal import Goal
from jaxact.tuning.joint import metrics, noise, spectrum
from jaxact.tuning.joint import problem as joint
from jaxact.tuning.joint.ensemble import PARAMETERS, Sampling, ensemble
from jaxact.tuning.joint.problem import Case
from jaxact.tuning.joint.rescue import SLOWER, rescue
from jaxact.tuning.objective import Smooth, forward_gradient
from jaxact.tuning.optimise import Descent, descend
from jaxact.tuning.polish import Rows, polish

EXTRA = ("noise_gain", "bandwidth")


@pytest.fixture(scope="module")
def members():
    random = np.random.default_rng(1)
    return ensemble(
        random.uniform(0.1, 3.0, 8), random.uniform(60.0, 800.0, 8),
        random.uniform(0.3, 1.2, 8), random.uniform(0.0, 8e-3, 8),
    )  # fmt: skip


def _gains(members):
    return np.log(0.04 * members.mass / members.lag**2), np.log(0.3 * members.mass / members.lag)


@pytest.mark.exhaustive
def test_slopes_of_exact_figures_are_those_of_central_differences(members):
    log_kp, log_kd = _gains(members)
    plant = {name: getattr(members, name) for name in PARAMETERS}
    found = metrics.evaluate(log_kp, log_kd, plant, Sampling(), EXTRA)
    assert found.stable.all()
    for column in range(6):
        ends = []
        for sign in (1.0, -1.0):
            inputs = [log_kp, log_kd, *plant.values()]
            step = 1e-5 * (np.ones(8) if column < 2 else np.maximum(inputs[column], 1e-3))
            inputs[column] = inputs[column] + sign * step
            moved = dict(zip(PARAMETERS, inputs[2:], strict=True))
            ends.append(metrics.evaluate(inputs[0], inputs[1], moved, Sampling(), EXTRA))
        for name, slope in found.slope.items():
            numeric = (ends[0].log[name] - ends[1].log[name]) / (2.0 * step)
            np.testing.assert_allclose(slope[:, column], numeric, rtol=2e-4, atol=1e-4)


@pytest.mark.exhaustive
def test_smooth_figures_become_the_exact_ones(members):
    log_kp, log_kd = _gains(members)
    names = ("sensitivity_peak", "complementary_peak", "disk_margin", "gain_margin",
             "delay_margin", *EXTRA)  # fmt: skip
    found = metrics.evaluate(log_kp, log_kd, members, Sampling(), EXTRA)
    table = spectrum.tabulate(members, members.lag, 3000)
    with jax.enable_x64(True):
        table = jax.tree.map(jnp.asarray, table)
        every = jax.vmap(
            lambda row, kp, kd: spectrum.log_metrics(row, kp, kd, names, jnp.asarray(1e7))
        )
        smooth, stable = jax.jit(every)(table, np.exp(log_kp), np.exp(log_kd))
    assert stable.all()
    for name in names:
        # The table ends below the Nyquist frequency of a slow joint's encoder.
        near = 1e-2 if name == "noise_gain" else 2e-3
        np.testing.assert_allclose(smooth[name], found.log[name], atol=near, err_msg=name)


@pytest.mark.exhaustive
@pytest.mark.parametrize("period", [0.0, 2e-3])
def test_the_winding_of_the_table_counts_as_the_roots_do(members, period):
    sampling = Sampling(period, "differenced", 300.0) if period else Sampling()
    sampled = ensemble(*(getattr(members, name) for name in PARAMETERS), sampling=sampling)
    table = spectrum.tabulate(sampled, sampled.lag, 1200)
    random = np.random.default_rng(2)
    log_kp, log_kd = (row + random.uniform(-3.0, 3.0, (25, 8)) for row in _gains(members))
    with jax.enable_x64(True):
        table = jax.tree.map(jnp.asarray, table)
        one = jax.vmap(lambda row, kp, kd: spectrum.is_stable(*spectrum.open_loop(row, kp, kd)))
        found = np.asarray(jax.vmap(one, (None, 0, 0))(table, jnp.exp(log_kp), jnp.exp(log_kd)))
    growth = _growth_rates(members, np.exp(log_kp), np.exp(log_kd), period)
    assert 30 < np.sum(growth < 0) < 190
    # Only right at the boundary may a table differ.
    differ = found != (growth < 0)
    assert np.all(np.abs(growth * sampled.lag)[differ] < 0.02) and differ.sum() <= 2


def _growth_rates(members, kp, kd, period):
    """Real part of the rightmost root [1/s], by the tests' own matrices; shape (25, 8)."""
    rows = [getattr(members, name) for name in PARAMETERS]
    if period:
        each = [
            exact.growth_rate(kp[:, i], kd[:, i], *(row[i] for row in rows), period=period,
                              differenced=True, cutoff=300.0)
            for i in range(len(members))
        ]  # fmt: skip
        return np.stack(each, axis=1)
    values = np.stack([kp, kd, *(np.broadcast_to(row, kp.shape) for row in rows)])
    roots = theory.collocation_roots(values.reshape((6, -1)), 60)
    return roots.real.max(axis=1).reshape(kp.shape)


def test_noise_gain_is_the_h2_norm():
    """Without delay the force is a state: its variance solves a Lyapunov equation."""
    kp, kd, m, wn, zeta, period = 300.0, 20.0, 0.7, 110.0, 0.9, 1e-5
    # q, v, f, f' under u = -(kp (q + n) + kd v_n): the noise enters differentiated, so add a state
    # for it: n is white noise through a very fast filter.
    fast = 2e4
    a = np.zeros((5, 5))
    a[0, 1], a[1, 2], a[2, 3] = 1.0, 1.0 / m, 1.0
    a[3, :4] = [-(wn**2) * kp, -(wn**2) * kd, -(wn**2), -2.0 * zeta * wn]
    # measured: q + n, v + n' with n' = fast (white - n)
    a[3, 4] = -(wn**2) * (kp - kd * fast)
    a[4, 4] = -fast
    b = np.zeros((5, 1))
    b[3, 0], b[4, 0] = -(wn**2) * kd * fast, fast
    density = period / 12.0
    covariance = scipy.linalg.solve_continuous_lyapunov(a, -b @ b.T * density)
    with jax.enable_x64(True):
        loop = JointLoop(*(jnp.full(1, v) for v in (kp, kd, m, wn, zeta, 0.0)))
        found = float(noise.noise_gain(loop, period)[0])
    assert found == pytest.approx(np.sqrt(covariance[2, 2]), rel=5e-3)


@pytest.mark.exhaustive
def test_bandwidth_is_where_the_response_has_fallen_to_half_power(members):
    log_kp, log_kd = _gains(members)
    found = metrics.evaluate(log_kp, log_kd, members, Sampling(), EXTRA)
    w = np.exp(found.log["bandwidth"])
    m, wn, zeta, td = (getattr(members, name) for name in PARAMETERS)
    s = 1j * w
    unit = np.exp(-s * td) / (m * s**2 * (1 + 2 * zeta * s / wn + (s / wn) ** 2))
    kp, kd = np.exp(log_kp), np.exp(log_kd)
    size = np.abs(kp * unit / (1 + (kp + kd * s) * unit))
    np.testing.assert_allclose(size, np.sqrt(0.5), rtol=1e-9)


def test_forward_gradient_is_the_gradient():
    def f(x, a):
        return jnp.sum(jnp.sin(x) * a)

    x, a = jnp.arange(3.0), jnp.array([1.0, -2.0, 0.5])
    np.testing.assert_allclose(jax.grad(forward_gradient(f))(x, a), jax.grad(f)(x, a), rtol=1e-6)


def _paraboloid(x, data, sharpness):
    """A robot of five gains: as large as possible inside a ball around the data."""
    radius = jnp.sum((x - data) ** 2) - 1.0
    return Smooth(jnp.sum(x), radius, jnp.all(x < 5.0))


def _chain(steps):
    # Longer steps end up to 2.5 % away where rounding decides; with these, 0.4 % from 120 starts.
    rate = optax.cosine_decay_schedule(0.05, steps, alpha=0.005)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.rmsprop(rate, decay=0.95))


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "how", [Descent(gradient="forward"), Descent(gradient="reverse"), Descent(chain=_chain)]
)
def test_any_number_of_gains_descends_with_any_chain(how):
    centre = jnp.linspace(-1.0, 1.0, 5)[None]
    starts = jnp.zeros((1, 3, 5)) + jnp.array([0.0, 1.0, 2.0])[None, :, None]
    found = descend(_paraboloid, centre, starts, jnp.full(5, -1.0), how)
    # Near enough for the polish, whatever the chain.
    np.testing.assert_allclose(found.value, np.sqrt(5.0), rtol=5e-3)
    assert np.all(np.asarray(found.violation) < 1e-3)


def test_polish_finds_a_vertex_a_tangent_point_and_a_kink():
    def rows(x):
        a, b = x.T
        # tangent: a under a parabola; vertex: two lines; kink: one row that is a maximum
        first = np.stack([a + b * b - 1.0, a - 9.0], 1)
        first_slope = np.stack(
            [np.stack([np.ones_like(a), 2 * b], 1), np.tile([1.0, 0.0], (3, 1))], 1
        )
        second = np.stack([a + b - 1.0, a - b - 1.0], 1)
        second_slope = np.tile([[[1.0, 1.0], [1.0, -1.0]]], (3, 1, 1))
        sign = np.where(a + np.exp(b) > a + np.exp(-2 * b), 1.0, -2.0)
        third = np.stack([a + np.exp(sign * b) - 2.0, a - 9.0], 1)
        third_slope = np.stack(
            [np.stack([np.ones_like(a), sign * np.exp(sign * b)], 1), np.tile([1.0, 0.0], (3, 1))],
            1,
        )
        excess = np.stack([first[0], second[1], third[2]])
        slope = np.stack([first_slope[0], second_slope[1], third_slope[2]])
        value_slope = np.tile([[[1.0, 0.0]]], (3, 1, 1))
        return Rows(x[:, :1], value_slope, excess, slope, np.ones(3, bool))

    found = polish(rows, np.array([[0.2, 0.4]] * 3), np.full((3, 2), -5.0), np.full((3, 2), 5.0))
    assert found.feasible.all()
    np.testing.assert_allclose(found.x[:, 0], 1.0, atol=1e-6)


def test_rescue_reaches_the_stable_side_of_a_line():
    def distance(x):
        return 1.0 - x.sum(axis=1), np.full_like(x, -1.0)

    start = np.array([[3.0, 2.0], [0.1, 0.2]])
    there, steps = rescue(distance, start, SLOWER, np.full((2, 2), -9.0), np.full((2, 2), 9.0))
    assert there[0].sum() < 1.0 and steps[0] > 0
    np.testing.assert_array_equal(there[1], start[1])


def test_default_starts_are_the_same_but_for_scale():
    slow = Case(ensemble(2.0, 50.0, 0.9, 0.01), Goal())
    fast = Case(ensemble(0.5, 500.0, 0.9, 0.001), Goal())
    first, second = joint.starts(slow, 12), joint.starts(fast, 12)
    shift = np.log([4.0 / 100.0, 4.0 / 10.0])
    np.testing.assert_allclose(first, second + shift, rtol=1e-12)
