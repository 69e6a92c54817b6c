"""What the joints of a robot do in a rollout, thinned out to what a picture shows, and as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxact.simulation.thinning import thinned
from jaxact.simulation.trajectory import Trajectory

_MOST_POINTS = 240
_DIGITS = 6
_SIGNALS = ("time", "setpoint", "position", "force")
_HEAD = ("gains", "joint", *_SIGNALS)


@dataclass(frozen=True)
class Motion:
    """A joint over time, at times of its own: position and force have their extremes.

    Attributes:
        time: [s], shape (points,).
        setpoint, position: [rad or m], shape (points,).
        force: on the joint [N m or N], shape (points,).
    """

    time: np.ndarray
    setpoint: np.ndarray
    position: np.ndarray
    force: np.ndarray


Sides = Mapping[str, Mapping[str, Motion]]
"""The motions by the name of the gains, "before" and "tuned", and by the name of the joint."""


def motions(trajectory: Trajectory, order: Iterable[int]) -> tuple[Motion, ...]:
    """The joints of a rollout, in an order; until one of their numbers is none."""
    found = []
    for joint in order:
        position, force = (
            np.asarray(signal)[:, joint] for signal in (trajectory.position, trajectory.force)
        )
        broken = ~(np.isfinite(position) & np.isfinite(force))
        end = int(np.argmax(broken)) if broken.any() else len(position)
        kept = thinned(position[:end], force[:end], _MOST_POINTS) if end else np.arange(0)
        setpoint = np.asarray(trajectory.setpoint)[kept, joint]
        time = np.asarray(trajectory.time)[kept]
        found.append(Motion(time, setpoint, position[kept], force[kept]))
    return tuple(found)


def csv_text(sides: Sides) -> str:
    """A header, then a line for each point."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_HEAD)
    for side, joints in sides.items():
        for joint, motion in joints.items():
            columns = [getattr(motion, name).tolist() for name in _SIGNALS]
            for row in zip(*columns, strict=True):
                writer.writerow([side, joint, *(f"{value:.{_DIGITS}g}" for value in row)])
    return text.getvalue()


def read(text: str) -> dict[str, dict[str, Motion]]:
    """The same from such a text.

    Raises:
        ValueError: it is another.
    """
    head, *rows = csv.reader(text.splitlines())
    if tuple(head) != _HEAD:
        raise ValueError("has other columns")
    found: dict[str, dict[str, list[Sequence[str]]]] = {}
    for side, joint, *row in rows:
        found.setdefault(side, {}).setdefault(joint, []).append(row)
    return {
        side: {name: Motion(*np.array(own, float).T) for name, own in joints.items()}
        for side, joints in found.items()
    }
