"""`claims.md`: the claims as a table, what else the figures show, and the numbers behind them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import study
from claim import KINDS, Claim
from claims import claims

from jaxact.plotting.wording import display_name, quantity
from results import Results


def report(results: Results) -> str:
    """The whole document as Markdown; the same results give the same text.

    Args:
        results: from `results.compute`.
    """
    judged = claims(results)
    delays = " / ".join(quantity(delay, "s") for delay in study.DELAYS)
    parts = [
        "# The study's claims, judged",
        f"{study.CITATION}.",
        "Written by `make paper` from computed numbers; not edited by hand. Quoted by section, and "
        f"shortened. Three numbers separated by strokes are for delays of {delays}. Continuous: "
        "exact, in continuous time. Sampled: exact, control at 1 kHz. Simulated: measured on "
        "simulated loops, without the exact formulas. Ideal: no actuator dynamics.",
        "## In one line each",
        _table(
            ["Section", "The study says", "Does it hold?"],
            [[one.section, f"“{one.quote}”", one.verdict] for one in judged],
        ),
        "## Details",
        *(_details(one) for one in judged),
        "## What else the figures show",
        _table(["Statement", "Holds", "Computed"], _observations(results)),
        "## The robots' actuators",
        _robots(results),
        "## Assumed",
        "\n".join(f"- {line}" for line in study.ASSUMED),
        "## Pictures",
        *_PICTURES,
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def _details(claim: Claim) -> str:
    """The verdict first, then what it rests on."""
    lines = [f"**{claim.verdict}.** §{claim.section}: “{claim.quote}”"]
    reading = [f"Read as: {claim.reading}."] if claim.reading else []
    bullets = [f"- {line}" for line in (*reading, *claim.numbers)]
    return "\n\n".join([*lines, "\n".join(bullets)] if bullets else lines)


_PICTURES = (
    "![Figure 2: steps of the force and of the joint](figure_2_steps.png)",
    "![Figure 3: gain, phase and delay margin](figure_3_margins.png)",
    "![Figure 4, over frequency: the sensitivity](figure_4_sensitivity.png)",
    "![Figure 4, over the natural frequency: its peak](figure_4_sensitivity_peak.png)",
)


def _observations(results: Results) -> list[list[str]]:
    return [
        _damping(results),
        _stable_above(results),
        _sampling(results),
        _agreement(results),
    ]


def _damping(results: Results) -> list[str]:
    """Gain margin prefers the damped actuator, phase margin the lightly damped one."""
    words, counts = [], np.zeros((2, 2), int)
    for which, name in enumerate(("gain_margin", "phase_margin")):
        for kind in KINDS:
            light, damped = results.curves[kind][name]
            both = np.isfinite(light) & np.isfinite(damped)
            larger = (damped > light) if which == 0 else (damped < light)
            counts[which] += (int(np.sum(larger & both)), int(np.sum(both)))
    for name, way, (share, total) in zip(
        ("gain margin", "phase margin"), ("larger", "smaller"), counts, strict=True
    ):
        words.append(f"{name} {way} in {share} of {total} loops")
    low, high = study.DAMPING_RATIOS
    done = counts.sum(axis=0)
    return [
        f"The better damped actuator (ζ {high:g} against {low:g}) has the larger gain margin, but "
        "the smaller phase margin.",
        _answer(int(done[0]), int(done[1])),
        "; ".join(words),
    ]


def _stable_above(results: Results) -> list[str]:
    words = []
    for z, zeta in enumerate(study.DAMPING_RATIOS):
        for kind in KINDS:
            limits = [
                f"below {study.LOWEST:g}" if math.isnan(limit) else f"{limit:.3g}"
                for limit in results.boundary[kind][z]
            ]
            words.append(f"ζ {zeta:g} ({kind}): {' / '.join(limits)} rad/s")
    count = sum(int(np.sum(~np.isnan(results.boundary[kind]))) for kind in KINDS)
    total = sum(results.boundary[kind].size for kind in KINDS)
    return [
        "The slowest actuators of the range make even the nominal gains unstable.",
        _answer(count, total),
        "stable from natural frequencies of " + "; ".join(words),
    ]


def _sampling(results: Results) -> list[str]:
    continuous, sampled = (results.curves[kind] for kind in KINDS)
    both = np.isfinite(continuous["gain_margin"]) & np.isfinite(sampled["gain_margin"])
    loss = 100.0 * (1.0 - sampled["gain_margin"][both] / continuous["gain_margin"][both])
    later = 1e3 * (continuous["delay_margin"][both] - sampled["delay_margin"][both])
    count = int(np.sum((loss > 0.0) & (later > 0.0)))
    return [
        "Control at 1 kHz costs margin: the held command comes half a period late on average.",
        _answer(count, int(np.sum(both))),
        f"gain margin {np.min(loss):.2g} to {np.max(loss):.2g} % smaller, delay margin "
        f"{np.min(later):.3g} to {np.max(later):.3g} ms shorter",
    ]


def _agreement(results: Results) -> list[str]:
    """How far simulation and exact theory of the sampled loop are apart."""
    gains, delays = [], []
    for simulated, exact in (
        (results.simulated_curves, {n: results.curves["sampled"][n][..., results.marked]
                                    for n in ("gain_margin", "delay_margin")}),
        (results.simulated_robots, results.robots["sampled"]),
    ):  # fmt: skip
        gains.append(np.abs(simulated["gain_margin"] / exact["gain_margin"] - 1.0).reshape(-1))
        delays.append(np.abs(simulated["delay_margin"] - exact["delay_margin"]).reshape(-1))
    ratio = results.measured_sensitivity / results.measured_reference
    gain, delay = np.concatenate(gains), np.concatenate(delays)
    done = int(np.sum(gain < 1e-3))
    compared = int(np.sum(~np.isnan(gain)))
    return [
        "Simulation and the exact margins of the sampled loop agree, to 0.1 % in gain.",
        _answer(done, compared),
        f"{compared} gain margins within {100 * np.nanmax(gain):.1g} %, as many delay margins "
        f"within {1e6 * np.nanmax(delay):.1g} µs, {ratio.size} points of |S| within "
        f"{100 * np.max(np.abs(ratio - 1.0)):.1g} %",
    ]


def _answer(done: int, total: int) -> str:
    return "yes" if done == total else ("no" if done == 0 else "in some cases")


def _robots(results: Results) -> str:
    head = [
        "Actuator", "Delay", "", "Gain margin", "Simulated", "Phase margin [deg]",
        "Delay margin [ms]", "Simulated [ms]", "Ms", "at [rad/s]",
    ]  # fmt: skip
    rows = []
    for r, name in enumerate(study.ROBOTS):
        for d, delay in enumerate(study.DELAYS):
            for kind in KINDS:
                found = {key: float(array[r, d]) for key, array in results.robots[kind].items()}
                measured = {
                    key: float(array[r, d]) if kind == "sampled" else math.nan
                    for key, array in results.simulated_robots.items()
                }
                numbers = (
                    found["gain_margin"], measured["gain_margin"],
                    math.degrees(found["phase_margin"]), 1e3 * found["delay_margin"],
                    1e3 * measured["delay_margin"], found["sensitivity_peak"],
                    found["sensitivity_peak_frequency"],
                )  # fmt: skip
                cells = [_cell(number) for number in numbers]
                rows.append([display_name(name), quantity(delay, "s"), kind, *cells])
    return _table(head, rows)


def _cell(value: float) -> str:
    if math.isnan(value):
        return ""
    return quantity(value) if math.isinf(value) else f"{value:#.5g}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    safe = [[cell.replace("|", "\\|") for cell in row] for row in rows]
    lines = [head, ["---"] * len(head), *safe]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
