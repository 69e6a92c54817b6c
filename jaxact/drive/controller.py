"""The joint controller: proportional-derivative with feedforward, at the control rate.

u = kp (r - q) + kd (r' - v) + feedforward,     quantised to the resolution of the D/A converter
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from jaxact.drive.sensor import quantise


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Controller:
    """Parameters of the controller; every field a float or an array of shape (joints,).

    Attributes:
        kp: proportional gain, the stiffness [N/m or N m/rad].
        kd: derivative gain, the damping [N s/m or N m s/rad].
        feedforward: constant force added to the command [N or N m].
        command_resolution: one step of the D/A converter [N or N m]; 0 for none.
        setpoint_delay: delay of the setpoint before the controller [s].
        lowest_setpoint, highest_setpoint: positions that the controller accepts as setpoints, and
            clamps them to [m or rad]; None for all.
    """

    kp: jax.Array | float
    kd: jax.Array | float
    feedforward: jax.Array | float = 0.0
    command_resolution: jax.Array | float = 0.0
    setpoint_delay: jax.Array | float = 0.0
    lowest_setpoint: jax.Array | float | None = None
    highest_setpoint: jax.Array | float | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Setpoint:
    """What the joint should do, each of shape (joints,).

    Attributes:
        position: [m or rad].
        velocity: [m/s or rad/s].
        force: feedforward that varies with time, added to the controller's constant [N or N m].
    """

    position: jax.Array
    velocity: jax.Array | float = 0.0
    force: jax.Array | float = 0.0


def accepted(controller: Controller, setpoint: Setpoint) -> Setpoint:
    """The setpoint with its position clamped to what a controller with a range accepts."""
    low, high = controller.lowest_setpoint, controller.highest_setpoint
    return replace(setpoint, position=jnp.clip(setpoint.position, low, high))


def step(
    controller: Controller,
    setpoint: Setpoint,
    position: jax.Array,
    velocity: jax.Array,
    *,
    quantised: bool,
) -> jax.Array:
    """The command of one control tick; see the module for the equation.

    Args:
        controller: gains, fields of shape (joints,).
        setpoint: as it reaches the controller.
        position: measured [m or rad], shape (joints,).
        velocity: measured [m/s or rad/s], shape (joints,).
        quantised: static; whether the D/A converter has a resolution.

    Returns:
        The command [N or N m], shape (joints,), held until the next tick.
    """
    command = (
        controller.kp * (setpoint.position - position)
        + controller.kd * (setpoint.velocity - velocity)
        + (controller.feedforward + setpoint.force)
    )
    if quantised:
        return quantise(command, jnp.asarray(controller.command_resolution))
    return command
