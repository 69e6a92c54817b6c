"""The open loops of a robot's situations with members of its box, together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxact.analysis.robot.multiloop import joined
from jaxact.tuning.box import Points
from jaxact.tuning.robot.condensed import Condensed, condensed
from jaxact.tuning.robot.condensed import together as joined_condensed
from jaxact.tuning.robot.loops import Situation


@dataclass(frozen=True)
class OpenLoops:
    """Open loops of a robot, l of them, with n states (the smaller ones filled up) and m joints.

    Attributes:
        names: what they are called: situation and member.
        situation: number of the situation of each, shape (l,).
        fraction: of the ranges of the box, shape (l, ranges).
        A, B: shape (l, n, n), (l, n, m).
        seen: positions and velocities as the controllers measure them, shape (l, m, 2, n).
        period: T [s], shape (l,).
        condensed: the same without delay lines, for responses.
    """

    names: tuple[str, ...]
    situation: np.ndarray
    fraction: np.ndarray
    A: np.ndarray
    B: np.ndarray
    seen: np.ndarray
    period: np.ndarray
    condensed: Condensed

    def __len__(self) -> int:
        """Number of loops."""
        return len(self.names)

    def name(self, index: int) -> str:
        """What a loop is called."""
        return self.names[index]

    def take(self, index: np.ndarray) -> OpenLoops:
        """Some of the loops, by their numbers."""
        return OpenLoops(
            tuple(self.names[int(i)] for i in index), self.situation[index], self.fraction[index],
            self.A[index], self.B[index], self.seen[index], self.period[index],
            self.condensed.take(index),
        )  # fmt: skip

    def closed(self, index: int, kp: np.ndarray, kd: np.ndarray) -> tuple[np.ndarray, ...]:
        """M, N, C of one loop closed with gains of shape (m,), as in `analysis.robot.multiloop`."""
        C = -(kp[:, None] * self.seen[index, :, 0] + kd[:, None] * self.seen[index, :, 1])
        return self.A[index] + self.B[index] @ C, self.B[index], C

    def response(self, index: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """G of loops at w T = `angle` [rad], shape (k,) each: shape (k, m, 2, m), complex."""
        return self.condensed.response(index, angle)


def open_loops(situations: Sequence[Situation], members: Points) -> OpenLoops:
    """The loops of every situation with every member."""
    found, names, number = [], [], []
    for place, one in enumerate(situations):
        rows = [one.opened(row)[:3] for row in one.values(members.fraction)]
        # What gains of one and the same sign leave unmoved in one loop, they do in all alike.
        kept = np.unique(np.concatenate([_kept(*row) for row in rows]))
        found += [(A[np.ix_(kept, kept)], B[kept], Y[..., kept]) for A, B, Y in rows]
        names += [_name(one.name, member, len(situations)) for member in members.names]
        number += [place] * len(members)
    size = max(len(A) for A, _, _ in found)
    filled = [_filled(*row, size) for row in found]
    A, B, seen = (np.stack(column) for column in zip(*filled, strict=True))
    return OpenLoops(
        names=tuple(names),
        situation=np.array(number),
        fraction=np.tile(members.fraction, (len(situations), 1)),
        A=A,
        B=B,
        seen=seen,
        period=np.array([situations[place].period for place in number]),
        condensed=condensed(A, B, seen),
    )


def together(*parts: OpenLoops) -> OpenLoops:
    """The loops of several."""
    size = max(part.A.shape[-1] for part in parts)
    filled = [
        _filled(*row, size) for part in parts for row in zip(part.A, part.B, part.seen, strict=True)
    ]
    A, B, seen = (np.stack(column) for column in zip(*filled, strict=True))
    number, fraction, period = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("situation", "fraction", "period")
    )
    names = tuple(name for part in parts for name in part.names)
    short = joined_condensed([part.condensed for part in parts])
    return OpenLoops(names, number, fraction, A, B, seen, period, short)


def _kept(A: np.ndarray, B: np.ndarray, Y: np.ndarray) -> np.ndarray:
    C = Y.sum(axis=1)
    return joined((A + B @ C, B, C))


def _filled(A: np.ndarray, B: np.ndarray, Y: np.ndarray, size: int) -> tuple[np.ndarray, ...]:
    """The same with states that do nothing, up to a number of them."""
    more = size - len(A)
    return (
        np.pad(A, ((0, more), (0, more))),
        np.pad(B, ((0, more), (0, 0))),
        np.pad(Y, ((0, 0), (0, 0), (0, more))),
    )


def _name(situation: str, member: str, situations: int) -> str:
    return f"{situation}, {member}" if situations > 1 else member
