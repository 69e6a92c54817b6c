"""The worst points of a box: screened all over it, its edges too, and then climbed to.

    excess_r(u) as large as it gets over u in [0, 1]^d, for every constraint r apart

The worst point is often on an edge, some parameters at an end and others between; where a resonance
meets a delay there are many peaks, with narrow ridges up to them. So what is screened stands at
ends as often as not, and every step up is the best of several kinds.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxact.tuning.box import sobol

Slopes = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Numbers of points and a row for each, (k,) both -> the slopes of these rows there (k, d)."""
Rise = Callable[[np.ndarray], tuple[np.ndarray, Slopes]]
"""Points of the unit box (n, d) -> excess of every row (n, r), inf where unstable; and slopes."""

# How far the unit interval is stretched before what sticks out is put back to its ends: a
# coordinate stands at each of them in a quarter of the points.
_STRETCH = 0.5
# Points screened in d dimensions are 2^(d + this), at most so many.
_SCREENED, _MOST = 3, 256
# Points that climb side by side, if not told otherwise; each tries four kinds of steps.
CLIMBERS = 8
# First and last size of a step, how it grows and shrinks, and most steps.
_FIRST, _LAST, _GROW, _SHRINK, _STEPS = 0.2, 1e-5, 1.6, 0.35, 36
# How far the surroundings of a point reach, in units of how far apart points are.
_SURROUNDINGS = 1.0
# No more climbs begin after so many rounds of steps, and as many again for every peak there is,
# that led no higher.
_PATIENCE = 3
# Climbs this near each other lead to one peak, and points are one [fraction of the ranges].
_SAME = 0.02
# A peak that is higher by less is no higher [ln].
_HIGHER = 1e-3

AT_ONCE = 6
"""Points that join what the search knows of a box at once."""
SMALL = 1e-3
"""An excess below this [ln] is paid for with tighter bounds, instead of ever smaller ones."""


@dataclass(frozen=True)
class Worst:
    """The worst points of a box that were found.

    Attributes:
        fraction: of the ranges where each row exceeds its bound most, shape (r, d).
        excess: of the rows there [ln], inf where unstable, shape (r,).
        summits: unstable points and ends of climbs, the highest first, shape (n, d); their excess,
            shape (n,).
    """

    fraction: np.ndarray
    excess: np.ndarray
    summits: tuple[np.ndarray, np.ndarray] = (np.empty((0, 0)), np.empty(0))

    @property
    def largest(self) -> float:
        """The largest excess [ln], -inf where nothing is bounded."""
        return float(self.excess.max(initial=-np.inf))

    def peaks(self, least: float) -> np.ndarray:
        """Summits with more than some excess, the highest first, shape (n, d)."""
        points, excess = self.summits
        return points[excess > least]


def screen(dimensions: int, seed: int, number: int | None = None) -> np.ndarray:
    """Points all over the unit box, its faces, edges and corners, shape (number, dimensions)."""
    number = min(2 ** (dimensions + _SCREENED), _MOST) if number is None else number
    stretched = (1.0 + 2.0 * _STRETCH) * sobol(dimensions, number, seed) - _STRETCH
    return np.clip(stretched, 0.0, 1.0)


def worst(rise: Rise, points: np.ndarray, seed: int = 0, climbers: int = CLIMBERS) -> Worst:
    """The worst points that climbing from the worst of some points leads to.

    Args:
        rise: what is climbed.
        points: from which to choose where to begin, shape (n, d).
        seed: of the steps at random.
        climbers: points that climb side by side.
    """
    seen = _Seen(rise)
    generator = np.random.default_rng(seed)
    value, slopes = seen(points)
    queue = _starts(points, value, slopes)
    climbs = peaks = _Climbs.none(points.shape[1])
    idle, highest, patience = 0, seen.worst.excess, _PATIENCE
    while np.isfinite(highest).all():
        more = itertools.islice(queue, climbers - len(climbs)) if idle < patience else ()
        climbs = climbs.joined(*more)
        if not len(climbs):
            break
        climbs = _climbed(seen, climbs, generator)
        peaks, climbs = _finished(peaks, climbs)
        idle = 0 if np.any(seen.worst.excess > highest + _HIGHER) else idle + 1
        highest = np.where(idle, highest, seen.worst.excess)
        patience = _PATIENCE * (1 + len(peaks))
    lost = ~np.isfinite(value).all(axis=1)
    ends = np.concatenate([points[lost], peaks.u])
    excess = np.concatenate([np.full(int(lost.sum()), np.inf), peaks.value])
    order = np.argsort(-excess, kind="stable")
    return replace(seen.worst, summits=(ends[order], excess[order]))


def apart(points: Sequence[np.ndarray]) -> np.ndarray:
    """The first points of a box, one of each place, at most `AT_ONCE`; shape (n, d)."""
    kept: list[np.ndarray] = []
    for one in points:
        if all(np.abs(one - other).max() > _SAME for other in kept):
            kept.append(one)
    return np.array(kept[:AT_ONCE])


def named(before: str, names: Sequence[str], values: np.ndarray) -> tuple[str, ...]:
    """What points are called: by the values of what is uncertain, shape (n, d)."""
    return tuple(
        " ".join([before, *(f"{n}={v:.7g}" for n, v in zip(names, row, strict=True))])
        for row in values
    )


class _Seen:
    """A rise that keeps the worst points it was asked for."""

    def __init__(self, rise: Rise) -> None:
        self._rise = rise
        self.worst = Worst(np.empty((0, 0)), np.empty(0))

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, Slopes]:
        """As the rise."""
        value, slopes = self._rise(points)
        if not len(self.worst.excess):
            rows, size = value.shape[1], points.shape[1]
            self.worst = Worst(np.zeros((rows, size)), np.full(rows, -np.inf))
        top = np.argmax(value, axis=0)
        highest = value.max(axis=0)
        higher = highest > self.worst.excess
        self.worst = Worst(
            np.where(higher[:, None], points[top], self.worst.fraction),
            np.where(higher, highest, self.worst.excess),
        )
        return value, slopes


@dataclass(frozen=True)
class _Climbs:
    """Climbs that are on; k of them.

    Attributes:
        u: where they are, shape (k, d).
        row: that each climbs along, shape (k,).
        value, slope: of that row there, shape (k,) and (k, d).
        inverse: of the curvature, 0 before it is known, shape (k, d, d).
        radius: of the next step, shape (k,).
        count: of steps, shape (k,).
    """

    u: np.ndarray
    row: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    inverse: np.ndarray
    radius: np.ndarray
    count: np.ndarray

    @classmethod
    def none(cls, size: int) -> _Climbs:
        """No climbs, in a box of so many dimensions."""
        flat, wide, whole = np.empty(0), np.empty((0, size)), np.zeros((0, size, size))
        number = np.empty(0, dtype=int)
        return cls(wide, number, flat, wide, whole, flat, number)

    def __len__(self) -> int:
        """How many are on."""
        return len(self.row)

    def take(self, which: np.ndarray) -> _Climbs:
        """Some of them."""
        return _Climbs(*(getattr(self, name)[which] for name in self.__dataclass_fields__))

    def joined(self, *others: _Climbs) -> _Climbs:
        """These and others."""
        every = (self, *others)
        return _Climbs(*(
            np.concatenate([getattr(one, name) for one in every])
            for name in self.__dataclass_fields__
        ))  # fmt: skip


def _starts(points: np.ndarray, value: np.ndarray, slopes: Slopes) -> Iterator[_Climbs]:
    """Climbs to begin: those of the row that is worst have every other turn.

    A corner to which every slope leads is a peak already.
    """
    size = points.shape[1]
    queues = [_order(points, column) for column in value.T]
    lead = int(np.argmax(value.max(axis=0)))
    others = [row for row in range(len(queues)) if row != lead]
    turns = [turn for row in others for turn in (lead, row)] or [lead]
    while any(queues):
        for row in turns:
            while queues[row]:
                at = np.array([queues[row].pop(0)])
                slope = slopes(at, np.array([row]))
                if _free(points[at], slope).any():
                    yield _Climbs(
                        points[at], np.array([row]), value[at, row], slope,
                        np.zeros((1, size, size)), np.full(1, _FIRST), np.zeros(1, dtype=int),
                    )  # fmt: skip
                    break


def _order(points: np.ndarray, height: np.ndarray) -> list[int]:
    """In which order to climb from points: first those that are the highest around them."""
    number, size = points.shape
    apart = np.abs(points[:, None] - points).max(axis=2)
    near = apart < _SURROUNDINGS * number ** (-1.0 / size)
    summit = ~np.any(near & (height > height[:, None]), axis=1)
    return [int(i) for i in np.lexsort((-height, ~summit)) if np.isfinite(height[i])]


def _free(u: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Which coordinates a slope leads along within the unit box."""
    return (slope != 0.0) & ~((u <= 0.0) & (slope < 0.0)) & ~((u >= 1.0) & (slope > 0.0))


def _climbed(rise: Rise, on: _Climbs, generator: np.random.Generator) -> _Climbs:
    """One step of every climb, the best of several kinds; shorter after one that leads nowhere."""
    trial = np.clip(on.u[:, None] + _steps(on, generator), 0.0, 1.0)
    kinds, each = trial.shape[1], np.arange(len(on))
    there, slopes = rise(trial.reshape(-1, trial.shape[2]))
    heights = there.reshape(len(on), kinds, -1)[each, :, on.row]
    best = np.argmax(heights, axis=1)
    taken = heights[each, best] > on.value
    own = np.flatnonzero(taken)
    move = np.where(taken[:, None], trial[each, best] - on.u, 0.0)
    slope = on.slope.copy()
    slope[own] = slopes(own * kinds + best[own], on.row[own])
    grown = np.minimum(_GROW * np.abs(move).max(axis=1), 0.5)
    return _Climbs(
        on.u + move, on.row, np.where(taken, heights[each, best], on.value), slope,
        _curved(on.inverse, move, on.slope - slope),
        np.where(taken, grown, _SHRINK * on.radius), on.count + 1,
    )  # fmt: skip


def _finished(peaks: _Climbs, on: _Climbs) -> tuple[_Climbs, _Climbs]:
    """The peaks with those that were reached, and the climbs that go on.

    One that comes near a peak, or another that is higher, is given up.
    """
    done = (on.radius < _LAST) | ~_free(on.u, on.slope).any(axis=1) | (on.count >= _STEPS)
    done |= ~np.isfinite(on.value)
    every = peaks.joined(on)
    near = np.abs(on.u[:, None] - every.u).max(axis=2) < _SAME
    near &= on.row[:, None] == every.row
    first = np.arange(len(every)) - len(peaks)
    higher = every.value > on.value[:, None]
    higher |= (every.value == on.value[:, None]) & (first < np.arange(len(on))[:, None])
    given_up = np.any(near & (higher | (first < 0)), axis=1) & (on.count > 1)
    ends = on.take(np.flatnonzero(done & ~given_up))
    return peaks.joined(ends), on.take(np.flatnonzero(~done & ~given_up))


def _steps(on: _Climbs, generator: np.random.Generator) -> np.ndarray:
    """Steps to try in each climb, of at most its radius, shape (k, 4, d).

    Newton's, of the curvature met so far, which follows ridges; every parameter to its better side,
    which leads to corners; along the slope; and one at random. Before a curvature is known, only
    the steepest parameter moves in place of Newton's step.
    """
    free, radius = _free(on.u, on.slope), on.radius
    slope = np.where(free, on.slope, 0.0)
    largest = np.abs(slope).max(axis=1, keepdims=True)
    along = slope / largest
    newton = np.where(free, np.einsum("kij,kj->ki", on.inverse, slope), 0.0)
    length = np.abs(newton).max(axis=1, keepdims=True)
    steepest = np.where(np.abs(slope) == largest, np.sign(slope), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        newton = newton * np.minimum(1.0, 2.0 * radius[:, None] / length)
    newton = np.where(length > 0.0, newton, radius[:, None] * steepest)
    random = generator.standard_normal(slope.shape)
    others = radius[:, None, None] * np.stack([np.sign(slope), along, random], axis=1)
    return np.concatenate([newton[:, None], others], axis=1)


def _curved(inverse: np.ndarray, move: np.ndarray, fall: np.ndarray) -> np.ndarray:
    """The inverse of the curvature after a move over which the slope fell (BFGS), (k, d, d).

    Args:
        move: s, shape (k, d), 0 where none was made.
        fall: y, shape (k, d).
    """
    product = np.einsum("ki,ki->k", move, fall)
    square = np.einsum("ki,ki->k", fall, fall)
    fine = product > 1e-10 * np.sqrt(np.einsum("ki,ki->k", move, move) * square)
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = np.eye(move.shape[1])
        known = inverse.any(axis=(1, 2))[:, None, None]
        own = np.where(known, inverse, (product / square)[:, None, None] * unit)
        turn = unit - move[:, :, None] * fall[:, None, :] / product[:, None, None]
        again = turn @ own @ turn.swapaxes(1, 2)
        again = again + move[:, :, None] * move[:, None, :] / product[:, None, None]
    return np.where(fine[:, None, None], again, inverse)
