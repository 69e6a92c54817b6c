"""The check of an optimum by trying every gain of a grid: `--verify`.

Tabulated responses on a fine frequency axis decide which gains of the grid meet the constraints;
the grid then closes in on the best of them, and the last word is that of the exact metrics.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.tuning.certificate import over_all
from jaxact.tuning.joint import problem as joint
from jaxact.tuning.joint.problem import Case, JointSurrogate, Table
from jaxact.tuning.joint.response import timed as timed_of
from jaxact.tuning.joint.spectrum import single_precision, tabulate

_POINTS = 600
GRID = 64
_REFINEMENTS = 4
# The least damping that is looked at, of a bare mass and of a sprung one [m / lag].
_LEAST, _SPRUNG = 2e-2, 2e-5
# Behind a servo that rings it must leave the resonance below 1, kd < 2 zeta wn m: the lag that this
# is like, as a share of 1 / (2 zeta wn).
_RINGING = 0.2
_TILE = 64
# The tables' own error in ln of a peak.
_SLACK = 2e-4


@dataclass(frozen=True)
class Brute:
    """What brute force found.

    Attributes:
        value: ln of the objective, signed so that larger is better; -inf if nothing meets
            everything.
        x: log-gains, shape (2,).
        evaluations: gains tried.
    """

    value: float
    x: np.ndarray
    evaluations: int


def brute_force(case: Case) -> Brute:
    """The best gains of a grid over everything that could be stable, refined four times."""
    data, centre, half = _plane(case)
    smooth = _smooth(case)
    tried = 0
    for _ in range(_REFINEMENTS + 1):
        grid = _grid(case, centre, half)
        value, violation, stable = map(
            np.asarray, _all(smooth, data, jnp.asarray(grid, jnp.float32))
        )
        tried += len(grid)
        score = np.where(stable & (violation <= _SLACK), value, -np.inf)
        if not np.any(np.isfinite(score)):
            return Brute(-np.inf, centre, tried)
        order = np.argsort(-score)
        centre, half = grid[order[0]], half * 4.0 / GRID
    timed = timed_of(case.goal, [case.members], use="polish")
    return _exactly(case, grid[order[:256]], tried, timed)


def nearest(case: Case) -> Brute:
    """The stable gains of a grid that exceed the constraints least; the objective does not count.

    Its value is -inf where no gains of the grid are stable.
    """
    data, centre, half = _plane(case)
    smooth = _smooth(case)
    grid = _grid(case, centre, half)
    _, violation, stable = map(np.asarray, _all(smooth, data, jnp.asarray(grid, jnp.float32)))
    score = np.where(stable & np.isfinite(violation), -violation, -np.inf)
    best = int(np.argmax(score))
    return Brute(float(score[best]), grid[best], len(grid))


def _smooth(case: Case) -> JointSurrogate:
    return JointSurrogate(
        joint.family(case.goal), timed_of(case.goal, [case.members], use="descent")
    )


def _plane(case: Case) -> tuple[Table, np.ndarray, np.ndarray]:
    """What is tabulated of a case, and centre and half the width of all that could be stable."""
    spectrum = tabulate(case.members, joint.time_scale(case), _POINTS)
    own = jax.tree.map(lambda a: a[0], joint.table([case]))
    data = replace(own, spectrum=single_precision(spectrum))
    low, high = plane(case)
    return data, 0.5 * (low + high), 0.5 * (high - low)


def plane(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest log-gains of all that could be stable, shape (2,) each."""
    members = case.members
    lag, mass = float(joint.time_scale(case).max()), float(members.mass.min())
    # A spring keeps a joint stable with hardly any damping from its drive.
    damped = _SPRUNG if np.all(members.joint_stiffness > 0.0) else _LEAST
    rings = _RINGING / (2.0 * members.damping_ratio * members.natural_frequency)
    slow = max(lag, float(rings.max()))
    low = np.log([2e-4 * mass / slow**2, damped * mass / slow])
    high = np.log([1.5 * mass / lag**2, 1.6 * mass / lag])
    bounds = joint.log_bounds(case.goal)
    low[0], high[0] = max(low[0], bounds[0, 0]), max(min(high[0], bounds[1, 0]), bounds[0, 0])
    return low, high


def _grid(case: Case, centre: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Log-gains around a centre, within the bounds of the goal, shape (n, 2)."""
    axes = [np.linspace(c - h, c + h, GRID) for c, h in zip(centre, half, strict=True)]
    grid = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    ends = zip(joint.log_bounds(case.goal), (grid.min(0), grid.max(0)), strict=True)
    return np.clip(grid, *(np.where(np.isfinite(b), b, g) for b, g in ends))


@partial(jax.jit, static_argnums=0)
def _all(smooth: Any, data: Table, grid: jax.Array) -> tuple[jax.Array, ...]:
    def one(x: jax.Array) -> tuple[jax.Array, ...]:
        seen = smooth(x, data, jnp.asarray(1e5, x.dtype))
        return seen.value, seen.violation, seen.stable

    return jax.lax.map(one, grid, batch_size=_TILE)


def _exactly(case: Case, x: np.ndarray, tried: int, timed: Any) -> Brute:
    """The best of a few gains that meets all constraints exactly."""
    found = joint.exact([case] * len(x), x, timed)
    rows = joint.rows_of([case.goal] * len(x), x, found)
    excess = [
        max((over_all(sign * (found.log[metric][i] - np.log(bound)), case.goal)
             for _, metric, sign, bound in case.goal.rows), default=-np.inf)
        for i in range(len(x))
    ]  # fmt: skip
    met = rows.usable & (np.array(excess) <= 0.0)
    value = np.where(met, rows.worst_value, -np.inf)
    best = int(np.argmax(value))
    return Brute(float(value[best]), x[best], tried + len(x))
