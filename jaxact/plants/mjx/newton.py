"""The accelerations of a step with constraints, by Newton's method, for many robots side by side.

They minimise the cost of `jaxact.plants.mjx.constraint_cost`. The method is that of MJX, and so are
its line search and its end; what MJX computes of one robot after another is computed here of all of
a batch at once, the factor of the Hessian H = M + J' D J again only where other constraints hold
than before.

In float32 the cost is known to 1e-4 or so of some thousand, and MJX's method ends where a step
would gain less: not far from the solution, but always on the side it came from, so that a robot
that sways slowly on its feet drifts. The gradient is known far better. Here every robot takes one
whole Newton step at the end if that makes the gradient smaller.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxact.plants.mjx import cholesky
from jaxact.plants.mjx.cholesky import total
from jaxact.plants.mjx.constraint_cost import (
    SMALLEST,
    Place,
    Problem,
    Settings,
    either,
    evaluated,
    times,
)
from jaxact.plants.mjx.line_search import Direction, searched


def _factor(problem: Problem, settings: Settings, held: jax.Array) -> cholesky.Factor:
    """The factor of the Hessian."""
    size, robots = problem.free.shape
    weights = jax.lax.optimization_barrier(problem.stiffness * held)
    several = [i for i, dof in enumerate(settings.alone) if dof < 0]
    weighted = None
    if several:
        weighted = jnp.stack([problem.rows[i] * weights[i] for i in several])
        weighted = jax.lax.optimization_barrier(weighted)
    own = [jnp.zeros(robots)] * size
    for i, dof in enumerate(settings.alone):
        if dof >= 0:
            own[dof] += problem.rows[i, dof] ** 2 * weights[i]
    diagonal = jax.lax.optimization_barrier(jnp.stack(own))
    places = jnp.arange(size)[:, None]

    def column(j: jax.Array) -> jax.Array:
        inertia = jax.lax.dynamic_index_in_dim(problem.inertia, j, 0, keepdims=False)
        terms = [inertia + jnp.where(places == j, diagonal, 0.0)]
        if weighted is not None:
            here = jax.lax.dynamic_index_in_dim(weighted, j, 1, keepdims=False)
            terms += [problem.rows[i] * here[k] for k, i in enumerate(several)]
        return total(terms)

    return cholesky.factor(column, size, robots)


class _Turn(NamedTuple):
    """What one turn of the method hands to the next.

    Attributes:
        turns: how many there were.
        place: where each robot is.
        last: whether its next step is the whole Newton step at the end.
        done: whether it has taken that.
        factor: of the Hessian for `held`.
    """

    turns: jax.Array
    place: Place
    last: jax.Array
    done: jax.Array
    factor: cholesky.Factor
    held: jax.Array


def solve(problem: Problem, settings: Settings) -> tuple[jax.Array, jax.Array]:
    """The accelerations x and the forces of the constraints J' f, each of shape (n, robots)."""
    size = len(problem.inertia)
    trace = jnp.maximum(total([problem.inertia[i, i] for i in range(size)]), SMALLEST)
    place = _begin(problem, settings)

    def flat(place: Place) -> jax.Array:
        return place.steepness / trace < problem.tolerance

    def once(turn: _Turn) -> _Turn:
        return _step(problem, settings, trace, flat, turn)

    none = jnp.zeros(place.cost.shape, bool)
    last = none if settings.iterations == 1 else flat(place)
    held = jnp.full_like(place.held, -1.0)
    factor = cholesky.blank(*problem.free.shape)
    begin = _Turn(jnp.int32(0), place, last, none, factor, held)
    end = jax.lax.while_loop(lambda turn: ~turn.done.all(), once, begin)
    return end.place.x, end.place.pull


def _begin(problem: Problem, settings: Settings) -> Place:
    """The better one of where the method may start."""

    def at(x: jax.Array, momentum: jax.Array) -> Place:
        error = times(problem.rows, x) - problem.reference
        return evaluated(problem, settings, x, momentum, error)

    free = at(problem.free, times(problem.inertia, problem.free))
    if not settings.warm:
        return free
    warm = at(problem.start, times(problem.inertia, problem.start))
    return either(warm.cost < free.cost, warm, free)


def _step(
    problem: Problem,
    settings: Settings,
    trace: jax.Array,
    flat: Callable[[Place], jax.Array],
    turn: _Turn,
) -> _Turn:
    """One turn: a step along Newton's direction, as far as the line search says or the last one."""
    place = turn.place
    factor = jax.lax.cond(
        ((place.held != turn.held) & ~turn.done).any(),
        lambda: _factor(problem, settings, place.held),
        lambda: turn.factor,
    )
    search = cholesky.solve(factor, problem.force + place.pull - place.momentum)
    along = Direction(search, times(problem.inertia, search), times(problem.rows, search))
    step, better = searched(problem, settings, place, along, trace)
    step = jnp.where(turn.last, 1.0, jnp.where(better, step, 0.0))
    step = jax.lax.optimization_barrier(step)
    after = evaluated(
        problem,
        settings,
        place.x + step * along.search,
        place.momentum + step * along.momentum,
        place.error + step * along.error,
    )
    takes = jnp.where(turn.last, after.steepness < place.steepness, True) & ~turn.done
    count = turn.turns + 1
    gained = (place.cost - after.cost) / trace
    last = (count >= settings.iterations) | (gained < problem.tolerance) | flat(after)
    last |= ~jnp.isfinite(after.cost)  # what has diverged keeps nobody waiting
    ends = turn.last | last
    return _Turn(
        count, either(takes, after, place), ends, turn.done | turn.last, factor, place.held
    )
