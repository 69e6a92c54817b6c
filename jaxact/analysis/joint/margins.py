"""All stability margins of a joint's loop: exact delay, batched, differentiable.

Frequencies are found with the parameters held constant; one Newton step with the parameters live
then gives them the derivative of the implicit function, so that nothing differentiates an
iteration. Margins of an unstable loop mean nothing and are NaN; its number of unstable roots and
its distance to the boundary are given all the same.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxact.analysis.joint.crossovers import (
    TURN,
    gain_crossovers,
    marginal_phasor,
    phase_crossovers,
    slowdown_frequency,
    slowdown_residual,
)
from jaxact.analysis.joint.distance import counted_distance, static_factor, static_move
from jaxact.analysis.joint.frequency import (
    JointLoop,
    broadcast_loop,
    log_gain,
    log_gain_slope,
    phase,
    phase_slope,
)
from jaxact.analysis.joint.peaks import locate_peaks, peak_slopes, peak_values
from jaxact.analysis.joint.positive_roots import insert_sorted, sort_rows
from jaxact.analysis.joint.roots import encirclements
from jaxact.analysis.joint.stationary import gain_extremes, phase_extremes, typical_frequency
from jaxact.compilation.filling import filled

_TILE = 256


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Margins:
    """Margins of a batch of loops, each of the batch's shape; NaN where the loop is unstable.

    A loop has one or three gain crossovers (at most five where its velocity is filtered, six where
    the joint has a stiffness besides), never more, and all are found, so nothing can overflow.

    Attributes:
        stable: bool.
        unstable_roots: closed-loop roots not in the open left half plane, int32.
        log_gain_to_boundary: ln of the common factor on all gains to the nearest boundary of the
            stable region [-], > 0 if stable (inf if no factor destabilises), < 0 if unstable. Where
            no common factor stabilises, kd/kp <= td + 2 zeta/wn, it is ln k of slowing the loop
            down to (kp k^2, kd k) on the first lobe of the boundary, which always exists for kp, kd
            > 0; of a joint with damping or stiffness of its own, -inf.
        gain_margin: smallest factor above 1 on all gains that destabilises [-], inf if none.
        gain_reduction_margin: largest factor below 1 that destabilises [-], 0 if none.
        phase_crossover: frequency of `gain_margin` [rad/s], inf if there is none.
        phase_margin: the one smallest in magnitude over all gain crossovers [rad].
        gain_crossover: its frequency [rad/s].
        delay_margin: smallest added delay that destabilises [s].
        sensitivity_peak: Ms = max |S| [-] and its frequency [rad/s], inf if |S| only tends to 1.
        complementary_peak: Mt = max |T| [-] and its frequency [rad/s].
        modulus_margin: 1 / Ms [-].
        disk_margin: balanced, 1 / max |S - 1/2| [-].
    """

    stable: jax.Array
    unstable_roots: jax.Array
    log_gain_to_boundary: jax.Array
    gain_margin: jax.Array
    gain_reduction_margin: jax.Array
    phase_crossover: jax.Array
    phase_margin: jax.Array
    gain_crossover: jax.Array
    delay_margin: jax.Array
    sensitivity_peak: jax.Array
    sensitivity_peak_frequency: jax.Array
    complementary_peak: jax.Array
    complementary_peak_frequency: jax.Array
    modulus_margin: jax.Array
    disk_margin: jax.Array


def margins(loop: JointLoop) -> Margins:
    """All margins of every loop of a batch, safe under jit, vmap and grad.

    Works in the precision of the fields (float64 for certification). Domain: mass, wn, zeta > 0,
    delay >= 0; kp <= 0 is unstable, unless the joint has a stiffness of its own.

    Args:
        loop: fields of any broadcastable shape; the result has their common shape.
    """
    loop = broadcast_loop(loop)
    shape = loop.kp.shape
    flat = jax.tree.map(lambda a: a.reshape((1, -1)), loop)
    frozen = jax.lax.stop_gradient(flat)
    found = _in_tiles(_search, frozen, flat.kp.shape[1])
    result = _assemble(flat, found)
    return jax.tree.map(lambda a: a.reshape(shape), result)


class _Found(NamedTuple):
    """What the search found: frequencies [rad/s], constant, candidates on axis 0 and loops on 1.

    Attributes:
        gain, gain_present: gain crossovers, shape (3, n), or (5, n) with a filter of the velocity.
        phase, level, direction, phase_present: critical crossings as `phase_crossovers` gives them.
        peaks: of |S|, |T|, |S - 1/2|, shape (3, n).
        slow: of `slowdown_frequency`, shape (1, n).
    """

    gain: jax.Array
    gain_present: jax.Array
    phase: jax.Array
    level: jax.Array
    direction: jax.Array
    phase_present: jax.Array
    peaks: jax.Array
    slow: jax.Array


def _in_tiles(function: Callable[[JointLoop], _Found], loop: JointLoop, number: int) -> _Found:
    """`function` over tiles of the batch: the search's work arrays then stay in cache."""
    if number <= _TILE:
        return function(loop)
    tiles = -(-number // _TILE)
    full = filled(loop, tiles * _TILE)
    found = jax.lax.map(function, jax.tree.map(lambda a: a.reshape((tiles, 1, _TILE)), full))
    return jax.tree.map(
        lambda a: jnp.moveaxis(a, 0, 1).reshape((a.shape[1], -1))[:, :number], found
    )


def _search(loop: JointLoop) -> _Found:
    """Refined crossovers and peaks of a tile of loops; fields of shape (1, n)."""
    extremes = gain_extremes(loop)
    w_gain, gain_present = gain_crossovers(loop, extremes)
    turns = [phase_extremes(loop), extremes, w_gain]
    if loop.sprung:
        # An undamped joint's phase jumps at its resonance; 1.07 keeps a missing one apart.
        resonance = jnp.sqrt(jnp.maximum(loop.joint_stiffness, 0.0) / loop.mass)
        turns.append(jnp.where(resonance > 0, resonance, 1.07 * typical_frequency(loop)))
    points = sort_rows(jnp.concatenate(turns))
    w_phase, level, direction, phase_present = phase_crossovers(loop, points)
    nodes = _peak_nodes(loop, points, w_phase, phase_present)
    peaks = locate_peaks(loop, nodes)
    slow = jnp.ones_like(peaks[:1]) if loop.sprung else slowdown_frequency(loop)
    return _Found(w_gain, gain_present, w_phase, level, direction, phase_present, peaks, slow)


def _peak_nodes(
    loop: JointLoop, points: jax.Array, crossings: jax.Array, present: jax.Array
) -> jax.Array:
    """Corners and crossings of L in ascending order, out to where |L| is negligible [rad/s]."""
    middle = jnp.where(present[1:-1], crossings[1:-1], 0.5 * (points[:-1] + points[1:]))
    first = jnp.where(present[:1], crossings[:1], 0.5 * points[:1])
    last = jnp.where(present[-1:], crossings[-1:], 2.0 * points[-1:])
    corner = jnp.where(loop.kd > 0, loop.kp / jnp.where(loop.kd > 0, loop.kd, 1.0), points[:1])
    corner = jnp.abs(corner)
    stiff = loop.kp + loop.joint_stiffness if loop.sprung else loop.kp
    rigid = jnp.sqrt(jnp.abs(stiff) / loop.mass)
    if loop.sprung:
        rigid = jnp.where(rigid > 0, rigid, typical_frequency(loop))
        corner = jnp.where(corner > 0, corner, rigid)
    start = 0.1 * jnp.minimum(jnp.minimum(corner, rigid), jnp.minimum(first, points[:1]))
    end = 1.5 * jnp.maximum(jnp.maximum(rigid, last), 8.0 * points[-1:])
    pairs = jnp.stack([points[:-1], middle], axis=1).reshape((-1, *points.shape[1:]))
    rows = jnp.concatenate([start, first, pairs, points[-1:], last, end])
    # The factors keep points apart that round numbers would make equal.
    extras = [1.037 * corner, 0.963 * rigid]
    if loop.velocity_filter is not None:
        finite = jnp.isfinite(loop.velocity_filter)
        extras.append(1.019 * jnp.where(finite, loop.velocity_filter, rigid))
    for extra in extras:
        rows = insert_sorted(rows, extra)
    return jnp.maximum(rows, jnp.finfo(rows.dtype).tiny * 1e6)


def _newton_frequency(w: jax.Array, residual: jax.Array, slope: jax.Array) -> jax.Array:
    """w refined once more: the value of Newton's step, the derivative of the implicit function.

    Args:
        w: constant [rad/s].
        residual: of the equation at w, live.
        slope: d residual / d ln w.
    """
    slope = jax.lax.stop_gradient(slope)
    step = residual / jnp.where(slope == 0.0, 1.0, slope)
    bounded = jnp.abs(jax.lax.stop_gradient(step)) < 0.1
    return w * (1.0 - jnp.where((slope != 0.0) & bounded, step, 0.0))


def _assemble(loop: JointLoop, found: _Found) -> Margins:
    """Margins from the frequencies found; the only part that is differentiated."""
    gain_present, phase_present = found.gain_present, found.phase_present
    loudness, fall = log_gain(loop, found.gain), log_gain_slope(loop, found.gain)
    w_gain = _newton_frequency(found.gain, loudness, fall)
    turned, turning = phase(loop, found.phase) - found.level, phase_slope(loop, found.phase)
    w_phase = _newton_frequency(found.phase, turned, turning)
    phases = phase(loop, w_gain)
    unstable = encirclements(jax.lax.stop_gradient(phases), gain_present, loop)
    stable = unstable == 0

    log_factor = -log_gain(loop, w_phase)
    if loop.sprung:
        # Where stiffness kp + k passes zero, a real root passes the origin.
        at_rest, there = static_factor(loop.kp, loop.joint_stiffness)
        log_factor = jnp.concatenate([log_factor, at_rest])
        phase_present = jnp.concatenate([phase_present, there])
        w_phase = jnp.concatenate([w_phase, jnp.zeros_like(at_rest)])
    above = phase_present & (log_factor > 0)
    below = phase_present & (log_factor < 0)
    up = jnp.where(above, log_factor, jnp.inf)
    log_up = jnp.min(up, axis=0, keepdims=True)
    log_down = jnp.max(jnp.where(below, log_factor, -jnp.inf), axis=0, keepdims=True)
    if loop.sprung:
        moved = jnp.concatenate([-2.0 * found.direction, static_move(loop)])
        distance = counted_distance(unstable, log_factor, moved, phase_present)
    else:
        distance = _signed_distance(loop, found, stable, log_factor)

    wrapped = phases - TURN * jnp.round(jax.lax.stop_gradient(phases) / TURN)
    phase_margin, gain_crossover = _smallest(jnp.abs(wrapped), gain_present, wrapped, w_gain)
    remaining = phases - TURN * jnp.floor(jax.lax.stop_gradient(phases) / TURN)
    delays = jnp.where(gain_present, remaining / w_gain, jnp.inf)
    sensitivity, complementary, disk, w_peak = _peaks(loop, found.peaks)

    def only_stable(value: jax.Array) -> jax.Array:
        return jnp.where(stable, value, jnp.nan)

    return Margins(
        stable=stable,
        unstable_roots=unstable.astype(jnp.int32),
        log_gain_to_boundary=distance,
        gain_margin=only_stable(jnp.exp(log_up)),
        gain_reduction_margin=only_stable(jnp.exp(log_down)),
        phase_crossover=only_stable(_smallest(up, above, w_phase, w_phase)[0]),
        phase_margin=only_stable(phase_margin),
        gain_crossover=only_stable(gain_crossover),
        delay_margin=only_stable(jnp.min(delays, axis=0, keepdims=True)),
        sensitivity_peak=only_stable(sensitivity),
        sensitivity_peak_frequency=only_stable(w_peak[0:1]),
        complementary_peak=only_stable(complementary),
        complementary_peak_frequency=only_stable(w_peak[1:2]),
        modulus_margin=only_stable(1.0 / sensitivity),
        disk_margin=only_stable(1.0 / disk),
    )


def _smallest(
    key: jax.Array, present: jax.Array, first: jax.Array, second: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """`first` and `second` at the present candidate of smallest `key`; inf if there is none."""
    key = jax.lax.stop_gradient(jnp.where(present, key, jnp.inf))
    chosen = jnp.argmin(key, axis=0)[None] == jnp.arange(key.shape[0])[:, None]
    chosen = chosen & present
    some = jnp.any(present, axis=0, keepdims=True)

    def pick(value: jax.Array) -> jax.Array:
        total = jnp.sum(jnp.where(chosen, value, 0.0), axis=0, keepdims=True)
        return jnp.where(some, total, jnp.inf)

    return pick(first), pick(second)


def _peaks(loop: JointLoop, w: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Ms, Mt, max |S - 1/2| and their frequencies; w: constant [rad/s], shape (3, n)."""
    slope, curvature = peak_slopes(loop, w)
    w = _newton_frequency(w, slope, curvature * w)
    value = peak_values(loop, w)
    # |S| tends to 1 and |T| starts at 1, so no peak is lower.
    floor = jnp.array([1.0, 1.0, 0.5], dtype=value.dtype)[:, None]
    limit = jnp.array([jnp.inf, 0.0, jnp.inf], dtype=value.dtype)[:, None]
    if loop.sprung:
        # At rest S = k / (kp + k), T = kp / (kp + k); T tends to 0.
        k, kp = loop.joint_stiffness, loop.kp
        whole = jnp.where(kp + k == 0, 1.0, kp + k)
        tops = jnp.concatenate([k / whole, kp / whole, 0.5 * (k - kp) / whole])
        still = jnp.abs(tops)
        higher = still >= floor * jnp.array([1.0, 0.0, 1.0], dtype=value.dtype)[:, None]
        floor, limit = jnp.where(higher, still, floor), jnp.where(higher, 0.0, limit)
    attained = value > floor
    value = jnp.where(attained, value, floor)
    w = jnp.where(attained, w, limit)
    return value[0:1], value[1:2], value[2:3], w


def _signed_distance(
    loop: JointLoop, found: _Found, stable: jax.Array, log_factor: jax.Array
) -> jax.Array:
    """ln of the common factor on the gains to the nearest edge of the stable set, signed.

    Raising the gains through a crossing moves a pair of roots to the right where the phase falls,
    and to the left where it rises. Counting them from zero gain says which crossings are edges.
    If even small gains are unstable, kd/kp <= td + 2 zeta/wn, no common factor helps; the
    distance is then that of slowing the loop down, (kp k^2, kd k), and |ln k| is what is given.
    """
    present, direction = found.phase_present, found.direction
    constant = jax.lax.stop_gradient(log_factor)
    earlier = present[None] & (constant[None] < constant[:, None])
    passed = jnp.sum(jnp.where(earlier, -direction[None], 0.0), axis=1)
    edge = present & ((passed == 0) | (passed - direction == 0))
    nearest = jnp.min(jnp.where(edge, jnp.abs(log_factor), jnp.inf), axis=0, keepdims=True)
    lag = loop.delay + 2.0 * loop.damping_ratio / loop.natural_frequency
    rescued = loop.kd > loop.kp * lag
    slowed = jnp.where(
        rescued | stable, -jnp.inf, _log_slowdown(loop, found.slow, rescued | stable)
    )
    return jnp.where(stable, nearest, jnp.where(rescued, -nearest, slowed))


def _log_slowdown(loop: JointLoop, w: jax.Array, unused: jax.Array) -> jax.Array:
    """ln k < 0 with (kp k^2, kd k) on the first lobe of the boundary: kp k^2 = m w^2 Re P.

    Args:
        w: constant, of `slowdown_frequency` [rad/s].
        unused: where the result does not matter, and a harmless loop is put in its place.
    """
    safe = jax.tree.map(lambda a: jnp.where(unused, 1.0, a), loop)
    w = jnp.where(unused, 0.5, w)
    residual, slope = jax.jvp(lambda x: slowdown_residual(safe, x), (w,), (w,))
    w = _newton_frequency(w, residual, slope)
    factor = safe.mass * w * w * marginal_phasor(safe, w)[0] / jnp.where(safe.kp > 0, safe.kp, 1.0)
    usable = (factor > 0) & (safe.kp > 0)
    return jnp.where(usable, 0.5 * jnp.log(jnp.where(usable, factor, 1.0)), -jnp.inf)
