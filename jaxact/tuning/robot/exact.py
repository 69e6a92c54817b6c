"""What is guaranteed of a robot's tuned gains: every loop, exact, by other means than the search.

The search follows peaks on a table of open-loop responses. Here every loop is closed, its roots
are counted, and its peaks are looked for on a grid made of these roots
(`jaxact.analysis.robot.multiloop`), in float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxact.analysis.robot import disk as _disk
from jaxact.analysis.robot import multiloop as _multiloop
from jaxact.tuning.certificate import Metrics
from jaxact.tuning.robot import cores
from jaxact.tuning.robot.open_loops import OpenLoops
from jaxact.tuning.robot.peaks import SHIFTS, growth_rates, limits, sensitivity

# Peaks on the grid below this share of the highest are not refined: the grid, made of the roots,
# misses a few per cent of a peak at most.
_LOW = 0.7
# Components of a unit vector this near each other are level.
_LEVEL = 1e-6


@dataclass(frozen=True)
class Exact(Metrics):
    """Metrics of l closed loops.

    Attributes:
        growth_rate: [1/s], shape (l,); at most 0 is stable.
        angle: w T of each metric's peak [rad], shape (l,) each.
    """

    growth_rate: np.ndarray
    angle: dict[str, np.ndarray]

    def take(self, index: np.ndarray) -> Exact:
        """Those of some of the loops, by their numbers."""
        log, angle = ({k: v[index] for k, v in each.items()} for each in (self.log, self.angle))
        return Exact(self.stable[index], log, self.growth_rate[index], angle)

    def joined(self, more: Exact) -> Exact:
        """Those of these loops and of others."""
        both = (self, more)
        return Exact(
            np.concatenate([one.stable for one in both]),
            {name: np.concatenate([one.log[name] for one in both]) for name in self.log},
            np.concatenate([one.growth_rate for one in both]),
            {name: np.concatenate([one.angle[name] for one in both]) for name in self.angle},
        )


def exact(loops: OpenLoops, kp: np.ndarray, kd: np.ndarray, metrics: tuple[str, ...]) -> Exact:
    """Stability and metrics of every loop.

    Args:
        kp, kd: gains of the joints, shape (m,).
        metrics: names of `jaxact.tuning.robot.peaks.SHIFTS`.
    """
    growth = growth_rates(loops, kp, kd)
    log = {name: np.full(len(loops), np.nan) for name in metrics}
    angle = {name: np.full(len(loops), np.nan) for name in metrics}
    stable = np.flatnonzero(growth < 0.0).tolist()

    def found(index: int) -> dict[str, tuple[float, float]]:
        loop = _multiloop.multiloop(*loops.closed(index, kp, kd), float(loops.period[index]))
        return _peaks(loop, metrics)

    for index, peaks_of in zip(stable, cores.each(found, stable), strict=True):
        for name, (value, at) in peaks_of.items():
            log[name][index], angle[name][index] = value, at
    return Exact(growth < 0.0, log, growth, angle)


def leading(
    loops: OpenLoops, known: Exact, kp: np.ndarray, kd: np.ndarray, metric: str, index: int
) -> int:
    """Number of the joint with the largest part in a loop's peak of a metric.

    That is the largest component of u, where sigma u = X v with the largest singular value of X
    (`jaxact.tuning.robot.peaks`) at the peak; of joints that are level, the first.

    Args:
        known: of all loops with these gains.
        kp, kd: gains of the joints, shape (m,).
        index: number of the loop, which is stable.
    """
    S = sensitivity(loops.response(np.array([index]), known.angle[metric][[index]]), kp, kd)[0]
    c, c0 = SHIFTS[metric]
    X = c * S + c0 * np.eye(len(S))
    if metric == "disk_margin":
        scale = _disk.scaled(X)[1]
        X = X * (scale[:, None] / scale[None, :])
    share = np.abs(np.linalg.svd(X)[0][:, 0])
    return int(np.argmax(share > share.max() - _LEVEL))


def _peaks(loop: _multiloop.Multiloop, metrics: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """ln of the metrics of one loop, and w T where."""
    grid = _multiloop.grid(loop)
    S = _multiloop.sensitivity(loop, grid)
    S[[0, -1]] = S[[0, -1]].real
    plain = [name for name in metrics if name != "disk_margin"]
    found = {}
    if "disk_margin" in metrics:
        peak, at = _disk.largest_bound(loop, grid, S)
        found["disk_margin"] = (-float(np.log(peak)), at)
    if not plain:
        return found
    unit = np.eye(S.shape[-1])
    turned = np.array([SHIFTS[name] for name in plain])

    def largest(t: np.ndarray, number: np.ndarray) -> np.ndarray:
        c, c0 = turned[number].T
        X = c[:, None, None] * _multiloop.sensitivity(loop, t) + c0[:, None, None] * unit
        return np.linalg.svd(X, compute_uv=False)[:, 0]

    columns = [_summit(c * S + c0 * unit) for c, c0 in turned]
    value, where = _multiloop.peaks(grid, np.stack(columns, axis=1), largest)
    logs = np.log(value)
    return found | {name: (float(logs[i]), float(where[i])) for i, name in enumerate(plain)}


def _summit(X: np.ndarray) -> np.ndarray:
    """Largest singular value of each, shape (k,); 0 of those that are surely below _LOW times the
    highest."""
    least, most = limits(X)
    wanted = np.flatnonzero(most >= _LOW * float(np.max(least)))
    value = np.zeros(len(X))
    value[wanted] = np.linalg.svd(X[wanted], compute_uv=False)[:, 0]
    return np.where(value >= _LOW * float(np.max(value)), value, 0.0)
