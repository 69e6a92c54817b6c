"""Exact theory of joints with damping and stiffness of their own, also of the wrong sign.

Against polynomial roots, `scipy.linalg.expm` and python-control, over random joints.
"""

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from quickly import compiled_quickly as compiled_quickly

from jaxact.analysis.boundary.boundary import continuous_boundary, sampled_boundary
from jaxact.analysis.joint.frequency import JointLoop
from jaxact.analysis.joint.margins import margins
from jaxact.analysis.joint.roots import characteristic, spectral_abscissa
from jaxact.analysis.sampled.margins import sampled_margins
from jaxact.analysis.sampled.period_map import SampledLoop, one_period_matrix
from jaxact.matrix_exponential import exponential_less_one

NUMBER, STEPS = 1000, 5


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def _random(seed):
    """Joints between overdamped and undamped, upright and hanging, under gains of either sign."""
    rng = np.random.default_rng(seed)
    mass, rate = 10 ** rng.uniform(-3, 2, NUMBER), 10 ** rng.uniform(0, 2.5, NUMBER)
    signs = rng.choice([-1, 1, 0], NUMBER, p=[0.4, 0.5, 0.1])
    ideal = rng.random(NUMBER) < 0.15
    return {
        "kp": mass * rate**2 * 10 ** rng.uniform(-1.5, 2, NUMBER)
        * rng.choice([-1, 1], NUMBER, p=[0.15, 0.85]),
        "kd": mass * rate * 10 ** rng.uniform(-1.5, 1.5, NUMBER)
        * rng.choice([-1, 1], NUMBER, p=[0.1, 0.9]),
        "mass": mass,
        "natural_frequency": np.where(ideal, np.inf, 10 ** rng.uniform(1, 3.5, NUMBER)),
        "damping_ratio": 10 ** rng.uniform(-1.5, 0.5, NUMBER),
        "delay": np.zeros(NUMBER),
        "joint_damping": 2 * mass * rate * 10 ** rng.uniform(-3, 0.7, NUMBER)
        * rng.choice([0, 1], NUMBER, p=[0.1, 0.9]),
        "joint_stiffness": mass * rate**2 * signs,
    }  # fmt: skip


def _loop(values, kind=JointLoop, **more):
    return kind(**{name: jnp.asarray(value) for name, value in {**values, **more}.items()})


def _fraction(values, index, cutoff=np.inf):
    """Numerator and denominator of L(s) without delay."""
    v = {name: float(array[index]) for name, array in values.items()}
    plant = [v["mass"], v["joint_damping"], v["joint_stiffness"]]
    servo = [1 / v["natural_frequency"] ** 2, 2 * v["damping_ratio"] / v["natural_frequency"], 1.0]
    lag = [1 / cutoff, 1.0]
    numerator = np.array([v["kd"] + v["kp"] / cutoff, v["kp"]])
    return numerator, np.trim_zeros(np.polymul(np.polymul(plant, servo), lag), "f")


@pytest.mark.exhaustive
@pytest.mark.parametrize("cutoff", [np.inf, 300.0])
def test_roots_of_random_joints_are_those_of_their_polynomials(cutoff):
    values = _random(0)
    more = {} if np.isinf(cutoff) else {"velocity_filter": np.full(NUMBER, cutoff)}
    loop = _loop(values, **more)
    found, abscissa = jax.jit(lambda x: (margins(x), spectral_abscissa(x)))(loop)
    upright = 0
    for index in range(NUMBER):
        numerator, denominator = _fraction(values, index, cutoff)
        roots = np.roots(np.polyadd(numerator, denominator))
        scale, rightmost = np.abs(roots).max(), roots.real.max()
        if abs(rightmost) > 1e-9 * scale:
            assert found.unstable_roots[index] == np.sum(roots.real > 0)
            upright += bool(found.stable[index]) and values["joint_stiffness"][index] < 0
        assert abscissa[index] == pytest.approx(rightmost, rel=1e-6, abs=1e-6 * scale)
    assert upright > 50


def test_margins_are_those_of_python_control():
    values = _random(1)
    found = jax.jit(margins)(_loop(values))
    seen = down = 0
    for index in np.flatnonzero(np.asarray(found.stable))[:250]:
        numerator, denominator = _fraction(values, index)
        gains, phases, _, _, crossovers, _ = control.stability_margins(
            control.TransferFunction(numerator, denominator), returnall=True
        )
        # python-control does not count the root that passes through the origin.
        kp, k = values["kp"][index], values["joint_stiffness"][index]
        gains = np.append(gains, -k / kp) if kp * k < 0 else gains
        seen += len(crossovers) > 0
        up = min((gain for gain in gains if gain > 1 + 1e-9), default=np.inf)
        lower = max((gain for gain in gains if 1e-9 < gain < 1 - 1e-9), default=0.0)
        down += lower > 0
        assert found.gain_margin[index] == pytest.approx(up, rel=1e-6)
        if values["joint_damping"][index] > 0:  # undamped, it is on the boundary without gains
            assert found.gain_reduction_margin[index] == pytest.approx(lower, rel=1e-6)
        nearest = min(np.abs(phases), default=np.inf)
        assert np.degrees(abs(found.phase_margin[index])) == pytest.approx(nearest, rel=1e-6)
        later = [
            np.angle(-np.polyval(numerator, 1j * w) / np.polyval(denominator, 1j * w))
            % (2 * np.pi) / w
            for w in crossovers
        ]  # fmt: skip
        assert found.delay_margin[index] == pytest.approx(min(later, default=np.inf), rel=1e-6)
    assert seen > 100 and down > 20


def test_peaks_are_not_below_those_of_a_fine_grid():
    values = _random(2)
    found = jax.jit(margins)(_loop(values))
    for index in np.flatnonzero(np.asarray(found.stable))[:100]:
        numerator, denominator = _fraction(values, index)
        unit = np.sqrt(abs(values["joint_stiffness"][index]) / values["mass"][index]) + 1.0
        s = 1j * np.geomspace(1e-4, 1e4, 40_001) * unit
        L = np.polyval(numerator, s) / np.polyval(denominator, s)
        for own, grid in (
            (found.sensitivity_peak, 1 / np.abs(1 + L)),
            (found.complementary_peak, np.abs(L / (1 + L))),
            (1 / found.disk_margin, np.abs((1 - L) / (1 + L)) / 2),
        ):
            # A grid falls short of a sharp peak, by less the broader it is.
            assert own[index] >= grid.max() * (1 - 1e-6)
            if grid.max() < 20:
                assert own[index] <= max(grid.max(), 1.0) * (1 + 2e-3)


def _period_matrix(v):
    """The closed loop over one control period from `scipy.linalg.expm`."""
    A = np.zeros((5, 5))
    A[0, 1], A[1, 0] = 1, -v["joint_stiffness"] / v["mass"]
    A[1, 1] = -v["joint_damping"] / v["mass"]
    wn, ideal = v["natural_frequency"], np.isinf(v["natural_frequency"])
    A[1, 4 if ideal else 2] = 1 / v["mass"]
    if not ideal:
        A[2:4, 2:] = [[0, wn, 0], [-wn, -2 * v["damping_ratio"] * wn, wn]]

    def over(time):
        whole = scipy.linalg.expm(A * time)
        if ideal:
            whole[2:4] = np.outer([1, 0], np.eye(5)[4])
        return whole[:4, :4], whole[:4, 4]

    steps = int(v["delay"] / v["control_period"])
    late = v["delay"] - steps * v["control_period"]
    (after, newer), (_, older) = over(v["control_period"] - late), over(late)
    size = 4 + STEPS + 1
    command = np.zeros(size)
    command[:2] = -v["kp"], -v["kd"]
    commands = np.vstack([command, np.eye(size)[4:]])
    matrix = np.zeros((size, size))
    matrix[:4, :4] = over(v["control_period"])[0]
    matrix[:4] += np.outer(after @ older, commands[steps + 1]) + np.outer(newer, commands[steps])
    matrix[4:] = commands[:-1]
    return matrix


def _radius(values, index, factor=1.0):
    own = {name: float(array[index]) for name, array in values.items()}
    own |= {"kp": factor * own["kp"], "kd": factor * own["kd"]}
    return np.abs(np.linalg.eigvals(_period_matrix(own))).max()


def _sampled(seed):
    rng = np.random.default_rng(seed)
    period = 10 ** rng.uniform(-3.5, -2, NUMBER)
    return _random(seed) | {
        "control_period": period, "delay": rng.uniform(0, STEPS, NUMBER) * period,
    }  # fmt: skip


def test_sampled_spectral_radius_is_that_of_scipy():
    values = _sampled(3)
    loops = _loop(values, SampledLoop, velocity_filter=np.full(NUMBER, np.inf))
    matrices = jax.jit(jax.vmap(lambda loop: one_period_matrix(loop, STEPS)))(loops)
    radii = np.abs(np.linalg.eigvals(np.asarray(matrices))).max(axis=1)
    expected = [_radius(values, index) for index in range(NUMBER)]
    np.testing.assert_allclose(radii, expected, rtol=1e-10)


@pytest.mark.exhaustive
def test_sampled_margins_end_where_the_radius_is_one():
    values = _sampled(4)
    found = jax.jit(lambda loop: sampled_margins(loop, max_delay_steps=STEPS))(
        _loop(values, SampledLoop)
    )
    stable = np.flatnonzero(np.asarray(found.stable))
    assert len(stable) > 200
    down = 0
    for index in stable:
        for margin in (found.gain_margin[index], found.gain_reduction_margin[index]):
            if 1e-3 < margin < 1e6:
                assert _radius(values, index, float(margin)) == pytest.approx(1.0, abs=1e-7)
        lower, upper = (float(m[index]) for m in (found.gain_reduction_margin, found.gain_margin))
        down += lower > 1e-3
        for share in (0.1, 0.5, 0.9):
            inside = max(lower, 1e-3) ** share, min(upper, 1e3) ** share
            assert all(_radius(values, index, factor) < 1 + 1e-9 for factor in inside)
        nearest = min(np.log(upper), -np.log(lower) if lower > 0 else np.inf)
        assert found.log_gain_to_boundary[index] == pytest.approx(nearest, rel=1e-6)
    assert down > 50


@pytest.mark.exhaustive
def test_no_damping_and_no_stiffness_are_the_bare_mass():
    bare = [np.full(4, v) for v in (400.0, 20.0, 0.7, 110.0, 0.9)]
    delay = np.array([0.0, 1e-3, 5e-3, 3e-2])
    zero = jnp.zeros(4)
    both = {}, {"joint_damping": zero, "joint_stiffness": zero}
    plain, sprung = (jax.jit(margins)(JointLoop(*bare, delay, **own)) for own in both)
    in_samples = jax.jit(lambda loop: sampled_margins(loop, max_delay_steps=30))
    sampled = [in_samples(SampledLoop(*bare, delay, np.full(4, 1e-3), **own)) for own in both]
    for one, other in ((plain, sprung), sampled):
        for name in ("unstable_roots", "gain_margin", "phase_margin", "delay_margin", "disk_margin",
                     "sensitivity_peak", "complementary_peak", "phase_crossover"):  # fmt: skip
            np.testing.assert_allclose(
                getattr(one, name), getattr(other, name), rtol=1e-8, err_msg=name
            )


@pytest.mark.exhaustive
@pytest.mark.parametrize("stiffness", [-60.0, 900.0])
def test_derivatives_by_damping_and_stiffness_are_those_of_differences(stiffness):
    def figures(c, k):
        parts = (400.0, 20.0, 0.7, 110.0, 0.9, 2e-3)
        one = margins(JointLoop(*parts, joint_damping=c, joint_stiffness=k))
        two = sampled_margins(
            SampledLoop(*parts, 1e-3, joint_damping=c, joint_stiffness=k), max_delay_steps=2
        )
        return jnp.stack(
            [one.gain_margin, one.delay_margin, one.sensitivity_peak, two.gain_margin,
             two.disk_margin, two.spectral_radius, two.delay_margin]
        )  # fmt: skip

    figures = jax.jit(figures)
    exact = jax.jacfwd(figures, (0, 1))(3.0, stiffness)
    for number, step in ((0, 1e-5), (1, 1e-3)):
        ends = [figures(*(np.array([3.0, stiffness]) + s * step * np.eye(2)[number]))
                for s in (1, -1)]  # fmt: skip
        np.testing.assert_allclose(exact[number], (ends[0] - ends[1]) / (2 * step), rtol=1e-5)


@pytest.mark.exhaustive
@pytest.mark.parametrize("stiffness", [-300.0, 300.0])
def test_boundaries_are_made_of_marginal_gains(stiffness):
    own = {"joint_damping": 4.0, "joint_stiffness": stiffness}
    window = {"kp_range": (-500.0, 6000.0), "kd_range": (-20.0, 200.0), **own}
    curves = continuous_boundary(0.7, 110.0, 0.9, 2e-3, **window)
    assert any(c.kind == "line" and c.separates and np.all(c.kp == -stiffness) for c in curves)
    for curve in curves:
        loop = JointLoop(curve.kp, curve.kd, 0.7, 110.0, 0.9, 2e-3, **own)
        value, _ = characteristic(loop, 1j * jnp.asarray(curve.frequency))
        assert np.abs(value).max() < 1e-6 * np.abs(curve.kp).max()
    plant = {"mass": 0.7, "natural_frequency": 110.0, "damping_ratio": 0.9, "delay": 2e-3}
    sampled = sampled_boundary(0.7, 110.0, 0.9, 2e-3, 1e-3, **window)
    assert any(c.kind == "line" and c.separates and np.all(c.kp == -stiffness) for c in sampled)
    for curve in sampled:
        for kp, kd in list(zip(curve.kp, curve.kd, strict=True))[:: len(curve.kp) // 5 + 1]:
            values = {**plant, **own, "kp": kp, "kd": kd, "control_period": 1e-3}
            size = np.abs(np.abs(np.linalg.eigvals(_period_matrix(values))) - 1.0).min()
            assert size < 1e-6


def test_the_exponential_is_that_of_scipy_however_stiff():
    rng = np.random.default_rng(7)
    for size, scale in ((2, 1e-6), (3, 1.0), (5, 30.0)):
        matrix = scale * rng.normal(size=(size, size))
        expected = scipy.linalg.expm(matrix) - np.eye(size)
        found = np.asarray(exponential_less_one(jnp.asarray(matrix)))
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    stiff = jnp.asarray([[-1e-9, 1.0], [0.0, -1e12]])
    np.testing.assert_allclose(
        exponential_less_one(stiff), [[np.expm1(-1e-9), 1e-12], [0.0, -1.0]], rtol=1e-9
    )


@pytest.mark.exhaustive
def test_a_velocity_loop_about_a_spring_has_a_gain_margin():
    """kp = 0: kd s exp(-s td) wn^2 / ((m s^2 + k) (s^2 + 2 zeta wn s + wn^2)) crosses as others."""
    mass, wn, zeta, delay, stiffness = 12.5, 51.0, 2.3, 6e-5, 2000.0

    def loop(w, kd=1.0):
        servo = wn**2 / (wn**2 - w**2 + 2j * zeta * wn * w)
        return kd * 1j * w * np.exp(-1j * w * delay) * servo / (stiffness - mass * w**2)

    w = scipy.optimize.brentq(lambda w: np.angle(-loop(w)), 45.0, 60.0)
    marginal = 1.0 / abs(loop(w))
    for kd, stable in ((0.4 * marginal, True), (1.5 * marginal, False)):
        values = (0.0, kd, mass, wn, zeta, delay, None, 0.0, stiffness)
        found = margins(JointLoop(*(one if one is None else jnp.asarray(one) for one in values)))
        assert bool(found.stable) == stable
        distance = np.log(marginal / kd)
        np.testing.assert_allclose(found.log_gain_to_boundary, distance, rtol=1e-9)
        if stable:
            np.testing.assert_allclose(found.gain_margin, marginal / kd, rtol=1e-9)
            np.testing.assert_allclose(found.phase_crossover, w, rtol=1e-9)
