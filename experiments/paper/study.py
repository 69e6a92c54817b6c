"""The loops of the study, and what had to be assumed about its figures.

Neunert, Boaventura, Buchli, "Why off-the-shelf physics simulators fail in evaluating feedback
controller performance - a case study for quadrupedal robots", Advances in Cooperative Robotics
(CLAWAR 2016), World Scientific 2017, pages 464-472.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import numpy as np

from jaxact.parameters import PRESETS

CITATION = (
    "M. Neunert, T. Boaventura, J. Buchli, “Why off-the-shelf physics simulators fail in "
    "evaluating feedback controller performance - a case study for quadrupedal robots”, "
    "Advances in Cooperative Robotics, World Scientific, 2017, pages 464-472"
)

MASS = 0.7  # [kg]
KP = 400.0  # [N/m]
KD = 20.0  # [N s/m]
CONTROL_RATE = 1000.0  # [Hz]
DELAYS = (0.0, 1e-3, 5e-3)  # [s]
DAMPING_RATIOS = (0.45, 0.9)  # those of HyQ's and of StarlETH's actuators
ROBOTS = ("ideal", "hyq", "starleth")
# Natural frequencies of figures 2 to 4 [rad/s]; 50, 100, 200, 400 and 800 are among them.
LOWEST, HIGHEST, POINTS = 50.0, 800.0, 65
# Every so many of them is simulated, and marked.
MARKED_EVERY = 4
# Natural frequencies whose steps and sensitivities are drawn [rad/s].
SHOWN = (70.0, 110.0, 200.0, 400.0, 800.0)
NOMINAL_DELAY = DELAYS.index(1e-3)  # "we decided to consider a more ideal time delay of 1 ms"

ASSUMED = (
    "The study's text is at hand, its drawings are not: what its figures have on their axes is "
    "read from the text. They are redrawn over the actuator's natural frequency, "
    f"{LOWEST:g} to {HIGHEST:g} rad/s, one curve for each damping ratio (those of HyQ and "
    "StarLETH, 0.45 and 0.9) and delay (0, 1, 5 ms), at the nominal gains.",
    "The text names no numerical method. Continuous: the delay is exact. What Padé approximations "
    "of first and second order would have given stands beside the gain margins.",
    "Gain margins are factors on both gains together; the delay is in series with the actuator.",
    "The simulated joint is an exact mass without friction, controlled at 1 kHz with held commands "
    "and sampled velocity; no quantisation, noise or saturation.",
)


@dataclass(frozen=True)
class Cases:
    """Loops that differ in their actuator; arrays of one common shape.

    Attributes:
        natural_frequency: wn [rad/s], inf = ideal.
        damping_ratio: zeta [-].
        delay: [s].
    """

    natural_frequency: np.ndarray | jax.Array
    damping_ratio: np.ndarray | jax.Array
    delay: np.ndarray | jax.Array

    @property
    def shape(self) -> tuple[int, ...]:
        """Of every field."""
        return self.natural_frequency.shape

    def flat(self) -> Cases:
        """The same loops in one row."""
        return Cases(*(np.asarray(array).reshape(-1) for array in self.columns))

    def along(self, count: int) -> Cases:
        """The same loops `count` times, along a new last axis."""
        return Cases(*(np.repeat(array[..., None], count, axis=-1) for array in self.columns))

    def at_delay(self, place: int) -> Cases:
        """Those of one delay, of loops of shape (_, delays, ...)."""
        return Cases(*(array[:, place] for array in self.columns))

    @property
    def columns(self) -> tuple[np.ndarray | jax.Array, ...]:
        """The fields in order."""
        return self.natural_frequency, self.damping_ratio, self.delay


def joined(*parts: Cases) -> Cases:
    """One row of all loops."""
    rows = zip(*(part.flat().columns for part in parts), strict=True)
    return Cases(*(np.concatenate(columns) for columns in rows))


def frequencies() -> np.ndarray:
    """Natural frequencies of the curves [rad/s], shape (POINTS,)."""
    return np.geomspace(LOWEST, HIGHEST, POINTS)


def curves(natural_frequency: np.ndarray) -> Cases:
    """Families of the figures: shape (damping ratios, delays, natural frequencies).

    Args:
        natural_frequency: [rad/s], shape (n,).
    """
    zeta, delay, wn = np.meshgrid(DAMPING_RATIOS, DELAYS, natural_frequency, indexing="ij")
    return Cases(wn, zeta, delay)


def robots() -> Cases:
    """The actuators of the robots with every delay: shape (robots, delays)."""
    presets = np.array([PRESETS[name] for name in ROBOTS])
    shape = (len(ROBOTS), len(DELAYS))
    wn, zeta = (np.broadcast_to(column[:, None], shape) for column in presets.T)
    return Cases(wn, zeta, np.broadcast_to(DELAYS, shape))
