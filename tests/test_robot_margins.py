"""Margins of whole robots: against the single joint's, and against matrices made independently."""

from functools import partial
from pathlib import Path

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from quickly import compiled_quickly as compiled_quickly
from scipy.linalg import expm
from scipy.optimize import minimize, minimize_scalar

from jaxact.analysis.robot import disk as multiloop_disk
from jaxact.analysis.sampled.margins import sampled_margins
from jaxact.analysis.sampled.period_map import SampledLoop
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.history import essential
from jaxact.drive.sensor import Sensor
from jaxact.drive.step import Drive, options
from jaxact.loops import loop as _loop
from jaxact.loops import reading
from jaxact.loops.loop import Loop
from jaxact.loops.samples import expand
from jaxact.plants import linearize
from jaxact.robot_margins import whole_robot
from jaxact.robots import model, posture
from jaxact.simulation import engines, plans, robot_loop, spectra
from jaxact.simulation.growth import rate as growth

ROOT = Path(__file__).resolve().parent.parent
PERIOD = 1e-3
SLIDE = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="slide" type="slide"/>
<geom size="0.1" mass="0.7"/></body></worldbody>
<actuator><position name="slide" joint="slide" kp="400" kv="20"/></actuator></mujoco>"""
LENGTHS, MASSES, RADII = (0.35, 0.3), (1.2, 0.8), (0.05, 0.04)
ARM = """<mujoco><option timestep="0.0005" gravity="0 0 -9.81"/><worldbody>
<body><joint name="shoulder" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.35" mass="1.2"/>
<body pos="0 0 -0.35"><joint name="elbow" axis="0 1 0"/>
<geom size="0.04" pos="0 0 -0.3" mass="0.8"/></body></body></worldbody>
<actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator></mujoco>"""
GAINS = np.array([150.0, 40.0]), np.array([9.0, 2.0])
DELAY, WN, ZETA, SUBSTEPS = 2.3e-3, 300.0, 0.5, 2


def _evaluated(path, text, overrides=()):
    document = f'engine = "mujoco"\n[plant]\nmodel = "{path.name}"\n{text}\n[axes]\nfeedforward=[0]'
    return whole_robot.evaluate(reading.parse(document, path.parent, overrides))


def _file(folder, name, text):
    path = folder / name
    path.write_text(text)
    return path


# --- the slide joint as a user's model --------------------------------------------------------


@pytest.fixture(scope="module")
def slide(tmp_path_factory):
    """The margins of the model, and of the equivalent mass under MuJoCo's own integrator."""
    path = _file(tmp_path_factory.mktemp("slide"), "slide.xml", SLIDE)
    changes = [
        "velocity=differenced", "velocity_filter=500", "physics_step=0.00025",
        "actuator=starleth", "delay=1.37e-3",
    ]  # fmt: skip
    (found,) = _evaluated(path, "[parameters]", changes)
    with jax.enable_x64(True):
        values = (400.0, 20.0, 0.7, 110.0, 0.9, 1.37e-3, PERIOD, 500.0)
        loop = SampledLoop(
            *(jnp.asarray(value) for value in values),
            velocity="differenced", integrator="euler", substeps=4,
        )  # fmt: skip
        expected = jax.jit(partial(sampled_margins, max_delay_steps=3))(loop)
        expected = jax.tree.map(float, expected)
    return found, expected


SAME = (
    "gain_margin phase_crossover phase_margin gain_crossover delay_margin sensitivity_peak "
    "sensitivity_peak_frequency complementary_peak complementary_peak_frequency modulus_margin "
    "disk_margin gain_reduction_margin"
).split()


@pytest.mark.parametrize("name", SAME)
def test_a_joint_of_a_model_has_the_margins_of_the_equivalent_mass(slide, name):
    """MuJoCo's semi-implicit Euler moves as `integrator="euler"` does; A and B are differences."""
    found, expected = slide
    (joint,) = found.margins.joints
    # A peak is flat: where it is, is known to the root of what it is known to.
    tolerance = 1e-4 if name.endswith("peak_frequency") else 1e-7
    np.testing.assert_allclose(
        getattr(joint, name), getattr(expected, name), rtol=tolerance, atol=1e-9
    )


def test_a_single_joint_is_its_own_whole(slide):
    found, expected = slide
    margins = found.margins
    np.testing.assert_allclose(margins.spectral_radius, expected.spectral_radius, rtol=1e-9)
    assert margins.stable and margins.unstable_roots == 0
    for name in ("gain_margin", "gain_reduction_margin", "sensitivity_peak", "complementary_peak",
                 "disk_margin"):  # fmt: skip
        np.testing.assert_allclose(
            getattr(margins.whole, name), getattr(margins.joints[0], name), rtol=1e-8, atol=1e-9
        )
    np.testing.assert_allclose(margins.whole.unscaled_disk_margin, margins.whole.disk_margin)
    np.testing.assert_allclose(
        margins.log_gain_to_boundary, expected.log_gain_to_boundary, rtol=1e-7
    )
    # One is exact for every delay, the other at whole periods.
    np.testing.assert_allclose(margins.whole.delay_margin, expected.delay_margin, rtol=1e-3)
    np.testing.assert_allclose(found.robot.inertias, [0.7], rtol=1e-6)
    np.testing.assert_allclose(margins.critical.participation, [1.0])
    assert (found.kp, found.kd) == (400.0, 20.0)


# --- a two-joint arm against matrices made from its equations of motion -----------------------


def _arm_matrices():
    """x' = A x + B u over a control period, and what is measured, from first principles.

    x = (q, v, f, f', u_{k-1}, u_{k-2}, u_{k-3}); point masses with the inertia of their spheres,
    hanging, semi-implicit Euler; the force loop by matrix exponentials with the integral of f.
    """
    (l1, l2), (m1, m2) = LENGTHS, MASSES
    I1, I2 = (0.4 * m * r * r for m, r in zip(MASSES, RADII, strict=True))
    far = l1 + l2
    M = np.array(
        [
            [m1 * l1**2 + m2 * far**2 + I1 + I2, m2 * l2 * far + I2],
            [m2 * l2 * far + I2, m2 * l2**2 + I2],
        ]
    )
    g = 9.81
    K = g * np.array([[(m1 + m2) * l1 + m2 * l2, m2 * l2], [m2 * l2, m2 * l2]])
    h = PERIOD / SUBSTEPS
    late = round(DELAY / PERIOD - 0.5)
    switch = DELAY - late * PERIOD
    servo = np.array([[0, 1, 0, 0], [-(WN**2), -2 * ZETA * WN, 0, WN**2], [1, 0, 0, 0], [0] * 4])
    q, v, f, r, lines = (slice(2 * i, 2 * i + 2) for i in (0, 1, 2, 3, 4))
    size = 8 + 2 * (late + 1)
    # Columns: states, then u_k.
    rows = np.eye(size, size + 2)
    now = rows.copy()
    newer = now[8 + 2 * (late - 1) : 8 + 2 * late]
    older = now[8 + 2 * late : 8 + 2 * late + 2]
    for step in range(SUBSTEPS):
        before = min(max(switch - step * h, 0.0), h)
        total = np.zeros((2, size + 2))
        for time, command in ((before, older), (h - before, newer)):
            E = expm(servo * time)
            force, rate = now[f].copy(), now[r].copy()
            total += E[2, 0] * force + E[2, 1] * rate + E[2, 3] * command
            now[f] = E[0, 0] * force + E[0, 1] * rate + E[0, 3] * command
            now[r] = E[1, 0] * force + E[1, 1] * rate + E[1, 3] * command
        now[v] = now[v] + np.linalg.solve(M, total - h * K @ now[q])
        now[q] = now[q] + h * now[v]
    now[10:] = rows[8:-2]
    now[lines] = 0.0
    now[lines, size:] = np.eye(2)
    return now[:, :size], now[:, size:], rows[q, :size], rows[v, :size]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = _file(tmp_path_factory.mktemp("arm"), "arm.xml", ARM)
    (kp, kd) = GAINS
    text = f"""[parameters]
    wn = {WN}
    zeta = {ZETA}
    delay = {DELAY}
    kp = {{ shoulder = {kp[0]}, elbow = {kp[1]} }}
    kd = {{ shoulder = {kd[0]}, elbow = {kd[1]} }}"""

    def evaluated(scale):
        changes = [f"gain_scale={scale}", f"physics_step={PERIOD / SUBSTEPS}"]
        return _evaluated(path, text, changes)[0]

    return evaluated


@pytest.fixture(scope="module")
def nominal(arm):
    return arm(1.0)


def _closed(scale=(1.0, 1.0), later=0):
    """The arm's closed matrix from `_arm_matrices`, its commands scaled."""
    A, B, Q, V = _arm_matrices()
    feedback = np.diag(scale) @ (np.diag(GAINS[0]) @ Q + np.diag(GAINS[1]) @ V)
    if not later:
        return A - B @ feedback
    size, line = len(A), 2 * later
    whole = np.zeros((size + line, size + line))
    whole[:size, :size], whole[:size, -2:] = A, B
    whole[size : size + 2, :size] = -feedback
    whole[size + 2 :, size:-2] = np.eye(line - 2)
    return whole


def _radius(matrix):
    return np.abs(np.linalg.eigvals(matrix)).max()


def _sensitivity(angle):
    """S of the arm at w T, by python-control's feedback of the loop transfer function."""
    A, B, Q, V = _arm_matrices()
    C = np.diag(GAINS[0]) @ Q + np.diag(GAINS[1]) @ V
    L = control.ss(A, B, C, np.zeros((2, 2)), PERIOD)
    S = control.ss([], [], [], np.eye(2), PERIOD).feedback(L)
    response = control.frequency_response(S, np.atleast_1d(angle) / PERIOD)
    return response.complex.transpose(2, 0, 1)


def test_the_arm_has_the_roots_of_its_equations_of_motion(nominal):
    np.testing.assert_allclose(nominal.margins.spectral_radius, _radius(_closed()), rtol=1e-8)
    expected = np.abs(np.linalg.eigvals(_closed()))
    found = np.abs(np.linalg.eigvals(nominal.robot.matrices[0]))
    largest = np.sort(expected)[::-1][:8]
    np.testing.assert_allclose(np.sort(found)[::-1][:8], largest, rtol=1e-7)
    assert nominal.neutral == 0 and nominal.residual < 1e-6


# python-control makes static systems in a way that NumPy has deprecated.
old_numpy = pytest.mark.filterwarnings("ignore:Setting the shape:DeprecationWarning")


@old_numpy
@pytest.mark.parametrize(
    ("name", "shift"), [("sensitivity_peak", 0.0), ("complementary_peak", 1.0)]
)
def test_singular_values_equal_those_of_python_control(nominal, name, shift):
    found = nominal.margins.whole

    def curve(angle):
        S = _sensitivity(angle) - shift * np.eye(2)
        return np.linalg.svd(S, compute_uv=False)[:, 0]

    angle = np.concatenate([np.geomspace(1e-4, np.pi, 3000)])
    values = curve(angle)
    best = int(np.argmax(values))
    refined = minimize_scalar(
        lambda t: -curve(t)[0], bounds=(angle[max(best - 1, 0)], angle[best + 1]),
        method="bounded", options={"xatol": 1e-10},
    )  # fmt: skip
    np.testing.assert_allclose(getattr(found, name), max(-refined.fun, values[0]), rtol=1e-7)
    at = getattr(found, f"{name}_frequency") * PERIOD
    if at > 0.0:
        np.testing.assert_allclose(curve(at)[0], getattr(found, name), rtol=1e-7)


@old_numpy
def test_the_disk_margin_equals_an_independent_scaling(nominal):
    def scaled(angle):
        H = _sensitivity(angle)[0] - 0.5 * np.eye(2)

        def largest(x):
            D = np.diag([1.0, np.exp(x)])
            return np.linalg.norm(D @ H @ np.linalg.inv(D), 2)

        return minimize_scalar(largest, bounds=(-12.0, 12.0), method="bounded",
                               options={"xatol": 1e-10}).fun  # fmt: skip

    angle = np.geomspace(1e-3, np.pi * (1 - 1e-9), 400)
    values = np.array([scaled(t) for t in angle])
    best = int(np.argmax(values))
    refined = minimize_scalar(lambda t: -scaled(t), bounds=tuple(angle[[best - 1, best + 1]]),
                              method="bounded", options={"xatol": 1e-9})  # fmt: skip
    whole = nominal.margins.whole
    np.testing.assert_allclose(whole.disk_margin, -1.0 / refined.fun, rtol=1e-6)
    assert whole.unscaled_disk_margin < whole.disk_margin
    assert whole.disk_margin < min(joint.disk_margin for joint in nominal.margins.joints)


@old_numpy
def test_the_disk_margin_of_one_joint_equals_that_of_python_control(nominal):
    A, B, Q, V = _arm_matrices()
    C = np.diag(GAINS[0]) @ Q + np.diag(GAINS[1]) @ V
    for joint in (0, 1):
        other = 1 - joint
        rest = A - B[:, [other]] @ C[[other]]
        L = control.ss(rest, B[:, [joint]], C[[joint]], 0.0, PERIOD)
        # python-control takes the frequencies of a discrete loop per second as well.
        omega = np.geomspace(1.0, np.pi / PERIOD * (1 - 1e-9), 6000)
        disk, _, _ = control.disk_margins(L, omega)
        found = nominal.margins.joints[joint].disk_margin
        assert disk * (1 - 1e-4) < found < disk * (1 + 1e-9)  # the peak between its frequencies


@pytest.mark.parametrize("joint", [0, 1])
def test_gain_margins_of_a_joint_are_where_a_root_leaves(nominal, joint):
    own = nominal.margins.joints[joint]
    scale = np.ones(2)
    for factor in (own.gain_margin, own.gain_reduction_margin):
        if not 0.0 < factor < np.inf:
            continue
        radii = []
        for beside in (-1e-6, 1e-6):
            scale[joint] = factor * (1.0 + beside)
            radii.append(_radius(_closed(scale)) > 1.0)
        assert radii[0] != radii[1]
    assert np.isfinite(own.gain_margin)


def test_the_common_gain_margin_is_where_the_loop_with_scaled_gains_is_marginal(arm, nominal):
    factor = nominal.margins.whole.gain_margin
    assert factor < min(joint.gain_margin for joint in nominal.margins.joints)
    for beside, unstable in ((-1e-6, False), (1e-6, True)):
        assert (_radius(_closed(np.full(2, factor * (1 + beside)))) > 1.0) == unstable
    # nothing destabilises earlier
    for factors in (np.geomspace(1.0, factor * (1 - 1e-6), 50), np.geomspace(1e-3, 1.0, 50)):
        assert all(_radius(_closed(np.full(2, g))) < 1.0 for g in factors)
    assert nominal.margins.whole.gain_reduction_margin == 0.0
    assert nominal.margins.gain_to_boundary == factor
    for beside, unstable in ((-1e-4, 0), (1e-4, 2)):
        assert arm(factor * (1 + beside)).margins.unstable_roots == unstable


def test_the_common_delay_margin_is_exact(nominal):
    margin = nominal.margins.whole.delay_margin
    path = nominal.robot
    for beside, unstable in ((-1e-7, False), (1e-7, True)):
        whole, part = divmod(margin + beside, PERIOD)
        M, N, C = path.later_by(part)
        size = len(M)
        longer = np.zeros((size + 2 * int(whole),) * 2)
        assert whole > 1
        longer[:size, :size] = M - N @ C
        longer[:size, -2:] = N
        longer[size : size + 2, :size] = C
        longer[size + 2 :, size:-2] = np.eye(2 * int(whole) - 2)
        assert (_radius(longer) > 1.0) == unstable
    # at whole periods the independent matrices say the same
    for later in range(1, int(margin / PERIOD) + 1):
        assert _radius(_closed(later=later)) < 1.0
    assert _radius(_closed(later=int(margin / PERIOD) + 1)) > 1.0


def test_an_unstable_loop_has_no_margins_and_says_how_far_it_is(arm, nominal):
    factor = nominal.margins.whole.gain_margin
    margins = arm(3.0 * factor).margins
    expected = np.sum(np.abs(np.linalg.eigvals(_closed(np.full(2, 3.0 * factor)))) > 1.0)
    assert not margins.stable and margins.unstable_roots == expected > 0
    assert margins.whole is None and margins.joints == () and margins.at_peak is None
    assert margins.growth_rate > 0.0
    np.testing.assert_allclose(margins.critical.growth_rate, margins.growth_rate, rtol=1e-9)
    np.testing.assert_allclose(margins.critical.participation.sum(), 1.0)
    again = margins.gain_to_boundary
    assert margins.log_gain_to_boundary == -abs(np.log(again)) < 0.0
    for beside, unstable in ((-1e-6, False), (1e-6, True)):
        assert (_radius(_closed(np.full(2, 3.0 * factor * again * (1 + beside)))) > 1) == unstable


def test_a_mode_is_a_motion_of_the_loop(nominal):
    """Its root and the shares of the joints, from the independent matrix's own eigenvectors."""
    values, vectors = np.linalg.eig(_closed())
    rates = np.log(values[np.abs(values) > 1e-3] + 0j) / PERIOD
    damping = -rates.real / np.abs(rates)
    rate = rates[np.argmin(damping)]
    mode = nominal.margins.critical
    np.testing.assert_allclose(mode.frequency, abs(rate.imag), rtol=1e-6)
    np.testing.assert_allclose(mode.growth_rate, rate.real, rtol=1e-6)
    place = np.argmin(np.abs(values - np.exp(rate * PERIOD)))
    energy = nominal.robot.inertias * np.abs(vectors[2:4, place]) ** 2
    np.testing.assert_allclose(mode.participation, energy / energy.sum(), rtol=1e-5)


# --- delays near the Nyquist frequency --------------------------------------------------------


def test_a_delay_of_a_part_of_a_period_can_destabilise_first(tmp_path):
    """Near the Nyquist frequency an added delay is more than a turn of the phase."""
    path = _file(tmp_path, "slide.xml", SLIDE)
    (found,) = _evaluated(path, "[parameters]", ["gain_scale=55", "physics_step=0.001"])
    margin = found.margins.whole.delay_margin
    assert 0.0 < margin < PERIOD
    for beside, unstable in ((-1e-8, False), (1e-8, True)):
        assert (_radius(found.robot.later_by(margin + beside)[0]) > 1.0) == unstable
    for delay in np.linspace(0.0, margin * (1 - 1e-6), 20):
        assert _radius(found.robot.later_by(delay)[0]) < 1.0


# --- the loop's matrices ----------------------------------------------------------------------


def _loop_of(robot, delay, **sensor):
    """A loop of the arm, with gains that differ."""
    place = posture.settled(robot)
    plant = linearize.linear_c(robot, place, PERIOD / SUBSTEPS).plant
    drive = Drive(
        Controller(kp=jnp.array([150.0, 40.0]), kd=jnp.array([9.0, 2.0])),
        Actuator(jnp.array([300.0, 500.0]), jnp.array([0.5, 0.9]), jnp.array([delay, 0.4e-3])),
        Sensor(delay=jnp.array([0.7e-3, 0.0]), **sensor),
        control_period=PERIOD,
    )
    return Loop(plant, drive)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return model.read(_file(tmp_path_factory.mktemp("robot"), "arm.xml", ARM))


@pytest.mark.exhaustive
@pytest.mark.parametrize(("delay", "differenced"), [(2.3e-3, False), (20.6e-3, True)])
def test_the_period_map_is_the_propagation_of_the_simulated_loop(robot, delay, differenced):
    """Long delays live in ring buffers, which the map sees from their newest value on."""
    with jax.enable_x64(True):
        loop = _loop_of(robot, delay, velocity_filter=jnp.array([400.0, np.inf]))
        static = options(loop.drive, substeps=SUBSTEPS, differenced=differenced)
        found = jax.jit(lambda loop: robot_loop.period_map(loop, static))(loop)

        @jax.jit
        def propagated(loop):
            prepared = _loop.prepare(loop, static)
            rest = jnp.zeros(2)
            state = _loop.init(prepared, static, rest, rest)
            start, apply = growth.propagation(prepared, static, state, Setpoint(rest), 1)
            flat, unravel = ravel_pytree(start)
            one = lambda unit: ravel_pytree(apply(unravel(unit)))[0]  # noqa: E731
            return state, jax.vmap(one)(jnp.eye(flat.size))

        state, columns = propagated(loop)
        whole, merge = growth.split(growth.aligned(state))
        places, back = ravel_pytree(whole)
        numbered = merge(back(jnp.arange(places.size, dtype=places.dtype)))
        smaller, _ = essential(numbered.drive)
        kept, _ = ravel_pytree(growth.split(_loop.LoopState(numbered.plant, smaller))[0])
        kept = np.asarray(kept, int)
        np.testing.assert_allclose(found.M[np.ix_(kept, kept)], columns.T, atol=1e-12)
        dropped = np.setdiff1d(np.arange(places.size), kept)
        assert dropped.size and not np.any(found.M[dropped])


@pytest.mark.exhaustive
def test_the_open_loop_gives_s_for_any_gains(robot):
    """S = (I + [kp kd] G)^-1, with G from the loop opened at its controllers."""
    with jax.enable_x64(True):
        loop = _loop_of(robot, 2.3e-3)
        static = options(loop.drive, substeps=SUBSTEPS)
        opened = jax.jit(lambda loop: robot_loop.open_map(loop, static))(loop)
        opened = jax.tree.map(np.asarray, opened)
        z = np.exp(1j * np.geomspace(0.5, np.pi / PERIOD, 40) * PERIOD)[:, None, None]
        states = np.linalg.solve(z * np.eye(len(opened.A)) - opened.A, opened.B[None])
        period = jax.jit(lambda loop: robot_loop.period_map(loop, static))
        for kp, kd in (((150.0, 40.0), (9.0, 2.0)), ((10.0, 90.0), (1.0, 0.5))):
            kp, kd = np.array(kp), np.array(kd)
            found = period(robot_loop.with_gains(loop, kp, kd))
            M, N, C = (np.asarray(part) for part in (found.M, found.N, found.C))
            expected = np.eye(2) + C @ np.linalg.solve(z * np.eye(len(M)) - M, N[None])
            commands = kp[:, None] * opened.positions + kd[:, None] * opened.velocities
            S = np.linalg.inv(np.eye(2) + commands @ states)
            np.testing.assert_allclose(S, expected, rtol=1e-9, atol=1e-11)


# --- the structured singular value ------------------------------------------------------------


@pytest.mark.parametrize("joints", [2, 3, 4])
def test_the_bound_is_the_best_scaling_and_never_below_mu(joints):
    generator = np.random.default_rng(joints)
    for _ in range(3):
        H = generator.normal(size=(joints, joints)) + 1j * generator.normal(size=(joints, joints))
        H *= np.exp(generator.normal(size=joints))[:, None]

        def log_largest(x, H=H):
            return np.log(np.linalg.norm(H * np.exp(x[:, None] - x[None]), 2))

        tight = {"xatol": 1e-9, "fatol": 1e-13, "maxiter": 20000, "maxfev": 20000}
        starts = [np.zeros(joints), generator.normal(size=joints)]
        runs = [minimize(log_largest, x, method="Nelder-Mead", options=tight) for x in starts]
        best = min(run.fun for run in runs)
        found = multiloop_disk.bound(H)
        assert found <= np.exp(best) * (1 + 1e-8)
        np.testing.assert_allclose(found, np.exp(best), rtol=1e-4)
        turns = np.exp(2j * np.pi * generator.random((4000, joints)))
        below = np.abs(np.linalg.eigvals(H * turns[:, None])).max()
        assert below <= found * (1 + 1e-12)
        if joints < 4:
            assert below > 0.97 * found
    assert multiloop_disk.bound(np.diag([1.0, -2.0, 3j])) == pytest.approx(3.0, rel=1e-8)


# --- the quadruped ----------------------------------------------------------------------------

QUADRUPED = """engine = "mujoco"
[plant]
model = "quadruped.xml"
keyframe = "stand"
[parameters]
kp = 600.0
kd = 30.0
actuator = "hyq"
delay = 0.0013
[axes]
"""


@pytest.fixture(scope="module")
def quadruped():
    folder = ROOT / "experiments" / "quadruped"
    return reading.parse(QUADRUPED + "feedforward = [0.0]", folder), folder


@pytest.mark.exhaustive
def test_the_growth_rate_of_a_quadruped_changes_sign_at_its_gain_margins(quadruped):
    specification, folder = quadruped
    (found,) = whole_robot.evaluate(specification)
    whole = found.margins.whole
    assert len(found.margins.joints) == 12 and found.neutral == 3
    assert 1.0 < whole.gain_margin < 10.0 and 0.05 < whole.gain_reduction_margin < 1.0
    beside = [
        factor * (1 + e)
        for factor in (whole.gain_margin, whole.gain_reduction_margin)
        for e in (-1e-3, 1e-3)
    ]
    swept = reading.parse(f"{QUADRUPED}gain_scale = {beside}", folder)
    samples = expand(swept)
    (plan,) = plans.groups(engines.resolved(swept), samples)
    ((numbers, count),) = plans.batches(plan, samples)
    rates = spectra.rates_batch(plan, engines.resolved(swept), samples, numbers).growth[:count]
    assert (np.sign(rates) == [-1, 1, 1, -1]).all()
    # low gain topples it, high gain shakes it
    assert whole.gain_reduction_frequency == 0.0 and whole.gain_margin_frequency > 100.0


def test_a_symmetric_robot_has_symmetric_margins(quadruped):
    (found,) = whole_robot.evaluate(quadruped[0])
    by_name = {joint.name: joint for joint in found.margins.joints}
    for joint in ("HAA", "HFE", "KFE"):
        for end in ("F", "H"):
            left, right = (by_name[f"{side}{end}_{joint}"] for side in "LR")
            for name in ("gain_margin", "disk_margin", "sensitivity_peak"):
                np.testing.assert_allclose(getattr(left, name), getattr(right, name), rtol=1e-4)
    shares = found.margins.changes.more_delay.participation[found.margins.ranking]
    assert (np.diff(shares) <= 1e-6).all()
    # Of legs that are alike, the model's first comes first.
    names = [found.margins.joints[place].name for place in found.margins.ranking]
    assert all(left[1:] == right[1:] for left, right in zip(names[::2], names[1::2], strict=True))
    assert all(left.startswith("L") for left in names[::2]), names
    for mode in (found.margins.critical, found.margins.at_peak):
        np.testing.assert_allclose(mode.participation.sum(), 1.0)
        assert (mode.participation >= 0.0).all()


def test_samples_with_other_masses_have_other_margins(tmp_path):
    path = _file(tmp_path, "arm.xml", ARM)
    document = f"""engine = "mujoco"
    [plant]
    model = "{path.name}"
    [parameters]
    kp = 150.0
    kd = 9.0
    [axes]
    inertia_scale = [1.0, 2.0]"""
    light, heavy = whole_robot.evaluate(reading.parse(document, tmp_path))
    np.testing.assert_allclose(heavy.robot.inertias, 2.0 * light.robot.inertias, rtol=1e-6)
    # gravity and damping aside, twice the mass bears twice the gains
    ratio = heavy.margins.whole.gain_margin / light.margins.whole.gain_margin
    assert 1.9 < ratio < 2.1
