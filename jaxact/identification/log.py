"""One recording of one joint: time stamps as they are, and the signals that were written down."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxact.errors import UserError
from jaxact.parameters import FEEDFORWARD, SETPOINT

FEWEST_ROWS = 200
"""A log with fewer rows says too little of a drive."""

# A drive is not seen in rows that are further apart, nor are loops so fast [s].
_LONGEST_PERIOD, _SHORTEST_PERIOD = 0.25, 1e-5
# Where so many periods and more lie between two rows, what happened then is not known.
_GAP = 3.5
# From so many periods on a row is missing, where the rows about it do not make up for the time.
_LONG_STEP, _ABOUT, _NOT_MADE_UP = 1.7, 5, 0.85
# Where rows are missing at a larger share of them, numbers are off by more than their intervals.
_FEW_MISSING = 0.003
# A signal that is measured once in several rows does so regularly, and not once in more than these.
_FEWEST_CHANGES, _MOST_ROWS_HELD = 20, 20

SIGNALS: dict[str, str] = {
    SETPOINT: "position that the joint was told to take [m or rad]",
    "position": "measured position [m or rad]",
    "velocity": "measured velocity [m/s or rad/s]",
    "command": "force that the drive was told to give [N or N m]",
    "force": "measured force [N or N m]",
    FEEDFORWARD: "force added to the command beside the controller's [N or N m]",
    "supply": "supply voltage [V]",
    "powered": "1 where the drive was switched on, 0 where not",
}
"""What a column can stand for, by name."""

LINKS = ("link_inertia", "link_force", "link_stiffness")
"""Signals of a robot's joint that its model computes, see `jaxact.identification.joint_motion`."""


@dataclass(frozen=True, eq=False)
class Log:
    """A recording of one joint.

    Attributes:
        name: of the file, as messages have it.
        time: stamps of the rows [s], shape (rows,), rising.
        signals: by their names in `SIGNALS`, each of shape (rows,).
        joint: its name, "" where there is one.
        unit: "rad" or "m".
        stamp: what of a control tick a row's time is, its "start" or its "end".
        gains: (kp, kd) of the controller, None where unknown; [N/m, N s/m] or [N m/rad, N m s/rad].
        difference_ticks: rows over which the controller differenced its position; 0 for a measured
            velocity.
        details: what else is known of the recording by name, such as masses and lengths.
        row: of the file in which its first row stands, whose head is row 1.
        notes: what was done to it, in words.
    """

    name: str
    time: np.ndarray
    signals: Mapping[str, np.ndarray]
    joint: str = ""
    unit: str = "rad"
    stamp: str = "start"
    gains: tuple[float | None, float | None] = (None, None)
    difference_ticks: int = 0
    details: Mapping[str, float] = field(default_factory=dict)
    row: int = 2
    notes: tuple[str, ...] = ()

    @property
    def period(self) -> float:
        """Median time between two rows [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def duration(self) -> float:
        """From the first row to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def title(self) -> str:
        """The file, and the joint where it has a name."""
        return f"{self.name}, {self.joint}" if self.joint else self.name

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.time)

    def __getitem__(self, name: str) -> np.ndarray:
        """One of the signals, shape (rows,)."""
        return self.signals[name]

    def __contains__(self, name: str) -> bool:
        """Whether the signal was recorded."""
        return name in self.signals

    def part(self, first: int, last: int) -> Log:
        """Rows `first` to `last` (exclusive) of this log."""
        signals = {name: values[first:last] for name, values in self.signals.items()}
        row = self.row + first
        return replace(self, time=self.time[first:last], signals=signals, row=row)


def filled(values: np.ndarray, *, rising: bool = False) -> np.ndarray:
    """A signal continued to one of few lengths, as a program is compiled for each.

    Args:
        values: shape (rows,).
        rising: times, which go on rising; others stay at the last value.

    Returns:
        At most an eighth longer, shape (rows or more,).
    """
    rows = len(values)
    whole = 2 ** max(rows.bit_length() - 4, 0)
    more = -rows % whole
    step = (values[-1] - values[0]) / max(rows - 1, 1) if rising else 0.0
    return np.append(values, values[-1] + step * np.arange(1, more + 1))


def check(log: Log) -> None:
    """That a log can be used at all.

    Raises:
        UserError: too few rows, values that are not numbers, time that does not rise, a signal that
            is zero or constant where it must move.
    """
    where = log.title
    if len(log) < FEWEST_ROWS:
        raise UserError(
            f"{where}: {len(log)} rows are too few; give a log of at least {FEWEST_ROWS}"
        )
    for name, values in (("time", log.time), *log.signals.items()):
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise UserError(
                f"{where}: {name} is not a number in {_rows(bad)}; put in what lies between their"
                " neighbours, or split the log there: rows that are merely taken out are missing"
            )
    late = np.flatnonzero(np.diff(log.time) <= 0.0)
    if late.size:
        raise UserError(
            f"{where}: time does not rise in {_rows(late + 1)}; sort the rows, or take them out"
        )
    if not _SHORTEST_PERIOD <= log.period <= _LONGEST_PERIOD:
        raise UserError(
            f"{where}: its rows are {log.period:.4g} s apart, which tells nothing of a drive; say"
            ' in the map what the stamps are: time_unit = "ms", "us", "ns" or "s"'
        )
    still = _still(log)
    if not _tells(log):
        said = ", ".join(f"{name} is {log[name][0]:g} throughout" for name in still)
        raise UserError(
            f"{where}: {said or 'nothing moves'}; a log must show a command or setpoint and what"
            " the joint made of it"
        )


def _still(log: Log) -> list[str]:
    """Signals that are constant."""
    each = ("command", SETPOINT, "force", "position")
    return [name for name in each if name in log and np.ptp(log[name]) == 0.0]


def _tells(log: Log) -> bool:
    """Whether a command or setpoint moves, and something answers."""
    moving = [name for name in log.signals if name not in _still(log)]
    return all(set(names) & set(moving) for names in (("command", SETPOINT), ("force", "position")))


def missing(log: Log) -> np.ndarray:
    """Rows before which rows are missing, by their numbers in this log.

    Where stamps jitter, what one is late by is made up for by the others about it.
    """
    steps = np.diff(log.time) / log.period - 1.0
    about = np.convolve(steps, np.ones(_ABOUT), "same")
    return np.flatnonzero((steps > _LONG_STEP - 1.0) & (about > _NOT_MADE_UP)) + 1


def too_many_missing(logs: Sequence[Log]) -> str:
    """That rows are missing at so many places of these logs that it matters, in words; "" if not.

    A few do less to the numbers than their intervals allow for. Cutting a log at many would leave
    pieces that are too short.
    """
    number = sum(len(missing(log)) for log in logs)
    if number <= _FEW_MISSING * sum(map(len, logs)):
        return ""
    return f"rows are missing at {number:,} places, where what was commanded is not known"


def stretches(log: Log) -> list[Log]:
    """The parts of a log between which no time is missing, as what was commanded then is not known.

    Rows that are missing one or two at a time, and often, are said in the notes.

    Raises:
        UserError: none is long enough.
    """
    return [
        replace(part, notes=(*part.notes, said)) if (said := too_many_missing([part])) else part
        for part in _parts(log)
    ]


def between_gaps(log: Log) -> list[tuple[int, int]]:
    """First row and end (exclusive) of what is long enough and misses no time, by number."""
    both = itertools.pairwise([0, *_gaps(log).tolist(), len(log)])
    return [each for each in both if each[1] - each[0] >= FEWEST_ROWS]


def _gaps(log: Log) -> np.ndarray:
    """Rows before which time is missing, by their numbers in this log."""
    return np.flatnonzero(np.diff(log.time) > _GAP * log.period) + 1


def _parts(log: Log) -> list[Log]:
    ends = _gaps(log)
    if not ends.size:
        return [log]
    parts = [log.part(*each) for each in between_gaps(log)]
    found = [
        replace(part, name=f"{log.name}, rows {part.row} to {part.row + len(part) - 1}")
        for part in parts
        if _tells(part)
    ]
    if not found:
        raise UserError(
            f"{log.title}: time is missing in {len(ends)} places, as before {_rows(ends)}, and no"
            f" {FEWEST_ROWS} rows lie between two of them; give a log without gaps"
        )
    return found


def renewed(log: Log) -> Log:
    """A log in which what was measured less often than once a row lies on lines between."""
    signals, notes = dict(log.signals), []
    for name in ("position", "velocity", "force"):
        fresh, number = new_rows(log[name]) if name in log else (np.empty(0), 1)
        if number > 1:
            signals[name] = np.interp(log.time, log.time[fresh], log[name][fresh])
            notes.append(f"{name} is new once in {number} rows; it is interpolated between them")
    return replace(log, signals=signals, notes=(*log.notes, *notes)) if notes else log


def new_rows(values: np.ndarray) -> tuple[np.ndarray, int]:
    """Rows in which a signal is new, by number, and once in how many rows that is.

    Args:
        values: shape (rows,).
    """
    number, first = _renewals(values)
    return np.arange(first, len(values), number), number


def _renewals(values: np.ndarray) -> tuple[int, int]:
    """(n, first row) of a signal that changes once in n rows only; (1, 0) of others."""
    changes = np.flatnonzero(np.diff(values)) + 1
    if len(changes) < _FEWEST_CHANGES:
        return 1, 0
    for number in range(_MOST_ROWS_HELD, 1, -1):
        counts = np.bincount(changes % number, minlength=number)
        first = int(np.argmax(counts))
        if counts[first] > 0.99 * len(changes) and counts[first] > 0.3 * len(values) / number:
            return number, first
    return 1, 0


def _rows(indices: np.ndarray, most: int = 5) -> str:
    """`rows 3, 4 and 7`, of the file, whose head is row 1."""
    numbers = [str(index + 2) for index in indices[:most].tolist()]
    if len(indices) > most:
        return f"rows {', '.join(numbers)} and {len(indices) - most:,} more"
    if len(numbers) == 1:
        return f"row {numbers[0]}"
    return f"rows {', '.join(numbers[:-1])} and {numbers[-1]}"
