"""What came out, as numbers and as a page for people; both follow from the results alone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import cases
import numpy as np
from gains import DAMPING, RESERVE, Nominal
from pictures import TITLES
from study import HIGHEST, LOWEST, Case, Critical, Situation

from jaxact.parameters import PRESETS
from jaxact.plotting.wording import display_name, quantity

CLOSE = 0.05  # difference of critical gain scales that counts as agreement


def numbers(rule: Nominal, found: Mapping[str, Situation]) -> dict[str, Any]:
    """Everything but the map, for `numbers.json`; infinity and NaN as words."""
    situations = {
        name: {
            "cases": [asdict(case) for case in one.cases],
            "critical": [asdict(row) | {"difference": row.difference} for row in one.critical],
        }
        for name, one in found.items()
    }
    return {"gains": _plain(asdict(rule)), "situations": _plain(situations)}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else str(value)
    return value


def holds(bare: Case, drive: Case) -> str:
    """Whether the study's finding holds for a drive, and if not, what happens instead."""
    if not (bare.calm(0) and bare.calm(1)):
        return "no, bare not stable"
    if not drive.calm(0):
        return "no, nominal not stable"
    return "no, tripled stable" if drive.calm(1) else "**yes**"


def agreeing(found: Mapping[str, Situation]) -> list[tuple[str, Critical]]:
    """Drives in situations whose two critical gain scales agree."""
    return [
        (name, row)
        for name, one in found.items()
        for row in one.critical
        if abs(row.difference) <= CLOSE
    ]


def page(
    rule: Nominal, found: Mapping[str, Situation], pictures: Mapping[str, str], command: str
) -> str:
    """The page, in Markdown.

    pictures: file and caption of each
    command: that made it
    """
    parts = [
        "# Tripled gains on a quadruped",
        f"Written by `{command}`; not edited by hand. What is asked and how it is simulated: "
        "[experiments/quadruped](../../experiments/quadruped/README.md).",
        "## The finding",
        "A bare simulator calls the tripled gains stable, with a model of the drive they are not, "
        "and the nominal gains are stable in both. Whether that is so:",
        _table(
            ["actuator", "delay", *(TITLES[name] for name in found)],
            [
                [_name(one), quantity(one.delay, "s"), *_finding(found, place)]
                for place, one in _drives(found)
            ],
        ),
        _summary(found),
        "## Gains",
        _gains(rule),
        _too_slow(rule),
        *(f"![{caption}]({file})" for file, caption in pictures.items()),
        "## Verdicts",
        "Nominal gains / tripled gains; first without a push, then with one. Bare: ideal "
        "actuators, no delay, perfect sensors; all others with noise, quantisation and bias. In "
        "brackets the growth rates of the linearised loop [1/s].",
        _table(
            ["actuator", "delay", *(TITLES[name] for name in found)],
            [
                [
                    "bare" if one.bare else _name(one),
                    quantity(one.delay, "s"),
                    *(_verdicts(situation.cases[place]) for situation in found.values()),
                ]
                for place, one in enumerate(next(iter(found.values())).cases)
            ],
        ),
        "## How much gain is too much",
        "Both gains of all joints are multiplied. Linear: where the growth rate of the linearised "
        "loop crosses zero. Rollouts: the largest multiplier at which small motions die out in "
        "nonlinear rollouts, without noise and quantisation. The two are computed independently. "
        f"Searched from {LOWEST:g} to {HIGHEST:g}; below the first number the robot topples.",
        _table(
            ["situation", "actuator", "delay", "topples below", "linear", "rollouts", "difference"],
            [
                [TITLES[name], _name(row), quantity(row.delay, "s"), *_limits(row)]
                for name, one in found.items()
                for row in one.critical
            ],
        ),
        _agreement(found),
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def _name(one: Case | Critical) -> str:
    return display_name(one.actuator)


def _drives(found: Mapping[str, Situation]) -> list[tuple[int, Case]]:
    """Number of every drive among the cases; the bare one left out."""
    rows = next(iter(found.values())).cases
    return [(place, case) for place, case in enumerate(rows) if not case.bare]


def _finding(found: Mapping[str, Situation], place: int) -> list[str]:
    return [holds(one.cases[0], one.cases[place]) for one in found.values()]


def _summary(found: Mapping[str, Situation]) -> str:
    rows = [
        f"{_name(one)} with {quantity(one.delay, 's')} ({', '.join(where)})"
        for place, one in _drives(found)
        if (where := [TITLES[n] for n, a in zip(found, _finding(found, place), strict=True)
                      if a == "**yes**"])
    ]  # fmt: skip
    return f"It holds for {_listed(rows)}." if rows else "It holds for none of them."


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _gains(rule: Nominal) -> str:
    toppling = ", ".join(
        f"{value:.0f} N m/rad {TITLES[name]}" for name, value in rule.toppling.items() if value > 0
    )
    kd = ", ".join(
        f"{kind} {value:.3g} ({rule.inertia[kind]:.3g} kg m²)" for kind, value in rule.kd.items()
    )
    return (
        f"Chosen from the bare robot alone. kp = {rule.kp:.3g} N m/rad for all joints: {RESERVE:g} "
        f"times the stiffness below which it topples ({toppling or 'never'}). kd [N m s/rad] is in "
        f"proportion to the least inertia of each kind of joint: {kd}. Their ratio, "
        f"{rule.bandwidth:.0f} rad/s, damps the lightest joint, the knee of a leg in the air, with "
        f"ζ = {DAMPING:g}."
    )


def _too_slow(rule: Nominal) -> str:
    """Which actuators cannot hold the lightest joint, whatever its damping.

    Routh's criterion for J s^2 (s^2 + 2 zeta wn s + wn^2)/wn^2 + kd s + kp, with the best kd.
    """
    knee = math.sqrt(rule.kp / min(rule.inertia.values()))
    finite = {name: PRESETS[name][0] for name in cases.ACTUATORS if PRESETS[name][0] < math.inf}
    limits = ", ".join(f"{display_name(name)}'s {wn / 2:.0f} rad/s" for name, wn in finite.items())
    return (
        f"With this kp, the knee of a leg in the air has √(kp/J) = {knee:.0f} rad/s. Without any "
        "delay, and whatever the damping gain, an actuator can hold a free inertia only while that "
        f"is less than half of its natural frequency: {limits}."
    )


def _verdicts(case: Case) -> str:
    rows = ["/".join(row) for row in case.verdicts]
    rates = " / ".join(f"{rate:.2g}" for rate in case.growth_rates)
    return f"{'; '.join(rows)} ({rates})"


def _limits(row: Critical) -> Iterable[str]:
    if math.isnan(row.linear):
        return ["", "never stable", "", ""]
    topples = f"{row.topples:.3g}" if row.topples > 0.0 else ""
    if math.isinf(row.linear):
        return [topples, f"above {HIGHEST:g}", "", ""]
    if not math.isfinite(row.rollouts):
        return [topples, f"{row.linear:.3g}", "not found nearby", ""]
    return [
        topples, f"{row.linear:.3g}", f"{row.rollouts:.3g}", f"{100.0 * row.difference:+.1f} %",
    ]  # fmt: skip


def _agreement(found: Mapping[str, Situation]) -> str:
    close = agreeing(found)
    whole = [row for one in found.values() for row in one.critical if np.isfinite(row.linear)]
    models = sorted({(row.actuator, row.delay) for _, row in close})
    said = (
        f"Within {100 * CLOSE:g} %: {len(close)} of {len(whole)}, of {len(models)} different drive "
        "models."
    )
    if not whole:
        return "No drive has a critical gain scale in this range."
    largest = max(abs(row.difference) for row in whole)
    return f"{said} The largest difference is {100 * largest:.1f} %."


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
