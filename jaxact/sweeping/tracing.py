"""The line between where something holds and where it does not, in a plane, refined by bisection.

A grid finds the squares that the line passes; where it passes their sides is bisected to a
millionth of a side, and the points are joined through the squares (marching squares). Features
narrower than a square can be missed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Holds = Callable[[np.ndarray, np.ndarray], np.ndarray]
Curve = tuple[np.ndarray, np.ndarray]

_BISECTIONS = 20


def trace(holds: Holds, x: np.ndarray, y: np.ndarray) -> list[Curve]:
    """All parts of the line inside a window, each as its points (x, y) in order.

    Args:
        holds: whether it holds at points, shape (n,) each.
        x, y: ascending coordinates of the grid, shape (columns,) and (rows,).
    """
    columns, rows = np.meshgrid(x, y)
    mask = holds(columns.ravel(), rows.ravel()).reshape(columns.shape)
    sides = np.concatenate([_changes(mask, 0), _changes(mask, 1)])
    if not len(sides):
        return []
    points = _refined(holds, mask, x, y, sides)
    places = {tuple(side): number for number, side in enumerate(sides.tolist())}
    return [
        (points[0][chain], points[1][chain]) for chain in _chains(_links(holds, mask, x, y, places))
    ]


def _changes(mask: np.ndarray, along: int) -> np.ndarray:
    """Sides (row, column, along) on which it changes; along 1 for rows' sides, 0 for columns'."""
    changed = np.argwhere(np.diff(mask.astype(int), axis=along) != 0)
    return np.column_stack([changed, np.full(len(changed), along)])


def _refined(
    holds: Holds, mask: np.ndarray, x: np.ndarray, y: np.ndarray, sides: np.ndarray
) -> Curve:
    """Where the line passes each side."""
    row, column, along = sides.T
    x_0, y_0 = x[column], y[row]
    x_1, y_1 = x[column + (along == 1)], y[row + (along == 0)]
    start = mask[row, column]
    low, high = np.zeros(len(sides)), np.ones(len(sides))
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        same = holds(x_0 + middle * (x_1 - x_0), y_0 + middle * (y_1 - y_0)) == start
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    share = 0.5 * (low + high)
    return x_0 + share * (x_1 - x_0), y_0 + share * (y_1 - y_0)


def _links(
    holds: Holds,
    mask: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    places: dict[tuple[int, ...], int],
) -> list[tuple[int, int]]:
    """Pairs of sides, by their numbers, that the line joins through a square."""
    corners = mask[:-1, :-1], mask[:-1, 1:], mask[1:, :-1], mask[1:, 1:]
    count = sum(corner.astype(int) for corner in corners)
    squares = np.argwhere((count > 0) & (count < 4))
    middle = holds(
        0.5 * (x[squares[:, 1]] + x[squares[:, 1] + 1]),
        0.5 * (y[squares[:, 0]] + y[squares[:, 0] + 1]),
    )
    links = []
    for (j, i), inside in zip(squares.tolist(), middle, strict=True):
        bottom, top = places.get((j, i, 1)), places.get((j + 1, i, 1))
        left, right = places.get((j, i, 0)), places.get((j, i + 1, 0))
        passed = [side for side in (bottom, left, top, right) if side is not None]
        if len(passed) == 2:
            links.append((passed[0], passed[1]))
        else:
            # A saddle: what the middle is like is connected across it.
            apart = bool(mask[j, i]) == bool(inside)
            pairs = ((bottom, right), (left, top)) if apart else ((bottom, left), (top, right))
            links += [(a, b) for a, b in pairs if a is not None and b is not None]
    return links


def _chains(links: list[tuple[int, int]]) -> list[list[int]]:
    """Links joined to lines, each the numbers of its points; a closed one ends where it starts."""
    neighbours: dict[int, list[int]] = {}
    for a, b in links:
        neighbours.setdefault(a, []).append(b)
        neighbours.setdefault(b, []).append(a)
    left = {point: list(others) for point, others in neighbours.items()}
    chains = []
    # Open lines from their ends first, closed ones from anywhere.
    for start in sorted(neighbours, key=lambda point: len(neighbours[point])):
        while left[start]:
            chain = [start]
            while left[chain[-1]]:
                here = chain[-1]
                following = left[here].pop()
                left[following].remove(here)
                chain.append(following)
            chains.append(chain)
    return chains
