"""What a sweep keeps of every loop: names, units, and what they mean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxact.loops.specification import Specification

KIND = "margins"
"""Attribute of a dataset of margins: of which loops its growth rate and verdict are."""
SAMPLED = "sampled"


@dataclass(frozen=True)
class Variable:
    """A result of every loop: its SI unit, its name in words, one sentence."""

    units: str
    long_name: str
    description: str


VARIABLES: dict[str, Variable] = {
    "growth_rate": Variable(
        "1/s", "growth rate", "Exponential rate of a small perturbation; negative: stable."
    ),
    "shaking_rate": Variable(
        "1/s",
        "shaking rate",
        "Growth rate of the fastest-growing motion that swings faster than it grows or decays: of"
        " a robot, without its toppling; negative: nothing shakes.",
    ),
    "verdict": Variable("1", "verdict", "What the loop did, see flag_meanings."),
    "overshoot": Variable(
        "1", "overshoot", "Largest excess over the setpoint, relative to the step's height."
    ),
    "rise_time": Variable("s", "rise time", "From 10 % to 90 % of the step."),
    "settling_time": Variable(
        "s",
        "settling time",
        "First control tick from which on it stays within 2 % of the step; none if it swings "
        "through at the end.",
    ),
    "integrated_absolute_error": Variable(
        "m s", "integrated absolute error", "Integral of |setpoint - position|."
    ),
    "integrated_squared_error": Variable(
        "m^2 s", "integrated squared error", "Integral of (setpoint - position)^2."
    ),
    "control_effort": Variable("N^2 s", "control effort", "Integral of the squared command."),
    "peak_force": Variable(
        "N",
        "peak force",
        "Largest mean force of a physics step; a shorter physics_step shows shorter peaks.",
    ),
    "rms_force": Variable(
        "N", "rms force", "Root mean square of the mean forces of the physics steps."
    ),
    "limit_cycle_amplitude": Variable(
        "m",
        "limit cycle amplitude",
        "Half the peak-to-peak position at the end; 0: no limit cycle.",
    ),
    "limit_cycle_frequency": Variable(
        "rad/s", "limit cycle frequency", "Angular frequency of the oscillation at the end."
    ),
}
"""Of simulated loops."""

MARGINS: dict[str, Variable] = {
    "toppling_rate": Variable(
        "1/s", "toppling rate", "Growth rate of the fastest-growing motion that does not swing."
    ),
    "unstable_roots": Variable("1", "unstable roots", "Roots outside the unit circle."),
    "gain_margin": Variable(
        "1", "gain margin", "Smallest factor above 1 on all gains that destabilises; inf: none."
    ),
    "gain_margin_frequency": Variable("rad/s", "gain margin frequency", "Where it is lost."),
    "gain_reduction_margin": Variable(
        "1", "gain reduction margin", "Largest factor below 1 that destabilises; 0: none."
    ),
    "gain_reduction_frequency": Variable("rad/s", "gain reduction frequency", "Where it is lost."),
    "delay_margin": Variable(
        "s", "delay margin", "Smallest delay added to all commands that destabilises; inf: none."
    ),
    "delay_margin_frequency": Variable("rad/s", "delay margin frequency", "Where it is lost."),
    "sensitivity_peak": Variable(
        "1", "sensitivity peak Ms", "Peak of the largest singular value of S."
    ),
    "sensitivity_peak_frequency": Variable("rad/s", "frequency of Ms", "Where S has its peak."),
    "complementary_peak": Variable(
        "1", "complementary peak Mt", "Peak of the largest singular value of T."
    ),
    "complementary_peak_frequency": Variable("rad/s", "frequency of Mt", "Where T has its peak."),
    "modulus_margin": Variable("1", "modulus margin", "1 / Ms."),
    "disk_margin": Variable(
        "1", "disk margin", "Balanced, of independent changes of all loops at once."
    ),
    "disk_margin_frequency": Variable("rad/s", "disk margin frequency", "Where it is smallest."),
    "unscaled_disk_margin": Variable(
        "1", "unscaled disk margin", "Of changes that may mix the joints."
    ),
}
"""Of robots whose margins are computed, beside their rates and their verdict."""
_BOTH = ("growth_rate", "shaking_rate", "verdict")


OF_ROBOTS = ("shaking_rate",)
"""Variables that only robots have."""


def variables(*, robot: bool, margins: bool = False) -> tuple[str, ...]:
    """Names of the results of every loop of a sweep, in the order of a store.

    Args:
        robot: whether the loops are robots'.
        margins: whether their margins are computed, and nothing is simulated.
    """
    if margins:
        return (*_BOTH, *MARGINS)
    return tuple(name for name in VARIABLES if robot or name not in OF_ROBOTS)


def variables_of(specification: Specification) -> tuple[str, ...]:
    """Names of the results of every loop of this sweep."""
    return variables(robot=specification.robot, margins=of_margins(specification))


def of_margins(specification: Specification) -> bool:
    """Whether margins are computed, and nothing is simulated."""
    engine = specification.simulator
    return engine is not None and not engine.simulates


def dtype_of(variable: str, precision: str) -> np.dtype[Any]:
    """Type of the numbers that are kept of a variable; precision: "float32" or "float64"."""
    return np.dtype(np.int8 if variable == "verdict" else precision)
