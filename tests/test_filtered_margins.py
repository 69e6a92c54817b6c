"""Continuous margins with a filtered velocity: polynomial roots, brute force, and their limits."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import theory
from gain_limits import continuous_limits
from hypothesis import given, settings
from hypothesis import strategies as st
from quickly import compiled_quickly as compiled_quickly

from jaxact.analysis.boundary.boundary import continuous_boundary
from jaxact.analysis.joint.frequency import JointLoop, loop_response, phase
from jaxact.analysis.joint.margins import margins
from jaxact.analysis.joint.roots import count_unstable_roots, rightmost_root

NUMBER = 1024


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


compiled = jax.jit(lambda loop: (margins(loop), count_unstable_roots(loop), rightmost_root(loop)))
counted = jax.jit(count_unstable_roots)


def filtered_loops(seed, *, delay=True):
    """Random loops (6, n) and the cutoff of each, from far below its crossover to far above."""
    random = np.random.default_rng(seed)
    values = theory.random_loops(NUMBER, seed)
    if not delay:
        values[5] = 0.0
    unit = np.sqrt(values[0] / values[2])
    cutoff = unit * 10 ** random.uniform(-1.0, 3.0, NUMBER)
    cutoff[random.random(NUMBER) < 0.05] = np.inf
    return values, cutoff


def as_loop(values, cutoff):
    return JointLoop(*map(jnp.asarray, values), velocity_filter=jnp.asarray(cutoff))


@functools.cache
def found(*, delay):
    values, cutoff = filtered_loops(11, delay=delay)
    with jax.enable_x64(True):
        result = jax.tree.map(np.asarray, compiled(as_loop(values, cutoff)))
    return values, cutoff, result


def response(values, cutoff, w):
    """L(jw) of one loop from its definition."""
    kp, kd, mass, wn, zeta, delay = values
    s = 1j * w
    servo = 1.0 if np.isinf(wn) else 1.0 / (1.0 + 2.0 * zeta * s / wn + (s / wn) ** 2)
    return (kp + kd * s / (1.0 + s / cutoff)) / (mass * s**2) * servo * np.exp(-s * delay)


def polynomial_roots(values, cutoff):
    """Closed-loop roots of a loop without delay."""
    kp, kd, mass, wn, zeta, _ = values
    servo = np.array([1.0]) if np.isinf(wn) else np.array([1.0 / wn**2, 2.0 * zeta / wn, 1.0])
    lag = np.array([1.0]) if np.isinf(cutoff) else np.array([1.0 / cutoff, 1.0])
    inertia = np.polymul(np.polymul([mass, 0.0, 0.0], servo), lag)
    lead = kd + (0.0 if np.isinf(cutoff) else kp / cutoff)
    return np.roots(np.polyadd(inertia, [lead, kp]))


@pytest.mark.exhaustive
def test_roots_without_delay_are_those_of_the_polynomial():
    values, cutoff, (figures, count, root) = found(delay=False)
    expected = [polynomial_roots(*one) for one in zip(values.T, cutoff, strict=True)]
    rightmost = np.array([roots.real.max() for roots in expected])
    clear = np.abs(rightmost) > 1e-6 * np.array([np.abs(roots).max() for roots in expected])
    assert clear.sum() > 0.8 * NUMBER
    numbers = np.array([np.sum(roots.real > 0) for roots in expected])
    np.testing.assert_array_equal(count[clear], numbers[clear])
    np.testing.assert_array_equal(figures.unstable_roots, count)
    assert 0.2 < figures.stable.mean() < 0.9
    scale = np.abs(root[clear]) + 1e-6
    assert np.max(np.abs(root.real[clear] - rightmost[clear]) / scale) < 1e-5


@pytest.mark.exhaustive
def test_the_count_changes_exactly_at_the_margins():
    values, cutoff, (figures, _, _) = found(delay=True)
    stable = figures.stable
    assert 0.2 < stable.mean() < 0.9
    for row, margin in ((0, figures.gain_margin), (5, figures.delay_margin)):
        for step, unstable in ((-1e-6, False), (1e-6, True)):
            changed = values.copy()
            if row == 0:
                changed[:2] *= np.where(np.isfinite(margin), margin * (1.0 + step), 1.0)
            else:
                changed[5] += np.where(np.isfinite(margin), margin * (1.0 + step), 0.0)
            there = np.asarray(counted(as_loop(changed, cutoff))) > 0
            concerned = stable & np.isfinite(margin)
            assert concerned.sum() > 0.1 * NUMBER
            assert (there[concerned] == unstable).all()


@pytest.mark.exhaustive
def test_margins_and_peaks_are_those_of_a_frequency_grid():
    values, cutoff, (figures, _, _) = found(delay=True)
    for index in np.flatnonzero(figures.stable)[:150]:
        # Where |L| is far from 1 nothing counts, so that the grid can be dense.
        unit = figures.gain_crossover[index]
        w = unit * np.geomspace(1e-3, 1e3, 60_001)
        own = response(values[:, index], cutoff[index], w)
        shape = np.abs(1.0 / (1.0 + own))
        for name, value in (
            ("sensitivity_peak", shape),
            ("complementary_peak", np.abs(own / (1.0 + own))),
            ("disk_margin", np.abs(1.0 / (1.0 + own) - 0.5)),
        ):
            figure = getattr(figures, name)[index]
            peak = max(value.max(), 0.5 if name == "disk_margin" else 1.0)
            figure = 1.0 / figure if name == "disk_margin" else figure
            assert peak <= figure * (1.0 + 1e-9), name
            assert figure <= peak * (1.0 + 2e-3), name
        turned = np.where(np.sign(np.abs(own[1:]) - 1.0) != np.sign(np.abs(own[:-1]) - 1.0))[0]
        least = np.abs(np.angle(-own[turned])).min()
        assert abs(abs(figures.phase_margin[index]) - least) < 2e-3 * (1.0 + least)


def test_responses_and_phase_are_those_of_the_definition():
    values, cutoff = filtered_loops(5)
    w = np.geomspace(0.1, 1e4, 64)
    loop = jax.tree.map(lambda a: a[:32, None], as_loop(values, cutoff))
    own = np.asarray(loop_response(loop, w[None]))
    turned = np.asarray(phase(loop, w[None]))
    for index in range(32):
        expected = response(values[:, index], cutoff[index], w)
        np.testing.assert_allclose(own[index], expected, rtol=1e-9)
        direction = np.exp(1j * (turned[index] - np.pi))
        np.testing.assert_allclose(direction, expected / np.abs(expected), atol=1e-7)


@pytest.mark.exhaustive
def test_no_cutoff_is_no_filter_to_rounding():
    values, _ = filtered_loops(7)
    without = jax.tree.map(np.asarray, jax.jit(margins)(JointLoop(*map(jnp.asarray, values))))
    with_infinity, _, root = compiled(as_loop(values, np.full(NUMBER, np.inf)))
    assert np.isfinite(root).all()
    for name in ("gain_margin", "delay_margin", "sensitivity_peak", "disk_margin", "phase_margin"):
        first, second = getattr(without, name), np.asarray(getattr(with_infinity, name))
        np.testing.assert_allclose(second, first, rtol=1e-8, err_msg=name)
    np.testing.assert_array_equal(without.unstable_roots, with_infinity.unstable_roots)


@pytest.mark.exhaustive
def test_derivatives_with_a_filter_are_those_of_differences():
    def figure(x):
        loop = JointLoop(400.0, 20.0, 0.7, 110.0, 0.9, x[0], velocity_filter=x[1])
        result = margins(loop)
        return jnp.stack([result.gain_margin, result.delay_margin, result.sensitivity_peak])

    at = jnp.array([0.002, 300.0])
    slopes = jax.jit(jax.jacfwd(figure))(at)
    for i, step in enumerate((1e-7, 1e-2)):
        shift = jnp.zeros(2).at[i].set(step)
        difference = (figure(at + shift) - figure(at - shift)) / (2.0 * step)
        np.testing.assert_allclose(slopes[:, i], difference, rtol=1e-5)


@pytest.mark.exhaustive
@settings(max_examples=25, deadline=None)
@given(
    wn=st.sampled_from([40.0, 800.0, np.inf]),
    zeta=st.floats(0.05, 2.0),
    delay=st.sampled_from([0.0, 0.001, 0.02]),
    cutoff=st.floats(5.0, 5e3),
)
def test_marginal_gains_are_roots_on_the_axis_and_limits_lie_on_them(wn, zeta, delay, cutoff):
    mass = 0.7
    window = {"kp_range": (1.0, 1e4), "kd_range": (0.1, 1e3)}
    curves = continuous_boundary(mass, wn, zeta, delay, velocity_filter=cutoff, **window)
    for curve in curves:
        if curve.kind == "line":
            continue
        inertia = mass * curve.frequency**2
        for kp, kd, w, size in zip(curve.kp, curve.kd, curve.frequency, inertia, strict=True):
            own = response((kp, kd, mass, wn, zeta, delay), cutoff, np.array([w]))
            assert abs(1.0 + own[0]) < 1e-6 * (1.0 + kp / size)
    limits = continuous_limits(mass, wn, zeta, delay, velocity_filter=cutoff, kp=400.0, kd=20.0)
    for factor, expected in ((1.0 - 1e-6, 0), (1.0 + 1e-6, 1)):
        if 0 < limits.kp_max < np.inf:
            loop = JointLoop(
                limits.kp_max * factor, 20.0, mass, wn, zeta, delay, jnp.asarray(cutoff)
            )
            assert (int(counted(loop)) > 0) == bool(expected)


@pytest.mark.exhaustive
def test_a_slow_filter_takes_most_of_the_gain_margin():
    """2.44 becomes 1.38 with a filter of 300 rad/s: what a loop's margins say must know of it."""
    values = (80.0, 1.5, 0.02, 300.0, 0.7, 0.002)
    loops = as_loop(np.tile(values, (NUMBER, 1)).T, np.resize([np.inf, 300.0], NUMBER))
    gain = np.asarray(compiled(loops)[0].gain_margin)[:2]
    np.testing.assert_allclose(gain, [2.438635, 1.384931], rtol=1e-6)
    for cutoff, margin in zip((np.inf, 300.0), gain, strict=True):
        w = np.geomspace(10.0, 1000.0, 2_000_001)
        own = response(values, cutoff, w)
        crossed = np.flatnonzero(np.diff(np.sign(own.imag)) != 0)
        largest = -own.real[crossed].min()
        assert abs(margin * largest - 1.0) < 1e-4
