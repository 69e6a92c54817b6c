"""Whether a drive fits the static options that others were made for: its delays and its parts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.drive import delay as _delay
from jaxact.drive.options import Drive, DriveOptions
from jaxact.drive.options import options as options_of
from jaxact.errors import UserError


def fitting(drive: Drive, longest: Drive, given: DriveOptions) -> Drive:
    """The drive, if its delays and its parts fit.

    A traced delay decides nothing yet: the gains are not a number where it does not fit, and so is
    all that comes of them.

    Args:
        drive: of which values may be traced.
        longest: concrete, of which the options were made.
        given: these options.

    Raises:
        UserError: delays that are known are longer, or parts are missing.
    """
    known = jax.tree.map(lambda own, other: other if _traced(own) else own, drive, longest)
    own = options_of(known, substeps=given.substeps, differenced=given.sensor.differenced)
    lacking = _lacking(own, given)
    if lacking:
        raise UserError(
            f"longest: lacks what the loop has: {', '.join(lacking)}; give it the longest delays, "
            "and every part that may occur"
        )
    if not any(map(_traced, jax.tree.leaves(drive))):
        return drive
    controller = drive.controller
    fits = _fits(drive, given)
    kp, kd = (jnp.where(fits, gain, jnp.nan) for gain in (controller.kp, controller.kd))
    return replace(drive, controller=replace(controller, kp=kp, kd=kd))


def _traced(value: Any) -> bool:
    return isinstance(value, jax.core.Tracer)


def _fits(drive: Drive, given: DriveOptions) -> jax.Array:
    """Whether the delays, traced, have slots enough; bool, of the shape of the delays."""
    period = jnp.asarray(drive.control_period)
    total = jnp.asarray(drive.actuator.delay) + drive.output_delay
    fits = (total >= 0.0) & (_delay.split(total, period)[0] < given.command_slots)
    # A line that is not there has no delay; a line of setpoints has one slot more.
    for late, slots in (
        (jnp.asarray(drive.sensor.delay), given.measurement_slots),
        (jnp.asarray(drive.controller.setpoint_delay), given.setpoint_slots - 1),
    ):
        room = _delay.split(late, period)[0] < slots if slots > 0 else late == 0.0
        fits &= (late >= 0.0) & room
    return fits


def _lacking(own: DriveOptions, given: DriveOptions) -> list[str]:
    """What a drive needs and these options do not have, in words."""
    sensor, other = own.sensor, given.sensor
    missing = {
        "command and output delay": own.command_slots > given.command_slots,
        "measurement delay": own.measurement_slots > given.measurement_slots,
        "setpoint delay": own.setpoint_slots > given.setpoint_slots,
        "noise": sensor.noise > other.noise,
        "walking bias": sensor.walk > other.walk,
        "resolution of the sensor": sensor.quantise > other.quantise,
        "resolution of the command": own.quantised_command > given.quantised_command,
        "force limit": own.limited > given.limited,
        "force rate limit": own.rate_limited > given.rate_limited,
        "policy rate": own.held_setpoint > given.held_setpoint,
    }
    return [name for name, is_missing in missing.items() if is_missing]
