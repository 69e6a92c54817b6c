"""What a log is worth before anything is fitted to it: rates, gaps, counts, limits, bands."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import signal as _signal

from jaxact.identification.log import LINKS, Log, missing
from jaxact.parameters import FEEDFORWARD, SETPOINT

# Where more than this share of the samples is at the extreme, it is a limit and no peak; where most
# are, or there are few levels at all, the signal switches between them, as a PRBS does.
_AT_THE_LIMIT, _SWITCHING = 0.005, 0.5
# A controller's command does not switch: it may be at its limit nearly all the time.
_NEARLY_ALWAYS = 0.98
_FEWEST_LEVELS = 20
# At a limit a signal is flat: rows within four times the distance of it are hardly more.
_FLAT = 1.5
_COHERENT = 0.5
_MOST_DIFFERENCES = 200_000


@dataclass(frozen=True)
class Inspection:
    """What was found in a log.

    Attributes:
        rate: 1 / median time between rows [Hz].
        jitter: standard deviation of the time between rows [s], without gaps.
        gaps: rows (as in the file, whose head is row 1) before which time is missing.
        repeated: share of rows that repeat the one before in every signal [-].
        quanta: smallest step of each signal that has one, in its unit.
        saturated: signals that stay at an extreme -> the extreme.
        band: frequency up to which the answer follows the stimulus [Hz]; None where nowhere.
        excited: frequency below which 95 % of the stimulus' power lies [Hz].
        controller: what the command is made of, see `recomputed`; None where it cannot be said.
        skew: time by which the velocity column lags the position's [s]; None where not both.
        notes: the findings in words.
    """

    rate: float
    jitter: float
    gaps: tuple[int, ...]
    repeated: float
    quanta: Mapping[str, float]
    saturated: Mapping[str, float]
    band: float | None
    excited: float
    controller: Controller | None
    skew: float | None
    notes: tuple[str, ...] = field(default_factory=tuple)


@dataclass(frozen=True)
class Controller:
    """The controller that the command of a log is made of, by least squares.

    Attributes:
        kp, kd: gains of setpoint minus position, and of minus velocity.
        feedforward: factor of the log's feedforward, 0 where there is none.
        offset: constant [N or N m].
        explained: share of the command's variance [-].
        missing: the signal that most of the rest goes with; "" for none.
    """

    kp: float
    kd: float
    feedforward: float
    offset: float
    explained: float
    missing: str


def inspect(log: Log) -> Inspection:
    """Everything that is looked at before a log is used; see `Inspection`."""
    steps = np.diff(log.time)
    period = log.period
    usual = steps[steps <= 1.7 * period]
    own = {name: values for name, values in log.signals.items() if name not in LINKS}
    together = np.stack(list(own.values()), axis=1)
    repeated = float(np.mean(np.all(together[1:] == together[:-1], axis=1)))
    quanta = {name: q for name, values in own.items() if (q := quantum(values)) is not None}
    limits = {"command": limit_of_command(log)} | {
        name: saturation(log[name]) for name in ("force", "supply") if name in log
    }
    stimulus = log["command"] if "force" in log and "command" in log else (
        log[SETPOINT] if SETPOINT in log else log["command"]
    )  # fmt: skip
    answer = log["force"] if "force" in log and "command" in log else log["position"]
    found = Inspection(
        rate=1.0 / period,
        jitter=float(np.std(usual)),
        gaps=tuple((missing(log) + log.row).tolist()),
        repeated=repeated,
        quanta=quanta,
        saturated={name: limit for name, limit in limits.items() if limit is not None},
        band=usable_band(stimulus, answer, 1.0 / period),
        excited=excited_band(stimulus, 1.0 / period),
        controller=recomputed(log),
        skew=skew(log),
    )
    return found


def quantum(values: np.ndarray) -> float | None:
    """The step that all values are multiples of, up to rounding; None where there is none.

    Args:
        values: shape (rows,).
    """
    levels = np.unique(values)
    if len(levels) < 3 or len(levels) > 0.5 * len(values):
        return None
    steps = np.diff(levels)[:_MOST_DIFFERENCES]
    floor = 1e-9 * max(float(np.max(np.abs(levels))), 1e-300)
    steps = steps[steps > 10 * floor]
    if steps.size < 2:
        return None
    # Rounding in the file may split a count in two: the most frequent small step is the count.
    guess = float(np.median(steps[steps <= 1.5 * np.percentile(steps, 10)]))
    whole = np.round(steps / guess)
    whole = whole[whole > 0]
    if whole.size < 2:
        return None
    kept = steps[np.round(steps / guess) > 0]
    refined = float(kept.sum() / whole.sum())
    away = np.abs(kept / refined - np.round(kept / refined))
    return refined if float(np.mean(away < 0.1)) > 0.9 else None


def limit_of_command(log: Log) -> float | None:
    """The limit at which a log's command stays; None where it does not, or there is no command."""
    if "command" not in log:
        return None
    controlled = {SETPOINT, "position"} <= set(log.signals)
    return saturation(log["command"], most=_NEARLY_ALWAYS if controlled else _SWITCHING)


def saturation(values: np.ndarray, *, most: float = _SWITCHING) -> float | None:
    """The limit at which a signal stays, its larger extreme; None where it does not.

    Args:
        values: shape (rows,).
        most: share of the rows from which on it switches between its extremes instead.
    """
    top = float(np.max(np.abs(values)))
    if top == 0.0 or len(np.unique(values)) < _FEWEST_LEVELS:
        return None
    there = np.abs(values) > top * (1.0 - 1e-3)
    # Below the top of a smooth curve four times the height holds twice the rows.
    around = np.abs(values) > top * (1.0 - 4e-3)
    flat = around.sum() < _FLAT * there.sum()
    runs = np.flatnonzero(there[1:] & there[:-1]).size
    share = float(np.mean(there))
    return top if flat and _AT_THE_LIMIT < share < most and runs > 0.5 * there.sum() else None


def usable_band(stimulus: np.ndarray, answer: np.ndarray, rate: float) -> float | None:
    """Highest frequency up to which the answer is coherent with the stimulus [Hz].

    Source: Bendat, Piersol, "Random Data", 4th ed., section 6.1 (coherence).
    """
    length = min(max(64, min(1024, len(stimulus) // 8)), len(stimulus))
    frequency, coherence = _signal.coherence(stimulus, answer, fs=rate, nperseg=length)
    coherent = coherence[1:] > _COHERENT
    if not coherent[:3].any():
        return None
    first_lost = np.flatnonzero(~coherent & np.append(~coherent[1:], True))
    first = int(np.argmax(coherent))
    lost = first_lost[first_lost > first]
    return float(frequency[1:][lost[0] - 1 if lost.size else -1])


def excited_band(stimulus: np.ndarray, rate: float) -> float:
    """Frequency below which 95 % of a signal's power lies [Hz], its mean apart."""
    power = np.abs(np.fft.rfft(stimulus - stimulus.mean())) ** 2
    share = np.cumsum(power) / max(float(power.sum()), 1e-300)
    return float(np.fft.rfftfreq(len(stimulus), 1.0 / rate)[int(np.searchsorted(share, 0.95))])


def recomputed(log: Log) -> Controller | None:
    """The PD controller that the command follows from, by least squares on the log's own signals.

    None where the log lacks setpoint, position or command.
    """
    if not {SETPOINT, "position", "command"} <= set(log.signals):
        return None
    speed = velocity(log)
    error = log[SETPOINT] - log["position"]
    columns = [error, -speed, np.ones(len(log))]
    names = ["error", "velocity", "offset"]
    if FEEDFORWARD in log:
        columns.append(log[FEEDFORWARD])
        names.append(FEEDFORWARD)
    command = log["command"]
    inside = np.ones(len(log), bool)
    limit = limit_of_command(log)
    if limit is not None:
        inside = np.abs(command) < 0.999 * limit
    matrix = np.stack(columns, axis=1)
    scale = np.maximum(np.linalg.norm(matrix[inside], axis=0), 1e-300)
    solved = np.linalg.lstsq(matrix[inside] / scale, command[inside], rcond=1e-10)[0] / scale
    rest = command[inside] - matrix[inside] @ solved
    spread = max(float(np.var(command[inside])), 1e-300)
    explained = 1.0 - float(np.var(rest)) / spread
    missing = "" if explained > 0.999 else _missing(log, rest, inside)
    found = dict(zip(names, solved.tolist(), strict=True))
    return Controller(
        kp=found["error"], kd=found["velocity"], feedforward=found.get(FEEDFORWARD, 0.0),
        offset=found["offset"], explained=explained, missing=missing,
    )  # fmt: skip


def explained_by(log: Log, kp: float, kd: float) -> float:
    """Share of the command's variance that these gains explain.

    With or without the setpoint's velocity in the damping, whichever explains more; a constant, and
    what is fed forward, are free.
    """
    error, speed = log[SETPOINT] - log["position"], velocity(log)
    command = log["command"]
    limit = limit_of_command(log)
    inside = np.ones(len(log), bool) if limit is None else np.abs(command) < 0.999 * limit
    free = [np.ones(len(log)), *([log[FEEDFORWARD]] if FEEDFORWARD in log else [])]
    matrix = np.stack(free, axis=1)[inside]
    left = []
    for wanted in (0.0, np.gradient(log[SETPOINT], log.time)):
        rest = (command - kp * error - kd * (wanted - speed))[inside]
        rest = rest - matrix @ np.linalg.lstsq(matrix, rest, rcond=1e-10)[0]
        left.append(float(np.var(rest)))
    return 1.0 - min(left) / max(float(np.var(command[inside])), 1e-300)


def _missing(log: Log, rest: np.ndarray, inside: np.ndarray) -> str:
    """What the unexplained rest of a command goes with most."""
    error = log[SETPOINT] - log["position"]
    rows = np.diff(log.time, prepend=log.time[0])
    wanted = np.gradient(log[SETPOINT], log.time)
    candidates = {
        "an integral of the error": np.cumsum(error * rows),
        "the setpoint's velocity": wanted,
        "the setpoint's acceleration": np.gradient(wanted, log.time),
        "gravity or a spring (sine of the position)": np.sin(log["position"]),
        "the sign of the velocity": np.sign(velocity(log)),
    }  # fmt: skip
    best, most = "", 0.3
    for name, values in candidates.items():
        own = values[inside]
        if np.std(own) > 0.0 and np.std(rest) > 0.0:
            share = abs(float(np.corrcoef(own, rest)[0, 1]))
            if share > most:
                best, most = name, share
    return best


def velocity(log: Log) -> np.ndarray:
    """The velocity that the controller saw: measured, or its position differenced."""
    if log.difference_ticks:
        late = log.difference_ticks
        before = np.concatenate([np.full(late, log["position"][0]), log["position"][:-late]])
        times = np.concatenate(
            [log.time[0] - log.period * np.arange(late, 0, -1), log.time[:-late]]
        )
        return (log["position"] - before) / (log.time - times)
    if "velocity" in log:
        return log["velocity"]
    before = np.append(log["position"][0], log["position"][:-1])
    return (log["position"] - before) / np.append(log.period, np.diff(log.time))


def skew(log: Log) -> float | None:
    """Time by which the velocity column lags the differenced position [s]; None where not both."""
    if not {"position", "velocity"} <= set(log.signals) or np.ptp(log["velocity"]) == 0.0:
        return None
    speed = np.gradient(log["position"], log.time)
    return _lag(speed, log["velocity"]) * log.period


def _lag(one: np.ndarray, two: np.ndarray, most: int = 20) -> float:
    """Rows by which `two` lags `one`, by the peak of their correlation."""
    one, two = one - one.mean(), two - two.mean()
    length = 1 << math.ceil(math.log2(2 * len(one)))
    cross = np.fft.irfft(np.fft.rfft(two, length) * np.conj(np.fft.rfft(one, length)), length)
    near = np.concatenate([cross[-most:], cross[: most + 1]])
    peak = int(np.argmax(near))
    if not 0 < peak < len(near) - 1:
        return float(peak - most)
    left, middle, right = near[peak - 1 : peak + 2]
    curve = left - 2.0 * middle + right
    return peak - most + (0.5 * (left - right) / curve if curve < 0.0 else 0.0)
