"""Margins of the sampled loop, from its exact frequency response up to the Nyquist frequency.

Stability is decided by the eigenvalues of the one-period matrix; the margins are read off
L(exp(j w T)), the delay margin as in `jaxact.analysis.sampled.delay`. Crossovers and peaks are
found with the parameters constant; one Newton step with the parameters live carries the derivatives
of the implicit functions.
"""

import math
from dataclasses import dataclass, fields, replace
from functools import partial

import jax
import jax.numpy as jnp

from jaxact.analysis.joint.distance import counted_distance, static_factor
from jaxact.analysis.joint.margins import Margins
from jaxact.analysis.sampled.delay import DelayLimit, added_delay, delay_limits
from jaxact.analysis.sampled.period_map import SampledLoop
from jaxact.analysis.sampled.pulse import PulseTransfer, plant_response, pulse_transfer
from jaxact.analysis.sampled.roots import count_unstable, dominant_modulus, sampled_roots
from jaxact.analysis.sampled.search import (
    GAIN_SLOTS,
    PHASE_SLOTS,
    Found,
    Response,
    crossing_residual,
    peak_heights,
    peak_slopes,
    response_at,
    search,
    with_slopes,
)
from jaxact.compilation.filling import filled
from jaxact.compilation.once import once
from jaxact.parameters import JOINT_DAMPING, JOINT_STIFFNESS

_TILE = 64


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SampledMargins(Margins):
    """Margins of a batch of sampled loops, each of the batch's shape; NaN where unstable.

    Those of `Margins`, and more. Unstable roots are eigenvalues of the one-period matrix that are
    not inside the unit circle. Where |L| > 1 up to the Nyquist frequency there is no gain
    crossover: its frequency and the phase margin are inf. `log_gain_to_boundary` of an unstable
    loop is -inf where no factor on the gains helps. A delay margin is NaN, too, where a loss of
    stability was found that is not the first, which was missed, or none where |L| exceeds 1: it is
    not known.

    Attributes:
        spectral_radius: largest |eigenvalue| over one control period [-].
        more_crossovers: bool, there were more crossovers than slots, margins may be too large.
    """

    spectral_radius: jax.Array
    more_crossovers: jax.Array


_ARRAYS = tuple(f.name for f in fields(SampledLoop))[:8]
_OF_JOINT = (JOINT_DAMPING, JOINT_STIFFNESS)


def sampled_margins(
    loop: SampledLoop, *, max_delay_steps: int, roots: jax.Array | None = None
) -> SampledMargins:
    """All margins of every sampled loop of a batch, safe under jit, vmap and grad.

    Args:
        loop: fields of any broadcastable shape; the result has their common shape.
        max_delay_steps: at least the largest floor(delay / T) in the batch; fixes all sizes. A loop
            whose delay does not fit comes out unstable with NaN throughout.
        roots: `sampled_roots` of each loop where they are known already, constant, the batch's
            shape after an axis for the roots.
    """
    names = (*_ARRAYS, *(_OF_JOINT if loop.sprung else ()))
    if loop.sprung:
        loop = replace(loop, **dict(zip(_OF_JOINT, loop.joint or (), strict=True)))
    values = [jnp.asarray(getattr(loop, name)) for name in names]
    dtype = jnp.result_type(*values, float)
    values = list(jnp.broadcast_arrays(*(v.astype(dtype) for v in values)))
    shape = values[0].shape
    kind = {name: getattr(loop, name) for name in ("velocity", "integrator", "substeps")}

    def tile(rows: list[jax.Array], roots: jax.Array | None) -> SampledMargins:
        loops = SampledLoop(**dict(zip(names, rows, strict=True)), **kind)
        return _margins_of_tile(loops, max_delay_steps, roots)

    flat = [v.reshape(-1) for v in values], None if roots is None else roots.reshape(len(roots), -1)
    count = flat[0][0].shape[0]
    if count <= _TILE:
        result = tile(*flat)
    else:
        full = filled(flat, count + -count % _TILE)
        parts = jax.lax.map(lambda part: tile(*part), jax.tree.map(_tiles, full))
        result = jax.tree.map(lambda a: a.reshape(-1)[:count], parts)
    return jax.tree.map(lambda a: a.reshape(shape), result)


def _tiles(array: jax.Array) -> jax.Array:
    """(..., n) as (n / _TILE, ..., _TILE)."""
    return jnp.moveaxis(array.reshape((*array.shape[:-1], -1, _TILE)), -2, 0)


def _margins_of_tile(
    loops: SampledLoop, max_delay_steps: int, roots: jax.Array | None
) -> SampledMargins:
    transfers = jax.vmap(pulse_transfer)(loops)
    constant, fixed = jax.lax.stop_gradient((loops, transfers))
    found = jax.vmap(partial(search, max_delay_steps=max_delay_steps))(constant, fixed)
    limits = delay_limits(constant, fixed, found)
    if roots is None:
        known = jax.vmap(partial(sampled_roots, max_delay_steps=max_delay_steps))(constant)
    else:
        known = jax.lax.stop_gradient(roots.T)
    return jax.vmap(_margins_of_one)(loops, transfers, found, limits, known)


def _margins_of_one(
    loop: SampledLoop, transfer: PulseTransfer, found: Found, limit: DelayLimit, roots: jax.Array
) -> SampledMargins:
    count = count_unstable(jax.lax.stop_gradient(loop), roots)
    radius = dominant_modulus(loop, transfer, roots)
    found = replace(found, overflow=found.overflow | limit.overflow)
    return _assemble(loop, transfer, found, radius, count, added_delay(loop, limit))


def _newton(theta: jax.Array, residual: jax.Array, slope: jax.Array) -> jax.Array:
    """Newton's step, whose derivative is that of the implicit function; theta constant."""
    slope = jax.lax.stop_gradient(slope)
    step = residual / jnp.where(slope == 0, 1.0, slope)
    small = jnp.abs(jax.lax.stop_gradient(step)) < 0.1 * theta
    # At the Nyquist frequency nothing moves.
    free = (slope != 0) & small & (theta < math.pi)
    return theta - jnp.where(free, step, 0.0)


def _live_frequencies(
    response: Response, found: Found
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Gain crossovers, crossings with the Nyquist frequency last, peaks, and directions.

    The direction is the sign with which arg(-L) passes zero at a crossing.
    """
    end = jnp.full_like(found.phase[:1], math.pi)
    theta = jnp.concatenate([found.gain, found.phase, end, found.peaks])
    value, first, second = with_slopes(response, theta)
    crossings = GAIN_SLOTS + PHASE_SLOTS + 1
    of_gain = jnp.arange(crossings) < GAIN_SLOTS
    residual, slope = crossing_residual(value[:crossings], first[:crossings], of_gain)
    crossing = _newton(theta[:crossings], residual, slope)
    columns = (a[crossings:, None] for a in (value, first, second))
    slope_there, curvature = (a[:, 0] for a in peak_slopes(*columns))
    peaks = _newton(found.peaks, slope_there, curvature)
    direction = jnp.sign(jax.lax.stop_gradient(slope[GAIN_SLOTS:]))
    return crossing[:GAIN_SLOTS], crossing[GAIN_SLOTS:], peaks, direction


def _assemble(
    loop: SampledLoop,
    transfer: PulseTransfer,
    found: Found,
    radius: jax.Array,
    count: jax.Array,
    delay_margin: jax.Array,
) -> SampledMargins:
    """Margins from the frequencies found; the only part that is differentiated."""
    period = loop.control_period
    response = partial(response_at, loop, transfer)
    theta_gain, theta_phase, theta_peak, direction = _live_frequencies(response, found)
    value = once(response(jnp.concatenate([theta_gain, theta_phase, theta_peak])))
    at_gain, at_phase, at_peak = jnp.split(value, [GAIN_SLOTS, GAIN_SLOTS + PHASE_SLOTS + 1])

    # At z = -1 the response is real: a single root crosses there, whatever the slope.
    present = jnp.concatenate([found.phase_present, at_phase[-1:].real < 0])
    log_factor = -jnp.log(jnp.abs(at_phase))
    stable = (radius < 1.0) & (count == 0)
    # A pair of roots crosses the circle, and a single one at z = -1.
    moved = -direction * jnp.where(jnp.arange(PHASE_SLOTS + 1) < PHASE_SLOTS, 2.0, 1.0)
    if loop.sprung:
        at_rest, moved_at_rest, there = _at_rest(loop, transfer)
        log_factor, moved = jnp.append(log_factor, at_rest), jnp.append(moved, moved_at_rest)
        present, theta_phase = jnp.append(present, there), jnp.append(theta_phase, 0.0)
    up = jnp.where(present & (log_factor > 0), log_factor, jnp.inf)
    down = jnp.where(present & (log_factor < 0), log_factor, -jnp.inf)
    distance = counted_distance(count[None], log_factor, moved, present)[0]
    bounded = jnp.isfinite(jnp.min(up))
    angle = jnp.arctan2(-at_gain.imag, -at_gain.real)
    nearest = jnp.argmin(jnp.where(found.gain_present, jnp.abs(angle), jnp.inf))
    some = jnp.any(found.gain_present)
    heights = peak_heights(at_peak[:, None])[:, 0]
    if loop.sprung:
        heights, theta_peak = _or_at_rest(loop, heights, theta_peak)

    def only_stable(value: jax.Array) -> jax.Array:
        return jnp.where(stable, value, jnp.nan)

    def where_some(value: jax.Array, exists: jax.Array) -> jax.Array:
        return only_stable(jnp.where(exists, value, jnp.inf))

    return SampledMargins(
        stable=stable,
        unstable_roots=count,
        spectral_radius=radius,
        log_gain_to_boundary=distance,
        gain_margin=only_stable(jnp.exp(jnp.min(up))),
        gain_reduction_margin=only_stable(jnp.exp(jnp.max(down))),
        phase_crossover=where_some(theta_phase[jnp.argmin(up)] / period, bounded),
        phase_margin=where_some(angle[nearest], some),
        gain_crossover=where_some(theta_gain[nearest] / period, some),
        delay_margin=only_stable(delay_margin),
        sensitivity_peak=only_stable(heights[0]),
        sensitivity_peak_frequency=only_stable(theta_peak[0] / period),
        complementary_peak=only_stable(heights[1]),
        complementary_peak_frequency=only_stable(theta_peak[1] / period),
        modulus_margin=only_stable(1.0 / heights[0]),
        disk_margin=only_stable(1.0 / heights[2]),
        more_crossovers=found.overflow,
    )


def _at_rest(loop: SampledLoop, transfer: PulseTransfer) -> tuple[jax.Array, jax.Array, jax.Array]:
    """ln f of f kp + k = 0, the root that it moves out of the unit circle (1 or -1), and whether
    there is one.
    """
    assert loop.joint is not None
    log_factor, there = static_factor(loop.kp, jnp.asarray(loop.joint[1]))

    def open_loop(u: jax.Array) -> jax.Array:
        hold = u ** (transfer.steps + 1.0)
        position, rate = plant_response(transfer, u, 1.0 - u, hold)
        return loop.kp * position + loop.kd * rate

    one = jnp.ones_like(log_factor)
    _, slope = jax.lax.stop_gradient(jax.jvp(open_loop, (one,), (one,)))
    return log_factor, jnp.where(there, -jnp.sign(slope), 0.0), there


def _or_at_rest(
    loop: SampledLoop, heights: jax.Array, theta: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The peaks, or the values at rest where those are higher: S = k / (kp + k)."""
    assert loop.joint is not None
    kp, k = loop.kp, loop.joint[1]
    whole = jnp.where(kp + k == 0, 1.0, kp + k)
    still = jnp.abs(jnp.stack([k / whole, kp / whole, 0.5 * (k - kp) / whole]))
    return jnp.maximum(heights, still), jnp.where(still > heights, 0.0, theta)
