"""What a log leaves open that is thinner than the loop it is of.

Between two rows a setpoint or command may have been held, or may have moved on along a line, and a
controller may have run many times. Both are fitted: numbers that differ more than their intervals
allow are not known, and their intervals reach as far beyond either as the two are apart.
"""

from __future__ import annotations

import math
from dataclasses import replace

from jaxact.identification import motion
from jaxact.identification.fitting import solve
from jaxact.identification.knowledge import Estimate
from jaxact.identification.ladder import Ladder
from jaxact.identification.log import Log
from jaxact.identification.model import of_rung
from jaxact.identification.problem import effective_lag

# Controllers of joints run at some such rate [Hz]; rows so far apart [s] do not show what they do.
_USUAL_RATE = 1000.0
_THIN = 8e-3
# A reading of the rows with so many times the other's sum of squares is not what happened.
_REFUTED = 4.0
# The rows are taken for what a controller saw up to this share of their rate.
_SHOWN = 0.1


def widest(logs: tuple[Log, ...], control_rate: float | None) -> float | None:
    """Time between rows [s] if the loop ran faster than these logs show; None if it did not.

    Args:
        logs: fitted.
        control_rate: of the controller [Hz]; None where it is not stated.
    """
    period = max(log.period for log in logs)
    faster = round(period * (control_rate or _USUAL_RATE)) > 1
    return period if period > _THIN and faster else None


def doubted(ladder: Ladder, plant: str, control_rate: float | None) -> Ladder:
    """A ladder whose chosen model knows no more than its rows show.

    Args:
        ladder: of a joint that moved.
        plant: "mass" or "pendulum".
        control_rate: of the controller [Hz]; None where it is not stated.
    """
    period = widest(ladder.fitted, control_rate)
    if period is None:
        return ladder
    chosen = ladder.chosen
    family = motion.family(ladder.fitted, plant, control_rate or _USUAL_RATE, lines=True)
    other = solve(of_rung(family, chosen.rung, ladder.fitted))
    if other.square_sum > _REFUTED * chosen.fit.square_sum:
        return ladder
    known = chosen.knowledge
    if all(_agree(e, other.values[e.name]) for e in known.estimates):
        return ladder
    # One that moves takes the others along: what is damping to one reading is delay to another.
    estimates = tuple(_widened(e, other.values[e.name], period) for e in known.estimates)
    lag = known.lag
    if lag is not None:
        apart = effective_lag(other.problem.model_values(other.point)) - lag[0]
        lag = lag[0], max(lag[1], abs(apart))
    refined = replace(chosen, knowledge=replace(known, estimates=estimates, lag=lag))
    return replace(
        ladder,
        chosen=refined,
        candidates=tuple(refined if one is chosen else one for one in ladder.candidates),
        shown=_SHOWN / period,
    )


def _agree(one: Estimate, other: float) -> bool:
    """Whether another estimate lies well within the interval of one."""
    return abs(other - one.value) <= 0.25 * (one.high - one.low)


def _widened(one: Estimate, other: float, period: float) -> Estimate:
    """An estimate that is another one as well, and may lie as far beyond both."""
    apart = max(abs(other - one.value), 0.5 * (one.high - one.low))
    return replace(
        one,
        low=max(min(one.low, other) - apart, 0.0 if one.low >= 0.0 else -math.inf),
        high=max(one.high, other) + apart,
        identified=False,
        reason=one.reason
        or f"depends on what was asked for within the {1e3 * period:.3g} ms between rows",
    )
