"""What a robot must have to be among those that a box holds, of what it was not given."""

from __future__ import annotations

import jax
import numpy as np

from jaxact.loops import robots
from jaxact.loops.specification import Specification
from jaxact.parameters import base
from jaxact.tuning.box import Box, Range, inside


def amid(specification: Specification, box: Box) -> tuple[dict[str, float], Box]:
    """The middle of every range that leaves out what some joint has by default, by its key.

    And the box, the same one, whose factors are on these values.

    Args:
        specification: of a robot.
        box: what is uncertain of it, ranges of some joints too.

    Raises:
        UserError: a range leaves out a value given, so that its certificate is not of this robot,
            or matches no joint.
    """
    given: dict[str, float] = {}
    defaults: dict[str, float] = {}
    for one in box.ranges:
        values = values_of(specification, one)
        beyond = np.maximum(one.low - values, values - one.high)
        is_given = _is_given(specification, one)
        if one.factor and not is_given and np.ptp(values):
            continue  # no one value is the middle of all: refused with the ends
        known = given if is_given else defaults
        known[one.name] = float(values[np.argmax(beyond)])
    return inside(box, given, defaults)


def values_of(specification: Specification, one: Range) -> np.ndarray:
    """What the joints have that the range is of, or the robot, shape (n,)."""
    assert specification.plant is not None
    scene, nominal = robots.scene(specification.plant), specification.nominal
    masks = {key: robots.matched(scene, key) for key in nominal if "@" in key}
    with jax.enable_x64(True):
        given = {key: np.float64(value) for key, value in nominal.items()}
        each = robots.each_joint(given, robots.brought(scene), masks)[base(one.name)]
    values = np.atleast_1d(np.asarray(each, float))
    if "@" not in one.name:
        return values
    which = robots.matched(scene, one.name)
    return np.broadcast_to(values, which.shape)[which]


def _is_given(specification: Specification, one: Range) -> bool:
    """Whether the range is of a joint, or of the robot, whose value was given."""
    assert specification.plant is not None
    scene = robots.scene(specification.plant)

    def joints(key: str) -> np.ndarray:
        return robots.matched(scene, key) if "@" in key else np.ones(len(scene.labels), bool)

    alike = (key for key in specification.parameters if base(key) == base(one.name))
    return any(np.any(joints(key) & joints(one.name)) for key in alike)
