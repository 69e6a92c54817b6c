"""What a user is told where joints of a robot are too weak for what they hold."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping

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


def tell_leaving(reasons: Iterable[str]) -> None:
    """Warn of loops whose linear metrics hide that the robot does not rest where they are taken.

    Stiff joints would hold it there, and a small motion about that posture decays; the joints that
    it has give way under a load until it falls.

    Args:
        reasons: of the stable loops why each does not come to rest, "" where it does.
    """
    told = tuple(dict.fromkeys(reason for reason in reasons if reason))
    if told:
        warnings.warn(
            "with the changes of its model, which the controllers do not know of, the robot of some"
            f" loops does not rest near its posture: {'; '.join(told)}; linear metrics, which are"
            " those of stiff joints that hold it there, have these loops as stable",
            InexactWarning,
            stacklevel=3,
        )
