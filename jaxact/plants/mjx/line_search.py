"""How far to go along a direction that makes the cost of the constraints less, for many robots.

The search is MJX's: from Newton steps on the slope of the cost, a bracket of its minimum that
becomes narrower. The last axis of all arrays is for the robots.

Source: mujoco.mjx, solver.py.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxact.plants.mjx.cholesky import dot
from jaxact.plants.mjx.constraint_cost import (
    SMALLEST,
    Place,
    Problem,
    Settings,
    either,
    positive,
    sliding,
)


class _Point(NamedTuple):
    """A step along the search direction: the cost there, and its first two derivatives."""

    step: jax.Array
    cost: jax.Array
    slope: jax.Array
    bend: jax.Array


def searched(
    problem: Problem, settings: Settings, place: Place, along: Direction, trace: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """How far to go along the direction, shape (robots,), and whether that makes the cost less."""
    point = _line(problem, settings, place, along)
    zero = jnp.zeros_like(place.cost)
    origin = point(zero)
    small = (
        problem.tolerance
        * problem.search_tolerance
        * trace
        * jnp.sqrt(dot(along.search, along.search))
    )
    # What the slope can be known to.
    linear, square = _along_gauss(problem, place, along)
    rows = 2.0 * jnp.sqrt(
        jnp.maximum(origin.cost - place.gauss, 0.0) * jnp.maximum(0.5 * origin.bend - square, 0.0)
    )
    small = jnp.maximum(small, 8.0 * jnp.finfo(zero.dtype).eps * (rows + jnp.abs(linear)))

    def flat(point: _Point) -> jax.Array:
        return (jnp.abs(point.slope) < small) & (point.cost < origin.cost)

    first = point(origin.step - origin.slope / origin.bend)
    lower = first.slope < origin.slope
    low, high = either(lower, first, origin), either(lower, origin, first)

    def going(at: tuple[jax.Array, jax.Array, _Point, _Point]) -> jax.Array:
        return (at[0] < settings.search_iterations) & at[1].any()

    def closer(at: tuple[jax.Array, jax.Array, _Point, _Point]) -> Any:
        count, going, low, high = at
        moved, low_, high_ = _closer(point, flat, low, high)
        low, high = either(going, (low_, high_), (low, high))
        return count + 1, going & moved & ~flat(low) & ~flat(high), low, high

    begin = jnp.int32(0), ~flat(low) & ~flat(high), low, high
    _, _, low, high = jax.lax.while_loop(going, closer, begin)
    better = (low.cost < origin.cost) | (high.cost < origin.cost)
    return jnp.where(low.cost < high.cost, low.step, high.step), better


def _closer(
    point: Callable[[jax.Array], _Point],
    flat: Callable[[_Point], jax.Array],
    low: _Point,
    high: _Point,
) -> tuple[jax.Array, _Point, _Point]:
    """The bracket of a minimum made narrower, as MJX does it; first, whether it was."""
    from_low = point(low.step - low.slope / low.bend)
    from_high = point(high.step - high.slope / high.bend)
    middle = point(0.5 * (low.step + high.step))

    def inside(x: _Point, y: _Point) -> jax.Array:
        return ((x.slope < y.slope) & (y.slope < 0.0)) | ((x.slope > y.slope) & (y.slope > 0.0))

    moved = jnp.zeros(low.cost.shape, bool)
    for candidate in (from_low, middle, from_high):
        nearer = inside(low, candidate)
        low, moved = either(nearer, candidate, low), moved | nearer
    for candidate in (from_high, middle, from_low):
        nearer = inside(high, candidate)
        if candidate is from_high:
            nearer |= (high.slope < 0.0) & (candidate.slope > 0.0)
        high, moved = either(nearer, candidate, high), moved | nearer
    best, found = from_low, flat(from_low)
    for candidate in (from_high, middle):
        takes = flat(candidate) & (~found | (candidate.cost < best.cost))
        best, found = either(takes, candidate, best), found | flat(candidate)
    low, high = either(found, (best, best), (low, high))
    return moved & ~found, low, high


class Direction(NamedTuple):
    """A search direction p, M p and J p."""

    search: jax.Array
    momentum: jax.Array
    error: jax.Array


def _along_gauss(problem: Problem, place: Place, along: Direction) -> tuple[jax.Array, jax.Array]:
    """How the first part of the cost grows along a direction: with the step, and its square."""
    linear = dot(along.search, place.momentum - problem.force)
    return jax.lax.optimization_barrier((linear, 0.5 * dot(along.search, along.momentum)))


def _line(
    problem: Problem, settings: Settings, place: Place, along: Direction
) -> Callable[[jax.Array], _Point]:
    """The cost along a direction, as a function of the step."""
    linear, square = _along_gauss(problem, place, along)
    stiffness, error = problem.stiffness, place.error
    rows = jax.lax.optimization_barrier(
        (
            0.5 * stiffness * error * error,
            stiffness * along.error * error,
            0.5 * stiffness * along.error * along.error,
        )
    )
    first, last = settings.equalities, settings.equalities + len(problem.friction)
    most = problem.friction
    start, going = error[first:last], along.error[first:last]
    half = 0.5 * most * most / positive(stiffness[first:last])

    def point(step: jax.Array) -> _Point:
        x = error + step * along.error
        held = jnp.concatenate([jnp.ones_like(x[:last]), (x[last:] < 0.0).astype(x.dtype)])
        if first < last:
            slides = sliding(problem, stiffness[first:last], x[first:last])
            sticks = (slides == 0.0).astype(x.dtype)
            held = jnp.concatenate([held[:first], sticks, held[last:]])
        held = jax.lax.optimization_barrier(held)
        constant, slope, bend = (dot(part, held) for part in rows)
        if first < last:
            constant += jnp.sum(slides * most * start - jnp.abs(slides) * half, axis=0)
            slope += jnp.sum(slides * most * going, axis=0)
        constant, slope, bend = constant + place.gauss, slope + linear, bend + square
        bend_ = 2.0 * bend + (bend == 0.0) * SMALLEST
        return jax.lax.optimization_barrier(
            _Point(step, (bend * step + slope) * step + constant, 2.0 * bend * step + slope, bend_)
        )

    return point
