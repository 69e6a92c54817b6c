"""Whether a drive fits the static options that others were made for: its delays and its parts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.drive import delay as _delay
from jaxact.drive.options import Drive, DriveOptions
from jaxact.drive.options import options as options_of
from jaxact.drive.step import Coefficients
from jaxact.errors import UserError

_ROUNDING = 1e-6


def fitting(drive: Drive, longest: Drive, given: DriveOptions) -> jax.Array:
    """Whether the delays and the parts of a drive fit; bool, () or of the shape of its joints.

    Args:
        drive: of which values may be traced, and then decide it only when they are known.
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
        return jnp.asarray(True)
    period = jnp.asarray(drive.control_period)
    same = jnp.abs(period - longest.control_period) <= _ROUNDING * period
    return same & _policy_fits(drive, given) & _delays_fit(drive, given)


def defined_where(fits: jax.Array, coefficients: Coefficients) -> Coefficients:
    """The coefficients of a drive that gives forces which are not a number where it does not fit.

    Its gains alone would not do: a compiler may take the product of a selector that is 0 and what
    the gains give, in a delay line, for 0.

    Args:
        fits: bool, () or of the shape of the joints.
        coefficients: from `jaxact.drive.step.prepare`.
    """

    def kept(leaf: jax.Array | float) -> jax.Array:
        return jnp.where(fits, leaf, jnp.nan)

    drive = coefficients.drive
    controller = replace(
        drive.controller, kp=kept(drive.controller.kp), kd=kept(drive.controller.kd)
    )
    responses = jax.tree.map(kept, coefficients.responses)
    return replace(coefficients, drive=replace(drive, controller=controller), responses=responses)


def _traced(value: Any) -> bool:
    return isinstance(value, jax.core.Tracer)


def _policy_fits(drive: Drive, given: DriveOptions) -> jax.Array:
    """Whether the policy's period is as many control periods, and held where it is several."""
    ticks = jnp.asarray(drive.policy_period) / drive.control_period
    whole = jnp.round(ticks)
    divides = (jnp.abs(ticks - whole) <= _ROUNDING * ticks) & (whole >= 1.0)
    return (ticks == 0.0) | (divides & ((whole == 1.0) | given.held_setpoint))


def _delays_fit(drive: Drive, given: DriveOptions) -> jax.Array:
    """Whether the delays have slots enough; bool, of their shape."""
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
        "ideal actuator behind a force limit": own.ideal > given.ideal,
        "force rate limit": own.rate_limited > given.rate_limited,
        "torque-speed line": own.speed_limited > given.speed_limited,
        "policy rate": own.held_setpoint > given.held_setpoint,
    }
    return [name for name, is_missing in missing.items() if is_missing]
