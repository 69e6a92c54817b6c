"""Postures at the edge of what is linear: on a limit of a joint's range or of its force.

There a joint moves freely to one side only, or gives way to one. Linear metrics take one of the two
for both; simulations do not.
"""

from __future__ import annotations

import mujoco
import numpy as np

from jaxact.loops import joint_ranges
from jaxact.loops.robots import BEYOND, Scene, beyond_ranges
from jaxact.robots.robot import Joint, Robot

# Within its range by less than this share of it, a joint is at its end.
_AT_END = 1e-6
_SEEN = "which linear metrics do not see; simulations do"


def said(scene: Scene) -> list[str]:
    """Of the driven joints at the end of their ranges, and of those whose force is, a line each."""
    lines = []
    ends = at_ends(scene.robot, scene.posture.qpos)
    if ends:
        are = f" and {len(ends) - 1} more are" if len(ends) > 1 else " is"
        lines.append(
            f"{ends[0]}{are} at the end of the range at this posture, where a limit acts to one"
            f" side only, {_SEEN}"
        )
    forces = on_limits(scene)
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


def on_limits(scene: Scene) -> tuple[str, ...]:
    """The driven joints that hold the posture with exactly a limit of their force, in words."""
    return tuple(
        f"{joint.name} holds the posture with {abs(force):.3g} {_unit(scene.robot, joint)}, a limit"
        f" of its force ({joint.force_low:.4g} to {joint.force_high:.4g})"
        for joint, force in zip(scene.robot.joints, scene.posture.force, strict=True)
        if joint_ranges.on_limit(joint, float(force))
    )


def _unit(robot: Robot, joint: Joint) -> str:
    hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
    return "N m" if robot.model.jnt_type[joint.joint] == hinge else "N"
