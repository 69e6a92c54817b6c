"""Sampled margins against the oracle and against spectral radii just inside and outside."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
import theory
from quickly import compiled_quickly as compiled_quickly

from jaxact.analysis.sampled.margins import SampledMargins, sampled_margins
from jaxact.analysis.sampled.period_map import SampledLoop, one_period_matrix, period_map
from jaxact.analysis.sampled.roots import spectral_radius
from jaxact.analysis.sampled.search import sampled_response

PERIOD = 1e-3
STEPS = 5
FIELDS = tuple(f.name for f in dataclasses.fields(SampledMargins))
PAPER = np.array([theory.plant_values(theory.ORACLE["paper_cases"], n) for n in theory.NAMES])
VARIANTS = {"velocity_sampled": "sampled", "velocity_backward_difference": "differenced"}


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


compiled = jax.jit(partial(sampled_margins, max_delay_steps=STEPS))
radii = jax.jit(jax.vmap(partial(spectral_radius, max_delay_steps=STEPS + 1)))
respond = jax.jit(sampled_response)
SIZE = 192


def loops(values, dtype=None, *, velocity="sampled", cutoff=np.inf):
    """SampledLoop of (6, n)."""
    ones = np.ones(values.shape[1])
    arrays = [jnp.asarray(v, dtype=dtype) for v in (*values, PERIOD * ones, cutoff * ones)]
    return SampledLoop(*arrays, velocity=velocity)


def in_parts(function, values, dtype=None, **kinds):
    """`function` of loops (6, n) as a NumPy pytree, compiled for one shape only."""
    padded = np.pad(values, ((0, 0), (0, -values.shape[1] % SIZE)), mode="edge")
    parts = [
        jax.tree.map(np.asarray, function(loops(part, dtype, **kinds)))
        for part in np.split(padded, padded.shape[1] // SIZE, axis=1)
    ]
    return jax.tree.map(lambda *a: np.concatenate(a)[: values.shape[1]], *parts)


def evaluate(values, dtype=None, **kinds):
    return in_parts(compiled, values, dtype, **kinds)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("variant", "dtype", "tolerance"),
    [
        ("velocity_sampled", "float64", 1e-9),
        ("velocity_backward_difference", "float64", 1e-9),
        ("velocity_backward_difference", "float32", 1e-4),
    ],
)
def test_every_sampled_figure_of_the_oracle(variant, dtype, tolerance):
    found = evaluate(PAPER, dtype, velocity=VARIANTS[variant])
    cases = [case[variant] for case in theory.ORACLE["sampled_1khz"]]
    assert found.stable.all() and not found.more_crossovers.any()
    for name, key in {
        "gain_margin": "gm",
        "gain_crossover": "wgc",
        "sensitivity_peak": "Ms",
        "spectral_radius": "rho",
    }.items():
        expected = theory.figures(cases, key)
        np.testing.assert_allclose(getattr(found, name), expected, rtol=tolerance, err_msg=name)
    np.testing.assert_allclose(
        np.degrees(found.phase_margin), theory.figures(cases, "pm"), rtol=tolerance
    )
    # The oracle's is the phase in seconds, which is exact for whole periods alone.
    delays = theory.figures(cases, "dm")
    np.testing.assert_allclose(found.phase_margin / found.gain_crossover, delays, rtol=tolerance)
    np.testing.assert_allclose(found.delay_margin, delays, rtol=2e-5)
    np.testing.assert_allclose(
        found.sensitivity_peak_frequency, theory.figures(cases, "wMs"), rtol=max(tolerance, 1e-6)
    )


@pytest.mark.exhaustive
def test_the_ideal_actuator_at_one_kilohertz_has_gain_margin_seventy():
    """It is lost at z = -1, the very end of the frequency axis, where other tools do not look."""
    found = evaluate(PAPER[:, :1])
    np.testing.assert_allclose(found.gain_margin[0], 70.0, rtol=1e-11)
    np.testing.assert_allclose(found.phase_crossover[0], np.pi / PERIOD, rtol=1e-12)


@pytest.fixture(scope="module")
def crowd():
    """Random loops whose delay fits, about half of them unstable, with their sampled margins."""
    values = theory.random_loops(4000, seed=11)
    values = values[:, (values[5] < STEPS * PERIOD) & (values[1] < 300)]
    with jax.enable_x64(True):
        size = 2 * SIZE
        values = values[:, :size]
        return values, evaluate(values)


def radius(values):
    return in_parts(radii, values)


@pytest.mark.exhaustive
def test_spectral_radius_decides_and_margins_follow(crowd):
    values, found = crowd
    assert 0.2 < found.stable.mean() < 0.8
    expected = [
        np.abs(np.linalg.eigvals(theory.sampled_matrix(values[:, j], PERIOD))).max()
        for j in range(values.shape[1])
    ]
    np.testing.assert_allclose(found.spectral_radius, expected, rtol=1e-8)
    np.testing.assert_array_equal(found.unstable_roots == 0, found.stable)
    for name in FIELDS:
        value = getattr(found, name).astype(float)
        assert not np.isnan(value[found.stable]).any(), name
    assert np.isnan(found.gain_margin[~found.stable]).all()
    assert (found.log_gain_to_boundary[~found.stable] < 0).all()
    assert not found.more_crossovers.any()


def test_gain_margin_is_where_the_spectral_radius_passes_one(crowd):
    values, found = crowd
    finite = found.stable & np.isfinite(found.gain_margin)
    assert finite.sum() > 80
    for step, outside in ((-1e-6, False), (1e-6, True)):
        changed = values.copy()
        changed[:2] *= np.where(finite, found.gain_margin * (1 + step), 1.0)
        np.testing.assert_array_equal(radius(changed)[finite] > 1.0, outside)
    # A few stops on the way: nothing destabilises earlier.
    for part in (0.3, 0.7, 0.95):
        changed = values.copy()
        changed[:2] *= np.where(finite, 1.0 + part * (found.gain_margin - 1.0), 1.0)
        assert (radius(changed)[finite] < 1.0).all()


def test_the_log_distance_rescues_unstable_loops(crowd):
    values, found = crowd
    distance = found.log_gain_to_boundary
    reachable = ~found.stable & np.isfinite(distance)
    assert reachable.sum() > 20
    for beyond, unstable in ((1e-6, False), (-1e-6, True)):
        changed = values.copy()
        changed[:2] *= np.where(reachable, np.exp(distance - beyond), 1.0)
        np.testing.assert_array_equal(radius(changed)[reachable] > 1.0, unstable)


def test_delay_margin_of_whole_periods_is_exact():
    """A loop whose delay margin is brought to a whole period is marginal with that period more."""
    values = PAPER[:, 8].copy()

    def excess(scale):
        values[:2] = PAPER[:2, 8] * scale
        return float(evaluate(values[:, None]).delay_margin[0]) / (9 * PERIOD) - 1.0

    assert abs(excess(scipy.optimize.newton(excess, 1.0, tol=1e-14))) < 1e-9
    values[5] += 9 * PERIOD
    matrix = theory.sampled_matrix(values, PERIOD)
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(matrix)).max(), 1.0, atol=1e-9)


def test_loops_far_slower_than_their_control_are_those_of_continuous_time():
    """Of a mass and ideal forces; down to 1e-9 rad a control period."""
    crossover = 10.0 ** np.arange(-9.0, -3.0) / PERIOD
    kp, kd, one = 0.5 * crossover**2, 0.8 * crossover, np.ones(6)
    found = evaluate(np.stack([kp, kd, one, np.inf * one, one, 0.0 * one]))
    gain_crossover = np.sqrt(0.5 * (kd**2 + np.sqrt(kd**4 + 4.0 * kp**2)))
    phase = np.arctan2(kd * gain_crossover, kp)
    assert found.stable.all()
    np.testing.assert_allclose(found.phase_margin, phase, rtol=1e-3)
    np.testing.assert_allclose(found.delay_margin, phase / gain_crossover, rtol=1e-3)


@pytest.fixture(scope="module")
def sprung():
    """The compiled margins of sampled loops with a period of 1 s and a spring, by columns of
    (kp, kd, mass, wn, zeta, delay, c, k).
    """
    one = np.ones(SIZE)

    def found(*columns):
        number = len(columns[0])
        padded = [np.resize(column, SIZE) for column in columns]
        arrays = [jnp.asarray(a) for a in (*padded[:6], one, np.inf * one, *padded[6:])]
        names = [field.name for field in dataclasses.fields(SampledLoop)]
        names = [name for name in names if name not in ("velocity", "integrator", "substeps")]
        result = compiled(SampledLoop(**dict(zip(names, arrays, strict=True))))
        return jax.tree.map(lambda a: np.asarray(a)[:number], result)

    return found


def largest_root(kp, kd, c, k, delay):
    """Of 1 kg with a damper and a spring under ideal forces after a delay, sampled each second."""
    whole = int(delay)
    flow = np.zeros((3, 3))
    flow[0, 1], flow[1] = 1.0, (-k, -c, 1.0)
    before, after = (scipy.linalg.expm(flow * t) for t in (delay - whole, 1 - delay + whole))
    state = after @ before
    size = 2 + whole + 1
    matrix = np.zeros((size, size))
    matrix[:2, :2] = state[:2, :2]
    matrix[:2, 2 + whole] = after[:2, :2] @ before[:2, 2]
    newest = np.zeros(size) if whole else None
    command = np.zeros(size)
    command[:2] = -kp, -kd
    if whole:
        newest[1 + whole] = 1.0
    matrix[:2] += np.outer(after[:2, 2], newest if whole else command)
    matrix[2] = command
    matrix[3:, 2:-1] += np.eye(size - 3)
    return np.abs(np.linalg.eigvals(matrix)).max()


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("gains", "joint", "between"),
    [
        # Until 1.409 s of delay |L| passes 1 at a resonance beyond Nyquist.
        (
            (3.660124437732472, 0.6505597026056574),
            (0.3086347764666271, 23.006307083143888),
            (1.2, 1.3),
        ),
        # Until 11.18 s: where |L| is flat, a part of a period moves its crossover far.
        (
            (5.406500357788654, 2.168483765172794),
            (10.84241882586397, 4.86487330836929),
            (10.9, 11.1),
        ),
    ],
    ids=["resonance", "flat"],
)
def test_the_delay_at_which_a_loop_is_first_lost_though_it_returns_soon_after(
    sprung, gains, joint, between
):
    (kp, kd), (c, k) = gains, joint
    found = sprung(*([value] for value in (kp, kd, 1.0, np.inf, 1.0, 0.0, c, k)))

    radius = partial(largest_root, kp, kd, c, k)
    first = scipy.optimize.brentq(lambda delay: radius(delay) - 1.0, *between)
    assert all(radius(delay) < 1.0 for delay in np.linspace(0.0, first - 1e-6, 40))
    np.testing.assert_allclose(found.delay_margin[0], first, rtol=1e-9)


def test_the_delay_of_weak_gains_beside_an_undamped_spring(sprung):
    """Both crossovers are within 1e-2 to 1e-5 of the joint's own frequency, where L is infinite."""
    rng = np.random.default_rng(5)
    kp, kd = 10.0 ** rng.uniform(-5, -2, SIZE), 10.0 ** rng.uniform(-4, -2, SIZE)
    k, none, one = rng.uniform(0.02, 3.0, SIZE), np.zeros(SIZE), np.ones(SIZE)
    found = sprung(kp, kd, one, np.inf * one, one, none, none, k)
    assert found.stable.sum() > 100
    assert np.isfinite(found.delay_margin[found.stable]).all()
    for each in np.flatnonzero(found.stable):
        radius = partial(largest_root, kp[each], kd[each], 0.0, k[each])
        limit = found.delay_margin[each]
        assert all(radius(delay) < 1.0 for delay in np.linspace(0.0, limit * (1 - 1e-6), 12))
        assert radius(limit * (1.0 + 1e-5)) > 1.0


@pytest.mark.exhaustive
def test_no_smaller_gain_loses_a_joint_with_an_undamped_spring(sprung):
    """L passes through infinity at its own frequency: no crossing of the negative axis."""
    rng = np.random.default_rng(2)
    kp, kd = 10.0 ** rng.uniform(-4, -1, SIZE), 10.0 ** rng.uniform(-2, -0.5, SIZE)
    k = kp * 10.0 ** rng.uniform(-1.0, 2.0, SIZE)
    wn, zeta = 10.0 ** rng.uniform(0.0, 1.5, SIZE), rng.uniform(0.3, 1.5, SIZE)
    others = np.ones(SIZE), wn, zeta, rng.uniform(0.0, 1.5, SIZE), np.zeros(SIZE), k
    found = sprung(kp, kd, *others)
    assert found.stable.sum() > 50
    smaller = sprung(1e-3 * kp, 1e-3 * kd, *others)
    assert (found.gain_reduction_margin[found.stable] == 0.0).mean() > 0.9
    none = found.stable & (found.gain_reduction_margin == 0.0)
    assert smaller.stable[none].all()


def slow_loops(seed):
    """Loops whose crossover is up to the Nyquist frequency, with a period of 1 s; (6, SIZE)."""
    rng = np.random.default_rng(seed)
    crossover = 10.0 ** rng.uniform(-1.5, 0.5, SIZE)
    ideal = rng.random(SIZE) < 0.3
    wn = np.where(ideal, np.inf, crossover * 10.0 ** rng.uniform(0, 2, SIZE))
    zeta = np.where(ideal, 1.0, 10.0 ** rng.uniform(-1.5, 0.3, SIZE))
    kd = crossover * rng.uniform(0.3, 1.0, SIZE)
    kp = crossover**2 * rng.uniform(0.02, 1.5, SIZE)
    delay = np.where(rng.random(SIZE) < 0.3, 0.0, rng.uniform(0.0, 2.0, SIZE))
    return np.stack([kp, kd, np.ones(SIZE), wn, zeta, delay])


@pytest.fixture(scope="module", params=["sampled", "differenced"])
def slow(request):
    """Such loops, their margins, and a function from one and (factor on the gains, more delay) to
    SciPy's spectral radius.
    """
    values, kind = slow_loops(5), request.param
    with jax.enable_x64(True):
        arrays = [jnp.asarray(v) for v in (*values, np.ones(SIZE), np.full(SIZE, np.inf))]
        found = jax.tree.map(np.asarray, compiled(SampledLoop(*arrays, velocity=kind)))

    def outside(number, factor=1.0, more=0.0):
        one = values[:, number].copy()
        one[:2] *= factor
        one[5] += more
        matrix = theory.sampled_matrix(one, 1.0, differenced=kind == "differenced")
        return np.abs(np.linalg.eigvals(matrix)).max() > 1.0

    return found, outside


@pytest.mark.exhaustive
def test_a_loop_is_lost_at_its_delay_margin_and_not_before(slow):
    """Near the Nyquist frequency, where the phase in seconds is off by up to half and more."""
    found, outside = slow
    stable = np.flatnonzero(found.stable)
    assert stable.size > 80 and np.isfinite(found.delay_margin[stable]).all()
    in_seconds = found.phase_margin[stable] / found.gain_crossover[stable]
    assert np.mean(np.abs(in_seconds / found.delay_margin[stable] - 1.0) > 0.01) > 0.05
    for number in stable:
        margin = found.delay_margin[number]
        assert outside(number, more=margin * (1.0 + 1e-7))
        for part in (*np.linspace(0.0, 0.99, 12), 1.0 - 1e-7):
            assert not outside(number, more=margin * part), (number, part)


MARGINS = ("delay_margin", "disk_margin")


@jax.jit
@jax.value_and_grad
def backwards(values, which):
    """One of two margins by its place, and its derivatives by reverse mode."""
    found = sampled_margins(SampledLoop(*values, jnp.asarray(PERIOD)), max_delay_steps=2)
    return jnp.stack([getattr(found, name) for name in MARGINS])[which]


@pytest.mark.exhaustive
def test_the_slope_of_the_delay_margin_of_an_unstable_loop_is_zero():
    values = jnp.asarray([4e4, 20.0, 0.7, 110.0, 0.9, 1e-3])
    value, slopes = backwards(values, MARGINS.index("delay_margin"))
    assert np.isnan(value) and slopes[0] == 0.0


@pytest.mark.exhaustive
def test_the_log_distance_is_that_of_a_scan_of_factors(slow):
    """Infinite where no factor stabilises, as within half a period of hold."""
    found, outside = slow
    factors = np.linspace(-6.0, 5.0, 221)
    for number in range(0, SIZE, 2):
        good = np.array([not outside(number, factor=np.exp(one)) for one in factors])
        other = factors[good != found.stable[number]]
        sign = 1.0 if found.stable[number] else -1.0
        expected = sign * np.abs(other).min(initial=np.inf)
        distance = found.log_gain_to_boundary[number]
        if np.isfinite(expected):
            assert 0.0 <= abs(expected) - abs(distance) < 0.051 and distance * sign > 0.0
        else:
            assert abs(distance) > 5.0 and distance * sign > 0.0


def test_peaks_are_the_maxima_of_a_dense_grid(crowd):
    values, found = crowd
    chosen = np.flatnonzero(found.stable)[:40]
    theta = np.concatenate([np.geomspace(1e-4, np.pi, 4000), np.linspace(0, np.pi, 4000)[1:]])
    for j in chosen:
        loop = jax.tree.map(lambda a, j=j: a[j], loops(values))
        near = np.linspace(0.99, 1.01, 501) * found.sensitivity_peak_frequency[j]
        w = np.concatenate([theta / PERIOD, np.minimum(near, np.pi / PERIOD)])
        value = np.asarray(respond(loop, jnp.asarray(w)))
        for name, curve in (
            ("sensitivity_peak", np.abs(1 / (1 + value))),
            ("complementary_peak", np.abs(value / (1 + value))),
            ("disk_margin", 0.5 * np.abs((1 - value) / (1 + value))),
        ):
            peak = getattr(found, name)[j]
            peak = 1.0 / peak if name == "disk_margin" else peak
            assert curve.max() <= peak * (1 + 1e-9), name
            assert curve.max() >= peak * (1 - 2e-2), name


@pytest.mark.exhaustive
@pytest.mark.parametrize("velocity", ["sampled", "differenced"])
@pytest.mark.parametrize("integrator", ["exact", "euler"])
def test_response_equals_the_resolvent(velocity, integrator):
    """C (z - A)^-1 B of the plant with its delay line, by linear algebra."""
    for wn, delay, cutoff in ((110.0, 2.37e-3, 500.0), (np.inf, 0.0, np.inf), (20.0, 4e-3, 50.0)):
        arrays = (jnp.asarray(v) for v in (400.0, 20.0, 0.7, wn, 0.3, delay, PERIOD, cutoff))
        loop = SampledLoop(*arrays, velocity=velocity, integrator=integrator, substeps=3)
        closed = np.asarray(jax.jit(one_period_matrix, static_argnums=1)(loop, 5))
        still = dataclasses.replace(loop, kp=jnp.asarray(0.0), kd=jnp.asarray(0.0))
        opened = np.asarray(jax.jit(one_period_matrix, static_argnums=1)(still, 5))
        for theta in (0.01, 0.3, 1.7, 3.0):
            z = np.exp(1j * theta)
            # 1 + L(z) = det(z - A_closed) / det(z - A_open).
            size = len(closed)
            ratio = np.linalg.det(z * np.eye(size) - closed) / np.linalg.det(
                z * np.eye(size) - opened
            )
            found = complex(respond(loop, jnp.asarray(theta / PERIOD)))
            np.testing.assert_allclose(1 + found, ratio, rtol=1e-8)


def test_response_is_accurate_far_above_a_slow_actuator():
    """There the sampled plant cancels to almost nothing; compare with the aliases of L(s)."""
    values = np.array([1.0, 0.0, 1.0, 5.0, 0.4, 0.0])
    loop = SampledLoop(*(jnp.asarray(v) for v in values), jnp.asarray(PERIOD))
    theta = 2.0
    shifts = theta + 2 * np.pi * np.arange(-400, 401)
    s = 1j * shifts / PERIOD
    hold = (1 - np.exp(-1j * theta)) / (s * PERIOD)
    expected = np.sum(hold * theory.response(values, shifts / PERIOD))
    found = complex(respond(loop, jnp.asarray(theta / PERIOD)))
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.exhaustive
def test_a_slow_loop_approaches_the_continuous_one():
    from jaxact.analysis.joint.margins import margins

    values = np.array([4.0, 2.0, 0.7, 110.0, 0.9, 0.0])
    sampled = evaluate(values[:, None])
    values[5] = 0.5 * PERIOD  # the hold's mean delay
    continuous = jax.jit(margins)(theory.joint_loop(values))
    for name in ("gain_margin", "phase_margin", "sensitivity_peak", "disk_margin"):
        np.testing.assert_allclose(
            getattr(sampled, name)[0], float(getattr(continuous, name)), rtol=2e-3
        )


SMOOTH = tuple(
    f
    for f in FIELDS
    if f not in ("stable", "unstable_roots", "gain_reduction_margin", "more_crossovers")
)


@pytest.mark.exhaustive
def test_every_derivative_equals_central_differences():
    velocity, cutoff = "differenced", 400.0
    chosen = PAPER[:, [7, 8, 4]].copy()
    chosen[5] = [1.37e-3, 3.9e-3, 2.2e-3]
    unstable = chosen[:, :1].copy()
    unstable[:2] *= 6.0
    chosen = np.concatenate([chosen, unstable], axis=1)

    def vector(values):
        loop = SampledLoop(*values, jnp.asarray(PERIOD), jnp.asarray(cutoff), velocity=velocity)
        found = sampled_margins(loop, max_delay_steps=STEPS)
        return jnp.stack([getattr(found, name) for name in SMOOTH])

    jacobian = np.asarray(jax.jit(jax.vmap(jax.jacfwd(vector), in_axes=1))(jnp.asarray(chosen)))
    step = 1e-6
    stacked = np.repeat(chosen[:, None, :], 12, axis=1)
    for i in range(6):
        stacked[i, 2 * i] *= 1 + step
        stacked[i, 2 * i + 1] *= 1 - step
    found = evaluate(stacked.reshape(6, -1), velocity=velocity, cutoff=cutoff)
    for k, name in enumerate(SMOOTH):
        shifted = getattr(found, name).reshape(6, 2, -1)
        difference = (shifted[:, 0] - shifted[:, 1]).T / (2 * step * chosen.T)
        known = np.isfinite(difference).all(axis=1)
        assert known.sum() >= (4 if name in ("log_gain_to_boundary", "spectral_radius") else 3)
        size = np.abs(shifted[:, 0].T / chosen.T)
        error = np.abs(jacobian[:, k] - difference) / (size + np.abs(difference))
        assert error[known].max() < 1e-6, name


@pytest.mark.exhaustive
def test_reverse_mode_equals_central_differences():
    values = jnp.array([400.0, 20.0, 0.7, 110.0, 0.9, 1.37e-3])
    gradient = np.asarray(backwards(values, MARGINS.index("disk_margin"))[1])
    for i in range(6):
        shifted = np.repeat(np.asarray(values)[:, None], 2, axis=1)
        shifted[i] *= [1 + 1e-6, 1 - 1e-6]
        high, low = evaluate(shifted).disk_margin
        np.testing.assert_allclose(gradient[i], (high - low) / (2e-6 * values[i]), rtol=1e-6)


def test_a_delay_that_does_not_fit_is_unstable_and_not_a_number():
    values = PAPER[:, 8:9].copy()
    values[5] = (STEPS + 1.5) * PERIOD
    found = evaluate(values)
    assert not found.stable[0] and np.isnan(found.spectral_radius[0])
    assert np.isnan(found.gain_margin[0])


def test_integer_delays_shift_the_commands():
    loop = SampledLoop(*(jnp.asarray(v) for v in (400.0, 20.0, 0.7, 110.0, 0.9, 3e-3, PERIOD)))
    _, older, newer, steps = period_map(loop)
    assert steps == 3 and np.abs(np.asarray(older)).max() < 1e-12 * np.abs(np.asarray(newer)).max()
