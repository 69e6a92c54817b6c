"""Ranges of a robot's joints that no parameter of a drive has: they come with the model.

A force limit that differs by direction, and the setpoints that a position servo of the model
accepts.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from jaxact.parameters import SETPOINT

if TYPE_CHECKING:  # with MuJoCo, which a joint does not need
    from jaxact.robots.robot import Joint, Robot

LOWEST_FORCE, HIGHEST_FORCE = "lowest_force", "highest_force"
LOWEST_SETPOINT, HIGHEST_SETPOINT = "lowest_setpoint", "highest_setpoint"
RANGES = (LOWEST_FORCE, HIGHEST_FORCE, LOWEST_SETPOINT, HIGHEST_SETPOINT)
"""Keys of these ranges among the parameters of a robot's drives."""


def one_sided(joint: Joint) -> bool:
    """Whether a joint's force limit differs by direction, which `force_limit` cannot say."""
    return joint.force_low != -joint.force_high


def of(robot: Robot, position: np.ndarray) -> dict[str, np.ndarray]:
    """The ranges that some joint of a robot has; the others of its joints have infinite ones.

    Args:
        robot: from `jaxact.robots.model.read`.
        position: of its driven joints in the posture [m or rad], shape (joints,). What holds a
            posture beyond a servo's range is fed forward: it stays where it is.

    Returns:
        By key of `RANGES`, [N or N m] and [m or rad], shape (joints,). Without
        the range of force where no limit differs by direction: nothing is computed for it then.
    """
    found: dict[str, np.ndarray] = {}
    if any(map(one_sided, robot.joints)):
        ends = [
            (one.force_low, one.force_high) if one_sided(one) else (-np.inf, np.inf)
            for one in robot.joints
        ]
        found[LOWEST_FORCE], found[HIGHEST_FORCE] = np.array(ends, float).T
    low = np.array([one.setpoint_low for one in robot.joints], float)
    high = np.array([one.setpoint_high for one in robot.joints], float)
    if np.isfinite([low, high]).any():
        found[LOWEST_SETPOINT] = np.minimum(low, position)
        found[HIGHEST_SETPOINT] = np.maximum(high, position)
    return found


def within(values: Mapping[str, Any], setpoint: Any) -> Any:
    """Setpoints as the model's own position servos clamp them [m or rad], (..., joints).

    Args:
        values: parameters of a robot's drives, with the keys of `RANGES` that it has.
        setpoint: absolute positions.
    """
    if LOWEST_SETPOINT not in values:
        return setpoint
    low, high = (jnp.asarray(values[key], setpoint.dtype) for key in RANGES[2:])
    return jnp.clip(setpoint, low, high)


def clamped(robot: Robot, position: np.ndarray, asked: np.ndarray) -> str:
    """In a line, what servos of the model make of setpoints beyond their ranges; "" if none are.

    Args:
        robot: from `jaxact.robots.model.read`.
        position: of its driven joints in the posture, shape (joints,).
        asked: setpoints, absolute, shape (..., joints).
    """
    own = of(robot, position)
    if LOWEST_SETPOINT not in own:
        return ""
    low, high = own[LOWEST_SETPOINT], own[HIGHEST_SETPOINT]
    beyond = np.maximum(low - asked, asked - high).reshape(-1, len(robot.joints)).max(axis=0)
    (which,) = np.nonzero(beyond > 1e-9 * np.maximum(1.0, np.abs(position)))
    if not which.size:
        return ""
    first = int(which[0])
    rows = np.asarray(asked).reshape(-1, len(robot.joints))[:, first]
    far = rows[np.argmax(np.maximum(low[first] - rows, rows - high[first]))]
    more = f" and {which.size - 1} more" if which.size > 1 else ""
    return (
        f"{SETPOINT}: {robot.joints[first].name}{more} is asked to go to {far:.4g}, beyond what its"
        f" servo accepts ({low[first]:.4g} to {high[first]:.4g}, `ctrlrange`); it is clamped there,"
        " as MuJoCo does, and measured against that"
    )
