"""Setpoints that move: sine, chirp, or positions from a file, sampled at the control ticks.

sine   sin(2 pi f t)

chirp  sin(2 pi (f0 t + (f1 - f0) t^2 / (2 D))),     D the duration, linear from f0 to f1
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxact.errors import UserError, nearest
from jaxact.loops.robots import Scene
from jaxact.loops.specification import Motion


def sampled(
    motion: Motion | None, scene: Scene | None, period: float, ticks: int
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """The motion of the setpoint at every control tick.

    Args:
        motion: as specified; None is a step at time 0.
        scene: the robot, whose joints a file names; None for a single joint.
        period: control period [s].
        ticks: number of control periods.

    Returns:
        The share of the amplitude, shape (ticks,), or None; and positions relative to the posture
        [m or rad], shape (ticks, joints), or None.

    Raises:
        UserError: a file that cannot be used.
    """
    if motion is None or motion.kind == "step":
        return None, None
    time = period * np.arange(ticks)
    if motion.kind == "file":
        return None, _from_file(motion, scene, time)
    first = motion.frequency or 1.0
    slope = 0.0
    if motion.kind == "chirp":
        slope = ((motion.end_frequency or first) - first) / (ticks * period)
    phase = 2.0 * np.pi * (first * time + 0.5 * slope * time * time)
    return np.sin(phase), None


def _from_file(motion: Motion, scene: Scene | None, time: np.ndarray) -> np.ndarray:
    """Positions from a file, those of joints that it does not name at rest."""
    if motion.file is None:
        raise UserError('motion.file is missing; kind = "file" reads a CSV or NPZ file')
    columns = _columns(motion.file)
    given = columns.pop("time", None)
    if given is None:
        raise UserError(f"{motion.file}: has no column time [s]; {_listed(columns)}")
    if given.ndim != 1 or given.size < 2 or np.any(np.diff(given) <= 0.0):
        raise UserError(f"{motion.file}: time must rise from row to row")
    labels = ("joint",) if scene is None else scene.labels
    rest = np.zeros(1) if scene is None else scene.positions
    rows = np.zeros((time.size, len(labels)))
    for name, values in columns.items():
        if name not in labels:
            raise UserError(f"{motion.file}: column {name!r}: {nearest(name, labels)}")
        if values.shape != given.shape or not np.isfinite(values).all():
            raise UserError(f"{motion.file}: column {name!r} must hold one number for each time")
        place = labels.index(name)
        rows[:, place] = np.interp(time, given, values) - rest[place]
    return rows


def _listed(columns: dict[str, np.ndarray]) -> str:
    return f"it has {', '.join(columns)}" if columns else "it is empty"


def _columns(path: Path) -> dict[str, np.ndarray]:
    """Columns of a CSV file (names in the first line, units in brackets dropped) or NPZ file."""
    try:
        if path.suffix.lower() == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                return {name: np.asarray(arrays[name], float) for name in arrays.files}
        with path.open(encoding="utf-8-sig") as file:
            names = [name.partition("[")[0].strip() for name in file.readline().split(",")]
            table = np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())[:120]
        raise UserError(f"{path}: cannot be read as CSV or NPZ ({reason})") from None
    if table.shape[1] != len(names):
        raise UserError(f"{path}: {len(names)} names, but {table.shape[1]} columns of numbers")
    return dict(zip(names, table.T, strict=True))
