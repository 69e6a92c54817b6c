"""Bodies of a robot by name: which one carries a payload, or is pushed."""

from __future__ import annotations

import mujoco
import numpy as np

from jaxact.errors import UserError, nearest
from jaxact.robots.model import Robot


def named(robot: Robot, name: str, key: str) -> int:
    """Number of a body; `key` is what names it.

    Raises:
        UserError: there is none of that name.
    """
    model = robot.model
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if number <= 0:  # the world cannot be pushed, and carries any weight
        known = [model.body(index).name for index in range(1, model.nbody)]
        raise UserError(f"{key} = {name!r}: no such body; {nearest(name, filter(None, known))}")
    return int(number)


def payload_body(robot: Robot, name: str | None) -> int:
    """Number of the body that carries a payload; of the heaviest one without a name.

    Raises:
        UserError: there is none of that name.
    """
    if name is not None:
        return named(robot, name, "plant.payload_body")
    return int(np.argmax(robot.model.body_mass))


def label(robot: Robot, number: int) -> str:
    """Name of a body, or its number in words."""
    return robot.model.body(number).name or f"body {number}"


def pushed(robot: Robot, name: str) -> int:
    """Number of the body that a push acts on.

    Raises:
        UserError: there is none of that name, or it cannot move.
    """
    number = named(robot, name, "push.body")
    _demand_moving(robot, number, "push.body", "a push on it")
    return number


def check_payload(robot: Robot, number: int) -> None:
    """The body that carries a payload can move.

    Raises:
        UserError: it cannot, so that the payload would change nothing.
    """
    _demand_moving(robot, number, "plant.payload_body", "a payload on it")


def _demand_moving(robot: Robot, number: int, key: str, what: str) -> None:
    model = robot.model
    if model.body_weldid[number]:
        return
    moving = [body for body in range(1, model.nbody) if model.body_weldid[body]]
    heaviest = label(robot, max(moving, key=lambda body: model.body_mass[body]))
    raise UserError(
        f"{key}: '{label(robot, number)}' cannot move, so that {what} changes nothing; give a body "
        f"that moves, of which '{heaviest}' is the heaviest"
    )
