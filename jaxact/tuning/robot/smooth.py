"""Smooth stand-ins for the peaks of a robot's loops, cheap enough for hundreds of gradient steps.

G of every loop is tabulated once. For each gain I + K G is inverted by elimination, and the largest
singular value of S and T follows by the power method, for as many frequencies at once as stay in a
processor's cache; its slope is known in closed form (`jaxact.tuning.robot.peaks`), so nothing is
differentiated through either. Whether a loop is stable is not asked on the way. The descent begins
where all loops are, peaks are infinite on the boundary, and its steps are shorter than they are
high beside it. What comes out steers the descent; nothing is certified with it.
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
# Bytes of the matrices of all starts that are worked on at once, and the least frequencies.
_CACHED, _STARTS, _NARROWEST = 400_000, 8, 8


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Data:
    """What the descent needs of one case; f frequencies of l loops lie behind each other.

    Attributes:
        response: G, complex64, in tiles of w frequencies, shape (tiles, m, 2, m, w); 0 beyond l f.
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
    tiles = _tiled(response.reshape(-1, joints, 2, joints))
    bounds = np.log([bound for *_, bound in goal.rows])
    floats = (groups.spread, groups.share, bounds, np.clip(low, -80, 80), np.clip(high, -80, 80))
    return Data(jnp.asarray(tiles, jnp.complex64), *(jnp.asarray(a, jnp.float32) for a in floats))


def _tiled(response: np.ndarray) -> np.ndarray:
    """Responses of shape (l f, m, 2, m) in tiles, frequencies last."""
    number, joints = response.shape[:2]
    width = max(_NARROWEST, _CACHED // (8 * _STARTS * joints**2) // _NARROWEST * _NARROWEST)
    width = min(width, number)
    filled = np.pad(response, ((0, -number % width), (0, 0), (0, 0), (0, 0)))
    return np.moveaxis(filled.reshape(-1, width, joints, 2, joints), 1, -1)


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
        points: frequencies f of each.
        gated: whether a loop may be found unstable on the way; no.
    """

    goal: Goal
    loops: int
    points: int = POINTS
    gated: bool = False

    def __call__(self, x: jax.Array, case: Data, sharpness: jax.Array) -> Smooth:
        """Smoothed objective and bounds at the logarithms of the gains."""
        goal = self.goal
        rows = tuple((metric, sign) for _, metric, sign, _ in goal.rows)
        names = tuple(sorted({name for name, _ in rows} | {goal.metric} - {KP}))
        # Beyond a bound nothing changes any more.
        x = jnp.clip(x, case.low, case.high)
        logs = x.reshape(2, -1)
        gains = jnp.exp(logs @ case.spread.T)
        found, stable = _log_metrics(gains, case, names, sharpness, (self.loops, self.points))
        if goal.metric == KP:
            found = found | {KP: (logs[0] @ case.share)[None]}
        objective = goal.metric, goal.sense
        return combine(found, stable, rows, case.log_bounds, objective, None, sharpness)


def _log_metrics(
    gains: jax.Array,
    case: Data,
    names: tuple[str, ...],
    sharpness: jax.Array,
    shape: tuple[int, int],
) -> tuple[dict[str, jax.Array], jax.Array]:
    """Smooth ln of metrics of every loop, and which are stable; gains of shape (2, m).

    Args:
        shape: loops, and frequencies of each.
    """
    still = jax.lax.stop_gradient(gains)
    logs, slopes = jax.lax.map(lambda G: _of_tile(still, G, names), case.response)
    change = gains - still
    found = {}
    for place, name in enumerate(names):
        # The value with its slope: what differentiates to it.
        value = logs[:, place] + jnp.einsum("qa,taqw->tw", change, slopes[:, place])
        rows = value.reshape(-1)[: shape[0] * shape[1]].reshape(shape)
        peak = jax.vmap(lambda row: softmax(row, sharpness))(rows)
        found[name] = -peak if name == "disk_margin" else peak
    return found, jnp.all(jnp.isfinite(gains))


def _of_tile(gains: jax.Array, G: jax.Array, names: tuple[str, ...]) -> tuple[jax.Array, jax.Array]:
    """ln of the metrics at w frequencies, shape (n, w), and its slopes, shape (n, m, 2, w)."""
    loop = gains[0][:, None, None] * G[:, 0] + gains[1][:, None, None] * G[:, 1]
    eye = jnp.eye(len(G), dtype=G.dtype)[:, :, None]
    S = _inverse(eye + loop)
    shifts = (SHIFTS[name] for name in names)
    each = [_log_largest(c * S + c0 * eye, S, G, c) for c, c0 in shifts]
    logs, slopes = zip(*each, strict=True)
    return jnp.stack(logs), jnp.stack(slopes)


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
    """ln of the largest singular value of X = c S + c0 I, and its slopes, shape (m, 2, w)."""
    v = _right_vectors(X)
    u = jnp.sum(X * v[None], axis=1)
    sigma = jnp.sqrt(jnp.sum(jnp.abs(u) ** 2, axis=0)) + _TINY
    left = jnp.sum(S.conj() * (u / sigma[None])[:, None], axis=0)
    through = jnp.sum(S * v[None], axis=1)
    right = jnp.sum(G * through[None, None], axis=2)
    slope = -c * (left.conj()[:, None] * right).real / sigma[None, None]
    return jnp.log(sigma), slope


def _right_vectors(X: jax.Array) -> jax.Array:
    """Right singular vectors of the largest singular values by the power method, shape (m, w).

    The sums of a product are written out in real numbers: compiled as one over an axis, they take
    several times as long. There is one product in the loop, X or its adjoint by turns, since the
    compiler would compute the first one again for every sum of a second one.
    """
    size, _, number = X.shape
    start = jnp.cos(1.0 + jnp.arange(size, dtype=X.real.dtype))
    turns = jnp.stack([X, X.conj().swapaxes(0, 1)])
    both = turns.real, turns.imag
    each = range(size)

    def turn(number: int, v: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        """The product with the vectors, which are made unit ones before."""
        length = jnp.sqrt(jnp.sum(v[0] ** 2 + v[1] ** 2, axis=0, keepdims=True)) + _TINY
        p, q = v[0] / length, v[1] / length
        a, b = (part[number % 2] for part in both)
        real = sum(
            (a[:, k] * p[None, k] - b[:, k] * q[None, k] for k in each), start=jnp.zeros_like(p)
        )
        imaginary = sum(
            (a[:, k] * q[None, k] + b[:, k] * p[None, k] for k in each), start=jnp.zeros_like(p)
        )
        return real, imaginary

    first = jnp.broadcast_to(start[:, None], (size, number))
    real, imaginary = jax.lax.fori_loop(0, 2 * _POWERS, turn, (first, jnp.zeros_like(first)))
    length = jnp.sqrt(jnp.sum(real**2 + imaginary**2, axis=0, keepdims=True)) + _TINY
    return jax.lax.complex(real, imaginary) / length
