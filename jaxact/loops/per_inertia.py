"""What was identified per unit of an inertia that is not known, in front of one that is given.

A log of setpoints and positions under unknown gains has no force in it: of J q'' = kp e - kd q'
only kp / J and kd / J can be known.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jaxact.errors import UserError
from jaxact.parameters import (
    COMMAND_RESOLUTION,
    FEEDFORWARD,
    JOINT_DAMPING,
    JOINT_STIFFNESS,
    KD,
    KP,
    LIMITS,
    NO_LOAD_SPEED,
)

SCALED = (KP, KD, JOINT_DAMPING, JOINT_STIFFNESS)
"""Parameters that are forces, and so in proportion to the inertia."""
_FORCES = {*SCALED, *LIMITS, FEEDFORWARD, COMMAND_RESOLUTION} - {NO_LOAD_SPEED}


def multiplied(values: Mapping[str, Any], inertia: Any) -> dict[str, Any]:
    """Parameters of a joint of this inertia, from those per unit of it.

    Args:
        values: by short name; those that are no forces stay.
        inertia: [kg or kg m^2], number or array.
    """
    return {name: inertia * v if name in SCALED else v for name, v in values.items()}


def demand_inertia(name: str, own: Mapping[str, Any]) -> None:
    """That a loop that gives a force itself gives its inertia too.

    Args:
        name: of the drive's file.
        own: parameters of the loop by short name; none of them the inertia.

    Raises:
        UserError: it does not.
    """
    given = next((key for key in own if key in _FORCES), None)
    if given is not None:
        raise UserError(
            f"{name}: its gains and friction are per unit of an inertia that is not known, and"
            f" `{given}` is not; give the `inertia` as well, or the `mass` of what slides"
        )
