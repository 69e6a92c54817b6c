"""The study's quantitative claims against what is exactly true, every number from `Results`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import study

from jaxact.plotting.wording import display_name, quantity
from results import Results

KINDS = ("continuous", "sampled")
# "A factor of 3 to 5" is read as rounded to whole numbers, "near 40 rad/s" as within this share.
_DROP = (3, 5)
_PEAK, _NEAR = 40.0, 0.3

# (what it belongs to, one case of it, whether the claim holds there)
Case = tuple[str, str, bool]


@dataclass(frozen=True)
class Claim:
    """One claim, judged.

    says: the study, in other words
    true: what was computed
    cases: for which the claim was judged, and whether it holds there
    """

    says: str
    true: str
    cases: tuple[Case, ...]

    @property
    def holds(self) -> str:
        """`yes`, `in some cases` or `no`."""
        answers = {ok for _, _, ok in self.cases}
        return "in some cases" if len(answers) > 1 else ("yes" if True in answers else "no")

    @property
    def where(self) -> str:
        """For which cases it holds, and for which not."""
        parts = []
        for answer, words in ((True, "holds for"), (False, "does not hold for")):
            chosen = [case for case in self.cases if case[2] is answer]
            if chosen:
                parts.append(f"{words} {_grouped(chosen)}")
        return "; ".join(parts)


def claims(results: Results) -> list[Claim]:
    """Every quantitative claim of the study about the joint's loop, judged.

    results: from `results.compute`
    """
    judges: tuple[Callable[[Results], Claim], ...] = (
        _infinite_without_actuator, _finite_with_actuator, _drops, _delay_margin, _sensitivity,
        _nominal, _tripled_bare, _tripled_with_actuator,
    )  # fmt: skip
    return [judge(results) for judge in judges]


def _infinite_without_actuator(results: Results) -> Claim:
    margins = {kind: results.robots[kind]["gain_margin"][0] for kind in KINDS}
    return Claim(
        "Without an actuator model the gain margin is infinite, so nothing in simulation says that "
        "the gains are too high.",
        _by_kind(margins, "gain margin without actuator dynamics"),
        tuple(
            (kind, _delay(d), math.isinf(margins[kind][d]))
            for kind in KINDS
            for d in range(len(study.DELAYS))
        ),
    )


def _finite_with_actuator(results: Results) -> Claim:
    words, cases = [], []
    for r, name in _actuators():
        margins = {kind: results.robots[kind]["gain_margin"][r] for kind in KINDS}
        words.append(_by_kind(margins, f"{display_name(name)}: gain margin"))
        cases += [
            (display_name(name), _delay(d), all(math.isfinite(margins[k][d]) for k in KINDS))
            for d in range(len(study.DELAYS))
        ]
    return Claim("With the actuator's dynamics it is finite.", "<br>".join(words), tuple(cases))


def _drops(results: Results) -> Claim:
    words, cases = [], []
    names = [display_name(name) for name in study.ROBOTS]
    for a, b in ((0, 1), (0, 2), (1, 2)):
        ratios = {
            kind: results.robots[kind]["gain_margin"][a] / results.robots[kind]["gain_margin"][b]
            for kind in KINDS
        }
        pair = f"{names[a]} to {names[b]}"
        words.append(_by_kind(ratios, pair))
        for kind in KINDS:
            for d, ratio in enumerate(ratios[kind]):
                within = math.isfinite(ratio) and _DROP[0] <= round(ratio) <= _DROP[1]
                cases.append((f"{pair} ({kind})", _delay(d), within))
    return Claim(
        f"With slower actuator dynamics the gain margin drops by a factor of {_DROP[0]} to "
        f"{_DROP[1]} (read as rounded to whole numbers).",
        "Factors: " + "<br>".join(words),
        tuple(cases),
    )


def _delay_margin(results: Results) -> Claim:
    words = []
    for r, name in enumerate(study.ROBOTS):
        found = results.robots["continuous"]
        degrees = _row(np.degrees(found["phase_margin"][r]))
        milliseconds = _row(1e3 * found["delay_margin"][r])
        words.append(
            f"{display_name(name)}: phase margin {degrees} deg, delay margin {milliseconds} ms"
        )
    same = total = 0
    for kind in KINDS:
        curves = results.curves[kind]
        ratio = curves["phase_margin"] / curves["gain_crossover"] / curves["delay_margin"]
        stable = curves["stable"].astype(bool)
        same += int(np.sum(np.abs(ratio[stable] - 1.0) < 1e-9))
        total += int(np.sum(stable))
    words.append(
        f"In {same} of the {total} stable loops of the figure the delay margin is the phase margin "
        "divided by its crossover frequency."
    )
    return Claim(
        "Figure 3 shows the delay margin, in degrees.",
        "It is the phase margin. " + "<br>".join(words),
        (("the quantity drawn", "an angle, not the delay that can be added", False),),
    )


def _sensitivity(results: Results) -> Claim:
    words, cases = [], []
    for r, name in enumerate(study.ROBOTS):
        peaks = {kind: results.robots[kind]["sensitivity_peak_frequency"][r] for kind in KINDS}
        words.append(_by_kind(peaks, f"{display_name(name)}: peak at [rad/s]"))
        cases += [
            (display_name(name), _delay(d), all(_near(peaks[kind][d]) for kind in KINDS))
            for d in range(len(study.DELAYS))
        ]
    for z, zeta in enumerate(study.DAMPING_RATIOS):
        for d in range(len(study.DELAYS)):
            peaks = {k: results.curves[k]["sensitivity_peak_frequency"][z, d] for k in KINDS}
            spans = ", ".join(
                f"{_number(np.nanmin(peaks[k]))} to {_number(np.nanmax(peaks[k]))} ({k})"
                for k in KINDS
            )
            words.append(f"ζ {zeta:g}, {_delay(d)}, all stable ωn: {spans}")
            good = all(_near(peak) for k in KINDS for peak in peaks[k] if not math.isnan(peak))
            if not good:
                kept = (f"{_where_near(results, peaks[k])} ({k})" for k in KINDS)
                words[-1] += f"; near for ωn {', '.join(kept)} rad/s"
            cases.append((f"ζ {zeta:g} over the whole range", _delay(d), good))
    return Claim(
        f"The sensitivity peaks near {_PEAK:g} rad/s (read as within {100 * _NEAR:g} %).",
        "<br>".join(words),
        tuple(cases),
    )


def _nominal(results: Results) -> Claim:
    return Claim(
        "At the nominal gains the loop is stable, with and without the actuator's dynamics.",
        "<br>".join(_growth(results, "nominal", r) for r in range(len(study.ROBOTS))),
        tuple(_verdicts(results, "nominal", range(len(study.ROBOTS)), stable=True)),
    )


def _tripled_bare(results: Results) -> Claim:
    return Claim(
        "With tripled gains a simulation without actuator dynamics is stable.",
        _growth(results, "tripled", 0),
        tuple(_verdicts(results, "tripled", [0], stable=True)),
    )


def _tripled_with_actuator(results: Results) -> Claim:
    words = [_growth(results, "tripled", r) for r, _ in _actuators()]
    for z, zeta in enumerate(study.DAMPING_RATIOS):
        limits = {kind: results.tripled_boundary[kind][z] for kind in KINDS}
        words.append(_by_kind(limits, f"ζ {zeta:g}: unstable below ωn [rad/s]"))
    return Claim(
        "With tripled gains the loop is unstable once the actuator is modelled (the study's "
        "experiment was a whole quadruped, with setpoint, measurement and output delay, "
        "quantisation and noise; judged here is one joint with a command delay only).",
        "<br>".join(words),
        tuple(_verdicts(results, "tripled", [r for r, _ in _actuators()], stable=False)),
    )


def _verdicts(results: Results, gains: str, robots: Iterable[int], *, stable: bool) -> list[Case]:
    """Whether continuous, sampled and simulated loop are all stable, or all not."""
    factor = {"nominal": 1.0, "tripled": 3.0}[gains]
    cases = []
    for r in robots:
        for d in range(len(study.DELAYS)):
            found = [not results.robots[kind]["gain_margin"][r, d] <= factor for kind in KINDS]
            found = [
                answer and bool(results.robots[kind]["stable"][r, d])
                for answer, kind in zip(found, KINDS, strict=True)
            ]
            found.append(bool(results.growth_rate[gains][r, d] < 0.0))
            holds = all(found) if stable else not any(found)
            cases.append((display_name(study.ROBOTS[r]), _delay(d), holds))
    return cases


def _growth(results: Results, gains: str, r: int) -> str:
    name = display_name(study.ROBOTS[r])
    rates = results.growth_rate[gains][r]
    margins = {kind: results.robots[kind]["gain_margin"][r] for kind in KINDS}
    return f"{_by_kind(margins, f'{name}: gain margin')}; simulated growth {_row(rates)} 1/s"


def _actuators() -> list[tuple[int, str]]:
    return [(r, name) for r, name in enumerate(study.ROBOTS) if name != "ideal"]


def _where_near(results: Results, peaks: np.ndarray) -> str:
    """Natural frequencies of a curve where its peak is near, `50 to 62 and 330 to 800`."""
    near = np.concatenate([[False], [_near(peak) for peak in peaks], [False]])
    edges = np.flatnonzero(near[1:] != near[:-1]).reshape((-1, 2))
    wn = results.natural_frequency
    return " and ".join(f"{wn[a]:.3g} to {wn[b - 1]:.3g}" for a, b in edges) or "none"


def _near(frequency: float) -> bool:
    return abs(frequency - _PEAK) <= _NEAR * _PEAK


def _delay(d: int) -> str:
    return quantity(study.DELAYS[d], "s")


def _number(value: float) -> str:
    if math.isnan(value):
        return "-"
    return quantity(value) if math.isinf(value) else f"{value:.3g}"


def _row(values: Iterable[float]) -> str:
    return " / ".join(_number(float(value)) for value in values)


def _by_kind(values: dict[str, np.ndarray], what: str) -> str:
    """`what 1 / 2 / 3 (continuous), 1 / 2 / 3 (sampled)`: one number for each delay."""
    return f"{what} " + ", ".join(f"{_row(values[kind])} ({kind})" for kind in KINDS)


def _grouped(cases: Sequence[Case]) -> str:
    """`StarLETH: 0 ms, 1 ms` for the cases of one thing; several separated by semicolons."""
    groups: dict[str, list[str]] = {}
    for group, item, _ in cases:
        groups.setdefault(group, []).append(item)
    everything = [_delay(d) for d in range(len(study.DELAYS))]
    words = {
        group: "all delays" if items == everything else ", ".join(items)
        for group, items in groups.items()
    }
    return "; ".join(f"{group}: {items}" for group, items in words.items())
