"""Tracing curves of marginal gains through a window of the (kp, kd) plane, and telling their role.

A curve is given by a function from frequency to the two gains. Its stretches inside the window are
sampled evenly in the picture, cut wherever they change between boundary and inner lobe, and marked
with the side on which the loop is stable.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Range = tuple[float, float]
Gains = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
Count = Callable[[np.ndarray, np.ndarray], np.ndarray]
Line = tuple[np.ndarray, np.ndarray, float]

_PER_LOBE = 64
_MOST_POINTS = 200_000
_SEGMENT = 1.0 / 250.0
_SIDE_STEP = 1e-4


@dataclass(frozen=True)
class BoundaryCurve:
    """A connected part of a curve of marginal gains, inside the ranges asked for.

    Attributes:
        kp: [N/m], shape (k,).
        kd: [N s/m], shape (k,).
        frequency: of the marginal root [rad/s], shape (k,), ascending on a "curve", constant on a
            line.
        kind: "curve", or "line" for kp = -k (frequency 0) and for z = -1 (frequency pi/T).
        separates: whether one side is stable (no unstable root) and the other is not.
        stable_side: "left" or "right" of the direction of travel (kp to the right, kd upwards), or
            "".
    """

    kp: np.ndarray
    kd: np.ndarray
    frequency: np.ndarray
    kind: str
    separates: bool
    stable_side: str


def frequency_grid(low: float, high: float, delay: float) -> np.ndarray:
    """Frequencies dense enough in the logarithm, and in the phase of the delay [rad/s]."""
    lobes = (high - low) * delay / (2.0 * math.pi)
    number = min(int(_PER_LOBE * lobes) + 2, _MOST_POINTS)
    return np.union1d(np.geomspace(low, high, 4001), np.linspace(low, high, number))


def _scaled(values: np.ndarray, limits: Range) -> np.ndarray:
    """0 ... 1 over the axis: in the logarithm where the axis is positive."""
    low, high = limits
    if low > 0:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(values / low) / math.log(high / low)
    return (values - low) / (high - low)


def curves_inside(
    gains: Gains, grid: np.ndarray, kp_range: Range, kd_range: Range
) -> list[np.ndarray]:
    """Frequencies of every connected stretch inside the window, ending on its edges."""

    def inside(w: np.ndarray) -> np.ndarray:
        kp, kd = gains(w)
        return (kp >= kp_range[0]) & (kp <= kp_range[1]) & (kd >= kd_range[0]) & (kd <= kd_range[1])

    grid = _refine_in_window(gains, grid, kp_range, kd_range)
    mask = inside(grid)
    changes = np.flatnonzero(mask[1:] != mask[:-1])
    low, high = bisect(inside, mask[changes], grid[changes], grid[changes + 1])
    edges = np.where(mask[changes], low, high)
    starts = np.concatenate([grid[:1], edges]) if mask[0] else edges
    pieces = []
    for start in range(0, len(starts), 2):
        first = starts[start]
        last = starts[start + 1] if start + 1 < len(starts) else grid[-1]
        between = grid[(grid > first) & (grid < last)]
        w = np.concatenate([[first], between, [last]])
        pieces.append(_even_out(gains, w, kp_range, kd_range))
    return pieces


def _refine_in_window(
    gains: Gains, grid: np.ndarray, kp_range: Range, kd_range: Range
) -> np.ndarray:
    """Frequencies inserted until no step inside the window is long, however small the window."""
    for _ in range(30):
        x, y = (
            _scaled(a, limits) for a, limits in zip(gains(grid), (kp_range, kd_range), strict=True)
        )
        steps, near = np.zeros(len(grid) - 1), np.ones(len(grid) - 1, dtype=bool)
        for axis in (x, y):
            axis = np.clip(np.nan_to_num(axis, nan=-1.0), -1.0, 2.0)
            near &= (np.minimum(axis[1:], axis[:-1]) <= 1) & (np.maximum(axis[1:], axis[:-1]) >= 0)
            steps = np.maximum(steps, np.abs(np.diff(axis)))
        long = np.flatnonzero(near & (steps > 0.05))
        if len(long) == 0 or len(grid) > _MOST_POINTS:
            break
        grid = np.insert(grid, long + 1, 0.5 * (grid[long] + grid[long + 1]))
    return grid


def bisect(
    predicate: Callable[[np.ndarray], np.ndarray],
    at_low: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Brackets of where a predicate changes, shrunk to rounding; `at_low` is its value at low."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        same = predicate(middle) == at_low
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return low, high


def _even_out(gains: Gains, w: np.ndarray, kp_range: Range, kd_range: Range) -> np.ndarray:
    """Insert frequencies until neighbours are close in the picture, then drop the crowd."""
    for _ in range(40):
        length = _lengths(gains, w, kp_range, kd_range)
        long = np.flatnonzero(length > _SEGMENT)
        if len(long) == 0 or len(w) > _MOST_POINTS:
            break
        w = np.insert(w, long + 1, 0.5 * (w[long] + w[long + 1]))
    along = np.concatenate([[0.0], np.cumsum(_lengths(gains, w, kp_range, kd_range))])
    kept = np.unique(np.floor(along / (0.25 * _SEGMENT)), return_index=True)[1]
    return np.unique(np.concatenate([w[kept], w[-1:]]))


def _lengths(gains: Gains, w: np.ndarray, kp_range: Range, kd_range: Range) -> np.ndarray:
    kp, kd = gains(w)
    return np.hypot(np.diff(_scaled(kp, kp_range)), np.diff(_scaled(kd, kd_range)))


def spread(limits: Range) -> np.ndarray:
    """Values over an axis, even in its logarithm where it is positive."""
    return np.geomspace(*limits, 401) if limits[0] > 0 else np.linspace(*limits, 401)


def classify(
    curves: list[np.ndarray],
    gains: Gains,
    lines: list[Line],
    count: Count,
    kp_range: Range,
    kd_range: Range,
) -> list[BoundaryCurve]:
    """Cut every curve where its role changes, and say what each part separates."""
    result = []
    for w in curves:
        kp, kd = gains(w)
        for part, side in _roles(kp, kd, count, kp_range, kd_range):
            result.append(
                BoundaryCurve(kp[part], kd[part], w[part], "curve", side in ("left", "right"), side)
            )
    for kp, kd, frequency in lines:
        for part, side in _roles(kp, kd, count, kp_range, kd_range):
            w = np.full(len(kp[part]), frequency)
            separates = side in ("left", "right")
            result.append(BoundaryCurve(kp[part], kd[part], w, "line", separates, side))
    return result


def _roles(
    kp: np.ndarray, kd: np.ndarray, count: Count, kp_range: Range, kd_range: Range
) -> list[tuple[slice, str]]:
    """Slices of a curve of equal role: stable on the "left", on the "right", or "" (neither)."""
    points = len(kp)
    if points < 2:
        return []

    def side(index: np.ndarray) -> np.ndarray:
        left, right = _both_sides(kp, kd, index, count, kp_range, kd_range)
        return np.where((left == 0) & (right > 0), 1, np.where((right == 0) & (left > 0), -1, 0))

    probes = np.unique(np.linspace(0, points - 1, min(points, 65)).astype(int))
    roles = side(probes)
    while True:
        # Halve every stretch whose ends differ, until the ends are neighbours.
        differ = np.flatnonzero((roles[1:] != roles[:-1]) & (np.diff(probes) > 1))
        if len(differ) == 0:
            break
        middle = (probes[differ] + probes[differ + 1]) // 2
        roles = np.insert(roles, differ + 1, side(middle))
        probes = np.insert(probes, differ + 1, middle)
    cuts = np.flatnonzero(roles[1:] != roles[:-1])
    starts = [0, *probes[cuts + 1].tolist()]
    ends = [*starts[1:], points - 1]
    values = [roles[0], *roles[cuts + 1].tolist()]
    names = {1: "left", -1: "right", 0: ""}
    return [
        (slice(a, b + 1), names[int(v)])
        for a, b, v in zip(starts, ends, values, strict=True)
        if b > a
    ]


def _both_sides(
    kp: np.ndarray,
    kd: np.ndarray,
    index: np.ndarray,
    count: Count,
    kp_range: Range,
    kd_range: Range,
) -> tuple[np.ndarray, np.ndarray]:
    """Unstable roots just left and just right of the points `index` of a curve."""
    before, after = np.maximum(index - 1, 0), np.minimum(index + 1, len(kp) - 1)
    along_kp = _scaled(kp[after], kp_range) - _scaled(kp[before], kp_range)
    along_kd = _scaled(kd[after], kd_range) - _scaled(kd[before], kd_range)
    length = np.maximum(np.hypot(along_kp, along_kd), 1e-300)
    step_kp, step_kd = -_SIDE_STEP * along_kd / length, _SIDE_STEP * along_kp / length
    left = count(_moved(kp[index], step_kp, kp_range), _moved(kd[index], step_kd, kd_range))
    right = count(_moved(kp[index], -step_kp, kp_range), _moved(kd[index], -step_kd, kd_range))
    return left, right


def _moved(values: np.ndarray, step: np.ndarray, limits: Range) -> np.ndarray:
    low, high = limits
    return values * (high / low) ** step if low > 0 else values + step * (high - low)
