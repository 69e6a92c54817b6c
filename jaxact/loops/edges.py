"""Postures at the edge of what is linear: on a limit of a joint's range or of its force.

There a joint moves freely to one side only, or gives way to one. Linear metrics take one of the two
for both; simulations do not.
"""

from __future__ import annotations

import numpy as np

from jaxact.loops import strength
from jaxact.loops.robots import BEYOND, Scene, beyond_ranges
from jaxact.loops.strength import Along
from jaxact.robots.robot import Robot

# Within its range by less than this share of it, a joint is at its end.
_AT_END = 1e-6
_SEEN = "which linear metrics do not see; simulations do"


def said(scene: Scene, along: Along) -> list[str]:
    """Of the driven joints at the end of their ranges, and of those whose force is, a line each.

    Args:
        scene, along: as for `jaxact.loops.strength.limits`.
    """
    lines = []
    ends = at_ends(scene.robot, scene.posture.qpos)
    if ends:
        are = f" and {len(ends) - 1} more are" if len(ends) > 1 else " is"
        lines.append(
            f"{ends[0]}{are} at the end of the range at this posture, where a limit acts to one"
            f" side only, {_SEEN}"
        )
    forces = strength.on_limits(scene, along)
    if forces:
        more = f" (and {len(forces) - 1} more)" if len(forces) > 1 else ""
        lines.append(f"{forces[0]}{more}: it can exert more to one side only, {_SEEN}")
    return lines


def at_ends(robot: Robot, qpos: np.ndarray) -> tuple[str, ...]:
    """The driven joints that a configuration has at an end of their ranges.

    Args:
        robot: from `jaxact.robots.model.read`.
        qpos: as MuJoCo orders it.

    Returns:
        Of each its name, where it is, and its range.
    """
    return tuple(
        told
        for told, beyond, width in beyond_ranges(robot, qpos)
        if -_AT_END * width <= beyond <= BEYOND * width
    )
