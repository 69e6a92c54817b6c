"""Claims on the gain margin (section 3.1) and on the phase and delay margin (3.2), figure 3."""

from __future__ import annotations

import math

import numpy as np
import study
from claim import (
    KINDS,
    Claim,
    by_actuator,
    by_damping,
    delay,
    number,
    of_actuators,
    percent,
    reaching,
    row,
)  # fmt: skip

from jaxact.plotting.wording import display_name
from results import CONTROL_RATES, FASTER, PADE_ORDERS, Results

_IDEAL = study.ROBOTS.index("ideal")
_DROP = (3, 5)
_NOTICEABLE = 0.1  # share of a gain margin
_SAME = 0.01  # what counts as the same frequency [-]
_SLOW = 200.0  # the study's limit of slow actuators [rad/s]
_QUARTER = 0.25
_SMALL_DELAY = 5e-3  # [s], "small delays in the millisecond range", "up to 5 ms"
_CRITICAL = 2.0  # sensitivity peak from which a loop counts as critical [-]


def on_margins(results: Results) -> list[Claim]:
    """Sections 3.1 and 3.2."""
    judges = (
        _infinite, _finite_when_sampled, _faster_sampling, _not_indefinitely, _monotone, _drop,
        _delays_matter, _angle, _asymptote, _slow_loses, _shifts, _small_delays, _critical,
    )  # fmt: skip
    return [judge(results) for judge in judges]


def _infinite(results: Results) -> Claim:
    kinds = dict(zip(("continuous time", "sampled"), KINDS, strict=True))
    margins = {words: results.robots[kind]["gain_margin"][_IDEAL] for words, kind in kinds.items()}
    return Claim(
        "3.1",
        "The system without actuator dynamics ... has infinite gain margin",
        "",
        tuple(
            (kind, delay(d), math.isinf(margin))
            for kind, one in margins.items()
            for d, margin in enumerate(one)
        ),
        tuple(f"gain margin, {kind}: {row(one)}" for kind, one in margins.items()),
    )


def _finite_when_sampled(results: Results) -> Claim:
    continuous, sampled = (results.robots[kind]["gain_margin"][_IDEAL, 0] for kind in KINDS)
    measured = results.simulated_robots["gain_margin"][_IDEAL, 0]
    return Claim(
        "3.1",
        "this fact does not hold in simulation since we observe instabilities with finite gains. "
        "This results from the discrete implementation",
        "without actuator dynamics and delay, at 1 kHz",
        (("", "", math.isinf(continuous) and math.isfinite(sampled) and math.isfinite(measured)),),
        (
            f"gain margin: {number(continuous)} in continuous time, {number(sampled)} sampled, "
            f"{number(measured)} simulated",
        ),
    )


def _faster_sampling(results: Results) -> Claim:
    margins = results.rates[_IDEAL, 0]
    growth = np.diff(np.log(margins)) / np.diff(np.log(CONTROL_RATES))
    return Claim(
        "3.1",
        "we can mitigate this limitation by increasing our sampling/integration rates",
        "without actuator dynamics and delay the gain margin rises in proportion to the rate",
        (("", "", bool(np.all(np.abs(growth - 1.0) < 1e-3))),),
        (f"gain margin at {row(CONTROL_RATES)} Hz: {row(margins)}",),
    )


def _not_indefinitely(results: Results) -> Claim:
    d = study.NOMINAL_DELAY
    limits = results.robots["continuous"]["gain_margin"]
    lines = [
        f"{display_name(name)}, {delay(d)}, at {row(CONTROL_RATES)} Hz: "
        f"{row(results.rates[r, d])}; in continuous time {number(limits[r, d])}"
        for r, name in enumerate(study.ROBOTS)
        if r != _IDEAL
    ]
    rising = np.all(np.diff(results.rates, axis=-1) > 0.0, axis=-1)
    return Claim(
        "3.1",
        "we can also increase sampling on real hardware or simulate the system with actuator "
        "dynamics, this will not help indefinitely",
        "with actuator dynamics the margin rises with the rate, but not above its continuous value",
        of_actuators(rising & (results.rates[..., -1] < limits)),
        tuple(lines),
    )


def _monotone(results: Results) -> Claim:
    cases = []
    for kind in KINDS:
        rows = results.curves[kind]["gain_margin"].reshape((-1, len(results.natural_frequency)))
        rising = [bool(np.all(np.diff(one[np.isfinite(one)]) > 0.0)) for one in rows]
        cases.append((kind, "", all(rising)))
    return Claim(
        "3.1",
        "our gain margin monotonically decreases with the dynamics of our actuator model",
        "the slower the actuator, the smaller, along each curve",
        tuple(cases),
    )


def _drop(results: Results) -> Claim:
    """The range: from HyQ to StarLETH, which differ in both parameters, or along one curve."""
    cases, lines = [], []
    slow = np.argmin(np.abs(results.natural_frequency - results.robot_frequency[-1]))
    for kind in KINDS:
        robots = results.robots[kind]["gain_margin"]
        curves = results.curves[kind]["gain_margin"]
        drops = {"HyQ to StarLETH": robots[1] / robots[2]}
        for z, zeta in enumerate(study.DAMPING_RATIOS):
            drops[f"800 to 110 rad/s with ζ {zeta:g}"] = curves[z, :, -1] / curves[z, :, slow]
        with np.errstate(invalid="ignore"):
            drops["no actuator dynamics to HyQ"] = robots[0] / robots[1]
        for words, ratios in drops.items():
            lines.append(f"{words} ({kind}): {row(ratios)}")
            cases += [
                (words, delay(d), math.isfinite(ratio) and _DROP[0] <= round(ratio) <= _DROP[1])
                for d, ratio in enumerate(ratios)
            ]
    both = {case[:2]: True for case in cases}
    for *case, ok in cases:
        both[tuple(case)] &= ok
    return Claim(
        "3.1",
        "gain margin can drop by a factor of 3 to 5 for the chosen range",
        "rounded to whole numbers, in continuous time and sampled",
        tuple((*case, ok) for case, ok in both.items()),
        tuple(lines),
    )


def _delays_matter(results: Results) -> Claim:
    margins = results.robots["continuous"]["gain_margin"]
    with np.errstate(invalid="ignore"):
        lost = 1.0 - margins / margins[:, :1]
    lines = [by_actuator("gain margin", margins)]
    for order, found in zip(PADE_ORDERS, results.pade, strict=True):
        lines.append(by_actuator(f"with a Padé approximation of order {order}", found))
    words = ", ".join(
        f"{display_name(name)} {row(100.0 * one)}"
        for name, one in zip(study.ROBOTS, lost, strict=True)
        if name != "ideal"
    )
    return Claim(
        "3.1",
        "Even delays in the millisecond range influence the gain margin significantly",
        f"the actuator's delay takes more than {percent(_NOTICEABLE)} of it",
        tuple(case for case in of_actuators(lost > _NOTICEABLE) if case[1] != delay(0)),
        (*lines, f"lost to the delay: {words} %"),
    )


def _angle(results: Results) -> Claim:
    """What the study draws and calls delay margin."""
    cases, spans, off = [], [], {}
    for kind in KINDS:
        curves = results.curves[kind]
        stable = curves["stable"].astype(bool)
        crossover = curves["gain_crossover"][stable]
        ratio = curves["phase_margin"][stable] / crossover / curves["delay_margin"][stable]
        off[kind] = np.abs(ratio - 1.0)
        low, high = float(np.min(crossover)), float(np.max(crossover))
        cases.append((kind, "", high < (1.0 + _SAME) * low))
        spans.append(f"{number(low)} to {number(high)} rad/s ({kind})")
    found = results.robots["continuous"]
    return Claim(
        "3.2",
        "The delay margin is thus defined as DM = min(180° + ∠G(jω_gc))",
        "this angle stands for the delay that can be added if all loops have the same crossover "
        f"frequency, within {percent(_SAME)}",
        tuple(cases),
        (
            "It is the phase margin. The delay margin is the smallest (phase margin)/ω over all "
            f"gain crossovers; in {np.sum(off['continuous'] < 1e-9)} of the "
            f"{off['continuous'].size} stable continuous loops here that is the phase margin "
            "divided by its crossover frequency. A sampled loop's added delay need not be whole "
            f"control periods: in the {off['sampled'].size} stable ones its margin is within "
            f"{number(1e6 * np.max(off['sampled']))} millionths of that.",
            f"crossover frequencies: {', '.join(spans)}",
            by_actuator("phase margin", np.degrees(found["phase_margin"]), "deg"),
            by_actuator("delay margin", 1e3 * found["delay_margin"], "ms"),
        ),
    )


def _asymptote(results: Results) -> Claim:
    ideal = results.robots["continuous"]["delay_margin"][_IDEAL]
    missing = ideal[:, None] - results.faster["delay_margin"]
    ratio = missing[..., 1:] / missing[..., :-1]
    d = study.NOMINAL_DELAY
    return Claim(
        "3.2",
        "the delay margin asymptotically approaches the one of the model without actuator dynamics",
        "what is missing halves, within 5 %, with every doubling of ωn",
        tuple(
            (f"ζ {zeta:g}", delay(i), bool(np.all(np.abs(ratio[z, i] - 0.5) < 0.025)))
            for z, zeta in enumerate(study.DAMPING_RATIOS)
            for i in range(len(study.DELAYS))
        ),
        (
            by_damping(f"missing at {row(FASTER)} rad/s, {delay(d)}", 1e3 * missing[:, d], "ms"),
        ),
    )  # fmt: skip


def _slow_loses(results: Results) -> Claim:
    ideal = results.robots["continuous"]["delay_margin"][_IDEAL]
    wn = results.natural_frequency
    lost = 1.0 - results.curves["continuous"]["delay_margin"] / ideal[:, None]
    places = [int(np.argmin(np.abs(wn - w))) for w in (_SLOW, results.robot_frequency[-1])]
    names = " / ".join(f"{wn[i]:.3g}" for i in places)
    d = study.NOMINAL_DELAY
    limits = [[reaching(wn, one, _QUARTER) for one in family] for family in lost]
    return Claim(
        "3.2",
        "For dynamics below 200 rad/s which we e.g. see in StarLETH, the gain margin drops "
        "significantly",
        "of the delay margin, which the paragraph is on: at StarLETH's natural frequency at least "
        "a quarter of that without actuator dynamics is gone",
        tuple(
            (f"ζ {zeta:g}", delay(i), bool(lost[z, i, places[1]] >= _QUARTER))
            for z, zeta in enumerate(study.DAMPING_RATIOS)
            for i in range(len(study.DELAYS))
        ),
        (
            by_damping(f"lost at {names} rad/s, {delay(d)}", 100.0 * lost[:, d, places], "%"),
            by_damping("a quarter is lost below", limits, "rad/s"),
            by_damping(
                "gain margin there",
                results.curves["continuous"]["gain_margin"][:, d, places],
            ),
        ),
    )


def _shifts(results: Results) -> Claim:
    cases = []
    for kind in KINDS:
        margins = results.curves[kind]["delay_margin"]
        shift = margins[:, :1] - margins - np.array(study.DELAYS)[:, None]
        cases.append((kind, "", bool(np.nanmax(np.abs(shift)) < 1e-9)))
    return Claim(
        "3.2",
        "Any additional delay in the system will shift the delay margin further down",
        "by exactly that delay, as a time",
        tuple(cases),
    )


def _small_delays(results: Results) -> Claim:
    nominal = results.robots["continuous"]["delay_margin"]
    tripled = results.tripled["delay_margin"]
    wn = results.natural_frequency
    curves = results.curves["continuous"]["delay_margin"]
    limits = [[reaching(wn, -one, -_SMALL_DELAY) for one in family] for family in curves]
    cases = [
        (f"{name}{words}", d, ok)
        for words, margins in ((" as it is", nominal), (" with tripled gains", tripled))
        for name, d, ok in of_actuators(~(margins > _SMALL_DELAY))
    ]
    return Claim(
        "3.2",
        "for systems with parameters in comparable range ..., small delays in the millisecond "
        "range might lead to an unstable system",
        f"another {1e3 * _SMALL_DELAY:g} ms or less",
        tuple(cases),
        (
            by_actuator("delay margin", 1e3 * nominal, "ms"),
            by_actuator("with tripled gains", 1e3 * tripled, "ms (-: unstable)"),
            by_damping("nominal gains: small delays suffice below", limits, "rad/s"),
        ),
    )


def _critical(results: Results) -> Claim:
    wn = results.natural_frequency
    peaks = results.curves["continuous"]["sensitivity_peak"][:, study.DELAYS.index(_SMALL_DELAY)]
    start = results.boundary["continuous"][:, study.DELAYS.index(_SMALL_DELAY)]
    slow = np.argmin(np.abs(wn - results.robot_frequency[-1]))
    fast = wn >= _SLOW
    return Claim(
        "3.2",
        "delays of up to 5 ms and above, which can become critical for actuators with slow "
        "dynamics (ωn < 200 rad/s)",
        f"with 5 ms Ms is above {_CRITICAL:g} at StarLETH's natural frequency, and not from 200 "
        "rad/s on",
        tuple(
            (f"ζ {zeta:g}", "", bool(one[slow] > _CRITICAL and np.all(one[fast] < _CRITICAL)))
            for zeta, one in zip(study.DAMPING_RATIOS, peaks, strict=True)
        ),
        (
            by_damping("Ms above that below", [[reaching(wn, one, _CRITICAL)] for one in peaks],
                       "rad/s"),
            by_damping("unstable below", [[one] for one in start], "rad/s"),
        ),
    )  # fmt: skip
