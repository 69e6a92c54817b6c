"""What gains are exposed to before they are trusted: errors of sensors, and a push.

What a specification says itself is kept; what it leaves open is filled in with the usual.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np

from jaxact.errors import UserError
from jaxact.loops import robots
from jaxact.loops.robots import Scene
from jaxact.loops.specification import Push, Specification
from jaxact.parameters import (
    ERRORS,
    POSITION_NOISE,
    POSITION_RESOLUTION,
    VELOCITY_NOISE,
    VELOCITY_RESOLUTION,
    base,
)

USUAL: Mapping[str, float] = {
    POSITION_RESOLUTION: 2.0 * np.pi / 80_000,  # counts of the encoder per revolution
    POSITION_NOISE: 2e-5,  # [rad or m]
    VELOCITY_RESOLUTION: 5e-3,  # [rad/s or m/s]
    VELOCITY_NOISE: 1e-2,
}
"""Errors of usual joint sensors; a specification that gives any error, be it of some joints only,
is taken to give all."""

_DURATION = 2.0  # [s]
# The velocity that the push gives the body at once [m/s], and how long it takes at most [s].
_SPEED, _LASTS = 0.1, 0.05
# A body that gives way sideways by less than this share of how it gives way upwards does not.
_RIGID = 1e-3


def exposed(
    specification: Specification, *, duration: float | None = None, push: bool = True
) -> Specification:
    """A robot with errors of its sensors and a push, where its specification gives none.

    Args:
        specification: with a plant.
        duration: of the rollouts [s]; None: 2 s.
        push: whether it is pushed; the specification's own push is left out, too, if not.

    Raises:
        UserError: a push that does not end within the first quarter: verdicts compare the motion
            from quarter to quarter.
    """
    seconds = _DURATION if duration is None else duration
    parameters = dict(specification.parameters)
    if not any(value for key, value in parameters.items() if base(key) in ERRORS):
        parameters |= USUAL
    given = specification.push if push else None
    if push and given is None:
        given = usual_push(robots.scene(_plant(specification)), seconds)
    check_push(given, seconds)
    return replace(
        specification, duration=float(seconds), parameters=parameters, push=given, axes=(),
        sampling=None,
    )  # fmt: skip


def check_push(push: Push | None, duration: float) -> None:
    """Raise UserError for a push that does not end in the first quarter of a rollout.

    Args:
        push: None for none.
        duration: of the rollout [s].
    """
    if push is not None and push.time + push.duration > 0.25 * duration * (1.0 + 1e-9):
        raise UserError(
            f"push: ends after {push.time + push.duration:g} s; it must end within the first "
            f"quarter of the {duration:g} s that are simulated"
        )


def _plant(specification: Specification):
    if specification.plant is None:
        raise UserError("validation: only for a robot; give one below [plant]")
    return specification.plant


def usual_push(scene: Scene, duration: float) -> Push | None:
    """A push on the heaviest body that moves, sideways where it gives way most.

        impulse = v / (n' J M^-1 J' n)

    gives the free body's centre of mass the velocity v along n at once; J is its Jacobian and M the
    robot's inertia.

    Args:
        scene: the robot in its posture.
        duration: of the rollout [s].

    Returns:
        None for a robot none of whose moving bodies has a name.
    """
    model = scene.robot.model
    moving = [
        body for body in range(1, model.nbody) if model.body_weldid[body] and model.body(body).name
    ]
    if not moving:
        return None
    body = max(moving, key=lambda number: model.body_mass[number])
    mobility = _mobility(model, scene.posture.qpos, body)
    size, directions = np.linalg.eigh(mobility[:2, :2])
    along = np.array([*directions[:, -1], 0.0])
    if size[-1] < _RIGID * mobility[2, 2]:
        along = np.array([0.0, 0.0, 1.0])
    along *= np.sign(along[np.argmax(np.abs(along))])
    given = along @ mobility @ along
    if given <= 0.0:
        return None
    first, second, third = (float(part) for part in _SPEED / given * along)
    lasts = min(_LASTS, 0.1 * duration)
    return Push(model.body(body).name, (first, second, third), 0.1 * duration, lasts)


def _mobility(model: mujoco.MjModel, qpos: np.ndarray, body: int) -> np.ndarray:
    """J M^-1 J' of the centre of mass of a body in a posture [1/kg], shape (3, 3)."""
    data = mujoco.MjData(model)
    data.qpos = qpos
    mujoco.mj_fwdPosition(model, data)
    jacobian, inertia = np.zeros((3, model.nv)), np.zeros((model.nv, model.nv))
    mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
    mujoco.mj_fullM(model, data, inertia)
    return jacobian @ np.linalg.solve(inertia, jacobian.T)
