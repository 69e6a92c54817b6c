"""Do the 95 % intervals cover the truth in 95 of 100 logs?

    python experiments/identification/coverage.py [--seeds 200] [--whole 20] [--cases NAME ...]

Logs of known drives, with noise that hangs together (a first-order process), are identified, each
with a seed of its own. For every number it is counted how often its interval contains the truth, at
a fixed model; for the first seeds the whole ladder is climbed as well, and the intervals of the
chosen model count where it is the true one. The table goes to results/identification/coverage.md.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
from scipy import signal

from jaxact.identification import forces, knowledge, motion
from jaxact.identification.fitting import solve
from jaxact.identification.identify import identify
from jaxact.identification.log import Log
from jaxact.identification.model import Family, of_rung
from jaxact.identification.settling import settled

OUT = Path(__file__).resolve().parent.parent.parent / "results" / "identification" / "coverage.md"
FINE = 1e-4


@dataclass(frozen=True)
class Case:
    """One kind of log.

    Attributes:
        title: in words.
        plant: of `identify`.
        rung: the true model's name.
        truth: by name, in the unit of the unknown.
        rate: of the rows [Hz].
        duration: of each log [s].
        logs: that are fitted together.
        noise: standard deviation of the measured signal's noise.
        pole: of the noise, per row.
    """

    title: str
    plant: str
    rung: str
    truth: dict[str, float]
    rate: float = 500.0
    duration: float = 4.0
    logs: int = 1
    noise: float = 0.02
    pole: float = 0.8


def _force(wn: float, zeta: float, delay: float) -> dict[str, float]:
    return {"gain": 0.95, "offset": 0.01, "wn": wn, "zeta": zeta, "delay": delay}


BOTH = "second order with delay"
CASES = {
    "starleth": Case("force of StarLETH's drive, one log", "none", BOTH,
                     _force(110.0, 0.9, 2.3e-3)),
    "hyq": Case("force of HyQ's drive at 1 kHz, one log", "none", BOTH, _force(800.0, 0.45, 1.3e-3),
                rate=1000.0, duration=3.0),
    "slow_noise": Case("the same drive as the first, noise that lasts longer", "none", BOTH,
                       _force(110.0, 0.9, 2.3e-3), pole=0.95),
    "eight": Case("force of StarLETH's drive, eight logs", "none", BOTH,
                  _force(110.0, 0.9, 2.3e-3), duration=1.0, logs=8),
    "joint": Case("position of a joint with friction, one log", "mass", "delay, viscous and dry",
                  {"offset": 0.05, "inertia": 0.7, "viscous": 1.5, "coulomb": 0.8,
                   "delay": 3.1e-3}, noise=1e-4),
}  # fmt: skip


def coloured(generator: np.random.Generator, rows: int, pole: float) -> np.ndarray:
    """Noise of variance 1, a first-order process, shape (rows,)."""
    white = generator.normal(size=rows + 200) * np.sqrt(1.0 - pole**2)
    return signal.lfilter([1.0], [1.0, -pole], white)[200:]


def prbs(generator: np.random.Generator, rows: int, hold: int) -> np.ndarray:
    """Levels of +-1, held for so many rows, shape (rows,)."""
    return np.repeat(generator.choice([-1.0, 1.0], rows // hold + 1), hold)[:rows]


def force_log(case: Case, generator: np.random.Generator) -> Log:
    """Commanded and measured force, by SciPy's sampling of the transfer function."""
    rows, fine = round(case.duration * case.rate), round(1.0 / case.rate / FINE)
    command = prbs(generator, rows, 5)
    command[0] = 0.0
    wn, zeta = case.truth["wn"], case.truth["zeta"]
    b, a, _ = signal.cont2discrete(([wn**2], [1.0, 2.0 * zeta * wn, wn**2]), FINE)
    late = round(case.truth["delay"] / FINE)
    given = np.concatenate([np.zeros(late), np.repeat(command, fine)])[: rows * fine]
    force = case.truth["gain"] * signal.lfilter(b.ravel(), a, given)[::fine] + case.truth["offset"]
    noise = case.noise * coloured(generator, rows, case.pole)
    return Log(
        "synthetic", np.arange(rows) / case.rate, {"command": command, "force": force + noise}
    )


def joint_log(case: Case, generator: np.random.Generator) -> Log:
    """Setpoint and position of a joint under PD control, with friction."""
    rows = round(case.duration * case.rate)
    setpoint = 0.1 * prbs(generator, rows, 60)
    signals = {"setpoint": setpoint, "position": 0.0 * setpoint}
    clean = Log("synthetic", np.arange(rows) / case.rate, signals, unit="m", gains=(400.0, 20.0))
    with jax.enable_x64(True):
        family = motion.family([clean], "mass")
        values = {**family.neutral, **case.truth, "initial_position": 0.0, "initial_velocity": 0.0}
        moved = np.asarray(jax.jit(family.simulate)(values, family.inputs(clean)))[:rows]
    noise = case.noise * coloured(generator, rows, case.pole)
    return Log("synthetic", clean.time, {**signals, "position": moved + noise}, unit="m",
               gains=clean.gains)  # fmt: skip


def family_of(case: Case, logs: list[Log]) -> Family:
    """What is identified."""
    return forces.family(logs) if case.plant == "none" else motion.family(logs, case.plant)


def fixed(case: Case, logs: list[Log]) -> knowledge.Knowledge:
    """Intervals of the true model."""
    with jax.enable_x64(True):
        family = family_of(case, logs)
        rung = next(one for one in family.rungs if one.name == case.rung)
        return knowledge.of_fit(settled(solve(of_rung(family, rung, logs))))


def whole(case: Case, logs: list[Log], other: Log) -> knowledge.Knowledge | None:
    """Intervals of the chosen model, where it is the true one."""
    chosen = identify(logs, case.plant, validate=other).chosen
    return chosen.knowledge if chosen.rung.name == case.rung else None


def count(case: Case, seeds: range, found: Callable) -> tuple[Counter, int]:
    """How often each interval contains the truth, and of how many."""
    inside: Counter = Counter()
    number = 0
    make = force_log if case.plant == "none" else joint_log
    for seed in seeds:
        generator = np.random.default_rng(seed)
        known = found(case, [make(case, generator) for _ in range(case.logs)], generator)
        if known is None:
            continue
        number += 1
        for name, truth in case.truth.items():
            one = known[name]
            inside[name] += one.low <= truth <= one.high
    return inside, number


def main() -> None:
    """Print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--whole", type=int, default=20)
    parser.add_argument("--cases", nargs="*", choices=tuple(CASES), default=tuple(CASES))
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args()
    lines = ["# How often 95 % intervals contain the truth", "",
             "Made by `python experiments/identification/coverage.py`.", "",
             "| logs | identified | " + "of | by number |", "|---|---|---|---|"]  # fmt: skip
    for name in given.cases:
        case = CASES[name]
        make = force_log if case.plant == "none" else joint_log
        ways = {
            "at the true model": (given.seeds, lambda c, logs, _: fixed(c, logs)),
            "by the whole ladder": (
                given.whole, lambda c, logs, g, make=make: whole(c, logs, make(c, g))
            ),
        }  # fmt: skip
        for way, (seeds, found) in ways.items():
            inside, number = count(case, range(seeds), found)
            each = ", ".join(f"{n} {100.0 * inside[n] / max(number, 1):.1f} %" for n in case.truth)
            lines.append(f"| {case.title} | {way} | {number} of {seeds} | {each} |")
            print(lines[-1], flush=True)
    given.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"wrote {given.out}")


if __name__ == "__main__":
    main()
