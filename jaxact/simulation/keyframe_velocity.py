"""What a user is told where driven joints start slower or faster than their keyframe says."""

from __future__ import annotations

import warnings

from jaxact.engines import LINEAR
from jaxact.errors import InexactWarning
from jaxact.loops.specification import Specification
from jaxact.parameters import INITIAL_VELOCITY


def tell_keyframe_velocity(specification: Specification) -> None:
    """Warn of velocities of driven joints in a keyframe, which `initial_velocity` replaces.

    Args:
        specification: of what is going to be simulated.

    Raises:
        UserError: the robot or a pattern is wrong.
    """
    plant = specification.plant
    if plant is None or plant.posture != "keyframe" or specification.engine == LINEAR.name:
        return
    from jaxact.loops import robots  # with MuJoCo

    robot = robots.scene(plant).robot
    moving = [joint.name for joint in robot.joints if robot.qvel[joint.dof] != 0.0]
    if moving:
        warnings.warn(
            f"keyframe: its velocity of {', '.join(moving)} is left out: driven joints start with "
            f"`{INITIAL_VELOCITY}`, 0 unless it is given",
            InexactWarning,
            stacklevel=3,
        )
