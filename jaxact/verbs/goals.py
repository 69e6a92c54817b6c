"""What a tuning is asked for, as a person writes it."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.tuning.goal import Goal, check


def goal_of(goal: str | Goal, bounds: dict[str, Any]) -> Goal:
    """The goal that is asked for, checked.

    Args:
        goal: as it is, or its name; "tracking:FILE" reads the setpoints from a CSV file of
            time [s], setpoint [m].
        bounds: fields of it.

    Raises:
        UserError: an unknown name or bound, one that makes no sense, or a file that does not fit.
    """
    known = [field.name for field in dataclasses.fields(Goal)]
    for name, value in bounds.items():
        if name not in known:
            raise UserError(f"{name}: unknown bound of a goal; {nearest(name, known)}")
        if isinstance(value, float) and math.isnan(value):
            raise UserError(f"`{name}`: nan is not a bound")
        if isinstance(getattr(Goal, name), float) and not _is_number(value):
            raise UserError(f"`{name}`: {shown(value)} is not a number")
    if isinstance(goal, Goal):
        return check(dataclasses.replace(goal, **bounds))
    name, colon, file = goal.partition(":")
    own = dict(bounds)
    if name == "tracking" and colon:
        own["reference"], own["reference_period"] = _reference(Path(file))
    elif colon:
        raise UserError(f"`objective` {shown(goal)}: only tracking takes a file")
    if name == "disk-margin":
        own.setdefault("max_peak", math.inf)
    return check(Goal(objective=name, **own))


def _is_number(value: Any) -> bool:
    if isinstance(value, str | bool) or np.ndim(value):
        return False
    try:
        return not math.isnan(float(value))
    except (TypeError, ValueError):
        return False


def _reference(path: Path) -> tuple[tuple[float, ...], float]:
    """Setpoints and the time between them, from a CSV file of time and setpoint."""
    try:
        rows = np.loadtxt(path, delimiter=",", comments="#", ndmin=2, encoding="utf-8-sig")
    except OSError as error:
        reason = error.strerror or "is missing"
        raise UserError(f"{path}: cannot be read ({reason}); give a CSV file") from None
    except (ValueError, UnicodeDecodeError):
        raise UserError(
            f"{path}: write lines of time [s], setpoint [m]; # begins a comment"
        ) from None
    if rows.shape[1] != 2 or len(rows) < 2 or not np.all(np.isfinite(rows)):
        raise UserError(f"{path}: write at least two lines of time [s], setpoint [m]")
    time, setpoint = rows.T
    if not np.all(np.diff(time) > 0):
        raise UserError(f"{path}: times must rise")
    if np.ptp(setpoint) == 0:
        raise UserError(f"{path}: the setpoint never moves, any gains track it")
    period = float(np.min(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * period, period)
    if len(even) > 100_000:
        raise UserError(f"{path}: its shortest interval divides it into {len(even):,} steps")
    return tuple(map(float, np.interp(even, time, setpoint))), period
