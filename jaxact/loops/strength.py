"""What a robot's joints hold its posture with, beside what their drives can exert there.

At standstill that is the least of the force limit, the stall force of a torque-speed line, and the
range of a model's joint whose limit differs by direction.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from jaxact.loops.joint_ranges import HIGHEST_FORCE, LOWEST_FORCE
from jaxact.loops.robots import Scene, at_stops, brought, matched
from jaxact.parameters import FORCE_LIMIT, STALL_FORCE, base

Along = Mapping[str, np.ndarray]
"""Values of parameters that occur, by key in order; of any shape, NaN where the model's counts."""

# Share of a range of forces within which a settled posture's force is the end of it.
_ROUNDING = 1e-6


def limits(scene: Scene, along: Along) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest force of each joint at standstill, the narrowest that occurs [N or N m].

    Args:
        scene: the robot.
        along: of the loops; a parameter that is missing limits nothing, or as the model does.

    Returns:
        Shape (joints,) each.

    Raises:
        UserError: a key matches no joint.
    """
    own = brought(scene)
    count = len(scene.labels)
    most = np.minimum(
        _least(scene, along, FORCE_LIMIT, own[FORCE_LIMIT]),
        _least(scene, along, STALL_FORCE, np.full(count, np.inf)),
    )
    low, high = own.get(LOWEST_FORCE, -most), own.get(HIGHEST_FORCE, most)
    return np.maximum(-most, low), np.minimum(most, high)


def _least(scene: Scene, along: Along, name: str, own: np.ndarray) -> np.ndarray:
    """The smallest value of a parameter that each joint has, shape (joints,)."""
    found = own
    # One for all joints counts where no later one for some does.
    for key in sorted((key for key in along if base(key) == name), key=lambda key: "@" in key):
        missing = np.isnan(along[key])
        known = np.min(along[key], where=~missing, initial=np.inf)
        least = np.minimum(known, found) if missing.any() else np.full_like(own, known)
        found = np.where(matched(scene, key), least, found) if "@" in key else least
    return found


def overloaded(scene: Scene, along: Along) -> tuple[str, ...]:
    """The driven joints that hold the posture with more than they can exert, and how much.

    Those that are outside their ranges push against their limits, and are not counted.

    Args:
        scene, along: as for `limits`.
    """
    stopped = {text.partition(" (")[0] for text in at_stops(scene.robot, scene.posture.qpos)}
    found = []
    for place, (name, force) in enumerate(zip(scene.labels, scene.posture.force, strict=True)):
        low, high = (end[place] for end in limits(scene, along))
        if name not in stopped and not low <= force <= high and not _on_limit(low, high, force):
            limit = abs(high if force > 0.0 else low)
            unit = _unit(scene, place)
            found.append(f"{name} holds the posture with {abs(force):.4g} of {limit:.4g} {unit}")
    return tuple(found)


def too_weak(joints: tuple[str, ...]) -> str:
    """A line on joints from `overloaded`."""
    return (
        f"{', '.join(joints)}: more than the joints can exert; linear metrics are those "
        "of joints that could, simulations saturate"
    )


def on_limits(scene: Scene, along: Along) -> tuple[str, ...]:
    """The driven joints that hold the posture with exactly a limit of their force, in words.

    Args:
        scene, along: as for `limits`.
    """
    return tuple(
        f"{name} holds the posture with {abs(force):.3g} {_unit(scene, place)}, a limit"
        f" of its force ({low:.4g} to {high:.4g})"
        for place, (name, force, low, high) in enumerate(
            zip(scene.labels, scene.posture.force, *limits(scene, along), strict=True)
        )
        if _on_limit(low, high, force)
    )


def _on_limit(low: float, high: float, force: float) -> bool:
    """Whether a force [N or N m] is a limit of a joint's, but for rounding."""
    width = high - low
    near = _ROUNDING * (width if np.isfinite(width) else max(abs(force), 1.0))
    return any(bool(np.isfinite(end)) and abs(force - end) <= near for end in (low, high))


def _unit(scene: Scene, place: int) -> str:
    hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
    robot = scene.robot
    return "N m" if robot.model.jnt_type[robot.joints[place].joint] == hinge else "N"
