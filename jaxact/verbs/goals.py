"""What a tuning is asked for, as a person writes it."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.loops.control_loop import ControlLoop
from jaxact.parameters import INERTIA, canonical
from jaxact.tuning.goal import DERIVATIVES, OBJECTIVES, WORST, Goal, check

_TRACKED = ("reference", "reference_period")
# Fields of a goal that are given otherwise than as a bound.
_ELSEWHERE = {
    "objective": 'is given as the goal, e.g. jaxact.tune(loop, "disk-margin", min_kp=100)',
} | dict.fromkeys(
    _TRACKED, 'is of the goal "tracking"; give that, or "tracking:FILE" with a CSV file'
)


def goal_of(goal: str | Goal, bounds: dict[str, Any]) -> Goal:
    """The goal that is asked for, checked.

    Args:
        goal: as it is, or its name; "tracking:FILE" reads the setpoints from a CSV file of
            time [s], setpoint [m].
        bounds: fields of it.

    Raises:
        UserError: an unknown name or bound, one that makes no sense, or a file that does not fit.
    """
    tracked = "tracking" in (goal, getattr(goal, "objective", ""))
    named = ("objective",) if tracked else ("objective", *_TRACKED)
    known = [field.name for field in dataclasses.fields(Goal) if field.name not in named]
    for name, value in bounds.items():
        if name in named:
            raise UserError(f"{name}: {_ELSEWHERE[name]}")
        if name not in known:
            raise UserError(f"{name}: unknown bound of a goal; {nearest(name, known)}")
        if isinstance(value, float) and math.isnan(value):
            raise UserError(f"`{name}`: nan is not a bound")
        if isinstance(getattr(Goal, name), float) and not _is_number(value):
            raise UserError(f"`{name}`: {shown(value)} is not a number")
    if not isinstance(goal, str | Goal):
        raise UserError(f"`goal` {shown(goal)}; {nearest(goal, OBJECTIVES)}")
    if isinstance(goal, Goal):
        return check(dataclasses.replace(goal, **bounds))
    name, colon, file = goal.partition(":")
    own = dict(bounds)
    if name == "tracking" and colon:
        if not file:
            raise UserError("`goal` tracking: needs a file of setpoints, tracking:FILE")
        own["reference"], own["reference_period"] = _reference(Path(file))
    elif colon:
        raise UserError(f"`goal` {shown(goal)}: only tracking takes a file")
    if name == "disk-margin":
        own.setdefault("max_peak", math.inf)
    return check(Goal(objective=name, **own))


def check_options(
    sampled: bool | None, seed: int, derivative: str, *, counts: Mapping[str, tuple[Any, int]]
) -> None:
    """Raise UserError for an option of a tuning that it cannot have.

    Args:
        sampled, seed, derivative: as for `jaxact.tune`.
        counts: other whole numbers by name, each with the least that it may be; None is allowed.
    """
    if sampled is not None and not isinstance(sampled, bool | np.bool_):
        raise UserError(f"`sampled` {shown(sampled)}; allowed: True, False, None")
    for name, (number, least) in {**counts, "seed": (seed, 0)}.items():
        whole = isinstance(number, int | np.integer) and not isinstance(number, bool)
        if not (whole and number >= least) and not (number is None and name in counts):
            raise UserError(f"`{name}` {shown(number)}: give a whole number from {least}")
    if derivative not in DERIVATIVES:
        raise UserError(f"`derivative` {shown(derivative)}; {nearest(derivative, DERIVATIVES)}")


def check_uncertain(uncertain: Any, loop: ControlLoop, samples: int | None, risk: str) -> None:
    """Raise UserError for a risk of one loop or draw, and for an inertia of a joint that slides.

    And for samples of what is known, or of loops that are draws already.

    Args:
        uncertain: what is, as for `jaxact.tune`.
        loop: which is tuned.
        samples: of it, as asked for.
        risk: of the goal.
    """
    joint = loop.kind.plant is None
    if samples is not None and isinstance(uncertain, ControlLoop):
        raise UserError("`samples`: the loops of `uncertainty` are all that count; leave it out")
    if isinstance(uncertain, str | Mapping) and not uncertain:
        if samples is not None:
            raise UserError(
                f"`samples` {samples}: nothing is uncertain; give `uncertainty`, ranges with a"
                " width, or leave it out"
            )
        if joint and risk != WORST:
            raise UserError(f"`risk` {risk}: is over loops, and this is one; give `uncertainty`")
    elif samples == 1 and joint and risk != WORST and not isinstance(uncertain, ControlLoop):
        raise UserError(f"`samples` 1: `risk` {risk} would be that of a single draw; give more")
    sliding = joint and loop.kind.unit != "rad"
    if sliding and isinstance(uncertain, Mapping) and INERTIA in uncertain:
        raise UserError(
            "`uncertainty` inertia: is that of a rotary joint, and this one slides; give mass"
        )


def ranges_of(uncertainty: Mapping[str, Any]) -> str:
    """Ranges as the command line writes them; raises UserError where one has not two ends."""
    parts = []
    for name, span in uncertainty.items():
        try:
            ends = [span] if isinstance(span, str) else [repr(float(end)) for end in np.ravel(span)]
        except (TypeError, ValueError):  # such as a range of a sweep
            ends = [""]
        if len(ends) != 2 and ".." not in ends[0]:
            raise UserError(f"`uncertainty` {name} = {shown(span)}: give (low, high)")
        parts.append(f"{canonical(name)}={'..'.join(ends)}")
    return ",".join(parts)


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
        with warnings.catch_warnings():
            # Of a file without rows more is said below.
            warnings.simplefilter("ignore", UserWarning)
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
