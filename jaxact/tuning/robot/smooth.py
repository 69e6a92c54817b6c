"""Smooth stand-ins for the peaks of a robot's loops, cheap enough for hundreds of gradient steps.

G of every loop is tabulated once. For each gain I + K G is inverted by elimination for all
frequencies at once, and the largest singular value of S and T follows by the power method; its
slope is known in closed form (`jaxact.tuning.robot.peaks`), so nothing is differentiated through
either. Whether a loop is stable is not asked on the way. The descent begins where all loops are,
peaks are infinite on the boundary, and its steps are shorter than they are high beside it. What
comes out steers the descent; nothing is certified with it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.parameters import KP
from jaxact.tuning.goal import Goal
from jaxact.tuning.groups import Groups
from jaxact.tuning.objective import Smooth, combine, softmax
from jaxact.tuning.robot.peaks import SHIFTS, Table

# Frequencies of the table that are kept, and loops.
POINTS, LOOPS = 60, 16
_POWERS = 10
_TINY = 1e-20


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Data:
    """What the descent needs of one case; f frequencies of l loops lie behind each other.

    Attributes:
        response: G, complex64, shape (m, 2, m, l f).
        spread: of the groups, shape (m, g).
        share: of the groups in the joints, shape (g,).
        log_bounds: ln of the bounds of the constraints, shape (rows,).
        low, high: bounds of the log-gains, shape (2 g,).
    """

    response: jax.Array
    spread: jax.Array
    share: jax.Array
    log_bounds: jax.Array
    low: jax.Array
    high: jax.Array


def data(
    table: Table,
    groups: Groups,
    goal: Goal,
    low: np.ndarray,
    high: np.ndarray,
    points: int = POINTS,
) -> Data:
    """One case, its loops as tabulated.

    Args:
        table: of the loops.
        low, high: bounds of the log-gains, shape (2 g,).
        points: frequencies of the table that are kept.
    """
    every = np.unique(np.linspace(0, table.angle.shape[1] - 1, points).round().astype(int))
    response = table.response[:, every]
    joints = len(groups.joints)
    last = np.moveaxis(response.reshape(-1, joints, 2, joints), 0, -1)
    bounds = np.log([bound for *_, bound in goal.rows])
    floats = (groups.spread, groups.share, bounds, np.clip(low, -80, 80), np.clip(high, -80, 80))
    return Data(jnp.asarray(last, jnp.complex64), *(jnp.asarray(a, jnp.float32) for a in floats))


def family(goal: Goal) -> Goal:
    """The goal with bounds that only say which ones there are: one compiled program for all."""
    kept = {"max_peak": 2.0, "min_disk_margin": 0.5}
    bounds: dict[str, Any] = {name: kept[name] for name in goal.active}
    return replace(goal, **bounds, min_kp=0.0 if goal.objective == "stiffness" else 1.0,
                   max_kp=np.inf)  # fmt: skip


@dataclass(frozen=True)
class RobotSurrogate:
    """The smooth problem of a goal; its bounds come with the data.

    Attributes:
        goal: objective and which constraints there are.
        loops: l of the data.
    """

    goal: Goal
    loops: int

    def __call__(self, x: jax.Array, case: Data, sharpness: jax.Array) -> Smooth:
        """Smoothed objective and bounds at the logarithms of the gains."""
        goal = self.goal
        rows = tuple((metric, sign) for _, metric, sign, _ in goal.rows)
        names = tuple(sorted({name for name, _ in rows} | {goal.metric} - {KP}))
        # Beyond a bound nothing changes any more.
        x = jnp.clip(x, case.low, case.high)
        logs = x.reshape(2, -1)
        gains = jnp.exp(logs @ case.spread.T)
        found, stable = _log_metrics(gains, case, names, sharpness, self.loops)
        if goal.metric == KP:
            found = found | {KP: (logs[0] @ case.share)[None]}
        objective = goal.metric, goal.sense
        return combine(found, stable, rows, case.log_bounds, objective, None, sharpness)


def _log_metrics(
    gains: jax.Array, case: Data, names: tuple[str, ...], sharpness: jax.Array, loops: int
) -> tuple[dict[str, jax.Array], jax.Array]:
    """Smooth ln of metrics of every loop, and which are stable; gains of shape (2, m)."""
    G = case.response
    still = jax.lax.stop_gradient(gains)
    loop = still[0][:, None, None] * G[:, 0] + still[1][:, None, None] * G[:, 1]
    joints = G.shape[0]
    eye = jnp.eye(joints, dtype=G.dtype)[:, :, None]
    S = _inverse(eye + loop)
    change = gains - still
    found = {}
    for name in names:
        c, c0 = SHIFTS[name]
        X = c * S + c0 * eye
        log, slope = _log_largest(X, S, G, c)
        # The value with its slope: what differentiates to it.
        value = log + jnp.einsum("qa,aqf->f", change, slope)
        peak = jax.vmap(lambda row: softmax(row, sharpness))(value.reshape(loops, -1))
        found[name] = -peak if name == "disk_margin" else peak
    return found, jnp.all(jnp.isfinite(gains))


def _inverse(A: jax.Array) -> jax.Array:
    """Inverses of A, shape (m, m, f).

    Gauss and Jordan's elimination without pivoting: a leading minor vanishes only where a part of
    the joints alone is marginal at that very frequency.
    """

    def eliminate(k: int, A: jax.Array) -> jax.Array:
        """One pivot's row and column."""
        pivot = jnp.where(jnp.abs(A[k, k]) < _TINY, _TINY, A[k, k])
        here = jnp.arange(len(A)) == k
        row = jnp.where(here[:, None], 1.0, A[k]) / pivot[None]
        column = jnp.where(here[:, None], 0.0, A[:, k])
        kept = jnp.where(here[None, :, None] | here[:, None, None], 0.0, A)
        return kept - column[:, None] * row[None] + here[:, None, None] * row[None]

    return jax.lax.fori_loop(0, len(A), eliminate, A)


def _log_largest(X: jax.Array, S: jax.Array, G: jax.Array, c: float) -> tuple[jax.Array, jax.Array]:
    """ln of the largest singular value of X = c S + c0 I, and its slopes, shape (m, 2, f)."""
    size, _, number = X.shape
    start = jnp.cos(1.0 + jnp.arange(size, dtype=X.real.dtype))
    v = jnp.broadcast_to(start[:, None].astype(X.dtype), (size, number))

    def power(_: int, v: jax.Array) -> jax.Array:
        u = jnp.sum(X * v[None], axis=1)
        v = jnp.sum(X.conj() * u[:, None], axis=0)
        return v / (jnp.sqrt(jnp.sum(jnp.abs(v) ** 2, axis=0, keepdims=True)) + _TINY)

    v = jax.lax.fori_loop(0, _POWERS, power, v)
    u = jnp.sum(X * v[None], axis=1)
    sigma = jnp.sqrt(jnp.sum(jnp.abs(u) ** 2, axis=0)) + _TINY
    left = jnp.sum(S.conj() * (u / sigma[None])[:, None], axis=0)
    through = jnp.sum(S * v[None], axis=1)
    right = jnp.sum(G * through[None, None], axis=2)
    slope = -c * (left.conj()[:, None] * right).real / sigma[None, None]
    return jnp.log(sigma), slope
