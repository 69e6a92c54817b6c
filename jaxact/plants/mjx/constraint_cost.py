"""The cost that the accelerations of a step with constraints minimise, for many robots.

    g(x) = (x - a)' M (x - a) / 2 + sum_i s_i(J_i x - r_i),

where a are the accelerations without constraints, and s_i is D_i e^2 / 2 where a constraint holds,
zero where a contact or a limit lets go, and linear where dry friction slides. With pyramidal cones
each row of J is by itself. The last axis of all arrays is for the robots.

Source: MuJoCo's documentation, "Computation", constraint solver; mujoco.mjx, solver.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.plants.mjx.cholesky import dot, total

SMALLEST = 1e-15  # MuJoCo's mjMINVAL


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Problem:
    """What the accelerations of some robots follow from; the last axis is for the robots.

    Attributes:
        inertia: M, shape (n, n, robots).
        rows: J, shape (constraints, n, robots).
        stiffness: D, shape (constraints, robots).
        reference: r, shape (constraints, robots).
        friction: most force of the rows of dry friction, shape (rows of friction, robots).
        force: M a, shape (n, robots).
        free: a, shape (n, robots).
        start: accelerations of the step before, shape (n, robots).
        tolerance: of the cost and its gradient, for the mean inertia, shape (robots,).
        search_tolerance: of the line search, as a part of that, shape (robots,).
    """

    inertia: jax.Array
    rows: jax.Array
    stiffness: jax.Array
    reference: jax.Array
    friction: jax.Array
    force: jax.Array
    free: jax.Array
    start: jax.Array
    tolerance: jax.Array
    search_tolerance: jax.Array


@dataclass(frozen=True)
class Settings:
    """How far the method goes, as MuJoCo's options say.

    Attributes:
        equalities: rows of constraints that always hold; they come first, and dry friction next.
        alone: the one degree of freedom that a row is about; -1 where there may be several.
        warm: whether it may start from the accelerations of the step before.
        iterations: most of the method.
        search_iterations: most of each of its line searches.
    """

    equalities: int
    alone: tuple[int, ...]
    warm: bool
    iterations: int
    search_iterations: int


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Place:
    """Some accelerations, and what is known there.

    Attributes:
        x: accelerations; momentum: M x; both of shape (n, robots).
        error: J x - r; held: 1 where D e is the force, else 0; both of shape (constraints, robots).
        pull: J' f, forces of the constraints, shape (n, robots).
        gauss: first part of the cost; cost: all of it; shape (robots,).
        steepness: norm of its gradient, shape (robots,).
    """

    x: jax.Array
    momentum: jax.Array
    error: jax.Array
    held: jax.Array
    pull: jax.Array
    gauss: jax.Array
    cost: jax.Array
    steepness: jax.Array


def times(matrix: jax.Array, x: jax.Array) -> jax.Array:
    """A product of a matrix, shape (rows, n, robots), with a vector, shape (n, robots)."""
    return jax.lax.optimization_barrier(total([matrix[:, k] * x[k] for k in range(len(x))]))


def either(which: jax.Array, first: Any, second: Any) -> Any:
    """The first tree for the robots that `which` is true of, the second one for the others."""
    return jax.tree.map(lambda x, y: jnp.where(which, x, y), first, second)


def evaluated(
    problem: Problem, settings: Settings, x: jax.Array, momentum: jax.Array, error: jax.Array
) -> Place:
    """What is known at some accelerations."""
    held, force, costs = _forces(problem, settings, error)
    pull = total([row * force[i] for i, row in enumerate(problem.rows)])
    pull = jax.lax.optimization_barrier(pull)
    gauss = 0.5 * dot(momentum - problem.force, x - problem.free)
    gradient = momentum - problem.force - pull
    return Place(
        x=x,
        momentum=momentum,
        error=error,
        held=held,
        pull=pull,
        gauss=gauss,
        cost=gauss + jnp.sum(costs, axis=0),
        steepness=jnp.sqrt(dot(gradient, gradient)),
    )


def _forces(
    problem: Problem, settings: Settings, error: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Whether the rows hold, their forces and their costs, each of shape (constraints, robots)."""
    first, last = settings.equalities, settings.equalities + len(problem.friction)
    always = jnp.ones_like(error[:last])
    held = jnp.concatenate([always, (error[last:] < 0.0).astype(error.dtype)])
    stiffness = problem.stiffness
    if first < last:
        slides = sliding(problem, stiffness[first:last], error[first:last])
        sticks = (slides == 0.0).astype(error.dtype)
        held = jnp.concatenate([held[:first], sticks, held[last:]])
    held = jax.lax.optimization_barrier(held)
    force, cost = -stiffness * error * held, 0.5 * stiffness * error * error * held
    if first < last:
        most = problem.friction
        lost = (jnp.abs(error[first:last]) - 0.5 * most / positive(stiffness[first:last])) * most
        force = _added(force, first, -slides * most)
        cost = _added(cost, first, jnp.abs(slides) * lost)
    return held, jax.lax.optimization_barrier(force), cost


def _added(rows: jax.Array, first: int, more: jax.Array) -> jax.Array:
    """The rows with more on some of them, from the first one on."""
    last = first + len(more)
    return jnp.concatenate([rows[:first], rows[first:last] + more, rows[last:]])


def sliding(problem: Problem, stiffness: jax.Array, error: jax.Array) -> jax.Array:
    """Where dry friction is at its most: the error's sign, or 0 where it sticks."""
    width = problem.friction / positive(stiffness)
    slides = (jnp.abs(error) >= width) & (problem.friction > 0.0)
    return jnp.where(slides, jnp.where(error > 0.0, 1.0, -1.0), 0.0).astype(error.dtype)


def positive(stiffness: jax.Array) -> jax.Array:
    """Something to divide by."""
    return stiffness + (stiffness == 0.0) * SMALLEST
