"""Where the search for a robot's gains begins: gains over orders of magnitude, screened exactly.

Peaks over the gains of many joints have many minima, and where a robot stands, gains that are
stable at all lie between toppling and shaking. So three shapes of gains are scaled over four
decades and more, damped lightly and heavily: those that are given, those of equal bandwidth,
(kp, kd) = (J w^2, 2 zeta J w), and equal ones for all joints. Around the best of them every group
is moved on its own. The peaks of S = (I + [kp kd] G)^-1, with G as tabulated, are cheap, and so is
the spectrum of one loop.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from jaxact.parameters import KP
from jaxact.tuning.course import Course
from jaxact.tuning.robot.peaks import growth_rates, highest
from jaxact.tuning.robot.rows import Found, RobotCase, excess, part

# Factors on kp [ln], and, beside their square roots, on kd.
_SCALES, _RATIOS = np.linspace(-7.0, 2.4, 9), np.linspace(-2.4, 2.4, 5)
# The same where there is one group, whose gains fill a plane: finer.
_FINE_SCALES, _FINE_RATIOS = np.linspace(-7.4, 2.8, 15), np.linspace(-3.0, 3.0, 9)
# Natural frequencies of joints [1/lag], and their damping ratios.
_FREQUENCIES, _DAMPING = np.geomspace(0.01, 3.0, 7), np.geomspace(0.2, 5.0, 4)
# Points that others are tried around, how many, and how far away in ln kp and ln kd.
_CENTRES, _AROUND, _REACH = 3, 24, (1.5, 1.0)
# Clouds around what comes nearest to bounds that nothing meets: how wide [ln], points of each.
CLOUDS, _POINTS = (1.0, 0.5, 0.2, 0.1, 0.04, 0.015, 0.005), 64
# Starts this near each other are one [ln].
_SAME = 0.5


def screened(
    case: RobotCase, x: np.ndarray, inertia: np.ndarray, lag: float, seed: int, course: Course
) -> tuple[list[Found], int]:
    """Gains over orders of magnitude, judged at the loops that say most.

    Args:
        x: log-gains that are known, shape (2 g,); may be unstable.
        inertia: effective one of the joints [kg or kg m^2], shape (joints,).
        lag: of the slowest drive [s].
        seed: of the points around the best ones.
        course: of the search.

    Returns:
        Those at which these loops are stable, the best first; and how many were tried.
    """
    from scipy.stats import qmc

    few = part(case, _telling(case, x))
    first = _distinct(case, np.concatenate([x[None], lattice(case, x, inertia, lag)]))
    found = _judged(few, first, course)
    centres = apart(found, _CENTRES)
    size = len(x)
    reach = np.repeat(_REACH, size // 2)
    points = qmc.Sobol(size, scramble=True, rng=seed).random_base2(_AROUND.bit_length())
    offsets = (2.0 * points[:_AROUND] - 1.0) * reach
    around = [centre + offset for centre in centres for offset in offsets]
    if not around:
        return found, len(first)
    more = _distinct(case, np.array(around))
    return sorted([*found, *_judged(few, more, course)], key=Found.rank), len(first) + len(more)


def closer(
    case: RobotCase, x: np.ndarray, course: Course, seed: int = 0, clouds: Sequence[float] = CLOUDS
) -> np.ndarray:
    """Log-gains near x that exceed the bounds least, by clouds of points that grow narrow.

    Where two peaks are level no slope leads on; points to all sides do.

    Args:
        x: shape (2 g,), where all loops are stable.
        course: of the search.
        seed: of the points.
        clouds: how wide they are [ln].
    """
    few = part(case, _telling(case, x))
    generator = np.random.default_rng(seed)
    for width in clouds:
        offsets = generator.uniform(-1.0, 1.0, (_POINTS, len(x)))
        points = np.concatenate([x[None], x + width * offsets])
        found = _judged(few, _distinct(case, points), course)
        x = next((one.x for one in found if case.stable(one.x)), x)
    return x


def lattice(case: RobotCase, x: np.ndarray, inertia: np.ndarray, lag: float) -> np.ndarray:
    """Three shapes of gains over orders of magnitude, shape (n, 2 g); see the module."""
    groups = case.groups
    kp, kd = np.split(x, 2)

    def scaled(kp: np.ndarray, kd: np.ndarray, scales: np.ndarray, ratios: np.ndarray):
        return [np.concatenate([kp + a, kd + 0.5 * a + b])
                for a, b in itertools.product(scales, ratios)]  # fmt: skip

    if len(groups) == 1:
        return np.array(scaled(kp, kd, _FINE_SCALES, _FINE_RATIOS))
    found = scaled(kp, kd, _SCALES, _RATIOS)
    found += [np.concatenate([kp + a, kd + a]) for a in _SCALES]
    for w, zeta in itertools.product(_FREQUENCIES / lag, _DAMPING):
        found.append(groups.log_gains(inertia * w**2, 2.0 * zeta * inertia * w))
    level = [np.full(len(groups), half @ groups.share) for half in (kp, kd)]
    return np.array(found + scaled(*level, _SCALES, _RATIOS))


def apart(
    found: list[Found], number: int, wanted: Callable[[np.ndarray], bool] = lambda x: True
) -> list[np.ndarray]:
    """Log-gains of the best of them that are not beside a better one, at most that many.

    Args:
        found: the best first.
        number: of those to keep.
        wanted: whether log-gains may be kept.
    """
    kept: list[np.ndarray] = []
    for one in found:
        if len(kept) == number:
            break
        if all(np.abs(one.x - other).max() > _SAME for other in kept) and wanted(one.x):
            kept.append(one.x)
    return kept


def _telling(case: RobotCase, x: np.ndarray) -> np.ndarray:
    """Numbers of the first loop of every situation, and of the one that is worst at x."""
    situation = case.table.loops.situation
    if len(situation) == 1:
        return np.zeros(1, int)
    over = excess(case, x)
    own = [np.flatnonzero(situation == place) for place in np.unique(situation)]
    return np.unique([index for one in own for index in (one[0], one[np.argmax(over[one])])])


def _distinct(case: RobotCase, x: np.ndarray) -> np.ndarray:
    """The points within the bounds of the gains, each once, in their order."""
    x = np.clip(x, case.low, case.high)
    _, first = np.unique(np.round(x, 6), axis=0, return_index=True)
    return x[np.sort(first)]


def _judged(case: RobotCase, x: np.ndarray, course: Course) -> list[Found]:
    """Those of the points that are stable, the best first."""
    order = list(range(len(case.table.loops)))
    kept = []
    for number, point in enumerate(x):
        course.phase(course.doing, number, len(x))
        lost = _unstable(case, point, order)
        if lost is not None:
            # What one loop does not bear, it will hardly bear beside.
            order.remove(lost)
            order.insert(0, lost)
            continue
        kept.append(Found(point, *_roughly(case, point), 0, 0))
        course.points.append(kept[-1])
    return sorted(kept, key=Found.rank)


def _unstable(case: RobotCase, x: np.ndarray, order: list[int]) -> int | None:
    """The first loop in an order that is unstable at x, None if all are stable."""
    gains = case.groups.gains(x)
    for index in order:
        if growth_rates(case.table.loops.take(np.array([index])), *gains)[0] >= 0.0:
            return index
    return None


def _roughly(case: RobotCase, x: np.ndarray) -> tuple[float, float]:
    """Value and largest excess at x, of the peaks on the table."""
    goal = case.goal
    found = highest(case.table, *case.groups.gains(x), goal.wanted)
    # The disk margin is one over its peak.
    over = [found[metric].max() - sign * np.log(bound) for _, metric, sign, bound in goal.rows]
    own = x[: len(x) // 2] @ case.groups.share if goal.metric == KP else -found[goal.metric].max()
    return float(own), float(max(over, default=-np.inf))
