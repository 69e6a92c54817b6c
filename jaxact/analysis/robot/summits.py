"""The highest points of many curves at once, each within a bracket of three points.

Parabolas through the three points, and a step into the wider side where these say nothing new;
see Press et al., "Numerical Recipes", section 10.3, for the method of one curve.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# Steps at most; gain that a parabola still promises, relatively, below which a curve is done when
# it happens twice running; width of a bracket, relatively, below which it is too.
_STEPS, _GAIN, _WIDTH = 60, 1e-10, 1e-9
# Share of the wider side that a step takes where the parabola's vertex is too near to the middle,
# and how near that is, as a share of the bracket.
_GOLDEN, _INTO, _CLOSE = 0.382, 0.1, 1e-3

Curve = Callable[[np.ndarray, np.ndarray], np.ndarray]


def summits(brackets: np.ndarray, curve: Curve) -> np.ndarray:
    """Maxima of curves within brackets.

    Args:
        brackets: low, middle and high ends, of which the middle one is the highest, (k, 3); two may
            be the same, then the value is that of the higher end.
        curve: (points (j,), numbers of curves (j,)) -> values (j,).

    Returns:
        Values and places, shape (k, 2).
    """
    every = np.arange(len(brackets))
    x = np.array(brackets, float)
    y = np.stack([curve(x[:, side], every) for side in range(3)], axis=1)
    inside = (x[:, 0] < x[:, 1]) & (x[:, 1] < x[:, 2]) & (y[:, 1] >= np.maximum(y[:, 0], y[:, 2]))
    going, calm = every[inside], np.zeros(len(x), int)
    widths = np.full(len(x), np.inf)
    for _ in range(_STEPS):
        vertex, gain = _parabola(x[going], y[going])
        calm[going] = np.where(gain <= _GAIN * np.abs(y[going, 1]), calm[going] + 1, 0)
        width = x[going, 2] - x[going, 0]
        open_ = (calm[going] < 2) & (width > _WIDTH * np.abs(x[going, 1]))
        going, vertex, width = going[open_], vertex[open_], width[open_]
        if not going.size:
            break
        at = _next(x[going], vertex, width, slow=width > 0.5 * widths[going])
        widths[going] = width
        _narrow(x, y, going, at, curve(at, going))
    best = np.argmax(y, axis=1)
    return np.stack([y[every, best], x[every, best]], axis=1)


def _parabola(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertex of the parabola through three points, and how far it is above the middle one."""
    left, right = x[:, 1] - x[:, 0], x[:, 2] - x[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        up, down = (y[:, 1] - y[:, 0]) / left, (y[:, 1] - y[:, 2]) / right
        curvature = (up + down) / (left + right)
        slope = (up * right - down * left) / (left + right)
        step = slope / (2.0 * curvature)
        gain = slope * step / 2.0
    flat = ~np.isfinite(step)
    return np.where(flat, x[:, 1], x[:, 1] + step), np.where(flat, 0.0, gain)


def _next(x: np.ndarray, vertex: np.ndarray, width: np.ndarray, *, slow: np.ndarray) -> np.ndarray:
    """Where to look next: at the vertex, or on the wider side of the middle point."""
    middle = x[:, 1]
    wider = np.where(x[:, 2] - middle > middle - x[:, 0], x[:, 2], x[:, 0])
    inside = (vertex > x[:, 0]) & (vertex < x[:, 2])
    near = np.abs(vertex - middle) < _CLOSE * width
    share = np.where(near & inside & ~slow, _INTO, _GOLDEN)
    return np.where(inside & ~near & ~slow, vertex, middle + share * (wider - middle))


def _narrow(
    x: np.ndarray, y: np.ndarray, which: np.ndarray, at: np.ndarray, value: np.ndarray
) -> None:
    """Put a new point of each of these curves into its bracket, in place."""
    for side in (0, 2):
        own = (at < x[which, 1]) if side == 0 else (at > x[which, 1])
        higher = own & (value > y[which, 1])
        far, rows = which[higher], which[own & ~higher]
        x[far, 2 - side], y[far, 2 - side] = x[far, 1], y[far, 1]
        x[far, 1], y[far, 1] = at[higher], value[higher]
        x[rows, side], y[rows, side] = at[own & ~higher], value[own & ~higher]
