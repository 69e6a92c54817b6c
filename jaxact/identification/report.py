"""An identification in words and a table."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from jaxact.identification.choice import Candidate
from jaxact.identification.inspection import Inspection
from jaxact.identification.knowledge import Estimate, beyond
from jaxact.identification.ladder import FAR_FROM_A_DELAY, Ladder, too_long
from jaxact.identification.log import Log
from jaxact.identification.problem import effective_lag
from jaxact.parameters import DELAY, WN, ZETA

if TYPE_CHECKING:
    from jaxact.identification.result import Identified

# What models with more than this many times the chosen one's error leave open is of no interest.
_NEARLY_AS_GOOD = 1.5
# Half of a 95 % interval of independent residuals [standard deviations].
_NAIVE = 1.96
# Loops run faster than logs of longer periods do [s].
_COARSE = 4e-3


def text(identified: Identified) -> str:
    """The whole report, lines of at most some 100 characters."""
    ladder = identified.ladder
    logs = (*ladder.fitted, *ladder.validation)
    lines = []
    roles = ["fit"] * len(ladder.fitted) + ["validate"] * len(ladder.validation)
    for role, log, found in zip(roles, logs, identified.inspections, strict=True):
        lines += [f"{role}: {log.title}: {first}" for first in [summary(log, found)]]
        lines += [f"  {note}" for note in notes(log, found)]
    if ladder.kept_apart:
        lines.append("validated on the last 30 % of each log, as no other was given")
    lines += ["", *table(identified), *(f"  {said}" for said in collinear(identified)), ""]
    chosen = ladder.chosen
    lines.append(f"chosen: {chosen.rung.name}")
    lines += [f"  {estimate(one)}" for one in chosen.knowledge.estimates]
    lines += [f"  {said}" for said in combined(ladder)]
    lines += [f"  {said}" for said in left_out(identified)]
    lines += [f"  {said}" for said in unstable_delay(identified)]
    lines += [f"  {said}" for said in alignment(chosen, ladder.fitted[0])]
    lines += [f"  {said}" for said in stated(identified)]
    lines += ["", f"verdict: {identified.verdict.sentence}"]
    white = identified.verdict.whiteness
    lines.append(
        f"residuals: {100.0 * white:.0f} % of their autocorrelations are not those of white noise,"
        " which the intervals allow for"
    )
    lines += lacking(ladder)
    return "\n".join(lines)


def lacking(ladder: Ladder) -> list[str]:
    """That the chosen model lacks something, and what its intervals make of it."""
    rho = ladder.chosen.knowledge.misfit
    if rho == 0.0:
        return []
    return [
        f"the model lacks something: {100.0 * rho:.0f} % of its error goes with the motion, and"
        " intervals allow for two thirds as much that is gone into the numbers"
    ]


def summary(log: Log, found: Inspection) -> str:
    """`2,996 rows, 500 Hz, 6 s`."""
    band = "" if found.band is None else f", answer follows up to {found.band:.3g} Hz"
    return (
        f"{len(log):,} rows, {found.rate:.4g} Hz, {log.duration:.3g} s; 95 % of the excitation"
        f" below {found.excited:.3g} Hz{band}"
    )


def notes(log: Log, found: Inspection) -> list[str]:
    """What is odd about a log."""
    said = [*log.notes, *units(log)]
    if found.jitter > 0.02 * log.period:
        said.append(f"rows are {1e6 * found.jitter:.3g} us (standard deviation) off their rate")
    if found.gaps:
        first = ", ".join(str(row) for row in found.gaps[:3])
        more = f" and {len(found.gaps) - 3} more" if len(found.gaps) > 3 else ""
        said.append(f"time is missing before row {first}{more}")
    if found.repeated > 0.05:
        said.append(f"{100.0 * found.repeated:.0f} % of the rows repeat the one before")
    for name, quantum in found.quanta.items():
        if name in ("position", "velocity", "force", "command"):
            said.append(f"{name} comes in steps of {quantum:.4g}")
    for name, limit in found.saturated.items():
        said.append(f"{name} stays at {limit:.4g} for part of the time")
    if found.skew is not None and abs(found.skew) > 0.3 * log.period:
        said.append(f"velocity lags the position by {1e3 * found.skew:.2g} ms")
    controller = found.controller
    if controller is not None:
        share = 100.0 * controller.explained
        missing = f"; the rest goes with {controller.missing}" if controller.missing else ""
        said.append(
            f"the command is that of kp {controller.kp:.4g}, kd {controller.kd:.4g}"
            f" ({share:.4g} % explained{missing})"
        )
    return said


# So many turns of a joint [rad]; and columns that are so much alike, but for their size.
_MANY_TURNS, _ALIKE = 8.0 * math.pi, 0.84


def units(log: Log) -> list[str]:
    """What columns in other units look like."""
    said = []
    if log.unit == "rad" and "position" in log and np.ptp(log["position"]) > _MANY_TURNS:
        said.append(
            f"position spans {np.ptp(log['position']):.4g} rad; if these are degrees, say"
            ' position = { column = "...", scale = 0.01745329 } in the map'
        )
    if {"position", "velocity"} <= set(log.signals) and np.ptp(log["velocity"]) > 0.0:
        speed, told = np.gradient(log["position"], log.time), log["velocity"]
        alike = float(np.corrcoef(speed, told)[0, 1])
        ratio = math.copysign(float(np.std(told)) / max(float(np.std(speed)), 1e-300), alike)
        if abs(alike) > _ALIKE and not 0.8 < ratio < 1.25:
            said.append(
                f"velocity is {ratio:.4g} times the rate of the position; its unit or sign is"
                " another: give it a `scale` in the map"
            )
    return said


def table(identified: Identified) -> list[str]:
    """The ladder, a line for each model."""
    ladder = identified.ladder
    unit = ladder.family.unit
    width = max(len(one.rung.name) for one in ladder.candidates)
    head = f"  {'model':{width}}  unknowns  error on unseen logs  score  known"
    lines = [head]
    for one in ladder.candidates:
        mark = ">" if one is ladder.chosen else " "
        missing = [e.name for e in one.knowledge.estimates if not e.identified]
        known = "all" if not missing else f"not {', '.join(missing)}"
        lines.append(
            f"{mark} {one.rung.name:{width}}  {one.size:8d}  {one.error:14.4g} {unit:<5s}"
            f"  {min(one.scores):5.1f} %  {known}"
        )
    return lines


def estimate(one: Estimate) -> str:
    """`delay 2 ms (95 %: 1.9 to 2.1; 1.9 times the naive interval)`."""
    factor, unit = (1e3, "ms") if one.unit == "s" else (1.0, "" if one.unit == "1" else one.unit)
    value, low, high = (factor * x for x in (one.value, one.low, one.high))
    space = f" {unit}" if unit else ""
    width = high - low
    digits = 4
    if 0.0 < width < abs(value):
        # As many as make the ends of a narrow interval differ.
        digits = min(max(4, math.ceil(math.log10(abs(value) / width)) + 2), 9)
    if 0.0 <= value < 1e-3 * width:
        value = 0.0  # a search ends just inside its range
        low = 0.0 if low < 1e-3 * width else low
    said = f"{one.name} {value:.{digits}g}{space} (95 %: {low:.{digits}g} to {high:.{digits}g}"
    if one.wider > 0.0 and math.isfinite(one.wider):
        said += f"; {math.hypot(one.wider, one.bias / _NAIVE):.2g} times the naive interval"
    said += ")"
    return said if one.identified else f"{said}: not identified, {one.reason}"


def milliseconds(time: float) -> str:
    """`2.1`, and `0` for what is none [s]."""
    return "0" if abs(time) < 5e-7 else f"{1e3 * time:.3g}"


def combined(ladder: Ladder) -> list[str]:
    """Which combinations are known where single numbers are not."""
    chosen, log = ladder.chosen, ladder.fitted[0]
    known = chosen.knowledge
    said = [f"{' and '.join(names)} cannot be told apart by these logs" for names in _sets(chosen)]
    longest = too_long(ladder)
    if longest is not None:  # nor is their sum what it seems
        return [*said, f"the delay {beyond(longest.value)}"]
    unsure = [e for e in known.estimates if e.name in (DELAY, WN, ZETA, "lag") and not e.identified]
    if unsure and known.lag is not None:
        value, deviation = known.lag
        half = 1.96 * deviation
        if half < 0.3 * max(value, log.period):
            said.append(
                f"only delay + 2 zeta/wn = {1e3 * value:.4g} ms (+- {1e3 * half:.2g}) is known; a"
                f" PRBS of {5e3 * max(log.period, 1e-3):.3g} ms would separate them"
            )
    return said


def left_out(identified: Identified) -> list[str]:
    """The delay, where the chosen model has none: what it is known to be in the one that has."""
    chosen = identified.ladder.chosen
    if DELAY in chosen.rung.free:
        return []
    joint, drive = chosen.joint, chosen.rung.dynamics
    names = ("delay",) if drive == "gain" else (f"{drive} with delay",)
    beside = [
        one for one in identified.ladder.candidates
        if one.joint == joint and one.rung.dynamics in names
    ]  # fmt: skip
    return [
        f"with a delay as well ({one.rung.name}): {estimate(one.knowledge[DELAY])}"
        for one in beside
    ]


def collinear(identified: Identified) -> list[str]:
    """What cannot be told apart in models that were not chosen and are nearly as good."""
    chosen = identified.ladder.chosen
    said = {
        f"{' and '.join(names)} cannot be told apart ({one.rung.name})": None
        for one in identified.ladder.candidates
        if one is not chosen and one.error <= _NEARLY_AS_GOOD * chosen.error
        for names in _sets(one)
    }
    return list(said)


def _sets(one: Candidate) -> list[tuple[str, ...]]:
    return [names for names in one.knowledge.combinations if len(names) > 1]


def unstable_delay(identified: Identified) -> list[str]:
    """Whether the delay depends on what is assumed of friction."""
    ladder = identified.ladder
    mere = [one for one in ladder.candidates if one.rung.dynamics == DELAY and one.rung.friction]
    if all(ladder.chosen.error < FAR_FROM_A_DELAY * one.error for one in mere):
        return []
    delays = {one.rung.friction: one.knowledge[DELAY].value for one in mere}
    period = ladder.fitted[0].period
    if len(delays) < 2 or max(delays.values()) - min(delays.values()) < 0.5 * period:
        return []
    each = ", ".join(f"{name} {milliseconds(delay)}" for name, delay in delays.items())
    return [
        "a delay by itself is not stable, it makes up for what friction lacks; by the friction"
        f" assumed [ms]: {each}"
    ]


def stated(identified: Identified) -> list[str]:
    """That forces are those of stated gains, where no command confirms them."""
    chosen, log = identified.ladder.chosen, identified.ladder.fitted[0]
    free = set(chosen.rung.free)
    if log.gains[0] is None or "command" in log or "inertia" not in free or "gain" in free:
        return []
    return [
        "inertia and friction are in proportion to the gains that the map states, which no"
        " command in the logs confirms; damping that kd lacks would be viscous friction here"
    ]


def alignment(chosen: Candidate, log: Log) -> list[str]:
    """That a tick of the delay may be the log's."""
    if log.period > _COARSE:
        return [
            f"what is commanded is taken to hold from row to row ({1e3 * log.period:.3g} ms): of a"
            " log thinner than its loop, so much of the delay may be the log's"
        ]
    if log.stamp != "end" or effective_lag(chosen.numbers) < 0.5 * log.period:
        return []
    return [
        f"rows are stamped at the end of the tick: up to {1e3 * log.period:.3g} ms of the delay may"
        " be the log's own alignment"
    ]
