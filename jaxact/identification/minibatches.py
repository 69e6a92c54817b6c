"""Least squares by a first-order method over a few logs at a time, for many logs.

    x <- x - Adam(sum over a few logs of J^T r)

Each step sees a few logs drawn at random, so that its cost does not grow with their number;
unknowns are scaled by how much they move the residuals, and the step width falls to nothing.

Source: Kingma, Ba, "Adam: a method for stochastic optimization", ICLR 2015.
"""

from __future__ import annotations

import numpy as np
import optax

from jaxact.identification.problem import Problem

_STEPS = 300
_LOGS = 4
# Of the first step, as a share of the residuals' root mean square.
_FIRST_STEP = 0.1


def descend(
    sought: Problem, point: np.ndarray, low: np.ndarray, high: np.ndarray, free: list[int]
) -> np.ndarray:
    """Where the method ends, shape (unknowns,).

    Args:
        sought: the problem.
        point: where it begins.
        low, high: bounds.
        free: numbers of the unknowns that may move.
    """
    generator = np.random.default_rng(0)
    rest, slopes = sought.evaluate(point)
    size = np.maximum(np.linalg.norm(slopes, axis=0) / np.sqrt(len(rest)), 1e-300)
    first = _FIRST_STEP * float(np.sqrt(np.mean(rest**2)))
    chain = optax.adam(optax.cosine_decay_schedule(first, _STEPS, alpha=1e-3))
    moving = np.zeros(len(point))
    moving[free] = 1.0
    state = chain.init(point)
    for _ in range(_STEPS):
        logs = generator.permutation(len(sought.inputs))[:_LOGS]
        rest, slopes = sought.evaluate(point, np.sort(logs).tolist())
        gradient = slopes.T @ rest / len(rest) / size
        update, state = chain.update(gradient * moving, state)
        point = np.clip(point + np.asarray(update) * moving / size, low, high)
    return point
