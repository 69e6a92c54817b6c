"""The one-period matrix against scipy's matrix exponential and against plain simulation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import theory
from hypothesis import given
from hypothesis import strategies as st
from quickly import compiled_quickly as compiled_quickly

from jaxact.analysis.sampled.period_map import SampledLoop, delay_steps, one_period_matrix
from jaxact.analysis.sampled.roots import spectral_radius
from jaxact.analysis.sampled.servo import held_transition, servo_integrals

PERIOD = 1e-3


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def sampled_loop(values, period=PERIOD, **kinds):
    cutoff = kinds.pop("velocity_filter", np.inf)
    arrays = [jnp.asarray(v, dtype=float) for v in (*values, period, cutoff)]
    return SampledLoop(*arrays, **kinds)


matrix_of = jax.jit(one_period_matrix, static_argnums=1)
radius_of = jax.jit(spectral_radius, static_argnums=1)


@pytest.mark.parametrize("zeta", [0.01, 0.45, 1.0 - 1e-9, 1.0, 1.0 + 1e-9, 1.7])
@pytest.mark.parametrize("x", [1e-6, 0.03, 0.9, 1.1, 2.5, 40.0])
def test_servo_integrals_solve_their_equation(x, zeta):
    """b_0 from its differential equation, the others by integrating the one before."""

    def flow(_, b):
        return [b[1], -b[0] - 2 * zeta * b[1], b[0], b[2], b[3]]

    solved = scipy.integrate.solve_ivp(
        flow, (0, x), [0, 1, 0, 0, 0], rtol=1e-12, atol=1e-30, method="DOP853"
    ).y[:, -1]
    found = np.array(servo_integrals(jnp.asarray(x), jnp.asarray(zeta)))
    expected = solved[[1, 0, 2, 3, 4]]
    # An absolute error of the first two is all that matters: they oscillate through zero.
    np.testing.assert_allclose(found[:2], expected[:2], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(found[2:], expected[2:], rtol=1e-9)


def test_servo_integrals_are_smooth_through_critical_damping_and_the_series():
    zeta = jnp.array([1.0 - 1e-7, 1.0, 1.0 + 1e-7])
    each = jax.jacrev(lambda z, x: jnp.stack(servo_integrals(x, z)))
    slopes = jax.jit(jax.vmap(each, in_axes=(0, None)))
    for x in (0.4, 2.0 - 1e-9, 2.0 + 1e-9, 7.0):
        slope = np.asarray(slopes(zeta, jnp.asarray(x)))
        assert slope.shape == (3, 5) and np.isfinite(slope).all()
        np.testing.assert_allclose(slope, np.stack([slope[1]] * 3), rtol=1e-5, atol=1e-9)


@pytest.mark.exhaustive
@given(seed=st.integers(0, 100_000), period=st.sampled_from([1e-3, 2.5e-3, 4e-4]))
def test_matrix_equals_the_matrix_exponential(seed, period):
    values = theory.random_loops(1, seed)[:, 0]
    values[5] = min(values[5], 6.9 * period)
    expected = theory.sampled_matrix(values, period)
    steps = int(np.floor(values[5] / period + 1e-12))
    found = np.abs(np.linalg.eigvals(np.asarray(matrix_of(sampled_loop(values, period), 6))))
    ours = np.sort(found)[::-1][: 4 + steps]
    theirs = np.sort(np.abs(np.linalg.eigvals(expected)))[::-1][: 4 + steps]
    np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-8)
    assert radius_of(sampled_loop(values, period), 6) == pytest.approx(theirs[0], rel=1e-8)


@pytest.mark.parametrize("delay", [0.0, 0.37e-3, 1e-3, 1.83e-3, 5e-3])
@pytest.mark.parametrize("cutoff", [np.inf, 300.0])
@pytest.mark.parametrize("wn", [np.inf, 110.0])
def test_differenced_velocity_equals_the_matrix_exponential(delay, cutoff, wn):
    values = (400.0, 20.0, 0.7, wn, 0.9, delay)
    expected = theory.sampled_matrix(values, PERIOD, differenced=True, cutoff=cutoff)
    loop = sampled_loop(values, velocity="differenced", velocity_filter=cutoff)
    assert radius_of(loop, 5) == pytest.approx(np.abs(np.linalg.eigvals(expected)).max(), rel=1e-12)


@pytest.mark.parametrize("variant", ["velocity_sampled", "velocity_backward_difference"])
def test_spectral_radii_of_the_oracle(variant):
    velocity = "sampled" if variant == "velocity_sampled" else "differenced"
    for case, sampled in zip(
        theory.ORACLE["paper_cases"], theory.ORACLE["sampled_1khz"], strict=True
    ):
        values = [theory.plant_values([case], name)[0] for name in theory.NAMES]
        found = radius_of(sampled_loop(values, velocity=velocity), 5)
        assert found == pytest.approx(sampled[variant]["rho"], rel=1e-9), case["name"]


@pytest.mark.parametrize("wn", [np.inf, 150.0])
@pytest.mark.parametrize("delay", [0.0, 0.6e-3, 2e-3, 2.37e-3])
def test_euler_variant_equals_its_own_simulation(wn, delay):
    """v += h F/m, q += h v with the mean force of each substep, stepped one by one."""
    kp, kd, mass, zeta, substeps = 300.0, 15.0, 0.7, 0.4, 4
    h = PERIOD / substeps
    loop = sampled_loop((kp, kd, mass, wn, zeta, delay), integrator="euler", substeps=substeps)
    matrix = np.asarray(matrix_of(loop, 3))

    random = np.random.default_rng(1)
    state = random.normal(size=8)
    state[2:4] *= 0.0 if np.isinf(wn) else 1.0
    q, v, force, rate = state[0], state[1], state[2], state[3] * (0 if np.isinf(wn) else wn)
    commands = [-(kp * q + kd * v), *state[4:]]

    def command_at(t):
        return commands[max(0, int(np.ceil((delay - t) / PERIOD - 1e-9)))]

    def servo(f, g, u, t):
        return scipy.integrate.solve_ivp(
            lambda _, y: [y[1], wn**2 * (u - y[0]) - 2 * zeta * wn * y[1], y[0]],
            (0, t), [f, g, 0.0], rtol=1e-12, atol=1e-14,
        ).y[:, -1]  # fmt: skip

    for i in range(substeps):
        split = np.unique(np.clip([i * h, delay % PERIOD, (i + 1) * h], i * h, (i + 1) * h))
        impulse = 0.0
        for a, b in zip(split[:-1], split[1:], strict=True):
            u = command_at(0.5 * (a + b))
            if np.isinf(wn):
                force, impulse = u, impulse + u * (b - a)
            else:
                force, rate, part = servo(force, rate, u, b - a)
                impulse += part
        v += impulse / mass
        q += h * v
    expected = np.array([q, v, force, 0.0 if np.isinf(wn) else rate / wn, *commands[:4]])
    np.testing.assert_allclose(matrix @ state, expected, rtol=1e-8, atol=1e-10)


@pytest.mark.exhaustive
def test_euler_variant_converges_to_the_exact_one():
    values = (400.0, 20.0, 0.7, 110.0, 0.9, 2.37e-3)
    exact = float(radius_of(sampled_loop(values), 3))
    errors = [
        abs(float(radius_of(sampled_loop(values, integrator="euler", substeps=n), 3)) - exact)
        for n in (1, 2, 4)
    ]
    assert errors[0] > 1.8 * errors[1] > 3.2 * errors[2] > 0


@pytest.mark.exhaustive
def test_radius_is_continuous_and_differentiable_in_the_delay():
    """Across whole periods too, where the command that acts changes."""

    def radius(delay):
        values = (jnp.asarray(a) for a in (400.0, 20.0, 0.7, 110.0, 0.9))
        return spectral_radius(SampledLoop(*values, delay, jnp.asarray(PERIOD)), 6)

    function = jax.jit(jax.value_and_grad(radius))
    for delay in (1.3e-3, 2e-3, 4.999e-3):
        below, above = function(delay - 1e-9)[0], function(delay + 1e-9)[0]
        slope = function(delay)[1]
        np.testing.assert_allclose((above - below) / 2e-9, slope, rtol=1e-4)


@pytest.mark.parametrize("steps", [8, 9, 13])
def test_the_radius_changes_with_a_delay_of_whole_periods_as_differences_say(steps):
    """9 ms less 9 times 1 ms is not 0 but negative, by rounding."""
    values = (100.0, 10.0, 0.7, 110.0, 0.9)
    delay = steps / 1000
    assert (delay - steps * PERIOD < 0.0) == (steps != 8)

    def radius(delay):
        loop = SampledLoop(*map(jnp.asarray, values), delay, jnp.asarray(PERIOD))
        return spectral_radius(loop, 14)

    ends = [
        np.abs(np.linalg.eigvals(theory.sampled_matrix((*values, at), PERIOD))).max()
        for at in (delay - 1e-6, delay + 1e-6)
    ]
    slope = float(jax.grad(radius)(delay))
    np.testing.assert_allclose(slope, (ends[1] - ends[0]) / 2e-6, rtol=1e-3)


def test_a_delay_that_does_not_fit_is_not_a_number():
    loop = sampled_loop((400.0, 20.0, 0.7, 110.0, 0.9, 3e-3))
    assert np.isnan(np.asarray(matrix_of(loop, 2))).all()
    assert np.isfinite(np.asarray(matrix_of(loop, 3))).all()


@pytest.mark.parametrize(
    ("kinds", "message"),
    [({"velocity": "guessed"}, "velocity is"), ({"integrator": "rk4"}, "integrator is")],
)
def test_unknown_kinds_are_refused(kinds, message):
    loop = sampled_loop((400.0, 20.0, 0.7, 110.0, 0.9, 3e-3), **kinds)
    with pytest.raises(ValueError, match=message):
        jax.eval_shape(lambda: one_period_matrix(loop, 3))


def test_the_longest_delay_counts_in_whole_periods():
    delays, periods = np.array([[0.0, 2.999e-3], [3e-3, 0.4]]), np.array([1e-3, 0.1])
    assert delay_steps(delays, periods) == 4
    assert delay_steps(np.array(3e-3), 1e-3) == 3


def test_transition_of_half_steps_composes():
    for wn in (60.0, np.inf):
        whole, push = held_transition(*(jnp.asarray(v) for v in (2e-3, 0.7, wn, 0.3)))
        half, half_push = held_transition(*(jnp.asarray(v) for v in (1e-3, 0.7, wn, 0.3)))
        np.testing.assert_allclose(half @ half, whole, rtol=1e-12, atol=1e-16)
        np.testing.assert_allclose(half @ half_push + half_push, push, rtol=1e-12, atol=1e-16)
