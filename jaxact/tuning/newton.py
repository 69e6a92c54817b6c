"""The last digits of an optimum whose rows are smooth, by sequential quadratic programming.

    maximise  value(x)   subject to  c_r(x) <= 0,  low <= x <= high

where the linear programmes of `jaxact.tuning.polish` creep: at an optimum with fewer constraints
that bind than there are unknowns. Every step is Newton's for the Lagrangian within linearised
constraints. Its quadratic programme is one of least distance, and that is one of non-negative least
squares (Lawson and Hanson, "Solving least squares problems", SIAM 1995, chapter 23).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.linalg
from scipy.optimize import nnls

from jaxact.tuning.polish import MET, Polished, Problem, Rows, better

Curvature = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""x (d,) and weights of the constraints (r,) -> their weighted second derivatives, (d, d)."""

_STEPS, _HALVINGS = 20, 5
# Steps back inside the constraints, where the others did not end there; each squares what is left.
_BACK = 8
# Longest step, and one that ends the search.
_LONGEST, _SHORTEST = 0.2, 1e-8
# Constraints further inside than this do not bind within a step.
_INSIDE = 1.0
# Aim of the linearised constraints, and the least curvature, as a share of the value's slope.
_AIM, _FLAT = 4e-11, 1e-3
_STIFFER = (0.0, 1.0, 10.0, 100.0)


def newton(
    problem: Problem, curvature: Curvature, x: np.ndarray, low: np.ndarray, high: np.ndarray
) -> Polished:
    """The optimum next to x, where there is one value only.

    Args:
        problem: rows at a point, of one problem.
        curvature: of its constraints; that of the value is learnt on the way.
        x: shape (d,), within a few steps of where the constraints are met.
        low, high: bounds that are never left, shape (d,) each.
    """
    rows = problem(x[None])
    best = Polished(x[None], rows.worst_value, rows.violation, 1)
    weights, own = _multipliers(rows), np.zeros((len(x), len(x)))
    for _ in range(_STEPS):
        if not rows.usable[0]:
            break
        hessian = own + curvature(x, weights)
        step, weights = _step(rows, hessian, weights, low - x, high - x)
        if step is None or np.abs(step).max() < _SHORTEST:
            break
        before = x, rows
        x, rows, best, moved = _searched(problem, x, step, weights, rows, best, low, high)
        if not moved:
            break
        turned = before[1].value_slope[0, 0] - rows.value_slope[0, 0]
        own = _updated(own, x - before[0], turned)
    if best.violation[0] > MET or _ahead(rows, best):
        best = _inside(problem, x, rows, best, low, high)
    return best


def inside(
    problem: Problem, x: np.ndarray, found: Polished, low: np.ndarray, high: np.ndarray
) -> Polished:
    """The better of what is found and of the point next to x at which all constraints are met."""
    rows = problem(x[None])
    return _inside(problem, x, rows, _better(found, x, rows), low, high)


def _inside(
    problem: Problem,
    x: np.ndarray,
    rows: Rows,
    best: Polished,
    low: np.ndarray,
    high: np.ndarray,
) -> Polished:
    """The same, with the rows at x known: steps as short as linearised constraints allow."""
    weights = np.zeros(rows.excess.shape[1])
    for _ in range(_BACK):
        still = replace(rows, value_slope=0.0 * rows.value_slope)
        step, _ = _step(still, np.eye(len(x)), weights, low - x, high - x)
        if step is None or not rows.usable[0]:
            break
        x = np.clip(x + step, low, high)
        rows = problem(x[None])
        best = _better(best, x, rows)
        if rows.violation[0] <= MET:
            break
    return best


def _ahead(rows: Rows, best: Polished) -> bool:
    """Whether a point that is not quite inside promises more than the best that is."""
    return bool(rows.usable[0] and rows.violation[0] > MET and rows.worst_value > best.value)


def _better(best: Polished, x: np.ndarray, rows: Rows) -> Polished:
    """The better of the best point and one more."""
    value, violation, count = rows.worst_value, rows.violation, best.evaluations + 1
    if better(value, violation, best.value, best.violation)[0]:
        return Polished(x[None], value, violation, count)
    return replace(best, evaluations=count)


def _searched(
    problem: Problem,
    x: np.ndarray,
    step: np.ndarray,
    weights: np.ndarray,
    rows: Rows,
    best: Polished,
    low: np.ndarray,
    high: np.ndarray,
) -> tuple[np.ndarray, Rows, Polished, bool]:
    """The longest of some steps that is worth it: where it leads, the best point, whether it is."""
    heavy = 2.0 * weights.sum() + 1.0

    def merit(rows: Rows) -> float:
        return float(heavy * max(rows.violation[0], 0.0) - rows.worst_value[0])

    for _ in range(_HALVINGS):
        there = np.clip(x + step, low, high)
        seen = problem(there[None])
        best = _better(best, there, seen)
        wins = np.array_equal(best.x[0], there)
        if seen.usable[0] and (merit(seen) < merit(rows) or wins):
            return there, seen, best, True
        step = 0.35 * step
    return x, rows, best, False


def _updated(own: np.ndarray, moved: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Second derivatives of minus the value, by the update of Broyden, Fletcher, Goldfarb, Shanno.

    Args:
        moved: of x, shape (d,).
        turned: what that did to the slope.
    """
    along = float(moved @ turned)
    if along <= 1e-8 * np.linalg.norm(moved) * np.linalg.norm(turned):
        return own
    if not own.any():
        own = float(turned @ turned) / along * np.eye(len(moved))
    pulled = own @ moved
    return own - np.outer(pulled, pulled) / float(moved @ pulled) + np.outer(turned, turned) / along


def _multipliers(rows: Rows) -> np.ndarray:
    """Weights of the constraints whose slopes together are nearest to that of the value."""
    excess, slope = rows.excess[0], rows.excess_slope[0]
    weights = np.zeros(len(excess))
    near = np.isfinite(excess) & (excess > excess.max(initial=-np.inf) - 0.02)
    if near.any():
        weights[near] = nnls(slope[near].T, rows.value_slope[0, 0])[0]
    return weights


def _step(
    rows: Rows, hessian: np.ndarray, weights: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray | None, np.ndarray]:
    """Step of the quadratic programme, None where it has none, and weights of the constraints.

    Args:
        low, high: smallest and largest step, shape (d,) each.
    """
    excess, slope = rows.excess[0], rows.excess_slope[0]
    used = np.flatnonzero(np.isfinite(excess) & (excess > -_INSIDE))
    unit = np.eye(slope.shape[1])
    matrix = np.concatenate([slope[used], unit, -unit])
    sides = np.minimum(high, _LONGEST), np.minimum(-low, _LONGEST)
    limit = np.concatenate([-excess[used] - _AIM, *sides])
    least = _FLAT * (float(np.linalg.norm(rows.value_slope[0, 0])) + 1e-6)
    factor = _factor(hessian, slope[weights > 0.0], least)
    # L' s - L^-1 g is as short as it can be.
    aim = scipy.linalg.solve_triangular(factor, rows.value_slope[0, 0], lower=True)
    turned = scipy.linalg.solve_triangular(factor, matrix.T, lower=True)
    distance = np.concatenate([-turned, (turned.T @ aim - limit)[None]])
    target = np.zeros(len(distance))
    target[-1] = 1.0
    dual, _ = nnls(distance, target)
    rest = distance @ dual - target
    if rest[-1] > -1e-12:
        return None, weights
    weights = np.zeros(len(excess))
    weights[used] = dual[: len(used)] / -rest[-1]
    return scipy.linalg.solve_triangular(factor, aim - rest[:-1] / rest[-1], lower=True,
                                         trans="T"), weights  # fmt: skip


def _factor(hessian: np.ndarray, binding: np.ndarray, least: float) -> np.ndarray:
    """L of a positive L L' that curves as the Lagrangian does along what the constraints leave."""
    size = np.abs(np.linalg.eigvalsh(hessian)).max() + 1e-3
    gram = binding.T @ binding / max(float(np.square(binding).sum(axis=1).max(initial=0.0)), 1e-9)
    for stiffer in _STIFFER:
        found, vectors = np.linalg.eigh(hessian + stiffer * size * gram)
        if found[0] > least:
            break
    found = np.maximum(np.abs(found), least)
    return np.linalg.cholesky((vectors * found) @ vectors.T)
