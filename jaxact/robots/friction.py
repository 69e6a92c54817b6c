"""A robot without its dry friction: what margins and growth rates of moving joints are those of.

A joint that slides gets no damping from Coulomb friction: its force is constant. MuJoCo has it as a
constraint on the velocity, and at rest, within the limits of that constraint, this acts like very
strong damping (MuJoCo documentation, "Computation", friction loss). Linearised there, a loop that
shakes once it moves looks well damped. So the friction of joints and tendons is taken out;
contacts, limits and equalities stay.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import mujoco
import numpy as np

from jaxact.robots import posture as _posture
from jaxact.robots.model import Robot
from jaxact.robots.posture import Posture


def rubs(model: mujoco.MjModel) -> bool:
    """Whether a joint or a tendon of the model has dry friction."""
    return largest(model) > 0.0


def without(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of the model whose joints and tendons have no dry friction."""
    smooth = copy.copy(model)
    smooth.dof_frictionloss[:] = 0.0
    smooth.tendon_frictionloss[:] = 0.0
    return smooth


def moving(robot: Robot, posture: Posture) -> tuple[Robot, Posture]:
    """The robot without dry friction, in the same configuration.

    Args:
        robot: from `jaxact.robots.model.read`.
        posture: where it rests, perhaps held by friction.

    Returns:
        The robot, and the posture under the joint forces that hold it there without friction: where
        friction held what no driven joint can hold, its residual says so. Both are as they were
        where there is no dry friction.
    """
    if not rubs(robot.model):
        return robot, posture
    smooth = replace(robot, model=without(robot.model))
    there = replace(
        smooth, qpos=posture.qpos, qvel=posture.qvel, ctrl=posture.ctrl, act=posture.act
    )
    return smooth, replace(_posture.given(there), settled=posture.settled)


def largest(model: mujoco.MjModel) -> float:
    """Largest dry friction of a joint or a tendon [N or N m], 0 if there is none."""
    losses = np.concatenate([model.dof_frictionloss, model.tendon_frictionloss])
    return float(losses.max(initial=0.0))


def at_joints(robot: Robot) -> np.ndarray:
    """Dry friction of the driven joints themselves, not of tendons [N or N m], shape (joints,)."""
    return robot.model.dof_frictionloss[[joint.dof for joint in robot.joints]].copy()
