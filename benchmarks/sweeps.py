"""The sweeps of this machine: mass plant and MJX, as a user runs them."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.commands import python
from jaxact.loops import reading
from jaxact.loops.samples import Samples, expand
from jaxact.loops.specification import Specification
from jaxact.simulation import execute, plans
from jaxact.simulation.spectra import Rates

LOOP = {"actuator": "hyq", "delay": 0.005}


def written(engine: str, gains: int, duration: float, **options: object) -> str:
    """TOML of a grid of gains x gains around the study's loop with HyQ's actuator and 5 ms."""
    text = [f'engine = "{engine}"', f"duration = {duration}"]
    text += [f"{name} = {value}" for name, value in options.items() if name == "physics_step"]
    text += ["[parameters]", 'actuator = "hyq"', "delay = 0.005"]
    text += [f"{name} = {value}" for name, value in options.items() if name != "physics_step"]
    text += ["[axes]", f'kp = {{min = 10, max = 2000, num = {gains}, spacing = "log"}}']
    text += [f'kd = {{min = 5, max = 60, num = {gains}, spacing = "log"}}']
    return "\n".join(text)


def specification(engine: str, gains: int, duration: float, **options: object) -> Specification:
    """The same, read."""
    return reading.parse(written(engine, gains, duration, **options))


def command(engine: str, gains: int, duration: float) -> Callable[[], float]:
    """`jaxact sweep` from the shell, start to finished store; units: loop steps."""
    asked = specification(engine, gains, duration)
    units = steps(asked, expand(asked))

    def run() -> float:
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "sweep.toml").write_text(written(engine, gains, duration))
            words = ("sweep", "sweep.toml", "--out", "out", "--quiet")
            python("-m", "jaxact", *words, folder=Path(folder))()
        return units

    return run


def steps(asked: Specification, samples: Samples) -> int:
    """Loop steps in a sweep: control periods of all loops, from all their starts."""
    cases = [plan.case for plan in plans.groups(asked, samples)]
    each = sum(case.rollout.ticks * (1 + len(case.starts)) for case in cases)
    return each * len(samples)


def whole(asked: Specification) -> Callable[[], float]:
    """The whole sweep: growth rates, rollouts with metrics, verdicts; units: loop steps."""
    samples = expand(asked)
    units = steps(asked, samples)

    def run() -> float:
        execute.run(asked, samples)
        return units

    return run


def rollouts(asked: Specification) -> Callable[[], float]:
    """Only the rollouts with their metrics, growth rates given; units: loop steps."""
    samples = expand(asked)
    (plan,) = plans.groups(asked, samples)
    rates = Rates(np.zeros(plan.batch))
    units = steps(asked, samples)

    def run() -> float:
        for numbers, _ in plans.batches(plan, samples):
            execute.simulate_batch(plan, asked, samples, numbers, rates)
        return units

    return run


def with_everything(asked: Specification) -> Specification:
    """The same sweep with the full drive: three delays, quantisation, noise."""
    full: dict[str, float | str] = {
        "measurement_delay": 0.0012,
        "setpoint_delay": 0.002,
        "position_resolution": 1e-5,
        "velocity_resolution": 1e-3,
        "command_resolution": 0.01,
        "position_noise": 1e-5,
        "velocity_noise": 1e-3,
    }
    return dataclasses.replace(asked, parameters=dict(asked.parameters) | full)
