"""Metrics of a rollout, accumulated tick by tick; no trajectory is kept.

With the response y = (q - q0) / (r - q0) to a setpoint that steps from q0 to r:

    overshoot max(y) - 1,   rise time from y = 0.1 to 0.9,   settling time to |y - 1| <= 0.02,
    integrals of |r - q| and (r - q)^2, of the squared command and the squared force

Rise is interpolated between ticks, and so are the first two integrals (trapezoidal rule); settling
counts whole ticks, and is known of what stays settled: `jaxact.simulation.settling`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from jaxact.loops.loop import Output
from jaxact.simulation import envelope as _envelope
from jaxact.simulation import verdicts
from jaxact.simulation.envelope import Envelope
from jaxact.simulation.falling import Fall
from jaxact.simulation.scales import Scale
from jaxact.simulation.verdicts import Judgement, Motion
from jaxact.status import Verdict

SETTLED = 0.02
"""Half-width of the band, relative to the step, that counts as settled."""

SEGMENTS = 4
"""A rollout is cut into this many equal parts, each with its own envelope."""

_LOW, _HIGH = 0.1, 0.9


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Running:
    """Accumulators of a whole rollout, each of shape (joints,); times in ticks."""

    highest: jax.Array
    farthest: jax.Array
    low: jax.Array
    high: jax.Array
    unsettled: jax.Array
    absolute_error: jax.Array
    squared_error: jax.Array
    effort: jax.Array
    peak_force: jax.Array
    squared_force: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Reference:
    """What a response is measured against, each of shape (joints,).

    Attributes:
        start, target: q0 and r [m or rad].
        per_span: 1 / (r - q0), or 1 where there is no step.
    """

    start: jax.Array
    target: jax.Array
    per_span: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Metrics:
    """Results of a rollout; shape (joints,) except for the verdict and growth rate, shape ().

    Metrics that a loop does not have are NaN: all but the verdict and growth rate of a diverged
    loop, the rise or settling time of one that did not rise or settle in time.

    Attributes:
        growth_rate: of a small perturbation [1/s]; negative is stable.
        verdict: code of `jaxact.status.Verdict`.
        overshoot: relative to the step [-].
        rise_time: from 10 % to 90 % of the step [s].
        settling_time: until the response is, and will stay, within 2 % of the step [s].
        integrated_absolute_error: [m s or rad s].
        integrated_squared_error: [m^2 s or rad^2 s].
        control_effort: integral of the squared command [N^2 s or (N m)^2 s].
        peak_force: largest mean force of a physics step [N or N m].
        rms_force: root mean square of the force [N or N m].
        limit_cycle_amplitude: half the range of the position over the last quarter [m or rad], of
            the rollout itself where it goes on, else of another start's; 0 for a stable loop.
        limit_cycle_frequency: how often the motion passes its middle upwards in the last quarter
            [rad/s]: its fundamental frequency; NaN without a limit cycle, or below two passages.
    """

    growth_rate: jax.Array
    verdict: jax.Array
    overshoot: jax.Array
    rise_time: jax.Array
    settling_time: jax.Array
    integrated_absolute_error: jax.Array
    integrated_squared_error: jax.Array
    control_effort: jax.Array
    peak_force: jax.Array
    rms_force: jax.Array
    limit_cycle_amplitude: jax.Array
    limit_cycle_frequency: jax.Array


def reference(start: jax.Array, target: jax.Array) -> Reference:
    """Reference of a step from `start` to `target` [m or rad], shapes (joints,) and that or ()."""
    target = jnp.broadcast_to(target, start.shape)
    span = target - start
    per_span = jnp.where(span == 0.0, 1.0, 1.0 / jnp.where(span == 0.0, 1.0, span))
    return Reference(start=start, target=target, per_span=per_span)


def init(like: jax.Array) -> Running:
    """Accumulators before the first tick, shaped like `like`."""
    zero = jnp.zeros_like(like)
    never = zero + jnp.inf
    return Running(zero, zero, never, never, zero, zero, zero, zero, zero, zero)


@dataclass(frozen=True)
class Period:
    """What happened in one control period, and what it is measured against.

    Attributes:
        output: of the loop; shape (joints,).
        reference: of the step.
        tick: number of the period's end, counted from 1, as a float.
        weight: 0 leaves the period out of the integrals; None is 1 throughout.
    """

    output: Output
    reference: Reference
    tick: jax.Array
    weight: jax.Array | None = None

    @property
    def error(self) -> jax.Array:
        """q - r [m or rad]."""
        return self.output.position - self.reference.target

    @property
    def error_before(self) -> jax.Array:
        """The same at the beginning of the period [m or rad]."""
        return self.output.position_before - self.reference.target

    @property
    def response(self) -> jax.Array:
        """Position at the end of the period, relative to the step [-]."""
        return (self.output.position - self.reference.start) * self.reference.per_span

    @property
    def response_before(self) -> jax.Array:
        """Position at the beginning of the period, relative to the step [-]."""
        return (self.output.position_before - self.reference.start) * self.reference.per_span

    def counted(self, value: jax.Array) -> jax.Array:
        """A part of an integral."""
        return value if self.weight is None else self.weight * value


def _passed(passed: jax.Array, periods: Sequence[Period], level: float) -> jax.Array:
    """When the response first passed a level, linear between ticks; inf until it does."""
    above, rise, tick = jnp.zeros_like(passed), jnp.ones_like(passed), passed + jnp.inf
    for period in reversed(periods):
        after = period.response
        now = after >= level
        above = jnp.where(now, after - level, above)
        rise = jnp.where(now, after - period.response_before, rise)
        tick = jnp.where(now, period.tick, tick)
    # A single division for all the periods: it costs as much as all the rest.
    return jnp.where(passed == jnp.inf, tick - above / rise, passed)


def _integral(
    periods: Sequence[Period], of: Callable[[jax.Array], jax.Array], ends: bool
) -> jax.Array:
    """Of a function of the error over some periods, in periods."""
    after = [of(period.error) for period in periods]
    if not ends:
        before = [of(period.error_before) for period in periods]
        after = [0.5 * (early + late) for early, late in zip(before, after, strict=True)]
    parts = [period.counted(part) for period, part in zip(periods, after, strict=True)]
    return sum(parts[1:], start=parts[0])


def trapezoidal(running: Running, aim: Reference, start: jax.Array, end: jax.Array) -> Running:
    """What `update` summed at the periods' ends, by the trapezoidal rule.

    One period ends where the next one begins: only halves of the first and last error are amiss.

    Args:
        running: of all periods, none of them left out and all with the same target.
        aim: of the step.
        start, end: q before the first of them and after the last one, shape (joints,).
    """
    first, last = start - aim.target, end - aim.target
    absolute = running.absolute_error + 0.5 * (jnp.abs(first) - jnp.abs(last))
    squared = running.squared_error + 0.5 * (jnp.square(first) - jnp.square(last))
    return replace(running, absolute_error=absolute, squared_error=squared)


def update(
    running: Running, envelope: Envelope, periods: Sequence[Period], *, ends: bool = False
) -> tuple[Running, Envelope]:
    """Take in some control periods, in order.

    Several at once are cheaper than one at a time: each accumulator is read and written once.

    Args:
        running, envelope: of the rollout and of its segment so far.
        periods: at least one; shape (joints,).
        ends: static; errors are summed at the periods' ends, for `trapezoidal` to set right.

    Returns:
        The accumulators.
    """
    highest, farthest, unsettled = running.highest, running.farthest, running.unsettled
    effort, peak, squared_force = running.effort, running.peak_force, running.squared_force
    for period in periods:
        output, response = period.output, period.response
        size = jnp.abs(period.error)
        outside = size * jnp.abs(period.reference.per_span) > SETTLED
        # Comparisons rather than maxima: what is not a number never replaces what came before.
        highest = jnp.where(response > highest, response, highest)
        farthest = jnp.where(size > farthest, size, farthest)
        unsettled = jnp.where(outside, period.tick, unsettled)
        effort = effort + period.counted(output.command * output.command)
        peak = jnp.maximum(peak, output.peak_force)
        squared_force = squared_force + period.counted(output.square_force)
    whole = Running(
        highest=highest,
        farthest=farthest,
        low=_passed(running.low, periods, _LOW),
        high=_passed(running.high, periods, _HIGH),
        unsettled=unsettled,
        absolute_error=running.absolute_error + _integral(periods, jnp.abs, ends),
        squared_error=running.squared_error + _integral(periods, jnp.square, ends),
        effort=effort,
        peak_force=peak,
        squared_force=squared_force,
    )
    outputs, ticks = [each.output for each in periods], [each.tick for each in periods]
    return whole, _envelope.update(envelope, outputs, ticks)


def motion(
    running: Running, envelopes: Envelope, reference: Reference, period: jax.Array
) -> Motion:
    """What a finished rollout did; arguments as for `finish`."""
    final = jax.tree.map(lambda leaf: leaf[-1], envelopes)
    aim = reference.target[None]
    reach = jnp.maximum(jnp.abs(envelopes.highest - aim), jnp.abs(envelopes.lowest - aim))
    return Motion(
        amplitude=envelopes.amplitude,
        frequency=final.frequency(period),
        turning=final.turning,
        leaving=reach[-1] > jnp.max(reach[:-1], axis=0),
        farthest=running.farthest,
        span=jnp.abs(reference.target - reference.start),
        valid=jnp.isfinite(running.squared_error),
    )


def judge(
    running: Running,
    envelopes: Envelope,
    reference: Reference,
    growth_rate: jax.Array,
    *,
    period: jax.Array,
    ticks: int | jax.Array,
    scale: Scale | None,
    fell: Fall | None = None,
    told: bool = False,
) -> Judgement:
    """What came of one start; arguments as for `finish`, leaves of shape (joints,)."""
    done = motion(running, envelopes, reference, period)
    if scale is None:
        return verdicts.of_growth(growth_rate, done.span)
    segment = period * (ticks // SEGMENTS)
    found = verdicts.of_motion(done, scale, growth_rate, segment, told=told)
    if fell is None:
        return found
    fallen = fell.happened(envelopes, reference.target, done.span)
    return verdicts.of_fallen(found, fallen, growth_rate)


def finish(
    running: Running,
    envelopes: Envelope,
    reference: Reference,
    growth_rate: jax.Array,
    *,
    period: jax.Array,
    ticks: int | jax.Array,
    counted: jax.Array | float,
    scale: Scale | None,
    others: Judgement | None = None,
    fell: Fall | None = None,
    told: bool = False,
) -> tuple[Metrics, Judgement]:
    """The metrics of a finished rollout, and what came of its start alone.

    A linear loop's verdict is the sign of its growth rate, additive noise or not. Where
    quantisation, limits or a nonlinear plant are at work it comes from the motion that remains, see
    `jaxact.simulation.verdicts`, and from that of other starts where they are given.

    Args:
        running: accumulators of the whole rollout.
        envelopes: of the segments, shape (SEGMENTS, joints).
        reference: of the step.
        growth_rate: [1/s], shape ().
        period, ticks: control period [s], and number of them.
        counted: number of ticks in the integrals.
        scale: from `jaxact.simulation.scales.scale`; None for a loop that is linear, but for noise.
        others: from `judge`, of other starts of the same loop, shape (starts, joints).
        fell: from `jaxact.simulation.falling.fall`; None of what cannot.
        told: static; setpoints move on.
    """
    stepped = reference.target != reference.start
    loop = running, envelopes, reference, growth_rate
    own = each = judge(*loop, period=period, ticks=ticks, scale=scale, fell=fell, told=told)
    if others is not None and scale is not None:
        each = verdicts.together(own, others, scale)
    finite = jnp.isfinite(running.squared_error) & jnp.isfinite(running.effort)
    finite &= jnp.isfinite(running.squared_force)
    # A loop that is stable, and whose numbers overflow all the same, was not simulated.
    overflows = (each.verdict == Verdict.STABLE) & ~finite
    each = replace(each, verdict=jnp.where(overflows, Verdict.INVALID, each.verdict))
    if scale is not None and each.verdict.ndim:
        idle = ~scale.plant_linear & verdicts.idle(each)
        each = replace(each, verdict=jnp.where(idle, Verdict.STABLE, each.verdict))
    verdict = verdicts.worst(jnp.atleast_1d(each.verdict), axis=-1).astype(jnp.int8)
    finite &= verdict != Verdict.INVALID

    def known(value: jax.Array, when: jax.Array | bool = True) -> jax.Array:
        return jnp.where(finite & when, value, jnp.nan)

    cycling = each.verdict == Verdict.LIMIT_CYCLE
    rise, settled = (running.high - running.low) * period, (running.unsettled + 1.0) * period
    quiet = jnp.where(each.verdict == Verdict.STABLE, 0.0, jnp.nan)
    found = Metrics(
        growth_rate=growth_rate,
        verdict=verdict,
        overshoot=known(jnp.maximum(running.highest - 1.0, 0.0), stepped),
        rise_time=known(rise, stepped & jnp.isfinite(running.high)),
        settling_time=known(settled, stepped & (running.unsettled < ticks)),
        integrated_absolute_error=known(running.absolute_error * period),
        integrated_squared_error=known(running.squared_error * period),
        control_effort=known(running.effort * period),
        peak_force=known(running.peak_force),
        rms_force=known(jnp.sqrt(running.squared_force / counted)),
        limit_cycle_amplitude=known(jnp.where(cycling, each.amplitude, quiet)),
        limit_cycle_frequency=known(each.frequency, cycling),
    )
    return found, own


def worst(result: Metrics) -> Metrics:
    """A loop with several joints is as good as its worst one.

    Joints that have no such metric (NaN) do not hide the others', but for one that was to move and
    did not rise or settle in time. The frequency of a limit cycle is that of the joint with the
    largest one; a loop with another verdict has none.

    Args:
        result: metrics of the joints along the last axis, or of a loop without one: as it is.

    Returns:
        All of the shape of the verdict.
    """
    axes = result.verdict.ndim
    amplitude, frequency = result.limit_cycle_amplitude, result.limit_cycle_frequency
    if amplitude.ndim == axes:
        return result
    found = jax.tree.map(
        lambda leaf: jnp.nanmax(leaf, axis=-1) if leaf.ndim > axes else leaf, result
    )
    moved = jnp.isfinite(result.overshoot)

    def of_all(time: jax.Array) -> jax.Array:
        never = jnp.any(moved & jnp.isnan(time), axis=-1)
        return jnp.where(never, jnp.nan, jnp.nanmax(time, axis=-1))

    turning = jnp.where(jnp.isfinite(frequency), amplitude, -1.0)
    most = jnp.argmax(turning, axis=-1)[..., None]
    its = jnp.take_along_axis(frequency, most, axis=-1)[..., 0]
    cycling = result.verdict == Verdict.LIMIT_CYCLE
    quiet = jnp.where(result.verdict == Verdict.STABLE, 0.0, jnp.nan).astype(amplitude.dtype)
    return replace(
        found,
        rise_time=of_all(result.rise_time),
        settling_time=of_all(result.settling_time),
        limit_cycle_amplitude=jnp.where(cycling, found.limit_cycle_amplitude, quiet),
        limit_cycle_frequency=jnp.where(cycling, its, jnp.nan),
    )
