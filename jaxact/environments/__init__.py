"""Drives in other people's environments, and gains in their files.

env = jaxact.environments.playground(env, actuator="starleth", delay=(0.002, 0.008))
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any


def playground(
    env: Any,
    *,
    joints: str | Sequence[str] = (".*",),
    gains: str | os.PathLike[str] | None = None,
    damping: str = "joint",
    velocity: str = "sampled",
    each_joint: bool = False,
    **parameters: Any,
) -> Any:
    """Put the drive into an environment of MuJoCo Playground.

        env = registry.load("Go1JoystickFlatTerrain", config_overrides={"impl": "jax"})
        env = jaxact.environments.playground(env, actuator="starleth", delay=(0.002, 0.008))

    The action stays what it was. Position servos of the model become the drive's controller, with
    their gains; of motors the drive delays and filters the force. It has held the first command for
    ever when an episode begins. Randomised models bring their own gains, limits, ranges of the
    controls, and damping.

    Args:
        env: of Playground, wrapped or not; before `wrap_for_brax_training`.
        joints: patterns of the driven ones; other actuators stay as they are.
        gains: file of gains instead of the model's, as for `jaxact.robot`.
        damping: "joint", or "drive": the driven joints' damping becomes part of kd.
        velocity: that the controllers see, "sampled" or "differenced".
        each_joint: every joint draws for itself; else a number is drawn for all of them.
        parameters: of the drive, as for `jaxact.robot`: a number, an array of shape (joints,), a
            range (low, high), drawn uniformly for each environment at every reset, or a table of
            patterns of joints -> number or range. `control_rate` [Hz] is that of the physics steps
            unless it is given.

    Returns:
        The environment, whose `drive` has what was understood.

    Raises:
        UserError: what is no single environment of Playground, an actuator that no drive can take
            over (its message names the joint), a stiffness of one without position setpoints, a
            control period that is not a multiple of the physics step, an environment that does not
            step through `mjx_env.step`.
        ModuleNotFoundError: Playground is not installed (`jaxact[playground]`).
    """
    from jaxact.environments import playground_wrapper

    return playground_wrapper.wrap(
        env, parameters=parameters, joints=joints, gains=gains, damping=damping,
        velocity=velocity, each_joint=each_joint,
    )  # fmt: skip


def gymnasium(
    env: Any,
    *,
    joints: str | Sequence[str] = (".*",),
    gains: str | os.PathLike[str] | None = None,
    damping: str = "joint",
    velocity: str = "sampled",
    each_joint: bool = False,
    **parameters: Any,
) -> Any:
    """Put the drive into an environment of gymnasium on C MuJoCo.

        env = jaxact.environments.gymnasium(gymnasium.make("Ant-v5"), delay=(0.002, 0.008))

    As `playground`, of which the arguments are those. The state of the drive is with the wrapper;
    what a reset draws follows from the environment's own `np_random`, so from its seed. In vectors,
    wrap each environment; asynchronous ones start with `context="spawn"`, since JAX and fork do not
    go together.

    Returns:
        The environment; its `drive` has what was understood, its `values` what was drawn.

    Raises:
        UserError: as `playground`, and an environment that is not a `MujocoEnv`.
        ModuleNotFoundError: gymnasium is not installed (`jaxact[gymnasium]`).
    """
    from jaxact.environments import gymnasium_wrapper

    return gymnasium_wrapper.wrap(
        env, parameters=parameters, joints=joints, gains=gains, damping=damping,
        velocity=velocity, each_joint=each_joint,
    )  # fmt: skip
