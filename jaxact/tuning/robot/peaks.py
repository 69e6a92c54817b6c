"""Exact peaks of a robot's loops, and their slopes by the gains; NumPy, float64.

    S = (I + K G)^-1,  K = [kp kd],
    d ln sigma(X) / d k_aq = -c Re(conj(S* u)_a (G S v)_aq) / sigma

for X = c S + c0 I with singular value sigma and vectors u, v: S (c = 1), T = I - S (c = -1), and
D (S - I/2) D^-1 of the disk margin, where D is the best scaling and has no slope of its own
(Danskin's theorem). G is tabulated once; peaks are found on the table, and refined where they
count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxact.analysis.robot import disk as _disk
from jaxact.analysis.robot.stability import MARGINAL
from jaxact.tuning.robot import cores
from jaxact.tuning.robot.open_loops import OpenLoops, together

# Metric -> (c, c0) of X = c S + c0 I.
SHIFTS = {
    "sensitivity_peak": (1.0, 0.0),
    "complementary_peak": (-1.0, 1.0),
    "disk_margin": (1.0, -0.5),
}
POINTS = 120
# From here to the Nyquist frequency, as a share of it.
_LOWEST = 1e-5
# Peaks of a loop that become rows, and singular values at each of them.
_PEAKS, _VALUES = 2, 2
ROWS = _PEAKS * _VALUES
# A peak that far below the highest of its kind is left out, or left as the table has it [ln].
_FAR, _ROUGH = 0.4, 0.04
# Columns of a table that are kept on either side of one that is wanted.
_BESIDE = 2
# Size of a change of the loops over I + L up to which it leaves them stable.
_BESIDE_STABLE = 0.5
# Parabolas through three points that a peak is refined with.
_PARABOLAS = 3


@dataclass(frozen=True)
class Table:
    """Responses of open loops, l of them at f frequencies each.

    Attributes:
        loops: the loops.
        angle: w T [rad], rising, shape (l, f).
        response: G there, shape (l, f, m, 2, m).
    """

    loops: OpenLoops
    angle: np.ndarray
    response: np.ndarray

    def take(self, index: np.ndarray, columns: np.ndarray | slice = slice(None)) -> Table:
        """Some of the loops, at some of the frequencies."""
        return Table(
            self.loops.take(index),
            self.angle[index][:, columns],
            self.response[index][:, columns],
        )


def tabulate(loops: OpenLoops, angle: np.ndarray | None = None) -> Table:
    """Responses at some angles, shape (l, f); without them, logarithmic ones up to Nyquist's."""
    if angle is None:
        angle = np.tile(np.pi * np.geomspace(_LOWEST, 1.0, POINTS), (len(loops), 1))
    return Table(loops, angle, _at(loops, angle))


def extended(table: Table, more: OpenLoops) -> Table:
    """The table with more loops, each at the frequencies of the first known of its situation."""
    first = [int(np.argmax(table.loops.situation == place)) for place in more.situation]
    added = tabulate(more, table.angle[first])
    return Table(
        together(table.loops, more),
        np.concatenate([table.angle, added.angle]),
        np.concatenate([table.response, added.response]),
    )


def _at(loops: OpenLoops, angle: np.ndarray) -> np.ndarray:
    index = np.repeat(np.arange(len(loops)), angle.shape[1])
    found = loops.response(index, angle.ravel())
    return found.reshape(*angle.shape, *found.shape[1:])


def refined(table: Table, angle: np.ndarray) -> Table:
    """The table with more frequencies of each loop, shape (l, k)."""
    response = np.concatenate([table.response, _at(table.loops, angle)], axis=1)
    angle = np.concatenate([table.angle, angle], axis=1)
    order = np.argsort(angle, axis=1, kind="stable")
    rows = np.arange(len(angle))[:, None]
    return Table(table.loops, angle[rows, order], response[rows, order])


def sensitivity(response: np.ndarray, kp: np.ndarray, kd: np.ndarray) -> np.ndarray:
    """S at the plant's input, shape (..., m, m).

    Args:
        response: G, shape (..., m, 2, m).
        kp, kd: shape (m,).
    """
    loop = kp[:, None] * response[..., 0, :] + kd[:, None] * response[..., 1, :]
    flat = (np.eye(len(kp)) + loop).reshape(-1, *loop.shape[-2:])
    return cores.stacked(np.linalg.inv, flat).reshape(loop.shape)


def growth_rates(loops: OpenLoops, kp: np.ndarray, kd: np.ndarray) -> np.ndarray:
    """Growth rate of every closed loop [1/s], shape (l,); 0 at the edge of stability, as counted.

    A root this little outside the unit circle is on it: `jaxact.analysis.robot.stability.MARGINAL`.
    """
    closed = loops.A - loops.B @ (
        kp[:, None] * loops.seen[:, :, 0] + kd[:, None] * loops.seen[:, :, 1]
    )
    radius = cores.stacked(_radius, closed)
    return (np.log(radius) - np.log1p(MARGINAL)) / loops.period


def beside(
    table: Table, S: np.ndarray, gains: Sequence[np.ndarray], stable: Sequence[np.ndarray]
) -> bool:
    """Whether loops are stable with gains since they are with others nearby, by the small gain.

        det(I + L) = det(I - (L' - L) S') det(I + L'),    S' = (I + L')^-1

    has no zero on the way from L to L' where (L' - L) S' is small at all frequencies. Those of the
    table are looked at, with a distance that leaves room for what is between them.

    Args:
        table: of the loops.
        S: on the table with the gains.
        gains: kp and kd of the joints, shape (m,) each.
        stable: others with which all loops are stable.
    """
    dp, dd = (here - there for here, there in zip(gains, stable, strict=True))
    moved = dp[:, None] * table.response[..., 0, :] + dd[:, None] * table.response[..., 1, :]
    change = moved @ S
    least, most = limits(change)
    if not least.max(initial=0.0) < _BESIDE_STABLE:  # NaN neither
        return False
    unclear = change[most >= _BESIDE_STABLE]
    return bool((np.linalg.norm(unclear, 2, axis=(-2, -1)) < _BESIDE_STABLE).all())


def _radius(closed: np.ndarray) -> np.ndarray:
    return np.abs(np.linalg.eigvals(closed)).max(axis=1)


@dataclass(frozen=True)
class Peaks:
    """Peaks of one metric of every loop; up to ROWS for each.

    Attributes:
        log: ln of the singular value there, -inf where there is none, shape (l, ROWS).
        slope: its derivatives by kp and kd of the joints, shape (l, ROWS, m, 2).
        angle: w T [rad], shape (l, ROWS).
    """

    log: np.ndarray
    slope: np.ndarray
    angle: np.ndarray

    @property
    def highest(self) -> np.ndarray:
        """ln of the highest peak of every loop, shape (l,)."""
        return self.log.max(axis=1)


def peaks(
    table: Table,
    kp: np.ndarray,
    kd: np.ndarray,
    metrics: Sequence[str],
    S: np.ndarray | None = None,
) -> dict[str, Peaks]:
    """The highest peaks of metrics of every loop, of `disk_margin` those of mu(S - I/2).

    Args:
        table: of the loops.
        kp, kd: gains of the joints, shape (m,).
        metrics: names of SHIFTS.
        S: on the table with these gains, where it is known.
    """
    S = sensitivity(table.response, kp, kd) if S is None else S
    return {name: _peaks(table, S, kp, kd, name) for name in metrics}


def highest(
    table: Table, kp: np.ndarray, kd: np.ndarray, metrics: Sequence[str]
) -> dict[str, np.ndarray]:
    """ln of the highest peak of each metric of every loop on the table, not refined; (l,) each."""
    S = sensitivity(table.response, kp, kd)
    return {name: _table(_shifted(S, name), name).max(axis=1) for name in metrics}


def columns(
    table: Table, kp: np.ndarray, kd: np.ndarray, metrics: Sequence[str], depth: float
) -> np.ndarray:
    """At which columns of the table, or beside, a loop comes near the highest of a metric; (f,).

    Args:
        depth: what is near [ln].
    """
    S = sensitivity(table.response, kp, kd)
    near = np.zeros(S.shape[1], bool)
    for name in metrics:
        value = _table(_shifted(S, name), name)
        near |= (value > value.max() - depth).any(axis=0)
    return np.convolve(near, np.ones(2 * _BESIDE + 1), "same") > 0.5


def _peaks(table: Table, S: np.ndarray, kp: np.ndarray, kd: np.ndarray, metric: str) -> Peaks:
    value = _table(_shifted(S, metric), metric)
    loop, place = _summits(value)
    top = value[loop, place]
    angle = table.angle[loop, place]
    near = (top > value.max() - _ROUGH) & (place > 0) & (place < value.shape[1] - 1)
    angle[near] = _refine(table, kp, kd, metric, loop[near], place[near])
    response = table.loops.response(loop, angle)
    return _rows(len(table.loops), loop, angle, *_singular(response, kp, kd, metric, near))


def _shifted(S: np.ndarray, metric: str) -> np.ndarray:
    c, c0 = SHIFTS[metric]
    return c * S + c0 * np.eye(S.shape[-1])


def largest(X: np.ndarray, metric: str) -> np.ndarray:
    """Largest singular value of each, scaled where the metric wants it; shape (k,)."""
    if metric == "disk_margin":
        return _disk.balanced(X)[0]
    return cores.stacked(lambda X: np.linalg.svd(X, compute_uv=False)[:, 0], X)


def limits(X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the largest singular value of each, shape (...,) each.

    max |column| <= sigma_max <= sqrt(largest row sum * largest column sum), of magnitudes
    """
    size = np.abs(X)
    most = np.sqrt(size.sum(axis=-1).max(axis=-1) * size.sum(axis=-2).max(axis=-1))
    return np.sqrt((size**2).sum(axis=-2).max(axis=-1)), most


def _table(X: np.ndarray, metric: str) -> np.ndarray:
    """ln of the largest singular value of each, shape (l, f); -inf of those far below the highest.

    Most frequencies need no decomposition.
    """
    least, most = limits(X)
    highest = most if metric == "disk_margin" else least
    # One of every loop at least; what scaling takes off is not known here.
    wanted = most >= np.minimum(np.exp(-_FAR) * least.max(), highest.max(axis=1, keepdims=True))
    if metric == "disk_margin":
        wanted = np.ones_like(wanted)
    value = np.full(X.shape[:2], -np.inf)
    value[wanted] = np.log(largest(X[wanted], metric))
    return value


def _summits(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Loops and places of the highest local maxima of each loop, the ends included."""
    padded = np.pad(value, ((0, 0), (1, 1)), constant_values=-np.inf)
    top = (value >= padded[:, :-2]) & (value >= padded[:, 2:])
    ranked = np.where(top & (value > value.max() - _FAR), value, -np.inf)
    ranked[np.arange(len(value)), value.argmax(axis=1)] = value.max(axis=1)
    order = np.argsort(-ranked, axis=1, kind="stable")[:, :_PEAKS]
    kept = np.take_along_axis(ranked, order, axis=1) > -np.inf
    loop, column = np.nonzero(kept)
    return loop, order[loop, column]


def _refine(
    table: Table,
    kp: np.ndarray,
    kd: np.ndarray,
    metric: str,
    loop: np.ndarray,
    place: np.ndarray,
) -> np.ndarray:
    """Angles of maxima between the neighbours on the table, shape (k,).

    Parabolas through ln of metric and angle; the best three points are kept each time.
    """
    sides = place[:, None] + np.array([-1, 0, 1])
    at = np.log(table.angle[loop[:, None], sides])
    around = sensitivity(table.response[loop[:, None], sides], kp, kd)
    log = np.log(largest(_shifted(around, metric).reshape(-1, *around.shape[2:]), metric))
    log = log.reshape(at.shape)
    for _ in range(_PARABOLAS if loop.size else 0):
        new = vertex(at, log)
        S = sensitivity(table.loops.response(loop, np.exp(new)), kp, kd)
        found = np.log(largest(_shifted(S, metric), metric))
        at, log = narrowed(at, log, new, found)
    return np.exp(at[:, 1])


def vertex(at: np.ndarray, log: np.ndarray) -> np.ndarray:
    """Where parabolas through three points are highest, strictly between the outer ones."""
    before, after = at[:, 1] - at[:, 0], at[:, 2] - at[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        rise, fall = (log[:, 1] - log[:, 0]) / before, (log[:, 1] - log[:, 2]) / after
        shift = 0.5 * (rise * after - fall * before) / (rise + fall)
    # A neighbour far below, or a point twice: halve the longer side.
    longer = np.where(after > before, 0.5 * after, -0.5 * before)
    inside = (shift > -0.95 * before) & (shift < 0.95 * after) & (shift != 0.0)
    return at[:, 1] + np.where(inside, shift, longer)


def narrowed(
    at: np.ndarray, log: np.ndarray, new: np.ndarray, found: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The highest of four points and its neighbours."""
    at = np.concatenate([at, new[:, None]], axis=1)
    log = np.concatenate([log, found[:, None]], axis=1)
    order = np.argsort(at, axis=1)
    at, log = np.take_along_axis(at, order, axis=1), np.take_along_axis(log, order, axis=1)
    middle = np.clip(np.argmax(log, axis=1), 1, 2)[:, None] + np.array([-1, 0, 1])
    return np.take_along_axis(at, middle, axis=1), np.take_along_axis(log, middle, axis=1)


def _singular(
    response: np.ndarray, kp: np.ndarray, kd: np.ndarray, metric: str, exact: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Singular values at k frequencies and their slopes, shapes (k, values), (k, values, m, 2).

    Args:
        exact: where the scaling of the disk margin is to be the best one, shape (k,).
    """
    S = sensitivity(response, kp, kd)
    X = _shifted(S, metric)
    scale = np.ones(X.shape[:2])
    if metric == "disk_margin":
        _, scale = _disk.balanced(X)
        for i in np.flatnonzero(exact):
            scale[i] = _disk.scaled(X[i])[1]
    U, sigma, V = np.linalg.svd(X * (scale[:, :, None] / scale[:, None, :]))
    number = min(_VALUES, sigma.shape[1])
    U, V = U[..., :number] * scale[..., None], V[:, :number].conj() / scale[:, None, :]
    left = np.einsum("kba,kbv->kva", S.conj(), U)
    right = np.einsum("kaqb,kbc,kvc->kvaq", response, S, V)
    c, _ = SHIFTS[metric]
    slope = -c * (left.conj()[..., None] * right).real / sigma[:, :number, None, None]
    return np.log(sigma[:, :number]), slope


def _rows(
    loops: int, loop: np.ndarray, angle: np.ndarray, log: np.ndarray, slope: np.ndarray
) -> Peaks:
    """Peaks in their loops' rows; singular values far below the first of their kind left out."""
    shape = (loops, _PEAKS, _VALUES)
    number = log.shape[1]
    # The summits of a loop follow each other.
    turn = np.arange(len(loop)) - np.searchsorted(loop, loop)
    logs = np.full(shape, -np.inf)
    slopes = np.zeros((*shape, *slope.shape[2:]))
    angles = np.zeros(shape)
    logs[loop, turn, :number] = np.where(log > log.max() - _FAR, log, -np.inf)
    logs[loop, turn, 0] = log[:, 0]
    slopes[loop, turn, :number] = slope
    angles[loop, turn] = angle[:, None]
    flat = (loops, ROWS)
    return Peaks(logs.reshape(flat), slopes.reshape(*flat, *slope.shape[2:]), angles.reshape(flat))
