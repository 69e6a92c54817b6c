"""Units of what varies over the loops of a robot, whose joints turn or slide."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from jaxact.loops.samples import Coordinate
from jaxact.loops.specification import Plant
from jaxact.parameters import MASS, PARAMETERS, PAYLOAD, base
from jaxact.units import joint_units

# These are masses whatever the joints are.
_OF_BODIES = (MASS, PAYLOAD)


def with_units(coords: Mapping[str, Coordinate], plant: Plant | None) -> dict[str, Coordinate]:
    """Coordinates with the units of the joints that each is meant for: kp of hinges is in N m/rad.

    Args:
        coords: of parameters by their keys, with the units of joints that slide; others stay.
        plant: of the robot; None of a single joint, whose coordinates have their units already.

    Raises:
        UserError: as `jaxact.loops.robots.scene`; a pattern matches no joint.
    """
    if plant is None:
        return dict(coords)
    found = dict(coords)
    for key, place in coords.items():
        name = base(key)
        if name in PARAMETERS and name not in _OF_BODIES:
            units = of_joints(PARAMETERS[name].unit, plant, key)
            found[key] = replace(place, attributes=place.attributes | {"units": units})
    return found


def of_joints(units: str, plant: Plant, key: str = "") -> str:
    """A unit that is written for slides, of the joints that a key is meant for, or of all.

    Raises:
        UserError: as `with_units`.
    """
    return joint_units(units, _rotary(plant, key))


def _rotary(plant: Plant, key: str) -> list[bool]:
    """Of each joint that a key is meant for, whether it turns."""
    from jaxact.loops import robots

    turns = np.array(rotary(plant))
    return (turns[robots.matched(robots.scene(plant), key)] if "@" in key else turns).tolist()


def rotary(plant: Plant) -> list[bool]:
    """Of each joint of a robot, whether it turns.

    Raises:
        UserError: as `jaxact.loops.robots.scene`.
    """
    import mujoco  # which single joints do without

    from jaxact.loops import robots

    own = robots.scene(plant).robot
    kinds = [own.model.jnt_type[joint.joint] for joint in own.joints]
    return [bool(kind == mujoco.mjtJoint.mjJNT_HINGE) for kind in kinds]
