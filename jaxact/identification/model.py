"""A ladder of models: each rung says which numbers are free, and how a log follows from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from jaxact.identification.log import Log
from jaxact.identification.problem import Problem, Unknown
from jaxact.parameters import DELAY, WN, ZETA


@dataclass(frozen=True)
class Rung:
    """One model of the ladder.

    Attributes:
        name: in words.
        dynamics: of the drive, of `DYNAMICS`.
        friction: of the joint, "" where no joint moves.
        free: names of the unknowns.
        fixed: numbers of the model that are not the neutral ones.
    """

    name: str
    dynamics: str
    friction: str
    free: tuple[str, ...]
    fixed: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Family:
    """All that a ladder needs to know of what is identified.

    Attributes:
        rungs: simplest first.
        unknowns: by name, for the logs that are fitted.
        neutral: every number of the model by name, at the value at which it changes nothing.
        positive: names of those that are searched as logarithms.
        inputs: what of a log the simulation needs, a pytree of arrays.
        simulate: (values by name, inputs) -> the measured signal, shape (rows,); hashable.
        measured: the signal of a log that is predicted, shape (rows,).
        stimulus: the signal of a log that moves it, shape (rows,).
        signal: its name, "force" or "position".
        unit: of the signal.
        beside: names of unknowns that only the chosen model is refined with: no log tells of them
            by themselves, and the others' intervals have to allow for them.
        perhaps: names of unknowns that every model is fitted with as well where the chosen one is
            better with them, such as a limit that noise hides.
        nuisances: (logs, whether they are only tried) -> unknowns that every log has for itself.
    """

    rungs: tuple[Rung, ...]
    unknowns: Callable[[Sequence[Log]], dict[str, Unknown]]
    neutral: Mapping[str, float]
    positive: frozenset[str]
    inputs: Callable[[Log], Any]
    simulate: Callable[[Mapping[str, Any], Any], jax.Array]
    measured: Callable[[Log], np.ndarray]
    stimulus: Callable[[Log], np.ndarray]
    signal: str
    unit: str
    nuisances: Callable[[Sequence[Log], bool], tuple[Unknown, ...]] = lambda logs, tried: ()
    beside: tuple[str, ...] = ()
    perhaps: tuple[str, ...] = ()


# A first-order loop is a second-order one whose other pole is 4 zeta^2 times faster.
FIRST_ORDER_ZETA = 100.0
# Names of the drive's numbers that each kind of dynamics leaves free, and those it fixes.
DYNAMICS: dict[str, tuple[tuple[str, ...], tuple[tuple[str, float], ...]]] = {
    "gain": ((), ()),
    DELAY: ((DELAY,), ()),
    "first order": (("lag",), ((ZETA, FIRST_ORDER_ZETA),)),
    "first order with delay": (("lag", DELAY), ((ZETA, FIRST_ORDER_ZETA),)),
    "second order": ((WN, ZETA), ()),
    "second order with delay": ((WN, ZETA, DELAY), ()),
}
_STARTS_OF_A_DELAY = (0, 1, 2, 3, 4, 5, 7, 9, 12, 16)
_STARTS_OF_A_LONG_DELAY = (24, 36, 52)
LONG_DELAYS = (0.015, 0.03, 0.06)
"""A drive's delay may be so long, whatever the rate of the log [s]; the longer ones are tried where
a fit ends at a shorter one."""
MOST_FREE_BEGINNINGS = 3
"""Logs that are so few each begin where the fit puts them; of more, where they were measured."""
# The beginning of a log enters almost linearly.
_STEPS_OF_A_BEGINNING = 2
# A step that promises to lower the sum of squares by less than this share of it is not taken.
_NO_FALL = 1e-6
NEUTRAL_DRIVE = {WN: math.inf, ZETA: 1.0, DELAY: 0.0}


def ticks_of_delay(period: float, least: int, longest: float = LONG_DELAYS[0]) -> int:
    """Rows by which a drive may be late, at least so many, and as many as a delay has [s]."""
    return max(least, round(longest / period))


def drive_unknowns(
    logs: Sequence[Log], most_ticks: int, longest: float = LONG_DELAYS[0]
) -> tuple[Unknown, ...]:
    """Delay, lag, wn and zeta in the range that logs of this rate and length can tell of.

    A search crosses control ticks by itself: delays of many of them are begun from a few.

    Args:
        logs: to be fitted.
        most_ticks: rows by which the drive may be late in any case.
        longest: delay that is tried [s].
    """
    more = _STARTS_OF_A_LONG_DELAY if longest > LONG_DELAYS[0] else ()
    period = float(np.median([log.period for log in logs]))
    shortest = min(log.duration for log in logs)
    most = ticks_of_delay(period, most_ticks, longest)
    ticks = max(int(min(most * period, 0.1 * shortest) / period), 1)
    fast, slow = 30.0 / period, 0.3 * math.pi / shortest
    middle = [math.pi / period * share for share in (0.05, 0.2, 0.8)]
    both = 2.0 * FIRST_ORDER_ZETA
    return (
        Unknown(DELAY, "s", 0.0, ticks * period,
                tuple((at + 0.5) * period for at in (*_STARTS_OF_A_DELAY, *more) if at < ticks)),
        Unknown("lag", "s", 1.0 / fast, 1.0 / slow, tuple(1.0 / w for w in middle),
                positive=True, inverse_of=(WN, both)),
        Unknown(WN, "rad/s", slow, fast, tuple(middle), positive=True),
        Unknown(ZETA, "1", 0.02, 50.0, (0.4, 1.0), positive=True),
    )  # fmt: skip


def of_rung(family: Family, rung: Rung, logs: Sequence[Log]) -> Problem:
    """The least-squares problem of a rung on these logs, each residual in shares of its spread."""
    known = family.unknowns(logs)
    measured = [family.measured(log) for log in logs]
    moved = np.concatenate([rows - rows.mean() for rows in measured])
    own = family.nuisances(logs, False)
    return Problem(
        unknowns=(*(known[name] for name in rung.free), *own),
        numbers={**family.neutral, **dict(rung.fixed)},
        positive=family.positive,
        simulate=family.simulate,
        inputs=tuple(family.inputs(log) for log in logs),
        measured=tuple(measured),
        scale=1.0 / max(float(np.sqrt(np.mean(moved**2))), 1e-300),
        period=float(np.median([log.period for log in logs])),
    )


def predicted(family: Family, log: Log, values: Mapping[str, float]) -> np.ndarray:
    """The signal that a model with these numbers predicts for a log, shape (rows,).

    Where the log begins is not the model's to know: it is fitted to the log.

    Args:
        family: of the model.
        log: any.
        values: of the model.
    """
    own = tuple(replace(unknown, log=0) for unknown in family.nuisances([log], True))
    measured = family.measured(log)
    with jax.enable_x64(True):
        inputs = family.inputs(log)
    numbers = {**family.neutral, **values}
    sought = Problem(
        own, numbers, family.positive, family.simulate, (inputs,), (measured,), 1.0, None
    )
    point = np.array([unknown.inner(unknown.starts[0]) for unknown in own])
    rest, slopes = sought.evaluate(point)
    for _ in range(_STEPS_OF_A_BEGINNING if own else 0):
        if not np.isfinite(slopes).all() or not np.isfinite(rest).all():
            break
        step = np.linalg.lstsq(slopes, -rest, rcond=None)[0]
        promised = rest + slopes @ step
        if promised @ promised > (1.0 - _NO_FALL) * (rest @ rest):
            break
        moved = np.clip(point + step, [u.low for u in own], [u.high for u in own])
        found = sought.evaluate(moved)
        if not found[0] @ found[0] < rest @ rest:
            break
        point, (rest, slopes) = moved, found
    return measured + rest
