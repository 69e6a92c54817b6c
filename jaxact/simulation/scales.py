"""What the motions of a loop that is not linear are measured with: its counts, limits and rounding.

And whether its limits keep them bounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.drive.joint_motion import Joint
from jaxact.drive.options import Drive

# A motion of less than this share of one count, as it is felt in position, is at rest.
_OF_A_COUNT = 0.01
# The same share of the displacement that commands the force limit.
_OF_THE_LIMIT = 1e-3
# Spacings of floating-point numbers at the setpoint that rounding alone can move a joint by.
_ROUNDING = 64.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Scale:
    """What a motion is measured with, each of shape (joints,).

    Attributes:
        count: what the coarsest quantiser makes of a position [m or rad]; 0 without one.
        rest: half range that counts as at rest [m or rad].
        floor: the part of it that is none of the loop's own [m or rad].
        limit: displacement that commands the largest force [m or rad]; 0 without limits, and where
            the plant bounds a motion, too.
        bounded: whether limits are likely to keep every motion of the loop bounded.
        held: whether they are sure to, see `_bounds`.
        linear: whether the loop is linear, but for noise: its growth rate tells all.
        unlimited: whether it is linear in a motion so large that counts are nothing in it; then
            what grows, grows for ever.
        plant_linear: whether the plant is.
        rubs: whether dry friction acts in it, which ends motions that would grow if they were
            larger.
    """

    count: jax.Array
    rest: jax.Array
    floor: jax.Array
    limit: jax.Array
    bounded: jax.Array
    held: jax.Array
    linear: jax.Array
    unlimited: jax.Array
    plant_linear: jax.Array
    rubs: jax.Array


def _felt(value: jax.Array, kp: jax.Array) -> jax.Array:
    """A force [N or N m] as the displacement that commands it [m or rad]; 0 without stiffness."""
    stiff = jnp.abs(kp)
    return jnp.where(stiff > 0.0, value / jnp.where(stiff > 0.0, stiff, 1.0), 0.0)


def count(drive: Drive) -> jax.Array:
    """One count of the coarsest quantiser of a drive, as it is felt in position.

        max(position count, |kd / kp| velocity count, D/A step / |kp|)

    Args:
        drive: leaves of shape (joints,).

    Returns:
        [m or rad], shape (joints,); 0 without quantisers.
    """
    controller, sensor = drive.controller, drive.sensor
    kp = jnp.asarray(controller.kp)
    velocity = _felt(jnp.abs(controller.kd) * sensor.velocity_resolution, kp)
    command = _felt(jnp.asarray(controller.command_resolution), kp)
    return jnp.maximum(jnp.maximum(sensor.position_resolution, velocity), command)


def limit(drive: Drive) -> jax.Array:
    """The displacement that commands the largest force, or its fastest change in ten periods.

    Returns:
        [m or rad], shape (joints,); inf without limits.
    """
    actuator = drive.actuator
    change = 10.0 * actuator.force_rate_limit * drive.control_period
    force = jnp.minimum(jnp.minimum(actuator.force_limit, actuator.stall_force), change)
    kp = jnp.asarray(drive.controller.kp)
    return jnp.where(jnp.abs(kp) > 0.0, _felt(force, kp), jnp.inf)


def _leads(drive: Drive) -> jax.Array:
    """Whether a force limit keeps the motions of a bare mass bounded, shape (joints,).

        kd > kp lag,   lag = delays + T / 2 + 2 zeta / wn

    In a motion that is large enough the limit makes any gain low, and a mass under low gains is
    damped where the derivative leads by more than the loop lags. Other limits lag themselves.
    """
    actuator, controller = drive.actuator, drive.controller
    lag = actuator.delay + drive.output_delay + drive.sensor.delay + 0.5 * drive.control_period
    lag = lag + 2.0 * actuator.damping_ratio / actuator.natural_frequency
    alone = jnp.isfinite(actuator.force_limit) & jnp.isinf(actuator.stall_force)
    alone &= jnp.isinf(actuator.force_rate_limit)
    return alone & (controller.kp > 0.0) & (controller.kd > controller.kp * lag)


def _bounds(drive: Drive, joint: Joint | None) -> tuple[jax.Array, jax.Array]:
    """Whether limits are likely to keep a joint's motions bounded, and whether they are sure to.

    Sure, where the force or its line is limited: a joint with damping c on a spring of its own is
    bounded, whatever a force within F does. Without a spring it is no faster than F / c, or than
    the line's no-load speed: far enough away all of the force pulls back, and it does not get far
    until then. With a spring and no damping, or a limit of the rate alone, where it is likely,
    another start has to show the cycle.

    Args:
        joint: None for a bare mass.

    Returns:
        Both of shape (joints,).
    """
    actuator, kp = drive.actuator, drive.controller.kp
    k, c = (0.0, 0.0) if joint is None else (joint.stiffness, joint.damping)
    damped, line = jnp.asarray(c) > 0.0, jnp.isfinite(actuator.stall_force)
    line &= jnp.isfinite(actuator.no_load_speed)
    rolls, stands = (k == 0.0) & (kp > 0.0), jnp.asarray(k) > 0.0
    likely = (_leads(drive) & (k >= 0.0)) | ((damped | line) & (rolls | stands))
    limited = jnp.isfinite(actuator.force_limit) | line
    return likely, limited & ((damped & (rolls | stands)) | (line & rolls))


def scale(
    drive: Drive,
    size: jax.Array,
    floor: jax.Array | float = 0.0,
    *,
    linear_plant: bool,
    rubs: bool | jax.Array = False,
    joint: Joint | None = None,
) -> Scale:
    """What the motions of a loop are measured with.

    Args:
        drive: leaves of shape (joints,).
        size: largest position in sight [m or rad], which sets the rounding.
        floor: half range that counts as at rest in any case [m or rad]: what noise sustains.
        linear_plant: static.
        rubs: whether dry friction may act in the plant.
        joint: where it has damping or stiffness of its own. Beyond what its limited force can hold,
            one that topples falls for ever.

    Returns:
        Of a drive with counts, a hundredth of one is at rest; else a thousandth of the displacement
        that commands the force limit. Rounding and the floor always are.
    """
    sensor, actuator = drive.sensor, drive.actuator
    exact = sensor.position_resolution == 0.0
    exact &= (sensor.velocity_resolution == 0.0) & (drive.controller.command_resolution == 0.0)
    unlimited = jnp.isinf(actuator.force_limit) & jnp.isinf(actuator.stall_force)
    unlimited &= jnp.isinf(actuator.force_rate_limit)
    counts, far = count(drive), limit(drive)
    least = jnp.maximum(_ROUNDING * jnp.finfo(size.dtype).eps * size, floor)
    most = jnp.where(jnp.isfinite(far) & linear_plant, far, 0.0)
    own = jnp.where(counts > 0.0, _OF_A_COUNT * counts, _OF_THE_LIMIT * most)
    bounded, held = _bounds(drive, joint)
    return Scale(
        count=counts,
        rest=jnp.maximum(least, own),
        floor=least,
        limit=most,
        bounded=bounded & linear_plant,
        held=held & linear_plant,
        linear=exact & unlimited & linear_plant,
        unlimited=unlimited & linear_plant,
        plant_linear=jnp.full_like(unlimited, linear_plant),
        rubs=jnp.full_like(unlimited, rubs),
    )
