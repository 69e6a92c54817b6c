"""The gradient of a robot's simulated tracking by its log-gains, forwards or backwards.

Forwards, every log-gain adds a tangent to the rollout: for p of them

    forward = 1 + FORWARD p   times the work of a rollout, memory of p + 1 states;
    reverse = REVERSE         times, memory of the states between chunks and of one chunk's steps.

Which costs less is counted: forwards for a handful of log-gains, backwards for many.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.tuning.rollouts.term import Term

FORWARD, REVERSE = 1.0, 9.4
"""Work of a tangent, and of a rollout with its derivatives backwards, in rollouts: measured on a
quadruped with contacts on a CPU."""

MODES = ("auto", "forward", "reverse")


@dataclass(frozen=True)
class Slope:
    """Simulated tracking and its gradient at some log-gains.

    tracking: [rad^2]
    effort: [(N m)^2]
    objective: tracking + effort_weight * effort
    gradient: of the objective, shape (2 g,)
    mode: in which it was computed, "forward" or "reverse"
    """

    tracking: float
    effort: float
    objective: float
    gradient: np.ndarray
    mode: str


def work(parameters: int) -> dict[str, float]:
    """What a gradient by so many parameters costs in each mode, in rollouts."""
    return {"forward": 1.0 + FORWARD * parameters, "reverse": REVERSE}


def chosen(mode: str, parameters: int) -> str:
    """The mode that is asked for, or the cheaper one for "auto".

    Raises UserError for a mode that is none.
    """
    if mode not in MODES:
        raise UserError(f"mode {shown(mode)}; {nearest(mode, MODES)}")
    costs = work(parameters)
    return min(costs, key=lambda name: costs[name]) if mode == "auto" else mode


def value_and_gradient(term: Term, x: np.ndarray, mode: str = "auto") -> Slope:
    """Tracking, effort and the gradient of the objective, in float64.

    term: from `jaxact.tuning.rollouts.term.term`
    x: log-gains, shape (2 g,)
    mode: "forward", "reverse", or "auto" by counting

    Raises UserError for a mode that is none.
    """
    mode = chosen(mode, 2 * term.groups)
    with jax.enable_x64(True):
        gradient, (tracking, effort) = _compiled(term, mode)(jnp.asarray(x, float))
        gradient = np.asarray(gradient)
    tracking, effort = float(tracking), float(effort)
    objective = tracking + term.effort_weight * effort
    return Slope(tracking, effort, objective, gradient, mode)


@functools.lru_cache(maxsize=8)
def _compiled(term: Term, mode: str) -> Callable:
    def objective(x: jax.Array):
        tracking, effort = term.costs(x)
        return tracking + term.effort_weight * effort, (tracking, effort)

    differentiate = jax.jacfwd if mode == "forward" else jax.grad
    return jax.jit(differentiate(objective, has_aux=True))
