"""What is guaranteed of a robot's tuned gains: every loop, exact, by other means than the search.

The search follows peaks on a table of open-loop responses. Here every loop is closed, its roots
are counted, and its peaks are looked for on a grid made of these roots
(`jaxact.analysis.robot.multiloop`), in float64.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jaxact.analysis.robot import disk as _disk
from jaxact.analysis.robot import multiloop as _multiloop
from jaxact.tuning.box import Points, ascend, spread
from jaxact.tuning.certificate import Metrics
from jaxact.tuning.goal import Goal
from jaxact.tuning.robot import cores
from jaxact.tuning.robot.loops import OpenLoops, Situation
from jaxact.tuning.robot.peaks import SHIFTS, growth_rates, limits, peaks, sensitivity
from jaxact.tuning.robot.rows import RobotCase, excess

# Peaks on the grid below this share of the highest are not refined: the grid, made of the roots,
# misses a few per cent of a peak at most.
_LOW = 0.7
# Components of a unit vector this near each other are level.
_LEVEL = 1e-6
# Ascent on the uncertainty: starts, steps, frequencies, and step of the difference quotients.
_STARTS, _ASCENTS, _BAND, _STEP = 4, 10, 24, 1e-4


@dataclass(frozen=True)
class Exact(Metrics):
    """Metrics of l closed loops.

    Attributes:
        growth_rate: [1/s], shape (l,); at most 0 is stable.
        angle: w T of each metric's peak [rad], shape (l,) each.
    """

    growth_rate: np.ndarray
    angle: dict[str, np.ndarray]


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


def worst_inside(
    situations: Sequence[Situation], case: RobotCase, x: np.ndarray, seed: int
) -> list[Points]:
    """Points of the box where each situation exceeds its bounds most, as ascent finds them.

    Args:
        case: what is known; the worst loops of each situation are starts of their own.
        x: log-gains.
        seed: of the other starts.
    """
    loops = case.table.loops
    gains = case.groups.gains(x)
    found = peaks(case.table, *gains, case.goal.wanted)
    over = excess(case, x)
    every = []
    for place, one in enumerate(situations):
        own = np.flatnonzero(loops.situation == place)
        worst = own[np.argsort(-over[own])[:2]]
        start = np.concatenate(
            [spread(loops.fraction.shape[1], _STARTS, seed), loops.fraction[worst]]
        )
        known = [found[metric] for _, metric, _, _ in case.goal.rows]
        angles = np.concatenate([p.angle[worst, p.log[worst].argmax(axis=1)] for p in known])
        points = ascend(_riser(one, case.goal, gains, _band(angles)), start, _ASCENTS)
        every.append(Points(points, tuple(f"interior {i}" for i in range(len(points)))))
    return every


def _band(peaks: np.ndarray) -> np.ndarray:
    """Angles around those of peaks [rad]."""
    around = np.geomspace(0.5, 2.0, _BAND // 2)
    ends = np.array([np.min(peaks), np.max(peaks)])
    return np.minimum(np.unique(ends[:, None] * around), np.pi)


def _riser(
    one: Situation, goal: Goal, gains: tuple[np.ndarray, np.ndarray], band: np.ndarray
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """The largest excess on a band of frequencies, and its slopes by fractions of the box."""

    def opened(u: np.ndarray) -> tuple[np.ndarray, ...]:
        return one.opened(one.values(u[None])[0])[:3]

    def over(matrices: tuple[np.ndarray, ...], angle: np.ndarray) -> np.ndarray:
        """ln of how far the worst metric exceeds its bound at each angle [-]."""
        A, B, seen = matrices
        z = np.exp(1j * angle)[:, None, None]
        states = np.linalg.solve(z * np.eye(len(A)) - A, B[None].astype(complex))
        rows = seen.reshape(-1, len(A)) @ states
        S = sensitivity(rows.reshape(len(angle), *seen.shape[:2], -1), *gains)
        worst = np.full(len(angle), -np.inf)
        for _, metric, sign, bound in goal.rows:
            c, c0 = SHIFTS[metric]
            X = c * S + c0 * np.eye(S.shape[-1])
            # mu of the disk margin is one over it
            size = _disk.balanced(X)[0] if sign < 0 else np.linalg.norm(X, 2, axis=(1, 2))
            worst = np.maximum(worst, np.log(size) - sign * np.log(bound))
        return worst

    def rise(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """At points of the box, shape (points, d): the excess, and its slopes one-sided."""
        values, slopes = [], []
        for u in points:
            here = over(opened(u), band)
            at = band[[int(np.argmax(here))]]
            slope = []
            for axis, fraction in enumerate(u):
                end = u.copy()
                end[axis] += _STEP if fraction < 0.5 else -_STEP
                slope.append((over(opened(end), at)[0] - here.max()) / (end[axis] - fraction))
            values.append(here.max())
            slopes.append(slope)
        return np.array(values), np.array(slopes)

    return rise
