"""The numbers of an identified model as parameters of a loop."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from jaxact.parameters import (
    DELAY,
    FORCE_LIMIT,
    JOINT_DAMPING,
    JOINT_STIFFNESS,
    KD,
    KP,
    MASS,
    WN,
    ZETA,
)

NO_LIMIT = 1e12
"""A bound of a force that is as large as this is none."""


def parameters_of(numbers: Mapping[str, Any], plant: str) -> dict[str, Any]:
    """The parameters of a joint that a model's numbers say, by short name; the controller's apart.

    Args:
        numbers: of the model by name, numbers or arrays.
        plant: "none" where a force was measured and no joint moved.
    """
    import numpy as np  # which options of the command line do without

    limit = numbers.get(FORCE_LIMIT, math.inf)
    found = {WN: numbers.get(WN, math.inf), ZETA: numbers.get(ZETA, 1.0),
             DELAY: numbers.get(DELAY, 0.0), FORCE_LIMIT: limit}  # fmt: skip
    if np.any(np.asarray(limit) >= NO_LIMIT):
        del found[FORCE_LIMIT]
    if np.any(np.isinf(found[WN])):
        del found[WN], found[ZETA]
    if plant != "none":
        found |= {MASS: numbers["inertia"]} if "inertia" in numbers else {}
        own = {JOINT_DAMPING: "viscous", JOINT_STIFFNESS: "gravity"}
        found |= {name: numbers[model] for name, model in own.items() if model in numbers}
    if KP in numbers:
        found |= {KP: numbers[KP], KD: numbers.get(KD, 0.0)}
    return found
