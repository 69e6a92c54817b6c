"""Where between two physics steps a delayed measurement is taken, and the force until then.

Before time 0 a plant has come to its position x0 at its velocity v0, measured at x0 + v0 t, t < 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from jaxact.drive import actuator as _actuator
from jaxact.drive import delay as _delay
from jaxact.drive import limiting as _limiting
from jaxact.drive.actuator import Response
from jaxact.drive.joint_motion import Joint
from jaxact.drive.options import Drive, DriveOptions


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Capture:
    """Where in a control period the delayed measurement is taken.

    Attributes:
        here: 1 in the physics step that contains the instant, else 0; shape (substeps, joints).
        offset: time of the instant from the start of that step [s], shape (joints,).
        response: response of the force loop from the start of that step to the instant.
    """

    here: jax.Array
    offset: jax.Array
    response: Response


def measured_before(
    drive: Drive, slots: int, position: jax.Array, velocity: jax.Array
) -> tuple[_delay.Line, _delay.Line]:
    """The lines of measurements at time 0: slot k was captured k T + r before it.

    Args:
        drive: every leaf but the control period T in the shape of its joints; r is what its
            measurement delay has beyond whole periods.
        slots: static; length of the lines.
        position: x0 [m or rad], shape (joints,).
        velocity: v0 [m/s or rad/s], shape (joints,).
    """
    delay, period = jnp.asarray(drive.sensor.delay), jnp.asarray(drive.control_period)
    whole, _ = _delay.split(delay, period)
    number = jnp.arange(slots, dtype=delay.dtype).reshape((-1,) + (1,) * delay.ndim)
    # So that the slot that is read, k = whole, is exactly the delay old.
    age = delay[None] + (number - whole[None]) * period
    before = (position[None] - velocity[None] * age).astype(position.dtype)
    return _delay.begun(before), _delay.init(velocity, slots)


def older_for(step: jax.Array, switched: tuple[jax.Array, jax.Array], index) -> jax.Array:
    """Time under the older command in a physics step [s]; the switch is (step number, offset).

    Written by cases rather than by clipping, whose derivative is half the right one at a boundary.
    """
    number, offset = switched
    partly = jnp.where(offset < step, offset, step)
    return jnp.where(index < number, step, jnp.where(index == number, partly, 0.0))


def capture_at(
    drive: Drive,
    options: DriveOptions,
    step: jax.Array,
    switched: tuple[jax.Array, jax.Array],
    remainder: jax.Array,
    joint: Joint | None = None,
    body: Joint | None = None,
) -> Capture:
    """Where the measurement falls: `remainder` before the end of a period."""
    actuator = drive.actuator
    instant = drive.control_period - remainder
    # An instant at the very end of a step belongs to that step, so that no delay means no look-up
    # in the next one.
    index = jnp.clip(jnp.ceil(instant / step - 1e-4) - 1.0, 0.0, options.substeps - 1.0)
    index = jax.lax.stop_gradient(index)
    offset = instant - index * step
    older = older_for(offset, switched, index)
    response = _actuator.response(
        jnp.asarray(actuator.natural_frequency),
        jnp.asarray(actuator.damping_ratio),
        offset,
        older,
        joint,
    )
    return Capture(
        here=jnp.stack([(index == i).astype(offset.dtype) for i in range(options.substeps)]),
        offset=offset,
        response=replace(response, limits=_limiting.span(options, actuator, offset, older, body)),
    )
