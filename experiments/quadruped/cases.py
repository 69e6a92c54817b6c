"""The loops of the experiment: situations, drives, gains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jaxact.loops import reading
from jaxact.loops.specification import Specification

HERE = Path(__file__).resolve().parent
SITUATIONS = ("stand", "three", "hang")
ACTUATORS = ("ideal", "hyq", "starleth")
DELAYS = (0.0, 0.001, 0.005)  # [s] around the loop
SCALES = (1.0, 3.0)  # nominal and tripled gains
# What a simulator leaves out beside actuator and delays.
ERRORS = (
    "position_resolution", "position_noise", "position_bias", "position_bias_walk",
    "velocity_resolution", "velocity_noise", "command_resolution",
)  # fmt: skip


@dataclass(frozen=True)
class Drives:
    """Drives side by side, shape (n,) each.

    actuators: names of presets
    delays: around the loop [s]
    bare: whether sensors and converters are perfect
    """

    actuators: np.ndarray
    delays: np.ndarray
    bare: np.ndarray

    def columns(self, scales: tuple[float, ...] | np.ndarray = ()) -> dict[str, np.ndarray]:
        """Values of the parameters in which they differ; every drive at every gain scale.

        A bus takes half of the delay one way: setpoints in, measurements in, commands out. Two of
        the three are in the loop.
        """
        half = 0.5 * self.delays
        found: dict[str, np.ndarray] = {
            "actuator": self.actuators,
            "setpoint_delay": half,
            "measurement_delay": half,
            "output_delay": half,
        }
        if not len(scales):
            return found
        spread = {name: np.tile(values, len(scales)) for name, values in found.items()}
        return {**spread, "gain_scale": np.repeat(np.asarray(scales, float), len(self.delays))}

    def errors(self, specification: Specification, times: int = 1) -> dict[str, np.ndarray]:
        """The errors of sensors and converters that a specification gives, none for a bare one.

        times: that the drives are repeated
        """
        given = {name: specification.parameters.get(name, 0.0) for name in ERRORS}
        return {
            name: np.tile(np.where(self.bare, 0.0, float(value)), times)
            for name, value in given.items()
        }

    def __len__(self) -> int:
        """Number of drives."""
        return len(self.delays)


def drives(*, bare: bool, delays: tuple[float, ...] = DELAYS) -> Drives:
    """Every actuator at every delay; before them the bare one, if it is wanted."""
    actuators = np.repeat(ACTUATORS, len(delays))
    late = np.tile(delays, len(ACTUATORS))
    rough = np.zeros(late.shape, bool)
    if bare:
        actuators = np.concatenate([["ideal"], actuators])
        late, rough = np.concatenate([[0.0], late]), np.concatenate([[True], rough])
    return Drives(actuators, late, rough)


def load(situation: str, duration: float | None = None) -> Specification:
    """The specification of a situation, perhaps with another duration [s]."""
    found = reading.load(HERE / f"{situation}.toml")
    return found if duration is None else replace(found, duration=duration)


def smooth(specification: Specification, duration: float = 2.0) -> Specification:
    """The same without push and errors, for a shorter time [s]."""
    kept = {name: value for name, value in specification.parameters.items() if name not in ERRORS}
    return replace(specification, parameters=kept, push=None, duration=duration)
