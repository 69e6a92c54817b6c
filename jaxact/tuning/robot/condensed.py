"""Responses of open loops without the states of their delay lines, which are powers of 1/z.

States d that only hand on what they get, x_d' = D x_d + E x_s + F u with D nilpotent, are

    x_d = sum_j z^-j D^(j-1) (E x_s + F u)

and leave a system of the others alone, about half as many, whose matrices are polynomials in 1/z:

    (z I - sum_j z^-j A_j) x_s = sum_j z^-j B_j u,    y = sum_j z^-j (Y_j x_s + W_j u),    j >= 0

Nothing is lost by it: it is the elimination that a solution begins with, done once for all z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jaxact.analysis.robot.multiloop import joined, reduced
from jaxact.tuning.robot import cores

# Longer delay lines than this stay states.
_LONGEST = 24
# Numbers that one call works on: bounds the memory of many frequencies at once.
_ENTRIES = 1_000_000


@dataclass(frozen=True)
class Condensed:
    """Of l open loops, the smaller ones filled up; k states, m joints, powers 0 to q.

    Attributes:
        A, B, Y, W: shape (l, q + 1, k, k), (l, q + 1, k, m), (l, q + 1, 2 m, k) and
            (l, q + 1, 2 m, m).
    """

    A: np.ndarray
    B: np.ndarray
    Y: np.ndarray
    W: np.ndarray

    @property
    def _all(self) -> tuple[np.ndarray, ...]:
        return self.A, self.B, self.Y, self.W

    @cached_property
    def _used(self) -> list[np.ndarray]:
        """Of each, the powers but 0 that are there."""
        return [np.flatnonzero(array[:, 1:].any(axis=(0, 2, 3))) + 1 for array in self._all]

    def take(self, index: np.ndarray) -> Condensed:
        """Some of the loops, by their numbers."""
        return Condensed(*(array[index] for array in self._all))

    def response(self, index: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """G of loops at w T = `angle` [rad], shape (j,) each: shape (j, m, 2, m), complex."""
        count, size = self.A.shape[1:3]
        joints = self.B.shape[-1]
        step = max(1, _ENTRIES // max(size, joints) ** 2)

        def part(first: int) -> np.ndarray:
            own, z = index[first : first + step], np.exp(1j * angle[first : first + step])
            late = (z[:, None] ** -np.arange(float(count)))[:, :, None, None]
            both = zip(self._all, self._used, strict=True)
            A, B, Y, W = (_summed(late, array, used, own) for array, used in both)
            states = np.linalg.solve(z[:, None, None] * np.eye(size) - A, B)
            return (Y @ states + W).reshape(len(own), joints, 2, joints)

        return np.concatenate(cores.each(part, range(0, len(index), step)))


def condensed(A: np.ndarray, B: np.ndarray, seen: np.ndarray) -> Condensed:
    """Those of l loops, shape (l, n, n), (l, n, m), (l, m, 2, n)."""
    rows = seen.reshape(len(seen), -1, seen.shape[-1])
    return together([_of_one(*matrices) for matrices in zip(A, B, rows, strict=True)])


def together(parts: Sequence[Condensed]) -> Condensed:
    """Those of several, the smaller ones filled up."""
    count, size = (max(part.A.shape[axis] for part in parts) for axis in (1, 2))

    def filled(array: np.ndarray, *ends: int) -> np.ndarray:
        more = [(0, end - own) for own, end in zip(array.shape[1:], ends, strict=True)]
        return np.pad(array, [(0, 0), *more])

    rows, joints = parts[0].W.shape[2:]
    return Condensed(
        np.concatenate([filled(part.A, count, size, size) for part in parts]),
        np.concatenate([filled(part.B, count, size, joints) for part in parts]),
        np.concatenate([filled(part.Y, count, rows, size) for part in parts]),
        np.concatenate([filled(part.W, count, rows, joints) for part in parts]),
    )


def _summed(late: np.ndarray, array: np.ndarray, used: np.ndarray, own: np.ndarray) -> np.ndarray:
    """sum_j z^-j of some loops' matrices, of the powers j that are there; shape (j, ...)."""
    total = array[own, 0]
    for power in used:
        total = total + late[:, power] * array[own, power]
    return total


def _of_one(A: np.ndarray, B: np.ndarray, Y: np.ndarray) -> Condensed:
    A, B, Y = reduced((A, B, Y), joined((A, B, Y)))
    held = _handing_on(A)
    kept = np.setdiff1d(np.arange(len(A)), held)
    D, E, F = A[np.ix_(held, held)], A[np.ix_(held, kept)], B[held]
    out, seen = A[np.ix_(kept, held)], Y[:, held]
    found = [(A[np.ix_(kept, kept)], B[kept], Y[:, kept], np.zeros((len(Y), B.shape[1])))]
    while E.any() or F.any():
        found.append((out @ E, out @ F, seen @ E, seen @ F))
        E, F = D @ E, D @ F
    return Condensed(*(np.stack(arrays)[None] for arrays in zip(*found, strict=True)))


def _handing_on(A: np.ndarray) -> np.ndarray:
    """States that do not depend on themselves, not by others of their kind either."""
    left = np.flatnonzero(np.diag(A) == 0.0)
    found: list[np.ndarray] = []
    while len(left) and len(found) < _LONGEST:
        first = ~(A[np.ix_(left, left)] != 0.0).any(axis=1)
        if not first.any():
            break
        found.append(left[first])
        left = left[~first]
    return np.sort(np.concatenate(found)) if found else np.zeros(0, int)
