"""Closed-loop roots: how many are unstable (argument principle), and the rightmost one.

Delta(s) = (m s^2 + c s + k) (s^2 + 2 zeta wn s + wn^2) / wn^2 + (kp + kd s) exp(-s delay)

With a filter of the velocity the first term takes the factor 1 + s tau, and kd becomes kd + kp tau.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.analysis.joint.crossovers import TURN, gain_crossovers
from jaxact.analysis.joint.frequency import JointLoop, broadcast_loop, filter_lag, lead_gain, phase
from jaxact.analysis.joint.stationary import gain_extremes, typical_frequency

_NODES = 24
_STARTS = 10
_NEWTON_STEPS = 24


def encirclements(phases: jax.Array, present: jax.Array, loop: JointLoop) -> jax.Array:
    """Number of closed-loop roots not in the open left half plane, from the phase at gain
    crossovers.

    Between crossovers with |L| > 1 the curve passes the critical ray once for every multiple of
    2 pi that the phase passes, and each passage downwards moves a pair of roots to the right:

        2 sum over those stretches [a, b] of (floor(phase_a / 2 pi) - ceil(phase_b / 2 pi) + 1).

    A curve that ends on the critical point has a pair of roots on the axis, which is counted. Where
    |L| < 1 it cannot encircle the point. The double pole at the origin starts the curve at
    phase 0+ for kp > 0; for kp <= 0 one root is never on the left. A sprung joint may start at
    |L| = |kp/k| < 1: then none of that counts, and one root is not on the left if kp + k <= 0.

    Args:
        phases: phase(w) at the gain crossovers in ascending order [rad], shape (k, ...).
        present: which of them exist, shape (k, ...).
        loop: fields of shape (1, ...).
    """
    start = jnp.where(loop.kp > 0, 0.0, jnp.where(loop.kd < 0, -1.0, 0.0))
    # |L| < 1 after the last crossover, so present ones alternate towards it: down, up, down.
    number = present.astype(phases.dtype)
    rank = jnp.cumsum(number[::-1], axis=0)[::-1]
    turns = phases / TURN
    signed = jnp.where(rank % 2 == 1, 1.0 - jnp.ceil(turns), jnp.floor(turns))
    pairs = jnp.sum(jnp.where(present, signed, 0.0), axis=0, keepdims=True)
    if not loop.sprung:
        return 2.0 * (pairs + start) + jnp.where(loop.kp > 0, 0.0, 1.0) + _more_at_rest(loop)
    loud = rank[:1] % 2 == 1
    held = jnp.where(loud, loop.kp, loop.kp + loop.joint_stiffness) > 0
    turned = 2.0 * (pairs + jnp.where(loud, start, 0.0)) + jnp.where(held, 0.0, 1.0)
    return turned + _more_at_rest(loop) + _undamped(loop)


def _more_at_rest(loop: JointLoop) -> jax.Array:
    """1 where kp + k = 0 and the root at the origin is not the one that is never on the left.

    Delta'(0) = c + 2 zeta/wn k + kd - kp td. Where it is 0, two roots are at the origin; where it
    is negative, another one is to the right.
    """
    stiffness = loop.joint_stiffness if loop.sprung else 0.0
    lag = 2.0 * loop.damping_ratio / loop.natural_frequency
    slope = loop.kd - loop.kp * loop.delay
    if loop.sprung:
        slope = slope + loop.joint_damping + stiffness * lag
    return jnp.where((loop.kp + stiffness == 0.0) & (slope <= 0.0), 1.0, 0.0)


def _undamped(loop: JointLoop) -> jax.Array:
    """2 where the gains are 0 and a spring without damping swings on by itself."""
    free = (loop.kp == 0.0) & (loop.kd == 0.0) & (loop.joint_damping == 0.0)
    return jnp.where(free & (loop.joint_stiffness > 0.0), 2.0, 0.0)


def count_unstable_roots(loop: JointLoop) -> jax.Array:
    """Number of closed-loop roots that are not in the open left half plane, int32, shape (...).

    Exact for every delay: argument principle on the refined gain crossovers.

    Args:
        loop: fields of any broadcastable shape.
    """
    loop = broadcast_loop(loop)
    rows = jax.tree.map(lambda a: a[None], loop)
    w, present = gain_crossovers(rows, gain_extremes(rows))
    return encirclements(phase(rows, w), present, rows)[0].astype(jnp.int32)


def rightmost_root(loop: JointLoop, approximate: jax.Array | None = None) -> jax.Array:
    """The closed-loop root with the largest real part [1/s], complex with Im >= 0, shape (...).

    Collocation of the delayed command on Chebyshev nodes gives approximate roots (Breda, Maset
    and Vermiglio, Stability of Linear Delay Differential Equations); Newton on the exact
    characteristic function refines them together with the open-loop corners, and the derivative
    is that of the implicit function. NaN where no start converges.

    Args:
        loop: fields of any broadcastable shape.
        approximate: eigenvalues of `collocation_matrices`, shape (n, k); None to compute them here,
            by JAX's LAPACK, which imports all of SciPy's.
    """
    loop = broadcast_loop(loop)
    shape = loop.kp.shape
    rows = jax.tree.map(lambda a: a.reshape((1, -1)), loop)
    constant = jax.lax.stop_gradient(rows)
    if approximate is None:
        approximate = jnp.linalg.eigvals(collocation_matrices(constant))
    root = _rightmost(constant, approximate)
    value, slope = characteristic(rows, root)
    # One more step of Newton's; its derivative is -(d Delta / d parameter) / Delta'(s).
    slope = jax.lax.stop_gradient(slope)
    # Two roots at the origin have no slope, and are exact.
    step = jnp.where(slope == 0.0, 0.0, value / jnp.where(slope == 0.0, 1.0, slope))
    refined = (root - step).reshape(shape)
    return jax.lax.complex(refined.real, jnp.abs(refined.imag))


def spectral_abscissa(loop: JointLoop) -> jax.Array:
    """Real part of the rightmost closed-loop root [1/s], shape (...); negative = stable.

    Args:
        loop: fields of any broadcastable shape.
    """
    return rightmost_root(loop).real


def characteristic(loop: JointLoop, s: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Delta(s) = (m s^2 + c s + k) D(s) + (kp + kd s) exp(-s td) [N/m] and dDelta/ds, complex.

    Args:
        s: [1/s], complex.
    """
    v = 1.0 / loop.natural_frequency
    lag = 2.0 * loop.damping_ratio * v
    servo, servo_slope = 1.0 + s * (lag + s * v * v), lag + 2.0 * s * v * v
    shift = jnp.exp(-s * loop.delay)
    if loop.velocity_filter is not None:
        tau = filter_lag(loop)
        servo, servo_slope = servo * (1.0 + s * tau), servo_slope * (1.0 + s * tau) + servo * tau
    rate = lead_gain(loop)
    control = loop.kp + rate * s
    if loop.sprung:
        plant = s * (loop.mass * s + loop.joint_damping) + loop.joint_stiffness
        slope = (2.0 * loop.mass * s + loop.joint_damping) * servo + plant * servo_slope
        return plant * servo + control * shift, slope + (rate - loop.delay * control) * shift
    value = loop.mass * s * s * servo + control * shift
    slope = loop.mass * s * (2.0 * servo + s * servo_slope)
    return value, slope + (rate - loop.delay * control) * shift


def _rightmost(loop: JointLoop, approximate: jax.Array) -> jax.Array:
    """Newton from every start; the converged root furthest to the right, shape (1, n)."""
    # The rightmost of the approximate roots with Im >= 0.
    key = jnp.where(approximate.imag >= 0, approximate.real, -jnp.inf)
    _, index = jax.lax.top_k(key, _STARTS)
    approximate = jnp.take_along_axis(approximate, index, axis=1).T
    starts = jnp.concatenate([approximate, _corner_starts(loop)])

    def newton(_: int, s: jax.Array) -> jax.Array:
        value, slope = characteristic(loop, s)
        return s - value / slope

    s = jax.lax.fori_loop(0, _NEWTON_STEPS, newton, starts)
    value, slope = characteristic(loop, s)
    scale = jnp.abs(s) + 1e-3 * jnp.sqrt(jnp.abs(loop.kp) / loop.mass)
    tolerance = jnp.sqrt(jnp.finfo(scale.dtype).eps)
    converged = jnp.isfinite(jnp.abs(s)) & (jnp.abs(value / slope) <= tolerance * scale)
    # At rest kp + k = 0, which Newton finds slowly where two roots are there.
    still = loop.kp + loop.joint_stiffness if loop.sprung else loop.kp
    s = jnp.concatenate([s, jnp.zeros_like(s[:1])])
    converged = jnp.concatenate([converged, still == 0.0])
    real = jnp.where(converged, s.real, -jnp.inf)
    best = real == jnp.max(real, axis=0, keepdims=True)
    chosen = best & converged
    imaginary = jnp.max(jnp.where(chosen, jnp.abs(s.imag), 0.0), axis=0, keepdims=True)
    real = jnp.max(real, axis=0, keepdims=True)
    return jax.lax.complex(jnp.where(jnp.isinf(real), jnp.nan, real), imaginary)


def _corner_starts(loop: JointLoop) -> jax.Array:
    """Rigid-body roots, servo poles, gain crossovers and points in the right half plane."""
    kp, kd, mass = loop.kp + 0j, loop.kd, loop.mass
    if loop.sprung:
        kp, kd = kp + loop.joint_stiffness, kd + loop.joint_damping
    root = jnp.sqrt(kd**2 - 4.0 * mass * kp)
    wn = jnp.where(jnp.isinf(loop.natural_frequency), 1.0, loop.natural_frequency)
    servo = wn * (-loop.damping_ratio + jnp.sqrt(loop.damping_ratio**2 - 1.0 + 0j))
    w, _ = gain_crossovers(loop, gain_extremes(loop))
    starts = [(root - kd) / (2.0 * mass), -2.0 * kp / (kd + root), servo, 1j * w, (0.5 + 1.0j) * w]
    if loop.sprung:
        c = loop.joint_damping
        alone = jnp.sqrt(c**2 - 4.0 * mass * loop.joint_stiffness + 0j)
        starts += [(alone - c) / (2.0 * mass), -(alone + c) / (2.0 * mass)]
    return jnp.concatenate(starts)


def collocation_matrices(loop: JointLoop) -> jax.Array:
    """Matrices whose eigenvalues approximate the roots of n loops, shape (n, k, k).

    Args:
        loop: fields that broadcast to n numbers.
    """
    flat = jax.tree.map(jnp.ravel, broadcast_loop(loop))
    return jax.vmap(_collocation_matrix)(flat)


def _collocation_matrix(loop: JointLoop) -> jax.Array:
    """x' = A x of one loop, x = (q, v, f, f'/wn, u(t - theta_1 td), ..., u(t - td)).

    The command u = -(kp q + kd v) travels along the nodes as du/dt = -du/dtheta / td. Where the
    velocity is filtered, it is a fifth state before them.
    """
    ideal, late = jnp.isinf(loop.natural_frequency), loop.delay > 0
    wn = jnp.where(ideal, 1.0, loop.natural_frequency)
    filtered = loop.velocity_filter is not None
    own = 5 if filtered else 4
    travel = jnp.asarray(_differentiation_matrix(_NODES), dtype=loop.kp.dtype)
    speed = jnp.where(late, 2.0 / jnp.where(late, loop.delay, 1.0), 0.0)
    unit = jnp.eye(own + _NODES, dtype=loop.kp.dtype)
    position, velocity, force, rate = unit[0], unit[1], unit[2], unit[3]
    cutoff = jnp.inf if loop.velocity_filter is None else loop.velocity_filter
    sensed = jnp.where(jnp.isinf(cutoff), velocity, unit[4]) if filtered else velocity
    command = -(loop.kp * position + loop.kd * sensed)
    delayed = jnp.where(late, unit[-1], command)

    # The ideal servo has no state of its own: those two decay by themselves.
    push = jnp.where(ideal, delayed, force) / loop.mass
    if loop.sprung:
        own_force = loop.joint_stiffness * position + loop.joint_damping * velocity
        push = push - own_force / loop.mass
    force_row = jnp.where(ideal, -force, wn * rate)
    rate_row = wn * (delayed - force) - 2.0 * loop.damping_ratio * wn * rate
    rate_row = jnp.where(ideal, -rate, rate_row)
    history = speed * (jnp.outer(travel[1:, 0], command) + travel[1:, 1:] @ unit[own:])
    # Without delay the history is idle.
    idle = 1e3 * typical_frequency(loop) if loop.sprung else 1.0
    history = history - jnp.where(late, 0.0, idle) * unit[own:]
    rows = [velocity, push, force_row, rate_row]
    if filtered:
        finite = jnp.where(jnp.isinf(cutoff), 1.0, cutoff)
        rows.append(finite * (velocity * jnp.isfinite(cutoff) - unit[4]))
    return jnp.concatenate([jnp.stack(rows), history])


def _differentiation_matrix(order: int) -> np.ndarray:
    """Derivative at the Chebyshev points cos(pi k / order) (Trefethen, Spectral Methods)."""
    k = np.arange(order + 1)
    x = np.cos(np.pi * k / order)
    c = np.where((k == 0) | (k == order), 2.0, 1.0) * (-1.0) ** k
    matrix = np.outer(c, 1.0 / c) / (x[:, None] - x[None, :] + np.eye(order + 1))
    return matrix - np.diag(matrix.sum(axis=1))
