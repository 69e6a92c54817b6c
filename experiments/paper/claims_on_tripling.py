"""Claims of the summary (section 3.4), of the experiment (4) and of the conclusion (5)."""

from __future__ import annotations

import numpy as np
import study
from claim import KINDS, Claim, by_actuator, by_damping, number, of_actuators

from jaxact.plotting.wording import display_name
from results import Results

_QUADRUPED = (
    "One joint with its delay in the loop is judged here; the study's experiment was a whole "
    "quadruped, with setpoint, measurement and output delay, quantisation and noise. Such a robot "
    "is in [results/quadruped](../quadruped/README.md)."
)


def on_tripling(results: Results) -> list[Claim]:
    """Sections 3.4, 4 and 5."""
    judges = (_unmodelled_delay, _coupling, _real_time, _bare, _revealed, _unaltered, _not_revealed)
    return [judge(results) for judge in judges]


def _unmodelled_delay(results: Results) -> Claim:
    growth = results.growth_rate["tripled"]
    nominal = results.growth_rate["nominal"]
    cases = [
        (f"{name}{words}", d, ok)
        for words, rates in ((" as it is", nominal), (" with tripled gains", growth))
        for name, d, ok in of_actuators((rates > 0.0) & (rates[:, :1] < 0.0))
        if d != f"{0:g} ms"
    ]
    return Claim(
        "3.4",
        "if delays are unmodeled we might oversee a lack in phase margin also rendering the "
        "controller unstable",
        "stable with the actuator's dynamics alone, unstable with the delay as well",
        tuple(cases),
        (
            by_actuator("growth rate, nominal gains, simulated", nominal, "1/s"),
            by_actuator("with tripled gains", growth, "1/s"),
        ),
    )


def _coupling(results: Results) -> Claim:
    margins = results.robots["continuous"]["gain_margin"][1:]
    alone = margins[1, :1] * margins[0] / margins[0, :1]
    return Claim(
        "3.4",
        "there is cross coupling between the resulting effects",
        "delay and slow dynamics together do not cost the product of what each costs alone, within "
        "5 %",
        tuple(
            ("HyQ to StarLETH", f"{1e3 * t:g} ms", bool(abs(a / m - 1.0) > 0.05))
            for t, a, m in zip(study.DELAYS[1:], alone[1:], margins[1, 1:], strict=True)
        ),
        tuple(
            f"StarLETH with {1e3 * t:g} ms: gain margin {number(m)}, the product {number(a)}"
            for t, a, m in zip(study.DELAYS[1:], alone[1:], margins[1, 1:], strict=True)
        ),
    )


def _real_time(results: Results) -> Claim:
    del results
    return Claim(
        "4",
        "the simulator can still run in real-time, despite integrating 18 actuator systems at "
        "kilohertz rates",
        unjudged="it is of the authors' simulator and computer",
    )


def _bare(results: Results) -> Claim:
    """Tripled gains without actuator: no delay either, as the bare simulation has none."""
    margins = [results.robots[kind]["gain_margin"][0, 0] for kind in KINDS]
    growth = results.growth_rate["tripled"][0, 0]
    return Claim(
        "4",
        "the bare simulation suggests that these gains [times 3] are stable",
        "",
        (("", "", bool(all(m > 3.0 for m in margins) and growth < 0.0)),),
        (
            f"gain margin {number(margins[0])} in continuous time, {number(margins[1])} at 1 kHz; "
            f"simulated growth rate {number(growth)} 1/s",
        ),
    )


def _revealed(results: Results) -> Claim:
    growth = results.growth_rate["tripled"]
    unstable = np.all([results.robots[kind]["gain_margin"] < 3.0 for kind in KINDS], axis=0)
    limits = [results.tripled_boundary["continuous"][z] for z in range(len(study.DAMPING_RATIOS))]
    least = 1e3 * results.tripled["delay_margin"][:, 0]
    words = ", ".join(
        f"{display_name(name)} {number(one)}"
        for name, one in zip(study.ROBOTS, least, strict=True)
    )  # fmt: skip
    return Claim(
        "4",
        "Enabling the low-level actuation model, reveals the instability due to the over-tuning",
        "tripled gains are unstable in continuous time, sampled and simulated",
        of_actuators(unstable & (growth > 0.0)),
        (
            *(
                by_actuator(f"gain margin ({kind})", results.robots[kind]["gain_margin"])
                for kind in KINDS
            ),
            by_actuator("growth rate with tripled gains, simulated", growth, "1/s"),
            f"delay in the loop from which tripled gains are unstable: {words} ms",
            by_damping("tripled gains are unstable below", limits, "rad/s"),
            _QUADRUPED,
        ),
    )


def _unaltered(results: Results) -> Claim:
    growth = results.growth_rate["nominal"]
    stable = np.all([results.robots[kind]["stable"] for kind in KINDS], axis=0) & (growth < 0.0)
    return Claim(
        "4",
        "The unaltered hardware tuned gains are stable both in the bare and in the improved "
        "simulator",
        "the study's kp = 400, kd = 20",
        (("no actuator dynamics", "", bool(np.all(stable[0]))), *of_actuators(stable)),
        (by_actuator("growth rate, simulated", growth, "1/s"),),
    )


def _not_revealed(results: Results) -> Claim:
    bare = results.robots["sampled"]["gain_margin"][0, 0]
    real = results.robots["sampled"]["gain_margin"]
    return Claim(
        "5",
        "An actuator dynamic free, noise-free simulation does not reveal gain margins, encouraging "
        "over-tuning",
        "at 1 kHz it shows more than twice the margin that is there",
        of_actuators(bare > 2.0 * real),
        (by_actuator(f"{number(bare)} without delay or dynamics instead of", real),),
    )
