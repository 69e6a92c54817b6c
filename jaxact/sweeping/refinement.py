"""Which points of a fine grid are worth computing: those around a border, found by halving cells.

Cells whose corners disagree are halved along every axis until they are fine enough; so is a cell
whose neighbour's finer points on their common side disagree with it, whichever was there first.
Nothing is simulated here: `new points -> what is there` goes back and forth, round by round.

Points are whole numbers on the finest lattice; a point of case c with places p is the number
c * (points of the lattice) + (place in C order).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

# Which points are asked for. Rounds are known by their number, so that a sweep that was begun by
# another rule cannot be continued.
RULE = 2


@dataclass(frozen=True)
class Lattice:
    """A coarse grid, and how often its cells are halved.

    Attributes:
        cases: number of grids, refined each by itself.
        cells: coarse cells along each axis.
        halvings: of the cells along each axis.
    """

    cases: int
    cells: tuple[int, ...]
    halvings: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Points of the finest lattice along each axis."""
        return tuple(n * 2**h + 1 for n, h in zip(self.cells, self.halvings, strict=True))

    @property
    def levels(self) -> int:
        """Halvings until all axes are fine enough."""
        return max(self.halvings)

    @property
    def size(self) -> int:
        """Points of the finest lattice of one case."""
        return int(np.prod(self.shape, dtype=np.int64))

    def step(self, level: int) -> np.ndarray:
        """Size of a cell of a level, in finest steps along each axis, shape (axes,)."""
        return np.array([2 ** max(h - level, 0) for h in self.halvings], np.int64)

    def places(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Case of each point, shape (n,), and its places on the axes, shape (n, axes)."""
        case, flat = np.divmod(points, self.size)
        return case, np.stack(np.unravel_index(flat, self.shape), axis=1)

    def points(self, case: np.ndarray, places: np.ndarray) -> np.ndarray:
        """The number of each point, shape (n,)."""
        flat = np.ravel_multi_index(tuple(np.moveaxis(places, -1, 0)), self.shape)
        return np.asarray(case * self.size + flat)

    def coarse(self) -> np.ndarray:
        """All points of the coarse grids."""
        step = self.step(0)
        axes = [np.arange(0, n, s) for n, s in zip(self.shape, step, strict=True)]
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(self.cells))
        return np.concatenate(
            [self.points(np.full(len(places), c), places) for c in range(self.cases)]
        )


class Refinement:
    """Points known so far, and the cells that hold them.

    Each `tell` takes what is at the points last asked for; `ask` gives those to compute next, none
    when the border is fine enough. A cell that stays coarse agrees with every point known on it.
    """

    def __init__(self, lattice: Lattice) -> None:
        self._lattice = lattice
        self._points = np.zeros(0, np.int64)
        self._codes = np.zeros(0, np.int64)
        self._asked = lattice.coarse()
        step = lattice.step(0)
        # lowest corner of every cell without disagreement, by level, and what is at its corners
        self._calm: list[tuple[np.ndarray, np.ndarray]] = [
            (np.zeros(0, np.int64), np.zeros(0, np.int64)) for _ in range(lattice.levels + 1)
        ]
        _, places = lattice.places(self._asked)
        inside = np.all(places + step < np.array(lattice.shape), axis=1)
        self._fresh = {0: self._asked[inside]}

    def ask(self) -> np.ndarray:
        """The points to compute next, rising; empty when there are none."""
        return self._asked

    def tell(self, codes: np.ndarray) -> None:
        """What is at the points asked for: equal numbers agree; shape of `ask()`."""
        asked = self._asked
        points = np.concatenate([self._points, asked])
        order = np.argsort(points)
        self._points, self._codes = points[order], np.concatenate([self._codes, codes])[order]
        halved = self._disturbed(asked, codes)
        fresh, wanted = self._settle(halved)
        while fresh and not wanted.size:
            self._fresh = fresh
            fresh, wanted = self._settle({})
        self._fresh, self._asked = fresh, wanted

    def _at(self, points: np.ndarray) -> np.ndarray:
        return self._codes[np.searchsorted(self._points, points)]

    def _known(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which points are known, and what is at them where they are; shape of the points."""
        at = np.minimum(np.searchsorted(self._points, points), self._points.size - 1)
        return self._points[at] == points, self._codes[at]

    def _corners(self, cells: np.ndarray, level: int) -> np.ndarray:
        """The corners of cells, shape (cells, 2^axes)."""
        case, low = self._lattice.places(cells)
        step = self._lattice.step(level)
        offsets = [np.array(o) * step for o in itertools.product((0, 1), repeat=len(step))]
        return np.stack([self._lattice.points(case, low + o) for o in offsets], axis=1)

    def _disturbed(self, points: np.ndarray, codes: np.ndarray) -> dict[int, np.ndarray]:
        """Calm cells, by level, that hold a new point which disagrees with them; taken out."""
        found = {}
        case, places = self._lattice.places(points)
        axes = places.shape[1]
        for level, (cells, inside) in enumerate(self._calm):
            if level == self._lattice.levels or not cells.size:
                continue
            step = self._lattice.step(level)
            hit = np.zeros(cells.size, bool)
            for back in itertools.product((0, 1), repeat=axes):
                low = (places - np.array(back)) // step * step
                valid = np.all((low >= 0) & (low + step < np.array(self._lattice.shape)), axis=1)
                keys = self._lattice.points(case[valid], low[valid])
                at = np.minimum(np.searchsorted(cells, keys), cells.size - 1)
                wrong = (cells[at] == keys) & (inside[at] != codes[valid])
                hit[at[wrong]] = True
            found[level] = cells[hit]
            self._calm[level] = cells[~hit], inside[~hit]
        return found

    def _settle(self, halved: dict[int, np.ndarray]) -> tuple[dict[int, np.ndarray], np.ndarray]:
        """Sort the fresh cells into calm ones and ones to halve, and halve them.

        Returns:
            The halves, by level, and those of their corners that are not known yet.
        """
        split = dict(halved)
        for level, cells in self._fresh.items():
            codes = self._at(self._corners(cells, level))
            calm = np.all(codes == codes[:, :1], axis=1)
            calm[calm] = ~self._crossed(level, cells[calm], codes[calm, 0])
            self._add_calm(level, cells[calm], codes[calm, 0])
            if level < self._lattice.levels:
                split[level] = np.concatenate([split.get(level, cells[:0]), cells[~calm]])
        fresh = {
            level + 1: self._halves(cells, level) for level, cells in split.items() if cells.size
        }
        corners = [self._corners(cells, level).ravel() for level, cells in fresh.items()]
        wanted = np.unique(np.concatenate(corners)) if corners else np.zeros(0, np.int64)
        return fresh, wanted[~self._known(wanted)[0]]

    def _crossed(self, level: int, cells: np.ndarray, inside: np.ndarray) -> np.ndarray:
        """Which cells have a known point on their sides that disagrees with their corners.

        Points of a level are on a side only where those of the level before are, so that only the
        halves of cells with such points are looked at further.

        Args:
            level: of the cells.
            cells: their lowest corners, shape (n,).
            inside: what is at their corners, shape (n,).

        Returns:
            Shape (n,).
        """
        crossed = np.zeros(cells.size, bool)
        owner = np.arange(cells.size)
        while level < self._lattice.levels and cells.size:
            points = self._between(cells, level)
            known, codes = self._known(points)
            wrong = np.any(known & (codes != inside[owner, None]), axis=1)
            crossed[owner[wrong]] = True
            there = np.any(known, axis=1)
            halves = self._halves(cells[there], level)
            owner = np.tile(owner[there], halves.size // max(int(np.sum(there)), 1))
            cells, level = halves, level + 1
        return crossed

    def _between(self, cells: np.ndarray, level: int) -> np.ndarray:
        """Corners that the halves of cells have and they themselves have not, shape (cells, n)."""
        case, low = self._lattice.places(cells)
        step, finer = self._lattice.step(level), self._lattice.step(level + 1)
        ranges = [range(0, int(s) + 1, int(f)) for s, f in zip(step, finer, strict=True)]
        offsets = [np.array(o) for o in itertools.product(*ranges) if np.any(np.array(o) % step)]
        return np.stack([self._lattice.points(case, low + o) for o in offsets], axis=1)

    def _add_calm(self, level: int, cells: np.ndarray, codes: np.ndarray) -> None:
        known, inside = self._calm[level]
        cells, codes = np.concatenate([known, cells]), np.concatenate([inside, codes])
        order = np.argsort(cells)
        self._calm[level] = cells[order], codes[order]

    def _halves(self, cells: np.ndarray, level: int) -> np.ndarray:
        """The cells of the next level that these are made of."""
        case, low = self._lattice.places(cells)
        step, finer = self._lattice.step(level), self._lattice.step(level + 1)
        ranges = [range(int(s // f)) for s, f in zip(step, finer, strict=True)]
        offsets = [np.array(o) * finer for o in itertools.product(*ranges)]
        return np.concatenate([self._lattice.points(case, low + o) for o in offsets])
