"""The verdict of a loop that is not linear: what the motion that remains does.

A rollout is cut into segments, of which each has an envelope. With the half ranges a of the last
three and the growth rate g of a small perturbation, a loop is at rest, or on the way there, if

    a_last <= rest   or   a loses at least half of what exp(g t) predicts, from segment to segment

Else it cycles. What counts as rest is measured with the loop's own scales, never with the height of
the setpoint's step: see `rest`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from jaxact.simulation.scales import Scale
from jaxact.status import Verdict

# A motion this many times as large as all scales of the loop has diverged.
_DIVERGED = 1e3
# The first motion of a robot at rest is a scale for what follows up to this size [m or rad]: one
# that has diverged within the first segment would otherwise be measured by itself.
_FIRST = 10.0
# An envelope that grows by this factor from segment to segment, twice, is not bounded.
_GROWING = 1.1
# What friction ends is, in every joint, at most this part of what it was a segment ago.
_FALLING = 0.98
# A motion that is wider by this factor than a segment ago is getting wider.
_WIDER = 1.05
# What is no larger than so many counts, or so many times what noise sustains, does not grow.
_FEW = 3.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Motion:
    """What a rollout did, each of shape (joints,) unless said otherwise.

    Attributes:
        amplitude: half ranges of the position in the segments [m or rad], (segments, joints).
        frequency: of the last segment [rad/s]; NaN where the motion does not pass its middle twice.
        turning: whether it swings in the last segment.
        leaving: whether it goes farther from the setpoint in the last segment than before.
        farthest: largest distance from the setpoint [m or rad].
        span: height of the setpoint's step [m or rad].
        valid: whether all of it is finite.
    """

    amplitude: jax.Array
    frequency: jax.Array
    turning: jax.Array
    leaving: jax.Array
    farthest: jax.Array
    span: jax.Array
    valid: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Judgement:
    """What came of one start, each of shape (joints,).

    Attributes:
        verdict: code of `jaxact.status.Verdict`.
        moving: it still moved in the last segment, beyond rest, and not just about to end.
        resting: it has come to rest, or needs not to: the loop is linear.
        narrowing: it was smaller in each of the last two segments than in the one before.
        widening: it was wider in the last segment than in the one before.
        amplitude: half range of the last segment [m or rad].
        frequency: of it [rad/s]; NaN where it does not pass its middle twice.
    """

    verdict: jax.Array
    moving: jax.Array
    resting: jax.Array
    narrowing: jax.Array
    widening: jax.Array
    amplitude: jax.Array
    frequency: jax.Array


def of_growth(growth_rate: jax.Array, like: jax.Array) -> Judgement:
    """A linear loop needs no start: its growth rate [1/s] tells; leaves shaped as `like`."""
    none = jnp.zeros_like(like)
    verdict = jnp.where(growth_rate < 0.0, Verdict.STABLE, Verdict.UNSTABLE)
    verdict = jnp.where(jnp.isnan(growth_rate), Verdict.INVALID, verdict)
    return Judgement(
        verdict=verdict + none.astype(verdict.dtype),
        moving=none > 0.0,
        resting=none == 0.0,
        narrowing=none > 0.0,
        widening=none > 0.0,
        amplitude=none,
        frequency=none + jnp.nan,
    )


def _diverged(motion: Motion, scale: Scale) -> jax.Array:
    """Whether a motion left everything behind that the loop is measured with, shape (joints,)."""
    # Of a robot at rest, the first motion is rounding, and no scale for what follows.
    first = motion.amplitude[0]
    first = jnp.where(scale.plant_linear, first, jnp.minimum(first, _FIRST))
    size = jnp.where(motion.span > 0.0, motion.span, first)
    size = jnp.maximum(size, jnp.maximum(scale.limit, jnp.maximum(scale.count, scale.floor)))
    return motion.farthest > _DIVERGED * jnp.where(size > 0.0, size, 1.0)


def _calmer(motion: Motion) -> jax.Array:
    """Whether a motion gets smaller from segment to segment, shape (joints,)."""
    before, previous, last = motion.amplitude[-3], motion.amplitude[-2], motion.amplitude[-1]
    return (last <= _FALLING * previous) & (previous <= _FALLING * before)


def _falling(motion: Motion, resting: jax.Array) -> jax.Array:
    """Whether dry friction, where there is any, is ending a motion that would grow without it.

    The smaller such a motion is, the more it loses from segment to segment,

        before - previous <= previous - last,   last <= n (previous - last) + n (n + 1) / 2 change

    so that at this pace it is over within n more segments, as many as were seen; farther than that
    nothing can be foretold. What comes down to a cycle from a larger motion loses less and less,
    but for beats of several joints. These share a motion: while one of them keeps going, friction
    has not ended the others'.

    Args:
        resting: whether it has come to rest, shape (joints,).
    """
    before, previous, last = motion.amplitude[-3], motion.amplitude[-2], motion.amplitude[-1]
    segments = motion.amplitude.shape[0]
    calmer = (last <= _FALLING * previous) & (previous <= before)
    lost, change = previous - last, (previous - last) - (before - previous)
    ahead = segments * lost + 0.5 * segments * (segments + 1.0) * change
    return calmer & (change >= 0.0) & (last <= ahead) & jnp.all(calmer | resting)


def _growing(motion: Motion, scale: Scale, growth_rate: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Whether a motion grows, and whether it is a slow one on its way home, shapes (joints,)."""
    before, previous, last = motion.amplitude[-3], motion.amplitude[-2], motion.amplitude[-1]
    growing = (last > _GROWING * previous) & (previous > _GROWING * before)
    # Counts and noise make irregular motions, but none without bound.
    growing &= (last > _FEW * jnp.maximum(scale.count, scale.rest)) | (growth_rate >= 0.0)
    growing &= ~scale.unlimited | (growth_rate >= 0.0)
    # A robot's slow motion is first sped up by what brings it back, where small motions decay.
    growing &= scale.plant_linear | motion.turning | motion.leaving | (growth_rate >= 0.0)
    # A limit makes large motions of a mass so slow that a segment holds no whole turn. Halves of
    # the rollout tell then, and whether the motion went further than it began, away or on its way.
    slow = scale.plant_linear & ~scale.unlimited & ~motion.turning
    slow &= (growth_rate < 0.0) & (last > _FEW * jnp.maximum(scale.count, scale.rest))
    wider = jnp.maximum(last, previous) > _GROWING * jnp.maximum(before, motion.amplitude[0])
    beyond = motion.farthest > motion.span
    # A joint that is held is on its way to a cycle, however long that takes.
    growing = jnp.where(slow, wider & beyond, growing) & ~scale.held
    return growing, slow & ~beyond


def _ending(
    motion: Motion, scale: Scale, growth_rate: jax.Array, growing: jax.Array, resting: jax.Array
) -> jax.Array:
    """Whether a robot's motion is about to end, shape (joints,)."""
    previous, last = motion.amplitude[-2], motion.amplitude[-1]
    # What does not turn, and shrinks, is no cycle, nor is what neither turns nor grows where small
    # motions decay: it takes longer than was seen.
    shrinking = (last < previous) | ((growth_rate < 0.0) & ~growing)
    shrinking &= ~motion.turning
    # Counts may keep up a motion, but it turns then: what does not creeps, or sways slowly, home.
    ending = shrinking & ((scale.count == 0.0) | (growth_rate < 0.0))
    # One of many counts hardly feels them.
    falling = _falling(motion, resting) & (last > _FEW * scale.count)
    ending |= falling & (growth_rate >= 0.0) & scale.rubs
    ending |= ~motion.turning & (last <= 0.5 * previous)
    return ending & ~scale.plant_linear


def _decaying_if_neutral(growth_rate: jax.Array, scale: Scale) -> jax.Array:
    """The growth rate [1/s], just below 0 where a robot's is 0.

    A joint that no stiffness holds stays where it is put, as a wheel: nothing grows.
    """
    neutral = ~scale.plant_linear & (growth_rate == 0.0)
    return jnp.where(neutral, -jnp.finfo(scale.rest.dtype).tiny, growth_rate)


def of_motion(
    motion: Motion, scale: Scale, growth_rate: jax.Array, segment: jax.Array, *, told: bool = False
) -> Judgement:
    """What came of one start.

    Args:
        motion: of the rollout.
        scale: of the loop.
        growth_rate: [1/s], shape ().
        segment: how long one lasts [s].
        told: static; setpoints move on, so that the joints' following them says nothing.
    """
    growth_rate = _decaying_if_neutral(growth_rate, scale)
    if told:
        return _of_told(motion, scale, growth_rate)
    before, previous, last = motion.amplitude[-3], motion.amplitude[-2], motion.amplitude[-1]
    diverged = _diverged(motion, scale)
    growing, arriving = _growing(motion, scale, growth_rate)
    # Half the decay that the linear loop would show is decay; less is a motion that keeps going.
    kept = 1.0 + 0.5 * jnp.expm1(jnp.minimum(growth_rate, 0.0) * segment)
    # An irregular limit cycle is smaller than before now and then, but rarely twice in a row.
    decaying = (last <= kept * previous) & ((scale.count == 0.0) | (previous <= kept * before))
    resting = last <= scale.rest
    ending = arriving | _ending(motion, scale, growth_rate, growing, resting)
    moving = ~(resting | ending | ((growth_rate < 0.0) & decaying))
    # Beyond all bounds numbers are arbitrary, and may look like rest.
    moving |= diverged
    verdict = jnp.where(moving, Verdict.LIMIT_CYCLE, Verdict.STABLE)
    # A perturbation that grows, but has not had the time to, or dies in what the plant has of its
    # own: a larger one would not.
    grows = growth_rate >= 0.0
    unstable = growing | (grows & (~moving | scale.unlimited))
    verdict = jnp.where(unstable, Verdict.UNSTABLE, verdict)
    invalid = ~motion.valid | jnp.isnan(growth_rate)
    verdict = jnp.where(invalid, Verdict.INVALID, verdict)
    verdict = jnp.where(diverged, Verdict.UNSTABLE, verdict)
    linear = of_growth(growth_rate, last)
    return Judgement(
        verdict=jnp.where(scale.linear, linear.verdict, verdict),
        moving=moving & ~scale.linear,
        resting=resting | scale.linear,
        narrowing=_calmer(motion) & ~scale.linear,
        widening=(last > _WIDER * previous) & ~scale.linear,
        amplitude=last,
        frequency=motion.frequency,
    )


def _of_told(motion: Motion, scale: Scale, growth_rate: jax.Array) -> Judgement:
    """As `of_motion`, of setpoints that move on.

    What small perturbations do tells, and whether the motion leaves everything behind.
    """
    lost = _diverged(motion, scale)
    found = of_growth(growth_rate, motion.span)
    verdict = jnp.where(motion.valid, found.verdict, Verdict.INVALID)
    return replace(
        found,
        verdict=jnp.where(lost, Verdict.UNSTABLE, verdict),
        moving=lost,
        resting=jnp.zeros_like(lost),
        amplitude=motion.amplitude[-1],
    )


def idle(each: Judgement) -> jax.Array:
    """Which of a robot's joints, along the last axis, rest though unstable while others move.

    Nothing is known of them but that: they are stable as far as was seen.
    """
    still = ~each.moving & (each.verdict == Verdict.UNSTABLE)
    return still & jnp.any(each.moving, axis=-1, keepdims=True)


def of_fallen(judgement: Judgement, fallen: jax.Array, growth_rate: jax.Array) -> Judgement:
    """What came of a start, of a robot that may have fallen over in it.

    What has not swung, where small motions decay, is then the fall, and says nothing of the gains.

    Args:
        judgement: leaves of shape (joints,).
        fallen: whether it has, shape ().
        growth_rate: [1/s], shape ().
    """
    still = jnp.isnan(judgement.frequency) & (growth_rate < 0.0)
    still &= judgement.verdict != Verdict.INVALID
    fell = fallen & (still | (judgement.verdict == Verdict.STABLE))
    return replace(
        judgement,
        verdict=jnp.where(fell, Verdict.TOPPLES, judgement.verdict),
        moving=judgement.moving & ~fell,
        resting=judgement.resting | fell,
    )


def worst(verdict: jax.Array, axis: int) -> jax.Array:
    """The worst verdict along an axis: a fall is one where nothing is worse."""
    fell = verdict == Verdict.TOPPLES
    other = jnp.max(jnp.where(fell, Verdict.STABLE, verdict), axis=axis)
    alone = jnp.any(fell, axis=axis) & (other == Verdict.STABLE)
    return jnp.where(alone, Verdict.TOPPLES, other)


def together(own: Judgement, others: Judgement, scale: Scale) -> Judgement:
    """The worst of a loop's own start and of others, joint by joint.

    A start after which a robot has fallen over counts only if it is the loop's own.

    Of a start that has come to rest where small perturbations grow, nothing is known but that; what
    one that still moves shows is more. What remains of the own start counts where it is more than a
    count: within one, it depends on where between two counts the setpoint happens to be, and the
    others stand for all such places. A start that grows within the cycle that another one shows is
    on its way there, where a limit makes the cycle, or where a robot's does not get wider itself.

    Args:
        own: of the setpoint's step, shape (joints,).
        others: shape (starts, joints).
        scale: of the loop.

    Returns:
        The verdict; amplitude and frequency of the own motion where it goes on and turns, else of
        the largest of the others that do.
    """
    cycling = others.moving & (others.verdict == Verdict.LIMIT_CYCLE)
    amplitudes = jnp.where(cycling, others.amplitude, -1.0)
    largest = jnp.argmax(amplitudes, axis=0)[None]
    amplitude = jnp.take_along_axis(others.amplitude, largest, axis=0)[0]
    frequency = jnp.take_along_axis(others.frequency, largest, axis=0)[0]
    cycle = own.moving & (own.verdict == Verdict.LIMIT_CYCLE)
    minor = cycle & (own.amplitude <= scale.count)
    shown = (own.moving & ~minor) | jnp.any(others.moving, axis=0)
    sure = scale.bounded | ~own.widening
    widest = jnp.where(cycle & sure, own.amplitude, -1.0)
    sure = scale.bounded[None] | ~others.widening
    widest = jnp.maximum(widest, jnp.max(jnp.where(sure, amplitudes, -1.0), axis=0))
    kept = scale.bounded | ~scale.plant_linear

    def proven(start: Judgement) -> jax.Array:
        unproven = ~start.moving & (start.verdict == Verdict.UNSTABLE) & shown
        verdict = jnp.where(unproven, Verdict.STABLE, start.verdict)
        within = start.moving & (start.verdict == Verdict.UNSTABLE) & (start.amplitude <= widest)
        return jnp.where(within & kept, Verdict.LIMIT_CYCLE, verdict)

    mine = jnp.where(minor, Verdict.STABLE, proven(own))
    theirs = jax.vmap(proven)(others)
    theirs = jnp.where(theirs == Verdict.TOPPLES, Verdict.STABLE, theirs)
    verdict = worst(jnp.concatenate([mine[None], theirs]), axis=0)
    # A motion that passes its middle but once in a segment has no frequency to be measured.
    itself = (cycle & jnp.isfinite(own.frequency)) | ~jnp.any(cycling, axis=0)
    return Judgement(
        verdict=verdict,
        moving=shown,
        resting=own.resting & jnp.all(others.resting, axis=0),
        narrowing=own.narrowing,
        widening=own.widening,
        amplitude=jnp.where(itself, own.amplitude, amplitude),
        frequency=jnp.where(itself, own.frequency, frequency),
    )
