"""Columns of one row that are not of one instant, found by the command that was made of them.

Where a log has setpoint, position and command, the controller says which of their rows belong
together: ``command[k + c] = kp (setpoint[k] - position[k + p]) - kd velocity[k + v] + offset``
holds for the right p, v and c, and for no others.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from jaxact.identification import inspection
from jaxact.identification.log import LINKS, Log
from jaxact.parameters import SETPOINT

# Rows by which a column is tried to lag or lead, and rows of a log that are looked at for it.
_MOST_ROWS, _LOOKED_AT = 2, 20_000
# So little of the command may be left, and so many times less than with the rows as they are.
_LEFT, _BETTER = 1e-3, 10.0
# Rounding alone leaves about as much; a row's lateness of the position may leave no more than 1e-4.
_NOTHING = 1e-7
# Less than this is suspicious enough to be said.
_PERHAPS_LEFT, _PERHAPS_BETTER = 0.05, 2.0

UNSEEN = (
    "without stated gains nothing shows whether position and command are written at the same"
    " instant; what one is written late by is part of the delay"
)
"""What is so of every log whose gains are not stated: a late position is a little less damping."""


def aligned(log: Log, *, moves: bool = True) -> Log:
    """A log whose columns are of one instant, that of the setpoint, where its command shows it.

    Args:
        log: any.
        moves: its position is looked at, not its force alone.

    Returns:
        The log with what was moved, or cannot be seen, in its notes; the same log where its columns
        agree as they are.
    """
    if "position" not in log or "command" not in log or set(LINKS) & set(log.signals):
        return log
    unseen = (UNSEEN,) if moves and log.gains[0] is None else ()
    if SETPOINT not in log:
        return replace(log, notes=(*log.notes, *unseen))
    moved, certain = _apart(log.part(0, _LOOKED_AT))
    said = [_said(name, rows) for name, rows in moved.items() if rows]
    if certain:
        notes = [f"{each}; it is moved" for each in said]
        log = _moved(log, moved)
    else:
        notes = [f"{each}, it seems; numbers may be wrong by that" for each in said]
    return replace(log, notes=(*log.notes, *notes, *unseen))


def _apart(log: Log) -> tuple[dict[str, int], bool]:
    """Rows by which columns are late, none where they agree, and whether that is certain."""
    here = _unexplained(log, {})
    if here < _NOTHING:
        return {}, False
    columns = ["position", "command", *(["velocity"] if "velocity" in log else [])]
    tried = range(-_MOST_ROWS, _MOST_ROWS + 1)
    left = {
        rows: _unexplained(log, dict(zip(columns, rows, strict=True)))
        for rows in itertools.product(tried, repeat=len(columns))
    }
    least = min(left.values())
    # The fewest rows of the fewest columns that explain it about as well.
    enough = [rows for rows, rest in left.items() if rest < 2.0 * least + 1e-12]
    best = min(enough, key=lambda rows: (np.count_nonzero(rows), np.abs(rows).sum(), left[rows]))
    rest, moved = left[best], dict(zip(columns, best, strict=True))
    if rest < _LEFT and rest * _BETTER < here:
        return moved, True
    perhaps = rest < _PERHAPS_LEFT and rest * _PERHAPS_BETTER < here
    return (moved if perhaps else {}), False


def agree(log: Log) -> bool:
    """Whether the command, under the stated gains, shows the position to be of its own instant."""
    if not {SETPOINT, "position", "command"} <= set(log.signals) or None in log.gains:
        return False
    if UNSEEN in log.notes:  # its gains are those of the command as it is, and agree with anything
        return False
    part = log.part(0, _LOOKED_AT)
    here = _unexplained(part, {})
    return here < _LEFT and all(
        _unexplained(part, {"position": rows}) > _PERHAPS_BETTER * here for rows in (-1, 1)
    )


def _unexplained(log: Log, rows: dict[str, int]) -> float:
    """Share of the command's variance that the stated gains, or else any, do not explain [-]."""
    kp, kd = log.gains
    if kp is not None and kd is not None:
        return 1.0 - inspection.explained_by(_moved(log, rows), kp, kd)
    controller = inspection.recomputed(_moved(log, rows))
    return 1.0 if controller is None or controller.kp <= 0.0 else 1.0 - controller.explained


def _moved(log: Log, rows: dict[str, int]) -> Log:
    """A log with columns taken from so many rows later; what has no such rows is cut off."""
    first, end = max(0, *(-lag for lag in (*rows.values(), 0))), len(log)
    end -= max(0, *(*rows.values(), 0))
    signals = {
        name: values[first + rows.get(name, 0) : end + rows.get(name, 0)]
        for name, values in log.signals.items()
    }
    return replace(log, time=log.time[first:end], signals=signals, row=log.row + first)


def _said(name: str, rows: int) -> str:
    """What was found of a column, in words."""
    many = f"{abs(rows)} row{'' if abs(rows) == 1 else 's'}"
    return f"{name} is logged {many} {'later' if rows > 0 else 'earlier'} than the setpoint"
