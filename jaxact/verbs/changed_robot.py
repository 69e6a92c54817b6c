"""What is said of a robot with a changed model: what carries a payload, and where it rests then."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from jaxact.parameters import PAYLOAD

if TYPE_CHECKING:
    from jaxact.loops.specification import Specification
    from jaxact.robot_margins.whole_robot import WholeRobot

# A smaller distance from the posture is not worth a word [rad or m].
_WORTH_A_WORD = 1e-3
_KEYS = "payload_body", "sag", "leaves_posture"


def lines(found: WholeRobot) -> list[str]:
    """The body that carries the payload, and how far the robot gives way under what is changed.

    Args:
        found: the loop of one sample.
    """
    from jaxact.loops import robots

    said = []
    assert found.specification.plant is not None
    scene = robots.scene(found.specification.plant)
    if found.values[PAYLOAD] > 0.0:
        said.append(f"payload {found.values[PAYLOAD]:.4g} kg (on '{scene.carrier}')")
    rest = found.rest
    if rest is None:
        return said
    if rest.leaves:
        return [
            *said,
            "warning: with these changes of the model, which the controllers do not know of, it "
            f"does not rest near its posture: {rest.leaves}; linearised as if stiff joints held it",
        ]
    size = np.abs(rest.sag)
    place = int(np.argmax(size))
    if size[place] > _WORTH_A_WORD:
        joint = scene.robot.joints[place]
        hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
        unit = "rad" if scene.robot.model.jnt_type[joint.joint] == hinge else "m"
        others = int(np.sum(size > _WORTH_A_WORD)) - 1
        more = f", and {others} more joint{'' if others == 1 else 's'} by less" if others else ""
        said.append(
            f"sags by {size[place]:.3g} {unit} at {joint.name}{more}, as the controllers do not "
            "know of these changes of the model; linearised where it rests"
        )
    return said


def of_nominal(specification: Specification) -> list[str]:
    """The same of a specification's nominal loop; nothing where its model is not changed."""
    from jaxact.robot_margins import whole_robot

    return lines(whole_robot.nominal(specification)) if whole_robot.changed(specification) else []


def of_nominal_as_object(specification: Specification) -> dict[str, Any]:
    """As `as_object`, of a specification's nominal loop."""
    from jaxact.robot_margins import whole_robot

    if not whole_robot.changed(specification):
        return dict.fromkeys(_KEYS)
    return as_object(whole_robot.nominal(specification))


def as_object(found: WholeRobot) -> dict[str, Any]:
    """The same for JSON.

    `payload_body` (null without a payload), `sag` by joint [rad or m] and `leaves_posture` (null
    where it rests), all null where the model is not changed.
    """
    from jaxact.loops import robots

    assert found.specification.plant is not None
    scene, rest = robots.scene(found.specification.plant), found.rest
    row: dict[str, Any] = dict.fromkeys(_KEYS)
    if found.values[PAYLOAD] > 0.0:
        row["payload_body"] = scene.carrier
    if rest is not None:
        row["sag"] = dict(zip(scene.labels, rest.sag.tolist(), strict=True))
        row["leaves_posture"] = rest.leaves or None
    return row
