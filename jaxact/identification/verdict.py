"""Whether an identified model can be used, and up to which frequency, by logs it has not seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from scipy import signal as _signal

from jaxact.identification import signs, skew
from jaxact.identification.choice import Candidate
from jaxact.identification.inspection import excited_band
from jaxact.identification.joint_motion import COMMAND_LIMIT
from jaxact.identification.knowledge import beyond
from jaxact.identification.ladder import Ladder, too_long
from jaxact.identification.log import Log, too_many_missing
from jaxact.identification.model import Family, predicted
from jaxact.loops import drives
from jaxact.parameters import DELAY, WN, ZETA

# A share of amplitude in error up to which a model is usable at a frequency, and for being good.
_USABLE = 0.35
_GOOD_SCORE = 85.0
_LEAST_SCORE = 40.0
# Errors of which such a share of the autocorrelations is not white noise's are the model's own.
_NOT_NOISE = 0.5
# A validation log that is this much worse than the fitted ones was not foreseen by the model.
_MOST_LOST = 10.0
MOST_CORRELATED = 0.35
"""Correlation of error and stimulus from which on the error follows the stimulus."""
# Share of the largest command up to which nothing is asked for.
_NO_COMMAND = 1e-3
NOT_EXPLAINED = "its interval does not hold, as the model does not explain the logs"


class Level(Enum):
    """The three verdicts."""

    GOOD = "good"
    USABLE = "usable"
    NOT_ENOUGH = drives.NOT_ENOUGH


@dataclass(frozen=True)
class Verdict:
    """A verdict and what it rests on.

    Attributes:
        level: good, usable up to a frequency, or not good enough.
        below: frequency up to which the model is usable [Hz]; None where it is not.
        score: worst score of the validation logs [%].
        whiteness: share of the residuals' autocorrelations outside the 95 % band of white noise;
            reported, and decides nothing alone.
        correlated: largest correlation of residual and stimulus over lags.
        reasons: why it is not good, in words.
        provided: what the logs do not show and the numbers rest on, in words; "" for nothing.
    """

    level: Level
    below: float | None
    score: float
    whiteness: float
    correlated: float
    reasons: tuple[str, ...]
    provided: str = ""

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        if self.level is Level.GOOD:
            said = f"good: {self.score:.1f} % of what logs show that it has not seen is predicted"
            return f"{said}, {self.provided}" if self.provided else said
        why = "; ".join((*self.reasons, *([self.provided] if self.provided else [])))
        if self.level is Level.USABLE:
            return f"usable below {self.below:.3g} Hz: {why}"
        return f"not good enough: {why}"


def judge(ladder: Ladder) -> Verdict:
    """The verdict on a ladder's chosen model."""
    family, chosen = ladder.family, ladder.chosen
    rests = [
        predicted(family, log, chosen.numbers) - family.measured(log) for log in ladder.validation
    ]
    below = _usable_band(family, ladder.validation, rests)
    correlated = max(
        _correlation(rest, family.stimulus(log))
        for rest, log in zip(rests, ladder.validation, strict=True)
    )
    score = min(chosen.scores)
    own = _own_score(chosen)
    reasons = []
    if not math.isfinite(score) or score < _GOOD_SCORE:
        reasons.append(f"{score:.1f} % of logs it has not seen is predicted")
    if own - score > _MOST_LOST:
        reasons.append(f"it does not carry over: {own:.1f} % of the fitted logs is predicted")
    if correlated > MOST_CORRELATED:
        reasons.append(f"its error follows the stimulus (correlation {correlated:.2f})")
    longest = too_long(ladder)
    if longest is not None:
        reasons.append(f"the delay {beyond(longest.value)}")
    bounds = [e.name for e in chosen.knowledge.estimates if e.at_bound and e.name != DELAY]
    if bounds:
        reasons.append(f"{' and '.join(bounds)} at a bound")
    if chosen.numbers.get("gain", 1.0) < 0.0:
        reasons.append(
            f"{family.signal} goes against the command (gain {chosen.numbers['gain']:.3g}): one of"
            " the two has the wrong sign, give it scale = -1.0 in the map"
        )
    if ladder.kept_apart:
        reasons += _narrow(ladder)
    if gaps := too_many_missing(ladder.fitted):
        reasons.append(f"{gaps}: numbers may be off by more than their intervals")
    reasons += [f"{e.name} is not identified ({e.reason})" for e in chosen.knowledge.estimates
                if not e.identified and e.name in (DELAY, WN, ZETA, "lag")
                and not (e.at_bound and e.name == DELAY)]  # fmt: skip
    if ladder.shown is not None:
        below = None if below is None else min(below, ladder.shown)
        reasons.append(
            "its rows are too far apart for its loop; log faster, or state the control"
            " rate if it is theirs"
        )
    # Of signals that contradict each other, no model is usable, whatever it fits by chance.
    contradictions = _opposed(ladder) if reasons else []
    reasons = [*contradictions, *reasons]
    if not reasons:
        level = Level.GOOD
    elif below is not None and score > _LEAST_SCORE and not contradictions:
        level = Level.USABLE
    else:
        level = Level.NOT_ENOUGH
        reasons = reasons or ["its error is as large as the signal at all frequencies"]
    rests_on = () if level is Level.NOT_ENOUGH else (skew.taken_for(ladder), _of_one_size(ladder))
    provided = "; ".join(each for each in rests_on if each)
    return Verdict(level, below, score, _whiteness(rests), correlated, tuple(reasons), provided)


def _opposed(ladder: Ladder) -> list[str]:
    """Which signals of the logs go against each other."""
    said = (signs.opposed(log) for log in (*ladder.fitted, *ladder.validation))
    return list(dict.fromkeys(reason for reason in said if reason))


def _of_one_size(ladder: Ladder) -> str:
    """What the numbers rest on where commands are of one size, as a PRBS' are; "" otherwise.

    A drive that gives less than that, always as much, is that of a heavier joint.
    """
    family, logs = ladder.family, (*ladder.fitted, *ladder.validation)
    if family.signal != "position" or COMMAND_LIMIT in ladder.chosen.rung.free:
        return ""
    sizes = set()
    for log in logs:
        if "command" not in log or family.stimulus(log) is not log["command"]:
            return ""
        size = np.abs(log["command"])
        largest = float(np.max(size))
        sizes |= {float(f"{each:.3g}") for each in np.unique(size[size > _NO_COMMAND * largest])}
    if len(sizes) != 1:
        return ""
    unit = "N m" if ladder.family.unit == "rad" else "N"
    return (
        f"if the drive gives the {sizes.pop():.3g} {unit} that was always asked for: with a lower"
        " limit inertia, gravity and friction are smaller in proportion"
    )


def withdrawn(ladder: Ladder, verdict: Verdict) -> Ladder:
    """A ladder of which nothing is identified where its best model does not explain the logs.

    Intervals are those of a model that is right: of one that is not they say nothing, however
    narrow they are. What noise alone leaves unexplained does no harm. A delay as long as any that
    was tried stands for something else, such as a command that is not followed.

    Args:
        ladder: any.
        verdict: on it.
    """
    unexplained = verdict.score < _GOOD_SCORE and verdict.whiteness > _NOT_NOISE
    endless = any(e.name == DELAY and e.at_bound for e in ladder.chosen.knowledge.estimates)
    if verdict.level is not Level.NOT_ENOUGH and not unexplained and not endless:
        return ladder

    def doubted(one: Candidate) -> Candidate:
        estimates = tuple(
            replace(e, identified=False, reason=e.reason or NOT_EXPLAINED)
            for e in one.knowledge.estimates
        )
        return replace(one, knowledge=replace(one.knowledge, estimates=estimates))

    every = {id(one): doubted(one) for one in ladder.candidates}
    return replace(ladder, candidates=tuple(every.values()), chosen=every[id(ladder.chosen)])


def _own_score(chosen: Candidate) -> float:
    """Score on the fitted logs [%]; residuals are in shares of their spread."""
    return 100.0 * (1.0 - float(np.sqrt(np.mean(chosen.fit.residuals**2))))


def _narrow(ladder: Ladder) -> list[str]:
    """Whether only one log vouches for the model, whose parts resemble each other."""
    logs = ladder.fitted
    if len(logs) > 1:
        return []
    return ["no log of another excitation was there to try it on (give `validate`)"]


def _usable_band(family: Family, logs: Sequence[Log], rests: Sequence[np.ndarray]) -> float | None:
    """Frequency up to which the error stays a small share of the signal, on every log."""
    found = []
    for log, rest in zip(logs, rests, strict=True):
        measured = family.measured(log)
        if not np.isfinite(rest).all():
            return None
        length = min(max(64, min(1024, len(log) // 6)), len(log))
        rate = 1.0 / log.period
        frequency, whole = _signal.welch(measured, rate, nperseg=length)
        _, error = _signal.welch(rest, rate, nperseg=length)
        frequency, whole, error = frequency[1:], whole[1:], error[1:]
        top = max(excited_band(family.stimulus(log), rate), float(frequency[0]))
        share = np.sqrt(np.cumsum(error) / np.maximum(np.cumsum(whole), 1e-300))
        local = np.sqrt(error / np.maximum(whole, 1e-300))
        bad = (share > _USABLE) | ((local > 2.0 * _USABLE) & (frequency <= top))
        first = int(np.argmax(bad)) if bad.any() else len(bad)
        if first == 0:
            return None
        found.append(min(float(frequency[first - 1]), top))
    return min(found)


def _correlation(rest: np.ndarray, stimulus: np.ndarray, most: int = 50) -> float:
    """Largest correlation of residual and stimulus over lags."""
    one, two = rest - rest.mean(), stimulus - stimulus.mean()
    size = float(np.linalg.norm(one) * np.linalg.norm(two))
    if size == 0.0 or not math.isfinite(size):
        return 1.0 if not math.isfinite(size) else 0.0
    most = min(most, len(one) - 1)
    lags = [float(one[lag:] @ two[: len(two) - lag]) / size for lag in range(most)]
    return float(np.max(np.abs(lags)))


def _whiteness(rests: Sequence[np.ndarray], lags: int = 25) -> float:
    """Share of autocorrelations outside the band of white noise.

    Source: Box, Jenkins, "Time series analysis", section 8.2.
    """
    outside = []
    for rest in rests:
        centred = rest - rest.mean()
        power = float(centred @ centred)
        if power == 0.0:
            continue
        each = [float(centred[lag:] @ centred[:-lag]) / power for lag in range(1, lags + 1)]
        outside.append(np.mean(np.abs(each) > 1.96 / math.sqrt(len(rest))))
    return float(np.mean(outside)) if outside else 0.0
