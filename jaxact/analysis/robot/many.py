"""Margins of many loops of a robot that differ in their gains, as a map over gains needs them.

What `jaxact.analysis.robot.margins` computes of all joints at once, of all loops together: one
frequency response (`shared_response`), the nearest crossings only (`nearest`), disk margins side by
side (`disk_batch`). Every limit of gain and delay is held against the roots of the loop just before
and just after it, as there; where it does not stand, it is computed as there.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxact.analysis.robot import disk_batch, nearest
from jaxact.analysis.robot import limits as _limits
from jaxact.analysis.robot import modes as _modes
from jaxact.analysis.robot import multiloop as _multiloop
from jaxact.analysis.robot.margins import WholeMargins, demand_answers
from jaxact.analysis.robot.modes import Robot
from jaxact.analysis.robot.multiloop import Matrices
from jaxact.analysis.robot.nearest import Loci
from jaxact.analysis.robot.shared_response import SharedResponse
from jaxact.analysis.robot.stability import excess, farthest, switch
from jaxact.analysis.robot.summits import summits

# Share of the largest value on the grid from which on maxima are refined, and how many at most.
_HIGH, _SUMMITS = 0.97, 3
# Crossings within this share of the nearest one are refined too: which is nearest is not yet sure.
_CLOSE = 0.1
# Share of its distance within which stability changes at a crossing that it does not change beside.
_AWAY = 0.05
Limit = tuple[float, float]


@dataclass(frozen=True)
class Member:
    """One loop.

    Attributes:
        robot: the loop.
        kp, kd: its gains, shape (m,) each.
    """

    robot: Robot
    kp: np.ndarray
    kd: np.ndarray

    @functools.cached_property
    def reduced(self) -> Matrices:
        """Its matrices without the states that nothing moves, or that move nothing."""
        return _multiloop.reduced(self.robot.matrices)


@dataclass(frozen=True)
class Motion:
    """Whether a loop is stable.

    Attributes:
        unstable_roots: outside the unit circle.
        spectral_radius: largest |root| [-].
        shaking_rate, toppling_rate: of the fastest motion that swings, and that does not [1/s].
        shakes: whether a growing motion swings.
        leaves: why the robot does not rest where it is linearised, in words; "" where it does, or
            where that is not asked.
    """

    unstable_roots: int
    spectral_radius: float
    shaking_rate: float
    toppling_rate: float
    shakes: bool
    leaves: str = ""


@dataclass(frozen=True)
class _Looked:
    """A stable loop on its grid; limits are (value, w T).

    `above` are upper bounds of sigma_max of S, S - I and S - I/2, as `_SHIFTS`, shape (k,) each.
    """

    number: int
    member: Member
    angle: np.ndarray
    S: np.ndarray
    above: tuple[np.ndarray, np.ndarray, np.ndarray]
    gains: tuple[Limit, Limit]
    delay: Limit


def motion(roots: np.ndarray, period: float) -> Motion:
    """What the roots of a loop over a period T [s] say."""
    growing = _modes.growing(roots)
    return Motion(
        unstable_roots=int(growing.sum()),
        spectral_radius=float(np.max(np.abs(roots), initial=0.0)),
        shaking_rate=_modes.fastest(roots, period, swing=True),
        toppling_rate=_modes.fastest(roots, period, swing=False),
        shakes=bool(np.any(growing & _modes.swinging(roots))),
    )


def margins_of_many(
    shared: SharedResponse, members: Sequence[Member]
) -> list[tuple[Motion, WholeMargins | None]]:
    """Motions of loops, and margins of all joints at once of those that are stable.

    Args:
        shared: from `shared_response`, which holds for all of them.
        members: the loops.

    Raises:
        UserError: commands do not move some joints at all, so that no gain matters.
    """
    found: list[tuple[Motion, WholeMargins | None]] = []
    looked: list[_Looked] = []
    for number, member in enumerate(members):
        once = shared.sensitivity(member.kp, member.kd, np.array([1.0]))[0]
        demand_answers(member.robot.names, once)
        roots = np.linalg.eigvals(member.reduced[0])
        moving = motion(roots, member.robot.period)
        found.append((moving, None))
        if not moving.unstable_roots:
            looked.append(_look(shared, number, member, roots))
    if looked:
        for one, margins in zip(looked, _whole(shared, looked), strict=True):
            found[one.number] = (found[one.number][0], margins)
    return found


def _look(shared: SharedResponse, number: int, member: Member, roots: np.ndarray) -> _Looked:
    angle, response = shared.grid(roots)
    S = shared.sensitivity(member.kp, member.kd, angle, response)
    # At the ends of the axis it is real but for rounding.
    S[[0, -1]] = S[[0, -1]].real
    unit = np.eye(S.shape[-1])
    most, complementary, half = (disk_batch.singular_bound(S - by * unit) for by in _SHIFTS)
    loci = Loci(angle, S, most, complementary)
    gains = tuple(_gain(shared, member, loci, roots, up=up) for up in (True, False))
    above = most, complementary, half
    return _Looked(number, member, angle, S, above, gains, _delay(member, loci))


def _gain(
    shared: SharedResponse, member: Member, loci: Loci, roots: np.ndarray, *, up: bool
) -> Limit:
    """The nearest factor on all gains at which a stable loop loses it, above or below 1."""

    def respond(angle: np.ndarray) -> np.ndarray:
        return shared.sensitivity(member.kp, member.kd, angle)

    crossings = loci.more_gain() if up else loci.less_gain()
    if not crossings:
        return (math.inf if up else 0.0), math.inf
    close = _distance(crossings[0]) * (1.0 + _CLOSE)
    exact = [nearest.refined(respond, item) for item in crossings if _distance(item) <= close]
    best = min(exact, key=_distance)
    M, N, C = member.reduced
    feedback = N @ C
    at, sign = _distance(best), 1.0 if up else -1.0

    def matrix(distance: float) -> np.ndarray:
        return M + math.expm1(sign * distance) * feedback

    @functools.cache
    def growth(distance: float) -> float:
        return excess(matrix(distance))

    if growth(at * (1.0 - _limits.EARLIER)) <= 0.0 and growth(at * (1.0 + _limits.BESIDE)) > 0.0:
        return math.exp(sign * at), best.angle
    # It may grow so slowly that rounding hides it next to the crossing.
    low, high = at * (1.0 - _AWAY), at * (1.0 + _AWAY)
    if max(farthest(roots), growth(low)) <= 0.0 < growth(high):
        at = switch(growth, low, high)
        return math.exp(sign * at), _limits.angle_of_change(matrix, at)
    loop = _multiloop.multiloop(*member.robot.matrices, member.robot.period)
    every = _limits.gain_factors(loci.angle, _limits.followed(loci.S))
    return _limits.gain_limit(loop, member.robot.matrices, every, up=up)


def _distance(crossing: _limits.Crossing) -> float:
    return abs(math.log(_limits.factor(crossing)))


def _delay(member: Member, loci: Loci) -> Limit:
    """The smallest delay of all commands at which a stable loop loses it [s]."""
    robot = member.robot
    return _limits.delay_limit(robot.later_by, robot.period, loci.more_delay())


def _whole(shared: SharedResponse, looked: Sequence[_Looked]) -> list[WholeMargins]:
    kp = np.array([one.member.kp for one in looked])
    kd = np.array([one.member.kd for one in looked])
    unit = np.eye(kp.shape[1])

    def shifted(by: np.ndarray, angle: np.ndarray, loop: np.ndarray) -> np.ndarray:
        return shared.sensitivity(kp[loop], kd[loop], angle) - by[:, None, None] * unit

    peaks = _singular_peaks(looked, shifted)
    S, grids = [one.S for one in looked], [one.angle for one in looked]
    above = [one.above[_HALF] for one in looked]

    def family(t: np.ndarray, loop: np.ndarray) -> np.ndarray:
        return shifted(np.full(len(t), 0.5), t, loop)

    disks = disk_batch.largest(S, grids, above, family)
    period = looked[0].member.robot.period
    return [
        _of_all(one, top, disk, period) for one, top, disk in zip(looked, peaks, disks, strict=True)
    ]


def _of_all(one: _Looked, top: np.ndarray, disk: np.ndarray, period: float) -> WholeMargins:
    (up, up_at), (down, down_at) = one.gains
    delay, delay_at = one.delay
    (peak, at), (complementary, complementary_at), (plain, _) = top
    return WholeMargins(
        gain_margin=up,
        gain_margin_frequency=up_at / period,
        gain_reduction_margin=down,
        gain_reduction_frequency=down_at / period,
        delay_margin=delay,
        delay_margin_frequency=delay_at / period,
        sensitivity_peak=float(peak),
        sensitivity_peak_frequency=float(at) / period,
        complementary_peak=float(complementary),
        complementary_peak_frequency=float(complementary_at) / period,
        modulus_margin=1.0 / float(peak),
        disk_margin=1.0 / float(disk[0]),
        disk_margin_frequency=float(disk[1]) / period,
        unscaled_disk_margin=1.0 / float(plain),
    )


# What is taken from S for S, -T, and the disk margin's (S - T)/2.
_SHIFTS, _HALF = np.array([0.0, 1.0, 0.5]), 2


def _singular_peaks(looked: Sequence[_Looked], shifted) -> np.ndarray:
    """Peaks over frequency of the largest singular values of S, T and S - I/2, and w T.

    Returns:
        Shape (loops, 3, 2).
    """
    places, brackets = [], []
    best = np.zeros((len(looked), 3, 2))
    for number, one in enumerate(looked):
        for kind, shift in enumerate(_SHIFTS):
            P = one.S - shift * np.eye(one.S.shape[-1])
            values = _high_values(P, one.above[kind])
            top = int(np.argmax(values))
            best[number, kind] = values[top], one.angle[top]
            inner = 1 + np.flatnonzero(
                (values[1:-1] >= values[:-2]) & (values[1:-1] >= values[2:]) & (values[1:-1] > 0.0)
            )
            for row in inner[np.argsort(-values[inner])[:_SUMMITS]]:
                if values[row] >= _HIGH * values[top]:
                    places.append((number, kind))
                    brackets.append(one.angle[row - 1 : row + 2])
    if not places:
        return best
    loop, kind = np.array(places).T

    def largest(t: np.ndarray, which: np.ndarray) -> np.ndarray:
        P = shifted(_SHIFTS[kind[which]], t, loop[which])
        return np.linalg.svd(P, compute_uv=False)[:, 0]

    for (number, own), row in zip(places, summits(np.array(brackets), largest), strict=True):
        if row[0] > best[number, own, 0]:
            best[number, own] = row
    return best


def _high_values(P: np.ndarray, above: np.ndarray) -> np.ndarray:
    """Largest singular values where they may be near the largest of all, 0 elsewhere; (k,)."""
    values = np.zeros(len(P))
    first = int(np.argmax(above))
    values[first] = np.linalg.norm(P[first], 2)
    near = np.flatnonzero(above >= _HIGH * values[first])
    # Their neighbours tell whether they are maxima.
    near = np.unique(np.clip(np.concatenate([near - 1, near, near + 1]), 0, len(P) - 1))
    values[near] = np.linalg.svd(P[near], compute_uv=False)[:, 0]
    return values
