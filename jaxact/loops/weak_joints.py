"""What a user is told where joints of a robot are too weak for the posture that they hold."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np

from jaxact.errors import InexactWarning
from jaxact.loops.specification import Plant


def tell_weak(plant: Plant | None, along: Mapping[str, np.ndarray]) -> None:
    """Warn of joints that hold the posture with more than some loop lets them exert.

    Args:
        plant: the robot's; nothing is told without one.
        along: parameters of the loops by key, any shape.

    Raises:
        UserError: the robot or a pattern is wrong.
    """
    if plant is None:
        return
    from jaxact.loops import robots, strength  # with MuJoCo

    weak = strength.overloaded(robots.scene(plant), along)
    if weak:
        warnings.warn(strength.too_weak(weak), InexactWarning, stacklevel=3)
