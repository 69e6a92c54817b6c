"""What a user is told where setpoints of a robot are beyond what its own servos accept."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np

from jaxact.engines import LINEAR
from jaxact.errors import InexactWarning
from jaxact.loops.specification import Specification
from jaxact.parameters import CONTROL_RATE, SETPOINT, base


def tell_clamped(specification: Specification, along: Mapping[str, np.ndarray]) -> None:
    """Warn of setpoints that the model's position servos clamp; nothing without a robot.

    Args:
        specification: of what is going to be simulated.
        along: values of the samples by key, any shape.

    Raises:
        UserError: the robot, a pattern, or a file of setpoints is wrong.
    """
    if specification.plant is None or specification.engine == LINEAR.name:
        return
    from jaxact.loops import joint_ranges, motions, robots  # with MuJoCo

    scene = robots.scene(specification.plant)
    robot, positions = scene.robot, scene.positions
    if joint_ranges.LOWEST_SETPOINT not in joint_ranges.of(robot, positions):
        return
    low, high = np.zeros_like(positions), np.zeros_like(positions)
    for key in sorted((key for key in along if base(key) == SETPOINT), key=lambda key: "@" in key):
        which = robots.matched(scene, key) if "@" in key else np.full(positions.shape, True)
        values, missing = along[key], np.isnan(along[key])
        least = np.min(values, where=~missing, initial=np.inf)
        most = np.max(values, where=~missing, initial=-np.inf)
        if missing.any():  # there the value before it counts
            least, most = np.minimum(least, low), np.maximum(most, high)
        low, high = np.where(which, least, low), np.where(which, most, high)
    asked = positions + np.stack([low, high])
    motion = specification.motion
    if motion is not None and motion.kind == "file":
        period = 1.0 / float(np.max(along[CONTROL_RATE]))
        _, track = motions.sampled(motion, scene, period, round(specification.duration / period))
        asked = positions + np.asarray(track)
    elif motion is not None and motion.kind != "step":  # in either direction
        far = np.maximum(np.abs(low), np.abs(high))
        asked = positions + np.stack([-far, far])
    said = joint_ranges.clamped(robot, positions, asked)
    if said:
        warnings.warn(said, InexactWarning, stacklevel=3)
