"""A front of stiffness against robustness as JSON, table and CSV, of a joint or of a robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.parameters import KD, KP

if TYPE_CHECKING:
    from jaxact.tuning.result import Tuned


@dataclass(frozen=True)
class Front:
    """Points of a front, p of them, of g groups of joints that share their gains.

    Attributes:
        groups: their names; one without a name of a single joint.
        units: of kp, of kd and of the objective.
        objective: its name.
        peaks: largest Ms and Mt allowed [-], rising, shape (p,).
        kp, kd: of the groups, shape (p, g).
        values: of the objective, shape (p,).
        certified: whether everything asked for holds, shape (p,).
        verdicts: a sentence each.
    """

    groups: tuple[str, ...]
    units: tuple[str, str, str]
    objective: str
    peaks: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    values: np.ndarray
    certified: np.ndarray
    verdicts: tuple[str, ...]

    def __len__(self) -> int:
        """Number of points."""
        return len(self.peaks)

    @property
    def columns(self) -> list[tuple[str, np.ndarray]]:
        """The gains by name, shape (p,) each: kp of all groups, then kd."""
        return [
            (f"{kind} {group}".strip(), gains)
            for kind, rows in ((KP, self.kp), (KD, self.kd))
            for group, gains in zip(self.groups, rows.T, strict=True)
        ]


def front(points: Sequence[Tuned]) -> Front:
    """The front of some results, one at least."""
    first, robot = points[0], points[0].robot
    groups: tuple[str, ...] = ("",)
    own = np.zeros(1, int)
    if robot is not None:
        groups, own = robot.case.groups.names, robot.case.groups.first
    kp, kd = (
        np.array([np.atleast_1d(getattr(point, name))[own] for point in points])
        for name in (KP, KD)
    )
    return Front(
        groups, first.units, first.goal.objective, np.array([p.goal.max_peak for p in points]),
        kp, kd, np.array([p.value for p in points]), np.array([p.certified for p in points]),
        tuple(p.verdict for p in points),
    )  # fmt: skip


def report(front: Front) -> list[dict[str, Any]]:
    """The points as plain values, for JSON."""
    rows = []
    for i in range(len(front)):
        kp, kd = front.kp[i].tolist(), front.kd[i].tolist()
        gains: dict[str, Any] = {KP: kp[0], KD: kd[0]}
        if front.groups != ("",):
            each = zip(front.groups, kp, kd, strict=True)
            gains = {"groups": [{"name": name, KP: p, KD: d} for name, p, d in each]}
        value = float(front.values[i])
        rows.append(
            {"max_peak": float(front.peaks[i]), **gains,
             "objective": value if np.isfinite(value) else None,
             "certified": bool(front.certified[i])}
        )  # fmt: skip
    return rows


def table(front: Front) -> str:
    """A line for each point."""
    kp, kd, unit = front.units
    of_columns = [f"{name} [{kp if name.startswith(KP) else kd}]" for name, _ in front.columns]
    width = max(12, *map(len, of_columns))
    head = f"{'max peak':>9} " + " ".join(f"{name:>{width}}" for name in of_columns)
    rows = [f"{head} {'objective [' + unit + ']':>18}  certified"]
    for i in range(len(front)):
        gains = " ".join(f"{column[i]:{width}.6g}" for _, column in front.columns)
        sure = "yes" if front.certified[i] else "no: " + front.verdicts[i]
        rows.append(f"{front.peaks[i]:9.4f} {gains} {front.values[i]:18.6g}  {sure}")
    return "\n".join(rows)


def csv_text(front: Front) -> str:
    """A header, then one line a point."""
    names = [name.replace(" ", "_") for name, _ in front.columns]
    rows = [",".join(["max_peak", *names, "objective", "certified"])]
    for i in range(len(front)):
        numbers = [front.peaks[i], *(column[i] for _, column in front.columns), front.values[i]]
        cells = [repr(float(number)) for number in numbers]
        rows.append(",".join([*cells, str(bool(front.certified[i])).lower()]))
    return "\n".join(rows) + "\n"
