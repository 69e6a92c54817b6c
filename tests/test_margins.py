"""Continuous margins against the oracle, against root counts by collocation, and themselves."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import theory
from hypothesis import given, settings
from hypothesis import strategies as st
from quickly import compiled_quickly as compiled_quickly

from jaxact.analysis.joint.frequency import (
    JointLoop,
    complementary_sensitivity,
    loop_response,
    sensitivity,
)
from jaxact.analysis.joint.margins import Margins, margins
from jaxact.analysis.joint.roots import count_unstable_roots, rightmost_root, spectral_abscissa

FIELDS = tuple(f.name for f in dataclasses.fields(Margins))
compiled = jax.jit(margins)
counted = jax.jit(count_unstable_roots)
abscissa_of = jax.jit(spectral_abscissa)


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


CHUNK = 1024


def in_chunks(function, values, dtype=None):
    """`function` of loops (6, n) as a NumPy pytree, compiled for one shape only."""
    values = np.asarray(values, dtype=float)
    number = values.shape[1]
    padded = np.pad(values, ((0, 0), (0, -number % CHUNK)), mode="edge")
    parts = [
        jax.tree.map(np.asarray, function(theory.joint_loop(part, dtype)))
        for part in np.split(padded, padded.shape[1] // CHUNK, axis=1)
    ]
    return jax.tree.map(lambda *a: np.concatenate(a)[:number], *parts)


def evaluate(values, dtype=None):
    return in_chunks(compiled, values, dtype)


def count(values):
    return in_chunks(counted, values)


PAPER = np.array([theory.plant_values(theory.CONTINUOUS, name) for name in theory.NAMES])


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("dtype", "tolerance"), [("float64", 1e-9), ("float32", 1e-4)], ids=["double", "single"]
)
def test_every_continuous_figure_of_the_oracle(dtype, tolerance):
    found = evaluate(PAPER, dtype)
    assert found.gain_margin.dtype == dtype
    np.testing.assert_array_equal(
        found.unstable_roots, theory.figures(theory.CONTINUOUS, "unstable_roots")
    )
    np.testing.assert_array_equal(found.stable, found.unstable_roots == 0)
    for name, key in {
        "gain_margin": "gain_margin",
        "gain_crossover": "gain_crossover",
        "delay_margin": "delay_margin",
        "sensitivity_peak": "sensitivity_peak",
        "complementary_peak": "complementary_peak",
        "disk_margin": "disk_margin_balanced",
        "phase_margin": "phase_margin_deg",
    }.items():
        value = getattr(found, name).astype(float)
        value = np.degrees(value) if name == "phase_margin" else value
        expected = theory.figures(theory.CONTINUOUS, key)
        np.testing.assert_allclose(value, expected, rtol=tolerance, err_msg=name)
    np.testing.assert_allclose(found.modulus_margin, 1.0 / found.sensitivity_peak, rtol=tolerance)
    for name in ("sensitivity_peak_frequency", "phase_crossover"):
        expected = theory.figures(theory.CONTINUOUS, name)
        known = np.isfinite(expected)
        value = getattr(found, name)[known]
        np.testing.assert_allclose(value, expected[known], rtol=max(tolerance, 1e-6), err_msg=name)


@pytest.mark.parametrize(("dtype", "tolerance"), [("float64", 1e-9), ("float32", 1e-4)])
def test_rightmost_roots_of_the_oracle(dtype, tolerance):
    found = abscissa_of(theory.joint_loop(PAPER, dtype))
    expected = theory.figures(theory.CONTINUOUS, "spectral_abscissa")
    np.testing.assert_allclose(found, expected, rtol=tolerance)


@pytest.fixture(scope="module")
def crowd():
    """10,000 random loops, half of them unstable by an independent count, and that count."""
    candidates = theory.random_loops(14_000, seed=3)
    counts = theory.collocation_count(candidates)
    stable = np.flatnonzero(counts == 0)[:5000]
    unstable = np.flatnonzero(counts > 0)[:5000]
    assert len(stable) == len(unstable) == 5000
    chosen = np.concatenate([stable, unstable])
    return candidates[:, chosen], counts[chosen]


@pytest.fixture(scope="module")
def crowd_margins(crowd):
    with jax.enable_x64(True):
        return evaluate(crowd[0])


@pytest.mark.exhaustive
def test_ten_thousand_root_counts_agree_with_collocation(crowd, crowd_margins):
    np.testing.assert_array_equal(crowd_margins.unstable_roots, crowd[1])


@pytest.mark.exhaustive
def test_stable_loops_have_no_nan_and_unstable_loops_no_margins(crowd_margins):
    stable = crowd_margins.stable
    for name in FIELDS:
        value = getattr(crowd_margins, name).astype(float)
        assert not np.isnan(value[stable]).any(), name
        if name not in ("stable", "unstable_roots", "log_gain_to_boundary"):
            assert np.isnan(value[~stable]).all(), name
    distance = crowd_margins.log_gain_to_boundary
    assert (distance[stable] > 0).all()
    assert (distance[~stable] < 0).all() and np.isfinite(distance[~stable]).all()


def scaled(values, factor, added_delay=0.0):
    changed = values.copy()
    changed[:2] *= factor
    changed[5] += added_delay
    return changed


@pytest.mark.parametrize("step", [1e-6, 1e-8])
def test_gain_and_delay_margins_are_exactly_where_the_count_changes(crowd, crowd_margins, step):
    stable = crowd_margins.stable
    values = crowd[0][:, stable]
    gain, delay = crowd_margins.gain_margin[stable], crowd_margins.delay_margin[stable]
    finite = np.isfinite(gain)
    assert (count(scaled(values, np.where(finite, gain * (1 - step), 1e3))) == 0).all()
    assert (count(scaled(values, np.where(finite, gain * (1 + step), 1.0)))[finite] > 0).all()
    assert (count(scaled(values, 1.0, delay * (1 - step))) == 0).all()
    assert (count(scaled(values, 1.0, delay * (1 + step))) > 0).all()
    # Lowering all gains of a PD loop never destabilises it.
    assert (crowd_margins.gain_reduction_margin[stable] == 0).all()
    assert (count(scaled(values, 1e-3)) == 0).all()


def test_the_log_distance_is_the_factor_that_rescues_an_unstable_loop(crowd, crowd_margins):
    values, distance = crowd[0], crowd_margins.log_gain_to_boundary
    kp, kd, _, wn, zeta, delay = values
    unstable = ~crowd_margins.stable
    by_factor = unstable & (kd > kp * (delay + 2.0 * zeta / wn))
    assert by_factor.sum() > 1000
    for beyond, expected in ((1e-6, True), (-1e-6, False)):
        factor = np.where(by_factor, np.exp(distance - beyond), 1.0)
        np.testing.assert_array_equal(count(scaled(values, factor))[by_factor] == 0, expected)
    # No common factor helps the others; slowing down, (kp k^2, kd k), does.
    slow = unstable & ~by_factor
    for beyond, least in ((1e-6, 0.995), (-1e-6, 0.0)):
        factor = np.where(slow, np.exp(distance - beyond), 1.0)
        slowed = values.copy()
        slowed[0] *= factor**2
        slowed[1] *= factor
        rescued = (count(slowed)[slow] == 0).mean()
        assert rescued >= least and (beyond > 0 or rescued == 0.0)


def test_peaks_are_the_maxima_of_a_dense_grid(crowd, crowd_margins):
    random = np.random.default_rng(0)
    servo = np.isfinite(crowd[0][3]) & crowd_margins.stable
    chosen = random.choice(np.flatnonzero(servo), 150, replace=False)
    for j in chosen:
        centre = crowd_margins.gain_crossover[j]
        near = crowd_margins.sensitivity_peak_frequency[j]
        near = near if np.isfinite(near) else centre
        w = np.concatenate(
            [np.geomspace(3e-3, 3e2, 6000) * centre, np.linspace(0.9, 1.1, 999) * near]
        )
        value = theory.response(crowd[0][:, j], w)
        for name, curve in (
            ("sensitivity_peak", np.abs(1 / (1 + value))),
            ("complementary_peak", np.abs(value / (1 + value))),
            ("disk_margin", np.abs((1 - value) / (1 + value) / 2)),
        ):
            peak = getattr(crowd_margins, name)[j]
            peak = 1.0 / peak if name == "disk_margin" else peak
            assert curve.max() <= peak * (1 + 1e-9), (name, crowd[0][:, j])
            assert curve.max() >= peak * (1 - 2e-2), (name, crowd[0][:, j])


def test_abscissa_sign_agrees_with_the_count_and_is_a_root(crowd):
    values = crowd[0][:, ::10]
    root = np.asarray(jax.jit(rightmost_root)(theory.joint_loop(values)))
    np.testing.assert_array_equal(root.real > 0, crowd[1][::10] > 0)
    kp, kd, mass, wn, zeta, delay = values
    servo = 1 + 2 * zeta * root / wn + (root / wn) ** 2
    inertia, control = mass * root**2 * servo, (kp + kd * root) * np.exp(-root * delay)
    assert np.max(np.abs(inertia + control) / np.abs(inertia)) < 1e-7
    assert (root.imag >= 0).all()


@pytest.mark.exhaustive
def test_single_precision_agrees_with_double(crowd, crowd_margins):
    """Away from the boundary, where the question is well posed in seven digits."""
    found = evaluate(crowd[0], "float32")
    clear = np.abs(crowd_margins.log_gain_to_boundary) > 1e-2
    np.testing.assert_array_equal(
        found.stable[clear], crowd_margins.stable[clear], err_msg="verdict"
    )
    robust = clear & crowd_margins.stable & (crowd_margins.sensitivity_peak < 20)
    for name in ("gain_margin", "delay_margin", "sensitivity_peak", "disk_margin"):
        expected = getattr(crowd_margins, name)[robust]
        known = np.isfinite(expected)
        error = np.abs(getattr(found, name)[robust][known] / expected[known] - 1)
        assert np.quantile(error, 0.99) < 1e-4, name


# --- the cases that break other tools ---------------------------------------------------------


def test_delay_margin_is_not_the_smallest_phase_margin_over_its_frequency():
    """A stable, lightly damped loop with three gain crossovers."""
    loop = np.array([[480.0], [53.0], [4.2], [196.0], [0.0125], [0.015]])
    found = evaluate(loop)
    assert found.stable[0]
    naive = found.phase_margin[0] / found.gain_crossover[0]
    assert found.delay_margin[0] < 0.5 * abs(naive)
    edge = found.delay_margin[0]
    assert count(scaled(loop, 1.0, edge * (1 - 1e-9)))[0] == 0
    assert count(scaled(loop, 1.0, edge * (1 + 1e-9)))[0] == 2


def test_an_unstable_loop_whose_sensitivity_looks_harmless():
    """|S| stays near 1 all along the axis, and the loop is unstable all the same."""
    loop = np.array([[1e5], [2000.0], [0.01], [np.inf], [1.0], [0.02]])
    w = np.geomspace(1.0, 1e5, 200_000)
    peak = np.abs(1 / (1 + theory.response(loop[:, 0], w))).max()
    assert peak < 1.12
    found = evaluate(loop)
    assert not found.stable[0] and found.unstable_roots[0] > 100
    assert np.isnan(found.sensitivity_peak[0]) and found.log_gain_to_boundary[0] < -1


def test_an_ideal_actuator_without_delay_has_infinite_gain_margin():
    found = evaluate(np.array([[400.0], [20.0], [0.7], [np.inf], [1.0], [0.0]]))
    assert found.gain_margin[0] == np.inf and found.phase_crossover[0] == np.inf
    assert found.log_gain_to_boundary[0] == np.inf
    np.testing.assert_allclose(found.delay_margin[0], 0.030917011393690387, rtol=1e-12)


def test_an_overdamped_ideal_loop_has_no_sensitivity_peak():
    found = evaluate(np.array([[10.0], [50.0], [0.7], [np.inf], [1.0], [0.0]]))
    assert found.sensitivity_peak[0] == 1.0 and found.sensitivity_peak_frequency[0] == np.inf
    assert found.disk_margin[0] <= 2.0


@pytest.mark.parametrize(("kp", "kd"), [(-10.0, 5.0), (0.0, 5.0), (100.0, -1.0), (-5.0, -1.0)])
def test_gains_of_the_wrong_sign_are_unstable(kp, kd):
    loop = np.array([[kp], [kd], [0.7], [110.0], [0.9], [0.005]])
    found = evaluate(loop)
    expected = theory.collocation_roots(loop, 30).real
    assert not found.stable[0]
    assert found.unstable_roots[0] == np.sum(expected > -1e-9)


# --- derivatives -------------------------------------------------------------------------------

SMOOTH = tuple(f for f in FIELDS if f not in ("stable", "unstable_roots", "gain_reduction_margin"))


def vector(values):
    result = margins(JointLoop(*values))
    return jnp.stack([getattr(result, name) for name in SMOOTH])


CROWD = 160


forwards = jax.jit(jax.vmap(jax.jacfwd(vector), in_axes=1))
backwards = jax.jit(jax.vmap(jax.jacrev(vector), in_axes=1))


def jacobians(function, values):
    """Derivatives of the figures of loops (6, n), shape (n, figures, 6); for one shape compiled."""
    padded = np.pad(values, ((0, 0), (0, -values.shape[1] % CROWD)), mode="edge")
    return np.asarray(function(jnp.asarray(padded)))[: values.shape[1]]


@pytest.mark.exhaustive
def test_every_derivative_equals_central_differences(crowd):
    """Forward and reverse, every margin by every parameter, at stable and unstable loops."""
    paper = PAPER[:, np.isfinite(PAPER[3])]
    values = np.concatenate([paper, crowd[0][:, :60], crowd[0][:, -60:]], axis=1)
    values = values[:, np.isfinite(values[3]) & (values[5] > 1e-4)]
    number = values.shape[1]
    forward, reverse = jacobians(forwards, values), jacobians(backwards, values)

    step = 1e-6
    stacked = np.repeat(values[:, None, :], 12, axis=1)
    for i in range(6):
        stacked[i, 2 * i] *= 1 + step
        stacked[i, 2 * i + 1] *= 1 - step
    found = evaluate(stacked.reshape(6, -1))
    base = evaluate(values)
    for k, name in enumerate(SMOOTH):
        shifted = getattr(found, name).reshape(6, 2, number)
        with np.errstate(invalid="ignore"):
            difference = (shifted[:, 0] - shifted[:, 1]).T / (2 * step * values.T)
        # In logarithmic measure, so that one tolerance serves all.
        scale = values.T / np.maximum(np.abs(getattr(base, name)), 1e-3)[:, None]
        known = np.isfinite(difference).all(axis=1) & np.isfinite(getattr(base, name))
        assert known.sum() > 50, name
        for derivative in (forward[:, k], reverse[:, k]):
            error = np.abs(derivative - difference)[known] * scale[known]
            size = 1.0 + np.abs(difference * scale)[known]
            assert np.median(error / size) < 1e-8, name
            assert np.quantile(error / size, 0.97) < 1e-5, name
            assert np.isfinite(derivative[known]).all(), name


@pytest.mark.exhaustive
def test_derivatives_of_an_ideal_actuator_are_finite():
    loop = np.array([[400.0], [20.0], [0.7], [np.inf], [1.0], [0.001]])
    (jacobian,) = jacobians(backwards, loop)
    assert np.isfinite(jacobian).all()
    np.testing.assert_array_equal(jacobian[:, 3:5], 0.0)


@pytest.mark.exhaustive
def test_the_distance_is_smooth_through_the_boundary():
    """Its gradient is the same just inside and just outside."""
    margin = evaluate(PAPER[:, 8:9]).gain_margin[0]  # StarlETH, 5 ms
    loops = np.repeat(PAPER[:, 8:9], 2, axis=1)
    loops[:2] *= margin * np.array([1 - 1e-5, 1 + 1e-5])  # just inside, just outside
    np.testing.assert_allclose(evaluate(loops).log_gain_to_boundary, [1e-5, -1e-5], rtol=1e-4)
    slopes = jacobians(backwards, loops)[:, SMOOTH.index("log_gain_to_boundary")] * loops.T
    np.testing.assert_allclose(*slopes, rtol=1e-3, atol=1e-6)


@pytest.mark.exhaustive
def test_derivative_of_the_rightmost_root():
    values = jnp.array(PAPER[:, 8])
    function = jax.jit(jax.value_and_grad(lambda x: spectral_abscissa(JointLoop(*x))))
    gradient = np.asarray(function(values)[1])
    for i in range(6):
        high, low = (values.at[i].multiply(1 + s) for s in (1e-6, -1e-6))
        expected = (function(high)[0] - function(low)[0]) / (2e-6 * values[i])
        np.testing.assert_allclose(gradient[i], expected, rtol=1e-6)


# --- shapes, transformations, invariants -------------------------------------------------------


@pytest.mark.exhaustive
def test_fields_broadcast_and_transformations_compose():
    kp = np.geomspace(50.0, 2000.0, 5)[:, None]
    delay = np.array([0.0, 0.001, 0.005])
    loop = JointLoop(kp, 20.0, 0.7, 110.0, 0.9, delay)
    whole = compiled(loop)
    assert whole.gain_margin.shape == (5, 3)
    mapped = jax.vmap(lambda k: margins(JointLoop(k, 20.0, 0.7, 110.0, 0.9, delay)))
    one_by_one = jax.jit(mapped)(kp[:, 0])
    for name in FIELDS:
        np.testing.assert_allclose(
            getattr(whole, name), getattr(one_by_one, name), rtol=1e-11, err_msg=name
        )
    single = compiled(JointLoop(kp[2, 0], 20.0, 0.7, 110.0, 0.9, delay[1]))
    assert single.gain_margin.shape == ()
    np.testing.assert_allclose(single.gain_margin, whole.gain_margin[2, 1], rtol=1e-11)


@settings(max_examples=12)
@given(
    seed=st.integers(0, 10_000),
    time=st.floats(0.1, 10.0),
    weight=st.floats(0.1, 10.0),
)
def test_scaling_mass_and_gains_or_time_changes_no_ratio(seed, time, weight):
    values = theory.random_loops(CHUNK // 2, seed)
    kp, kd, mass, wn, zeta, delay = values
    changed = np.array(
        [kp * weight / time**2, kd * weight / time, mass * weight, wn / time, zeta, delay * time]
    )
    both = evaluate(np.concatenate([values, changed], axis=1))
    plain, other = (jax.tree.map(lambda a, i=i: np.split(a, 2)[i], both) for i in range(2))
    for name in ("gain_margin", "phase_margin", "sensitivity_peak", "disk_margin"):
        np.testing.assert_allclose(getattr(other, name), getattr(plain, name), rtol=1e-7)
    np.testing.assert_allclose(other.delay_margin, plain.delay_margin * time, rtol=1e-7)
    np.testing.assert_array_equal(other.unstable_roots, plain.unstable_roots)


def test_a_fast_actuator_approaches_the_ideal_one():
    fast = evaluate(np.array([[400.0], [20.0], [0.7], [1e7], [0.7], [0.001]]))
    ideal = evaluate(np.array([[400.0], [20.0], [0.7], [np.inf], [1.0], [0.001]]))
    for name in ("gain_margin", "phase_margin", "delay_margin", "sensitivity_peak", "disk_margin"):
        np.testing.assert_allclose(getattr(fast, name), getattr(ideal, name), rtol=1e-3)


def test_responses_equal_their_definition():
    values = PAPER[:, 8]
    w = np.geomspace(1.0, 1e3, 50)
    expected = theory.response(values, w)
    loop = theory.joint_loop(values[:, None])
    np.testing.assert_allclose(loop_response(loop, w), expected, rtol=1e-12)
    np.testing.assert_allclose(sensitivity(loop, w), 1 / (1 + expected), rtol=1e-12)
    np.testing.assert_allclose(
        complementary_sensitivity(loop, w), expected / (1 + expected), rtol=1e-12
    )


# --- python-control, where it is right ---------------------------------------------------------


def control_system(values, order):
    control = pytest.importorskip("control")
    kp, kd, mass, wn, zeta, delay = values
    system = control.tf([kd, kp], [mass, 0, 0])
    if np.isfinite(wn):
        system = system * control.tf([wn**2], [1, 2 * zeta * wn, wn**2])
    if delay > 0:
        system = system * control.tf(*control.pade(delay, order))
    return system


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::PendingDeprecationWarning")
def test_python_control_agrees_on_the_study():
    import control

    chosen = [j for j in range(9) if j != 0]
    found = evaluate(PAPER[:, chosen])
    for i, j in enumerate(chosen):
        gain, angle, modulus, w_phase, w_gain, _ = control.stability_margins(
            control_system(PAPER[:, j], 6)
        )
        tolerance = 1e-6
        if np.isfinite(gain):
            np.testing.assert_allclose(found.gain_margin[i], gain, rtol=tolerance)
            np.testing.assert_allclose(found.phase_crossover[i], w_phase, rtol=tolerance)
        np.testing.assert_allclose(np.degrees(found.phase_margin[i]), angle, rtol=tolerance)
        np.testing.assert_allclose(found.gain_crossover[i], w_gain, rtol=tolerance)
        np.testing.assert_allclose(found.modulus_margin[i], modulus, rtol=tolerance)


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::PendingDeprecationWarning")
def test_python_control_agrees_on_random_loops_without_delay(crowd, crowd_margins):
    import control

    clear = crowd_margins.stable & (crowd_margins.sensitivity_peak < 10) & np.isfinite(crowd[0][3])
    for j in np.flatnonzero(clear)[:40]:
        values = crowd[0][:, j].copy()
        values[5] = 0.0
        found = evaluate(values[:, None])
        if not found.stable[0]:
            continue  # only the delay kept it stable; python-control would not say
        gain, angle, modulus, *_ = control.stability_margins(control_system(values, 0))
        np.testing.assert_allclose(found.gain_margin[0], gain, rtol=1e-5)
        np.testing.assert_allclose(np.degrees(abs(found.phase_margin[0])), abs(angle), rtol=1e-5)
        np.testing.assert_allclose(found.modulus_margin[0], modulus, rtol=1e-5)
        poles = control.feedback(control_system(values, 0), 1).poles()
        abscissa = float(abscissa_of(theory.joint_loop(values)))
        np.testing.assert_allclose(abscissa, poles.real.max(), rtol=1e-5, atol=1e-6)
