"""Signals that do not move: axes are never stretched until rounding looks like a motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

# Of a step, what can be seen of it: axes show at least this share [-].
_SHARE = 1e-3
# Without a step, what counts as standing still: 16 bits of a turn; a micrometre.
_STILL = {"rad": 1e-4, "m": 1e-6}
# Counts of an encoder that are a motion to be looked at.
_COUNTS = 20.0
# Steps below this are those of a posture that is its own setpoint, known to rounding.
_NO_STEP = {"rad": 1e-6, "m": 1e-9}
# Forces below the first are none, and get axes of the second [N or N m].
_NO_FORCE, _WITHOUT_FORCE = 1e-9, 0.1


@dataclass(frozen=True)
class Spans:
    """What the axes of a motion show at least.

    Attributes:
        position: [m or rad].
        velocity: [m/s or rad/s].
        force: [N or N m].
    """

    position: float
    velocity: float
    force: float


def spans(
    time: np.ndarray,
    positions: Sequence[np.ndarray],
    setpoint: np.ndarray,
    forces: Sequence[np.ndarray],
    *,
    unit: str,
    resolution: float = 0.0,
) -> Spans:
    """The least that the axes show of some motions that begin at the same place.

    Args:
        time: [s], shape (steps,).
        positions, setpoint: [m or rad], shape (steps,) each.
        forces: that act or are commanded [N or N m], shape (steps,) each.
        unit: of the position, "m" or "rad".
        resolution: of its encoder, 0 where it is not known [m or rad].
    """
    start = float(positions[0][0])
    step = float(np.max(np.abs(setpoint - start)))
    if step > max(_NO_STEP[unit], 1e-6 * abs(start)):
        position = _SHARE * step
    else:
        position = _STILL[unit]
        if resolution > 0.0:
            position = min(position, _COUNTS * resolution)
    pushed = max(float(np.max(np.abs(one), initial=0.0, where=np.isfinite(one))) for one in forces)
    return Spans(
        position=position,
        velocity=10.0 * position / max(float(time[-1] - time[0]), 1.0),
        force=_SHARE * pushed if pushed > _NO_FORCE else _WITHOUT_FORCE,
    )


def widen(axes: Axes, span: float) -> None:
    """Let the y axis show at least this span, what is drawn in its middle."""
    low, high = axes.get_ylim()
    if high - low < span:
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - 0.5 * span, middle + 0.5 * span)


def note(position: np.ndarray, span: float, unit: str) -> str:
    """`at rest: moves by 3.2e-07 rad` where next to nothing can be seen of a motion, else ""."""
    extent = float(np.ptp(position))
    if extent >= 0.01 * span:
        return ""
    return f"at rest: moves by {extent:.2g} {unit}" if extent > 0.0 else "at rest"
