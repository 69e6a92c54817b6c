"""Tuned gains against rules and other optimisers, on the same joints; see README.md."""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import cma
import jax
import jax.numpy as jnp
import numpy as np
import optax
import reference
import scipy.optimize

from jaxact.tuning.goal import Goal
from jaxact.tuning.joint import problem as joint
from jaxact.tuning.joint.ensemble import Ensemble, ensemble
from jaxact.tuning.joint.problem import Case
from jaxact.tuning.joint.response import timed
from jaxact.tuning.joint.search import tune_all

RESULTS = Path("results/tuning")
MAX_PEAK = 1.6
_STUDY = [(0.7, 800.0, 0.45, 1e-3), (0.7, 800.0, 0.45, 5e-3), (0.7, 110.0, 0.9, 1e-3),
          (0.7, 110.0, 0.9, 5e-3)]  # fmt: skip
# Beyond stability there is nothing to compare: a wall for the optimisers.
_WALL, _PENALTY = 20.0, 40.0


def plants(number: int, seed: int = 5) -> list[Ensemble]:
    """The study's joints, and random ones over the range of real joints."""
    random = np.random.default_rng(seed)
    drawn = [
        (np.exp(random.uniform(np.log(0.02), np.log(8.0))),
         np.exp(random.uniform(np.log(40.0), np.log(1200.0))),
         random.uniform(0.25, 1.3), random.uniform(0.0, 12e-3))
        for _ in range(number)
    ]  # fmt: skip
    return [ensemble(*row) for row in [*_STUDY, *drawn]]


class Counted:
    """The exact problem of one joint as other optimisers want it; counts its evaluations."""

    def __init__(self, case: Case, origin: np.ndarray):
        self.case, self.origin, self.number = case, origin, 0

    def metrics(self, x: np.ndarray) -> tuple[float, float, bool]:
        """ln kp, largest violation and whether stable, at log-gains relative to the origin."""
        self.number += 1
        gains = (np.asarray(x) + self.origin)[None]
        rows = joint.problem([self.case])(gains)
        usable = bool(rows.usable[0])
        return float(gains[0, 0]), float(rows.violation[0]) if usable else _WALL, usable

    def penalised(self, x: np.ndarray) -> float:
        """-ln kp + penalty on the violation."""
        value, violation, stable = self.metrics(x)
        if not stable:
            return _WALL * _PENALTY + float(np.sum(np.abs(x)))
        return -value + _PENALTY * max(violation, 0.0)

    def room(self, x: np.ndarray) -> float:
        """What is left of the constraints, for SLSQP."""
        return -self.metrics(x)[1]


Method = Callable[[Case], tuple[np.ndarray, int]]
"""A case -> log-gains, and the loops evaluated."""


def _simc(case: Case) -> tuple[np.ndarray, int]:
    kp, kd, number = reference.simc(case.members)
    return np.log([kp, kd]), number


def _damping(case: Case) -> tuple[np.ndarray, int]:
    kp, kd, number = reference.damping_rule(case)
    return np.log([kp, kd]), number


def _phase(case: Case) -> tuple[np.ndarray, int]:
    kp, kd, number = reference.phase_margin(case.members)
    return np.log([kp, kd]), number


def _nelder_mead(case: Case) -> tuple[np.ndarray, int]:
    origin = _simc(case)[0]
    counted = Counted(case, origin)
    found = scipy.optimize.minimize(
        counted.penalised, np.zeros(2), method="Nelder-Mead",
        options={"xatol": 1e-6, "fatol": 1e-8, "maxfev": 2000},
    )  # fmt: skip
    return found.x + origin, counted.number


def _slsqp(case: Case) -> tuple[np.ndarray, int]:
    origin = _simc(case)[0]
    counted = Counted(case, origin)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it says so when its line search leaves the stable set
        found = scipy.optimize.minimize(
            lambda x: -x[0], np.zeros(2), method="SLSQP", bounds=[(-4.0, 4.0)] * 2,
            constraints=[{"type": "ineq", "fun": counted.room}],
        )  # fmt: skip
    return found.x + origin, counted.number


def _cma(case: Case) -> tuple[np.ndarray, int]:
    origin = _simc(case)[0]
    counted = Counted(case, origin)
    search = cma.CMAEvolutionStrategy(np.zeros(2), 0.3, {"verbose": -9, "seed": 1, "tolfun": 1e-8})
    search.optimize(counted.penalised)
    return np.asarray(search.result.xbest) + origin, counted.number


def _simulation(case: Case) -> tuple[np.ndarray, int]:
    """Adam on the rms error of a simulated step response: the trap the margins keep out of."""
    how = timed(Goal(objective="settling"), [case.members])
    assert how is not None
    plant = jnp.array([case.members.mass[0], case.members.natural_frequency[0],
                       case.members.damping_ratio[0], case.members.delay[0]])  # fmt: skip

    @jax.jit
    def slope(x: jax.Array) -> jax.Array:
        return jax.jacfwd(lambda y: jnp.sqrt(jnp.mean(how.errors(*jnp.exp(y), plant) ** 2)))(x)

    steps = 200
    chain = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(0.05))
    x = jnp.asarray(_simc(case)[0], jnp.float32)
    state = chain.init(x)
    for _ in range(steps):
        change, state = chain.update(jnp.nan_to_num(slope(x)), state)
        x = optax.apply_updates(x, change)
    return np.asarray(x, float), steps


METHODS: dict[str, Method] = {
    "SIMC, critical damping": _simc,
    "damping ratio 0.7": _damping,
    "phase margin 60°": _phase,
    "Nelder-Mead": _nelder_mead,
    "SLSQP": _slsqp,
    "CMA-ES": _cma,
    "simulation loss, nothing else": _simulation,
}


def main() -> None:
    """Run every method on every joint, print the table and write it."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--quick", action="store_true", help="two joints, nothing written")
    quick = parser.parse_args().quick
    cases = [Case(members, Goal(max_peak=MAX_PEAK)) for members in plants(0 if quick else 16)]
    cases = cases[:2] if quick else cases
    start = time.perf_counter()
    tuned = tune_all(cases)
    found = {"jaxact": [(np.log([t.kp, t.kd]), t.evaluations) for t in tuned]}
    print(f"jaxact: {time.perf_counter() - start:.1f} s, compilation included", flush=True)
    for name, method in METHODS.items():
        start = time.perf_counter()
        found[name] = [method(case) for case in cases]
        print(f"{name}: {time.perf_counter() - start:.1f} s", flush=True)
    rows = judged(cases, found)
    text = markdown(rows, len(cases))
    print(text)
    if not quick:
        RESULTS.mkdir(parents=True, exist_ok=True)
        (RESULTS / "baselines.md").write_text(text, encoding="utf-8")
        (RESULTS / "baselines.json").write_text(json.dumps(rows, indent=1) + "\n", "utf-8")
        print(f"written to {RESULTS}")


def judged(cases: list[Case], found: dict[str, list[tuple[np.ndarray, int]]]) -> list[dict]:
    """A row for each method: kp relative to the best, constraints met, peak reached, price."""
    peaks, stiffness = {}, {}
    for name, ends in found.items():
        x = np.array([gains for gains, _ in ends])
        rows = joint.problem(cases)(x)
        peaks[name] = np.where(rows.usable, MAX_PEAK * np.exp(rows.violation), np.inf)
        stiffness[name] = np.exp(x[:, 0])
    met = {name: peak <= MAX_PEAK * (1.0 + 1e-3) for name, peak in peaks.items()}
    best = np.max([np.where(met[n], stiffness[n], 0.0) for n in found], axis=0)
    table = []
    for name, ends in found.items():
        ratio = (stiffness[name] / best)[met[name]]
        table.append({
            "method": name,
            "met": int(met[name].sum()),
            "median": float(np.median(ratio)) if ratio.size else None,
            "worst": float(ratio.min()) if ratio.size else None,
            "largest_peak": float(peaks[name].max()) if np.isfinite(peaks[name].max()) else "inf",
            "evaluations": float(np.median([number for _, number in ends])),
        })  # fmt: skip
    return table


def markdown(rows: list[dict], number: int) -> str:
    """The rows as a table."""
    lines = [
        "# Tuned gains against rules and other optimisers",
        "",
        f"Made by `python experiments/tuning/baselines.py`: {number} joints, the stiffest kp with",
        f"Ms and Mt at most {MAX_PEAK:g} (met to 0.1 %). kp is relative to the best method that",
        "meets the constraints, over the joints where the method itself does.",
        "",
        "| method | joints with constraints met | kp, median | kp, worst joint | largest peak | "
        "loops evaluated |",
        "|---|---|---|---|---|---|",
    ]

    def cell(value: object) -> str:
        if value is None:
            return "-"
        return "unstable" if value == "inf" else f"{value:.4g}"

    for row in rows:
        cells = (cell(row[key]) for key in ("median", "worst", "largest_peak", "evaluations"))
        lines.append(f"| {row['method']} | {row['met']} of {number} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
