"""The check of a robot's optimum by trying every gain of a grid, where there are few groups.

The smooth metrics, sharp and on the whole table, decide which gains could meet the constraints; the
grid closes in on the best of them, and the last word is that of the exact metrics.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.tuning.polish import MET
from jaxact.tuning.robot import smooth
from jaxact.tuning.robot.exact import exact
from jaxact.tuning.robot.exchange import Candidate, inside_worse
from jaxact.tuning.robot.loops import Situation
from jaxact.tuning.robot.rows import Found, RobotCase, excess, more, seen

MOST_GROUPS = 2
# Points along each unknown, for two and for four of them.
_GRID = {2: 48, 4: 7}
# How wide the grid is [ln], how it shrinks, how often.
_WIDTH, _SHRINK, _ROUNDS = 2.0, {2: 0.1, 4: 0.4}, {2: 4, 4: 7}
# Loops that the sieve looks at, the worst at the centre; all are in the last word.
_LOOPS = 12
_TILE, _SHARP = 32, 1e5
# What the tables may miss of a peak [ln], and how many points are looked at exactly.
_SLACK, _EXACTLY = 2e-3, 48


def brute_force(case: RobotCase, centre: np.ndarray) -> Found:
    """The best log-gains of a grid around a point, refined.

    Args:
        centre: shape (2 g,), of at most MOST_GROUPS groups.
    """
    size = len(centre)
    table = case.table.take(np.argsort(-excess(case, centre))[:_LOOPS])
    data = smooth.data(table, case.groups, case.goal, case.low, case.high, table.angle.shape[1])
    shape = table.angle.shape
    surrogate = smooth.RobotSurrogate(smooth.family(case.goal), *shape)
    offsets = np.array(list(itertools.product(np.linspace(-1.0, 1.0, _GRID[size]), repeat=size)))
    middle, width, tried = centre, _WIDTH, 0
    best = Found(centre, -np.inf, np.inf, 0, 0)
    for _ in range(_ROUNDS[size]):
        grid = np.clip(middle + width * offsets, case.low, case.high)
        value, violation = map(np.asarray, _all(surrogate, data, jnp.asarray(grid, jnp.float32)))
        tried += len(grid)
        # Exact metrics take long: no more points than it takes to find one that is fine.
        order = np.argsort(-np.where(violation <= _SLACK, value, -np.inf))[:_EXACTLY]
        for x in grid[order]:
            here = seen(case, x)
            if here.met and here.value > best.value:
                best = here
                break
        middle = best.x if np.isfinite(best.value) else grid[order[0]]
        width *= _SHRINK[size]
    return Found(best.x, best.value, best.violation, tried * len(table.loops), tried)


def verified(
    best: Candidate, situations: Sequence[Situation], seed: int
) -> tuple[Candidate, float]:
    """The best of a grid where that is better all over the box, and by how much it is better.

    Args:
        best: where a search has led, whose loops the grid is of.
        situations: of the robot.
        seed: of the climbs in the box.
    """
    found, case = best.found, best.case
    tried = brute_force(case, found.x)
    gap = float(np.expm1(max(tried.value - found.value, 0.0)))
    if tried.value > found.value + 1e-3:
        known = exact(case.table.loops, *case.groups.gains(tried.x), case.goal.wanted)
        inside = inside_worse(case, situations, tried.x, known, seed)
        if inside is None or inside.excess <= MET:
            interior = None if inside is None else inside.excess
            return Candidate(case, more(tried, found.evaluations), interior, known), gap
    return replace(best, found=more(found, tried.evaluations)), gap


@partial(jax.jit, static_argnums=0)
def _all(smooth: Any, data: Any, grid: jax.Array) -> tuple[jax.Array, ...]:
    def one(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        seen = smooth(x, data, jnp.asarray(_SHARP, x.dtype))
        return seen.value, seen.violation

    return jax.lax.map(one, grid, batch_size=_TILE)
