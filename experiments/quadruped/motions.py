"""Four rollouts side by side: bare and with a drive, with nominal and with tripled gains."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cases
import numpy as np
from cases import Drives

from jaxact.loops.samples import explicit
from jaxact.loops.specification import Specification
from jaxact.simulation import single
from jaxact.simulation.single import Single


@dataclass(frozen=True)
class Runs:
    """What is shown.

    specification: of the rollouts
    actuator, delay: of the drive [s]
    bare, drive: with nominal and with tripled gains
    """

    specification: Specification
    actuator: str
    delay: float
    bare: tuple[Single, Single]
    drive: tuple[Single, Single]

    def joint(self, name: str) -> int:
        """Number of a driven joint."""
        return [one.name for one in self.bare[0].joints].index(name)


def motions(specification: Specification, actuator: str, delay: float, duration: float) -> Runs:
    """The four rollouts, with the push and the errors of the specification.

    actuator: name of a preset
    delay: around the loop [s]
    duration: [s]
    """
    shorter = replace(specification, duration=duration)
    pair = Drives(
        np.array(["ideal", actuator]), np.array([0.0, delay]), np.array([True, False])
    )  # fmt: skip
    columns = pair.columns(cases.SCALES) | pair.errors(shorter, len(cases.SCALES))
    first, second, third, fourth = single.simulate_all(shorter, explicit(shorter, columns))
    return Runs(shorter, actuator, delay, bare=(first, third), drive=(second, fourth))
