"""The parameters of a drive, and the static options that follow from concrete ones.

What is numeric can be traced, batched and differentiated; what decides the shape of the computation
(lengths of delay lines, parts that exist at all) is static and lives in `DriveOptions`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import jax
import numpy as np

from jaxact.drive import delay as _delay
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller
from jaxact.drive.sensor import Sensor, SensorOptions


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Drive:
    """Parameters of a drive; every leaf a float or an array of shape (joints,).

    Attributes:
        controller: gains, feedforward, D/A resolution, setpoint delay.
        actuator: force loop, command delay, limits.
        sensor: measurement delay, bias, noise, resolution, velocity filter.
        output_delay: delay of the force after the actuator, before its force-speed line [s].
        control_period: T [s], one number for all joints.
        policy_period: time between new setpoints [s], a multiple of T; 0 for one at every tick.
    """

    controller: Controller
    actuator: Actuator = field(default_factory=Actuator)
    sensor: Sensor = field(default_factory=Sensor)
    output_delay: jax.Array | float = 0.0
    control_period: jax.Array | float = 1e-3
    policy_period: jax.Array | float = 0.0


@dataclass(frozen=True)
class DriveOptions:
    """The static side of a drive: lengths of the delay lines, and which parts exist at all.

    Build it with `options` from concrete parameters (of all samples of a sweep at once).

    Attributes:
        substeps: physics steps in a control period.
        command_slots: length of the line of commands (command and output delay).
        measurement_slots: length of the line of measurements; 0 without measurement delay.
        setpoint_slots: length of the line of setpoints; 0 without setpoint delay.
        sensor: static side of the sensor.
        quantised_command: the D/A converter has a resolution.
        limited: a force limit or a force-speed line exists.
        ideal: behind a delay, with a limit, an actuator without dynamics exists.
        rate_limited: a force rate limit exists.
        speed_limited: a force-speed line exists.
        held_setpoint: a policy gives setpoints more slowly than the controller ticks.
        clamped_setpoint: the controller accepts setpoints within a range only.
        staged: results that several later ones need are computed once and kept, rather than left to
            the compiler, which on CPUs computes them anew for each; changes nothing else.
    """

    substeps: int = 1
    command_slots: int = 1
    measurement_slots: int = 0
    setpoint_slots: int = 0
    sensor: SensorOptions = field(default_factory=SensorOptions)
    quantised_command: bool = False
    limited: bool = False
    ideal: bool = False
    rate_limited: bool = False
    speed_limited: bool = False
    held_setpoint: bool = False
    clamped_setpoint: bool = False
    staged: bool = False

    @property
    def random(self) -> bool:
        """Whether a step draws random numbers and needs a key."""
        return self.sensor.noise or self.sensor.walk

    @property
    def linear(self) -> bool:
        """Whether the drive is linear and deterministic."""
        return self.additive and not self.random

    @property
    def quantised(self) -> bool:
        """Whether a sensor or the command has counts."""
        return self.sensor.quantise or self.quantised_command

    @property
    def additive(self) -> bool:
        """Whether the drive is linear, but for noise that is added to what it senses."""
        return not self.quantised and self.unlimited

    @property
    def unlimited(self) -> bool:
        """Whether nothing bounds the force or its rate."""
        return not (self.limited or self.rate_limited)

    def linearised(self) -> DriveOptions:
        """The same drive without noise, quantisation, limits and a hold of the setpoint."""
        return replace(
            self,
            sensor=SensorOptions(differenced=self.sensor.differenced),
            quantised_command=False,
            limited=False,
            ideal=False,
            rate_limited=False,
            speed_limited=False,
            held_setpoint=False,
            clamped_setpoint=False,
        )


def options(drive: Drive, *, substeps: int = 1, differenced: bool = False) -> DriveOptions:
    """The static options that serve all of these drives.

    Args:
        drive: concrete parameters (not traced), leaves of any shape: one drive or many.
        substeps: physics steps in a control period.
        differenced: velocity from differenced positions instead of sampled.

    Returns:
        Options with delay lines long enough for the longest delays, and with every part that at
        least one drive uses.

    Raises:
        ValueError: substeps is not positive.
    """
    if substeps < 1:
        raise ValueError(f"substeps must be at least 1, got {substeps}")

    def used(*values: jax.Array | float) -> bool:
        return any(bool(np.any(np.asarray(value) != 0.0)) for value in values)

    def finite(*values: jax.Array | float) -> bool:
        return any(bool(np.any(np.isfinite(np.asarray(value)))) for value in values)

    sensor, actuator, period = drive.sensor, drive.actuator, drive.control_period
    total = np.asarray(actuator.delay, float) + np.asarray(drive.output_delay, float)
    setpoint_delay = drive.controller.setpoint_delay
    measured_late, commanded_late = used(sensor.delay), used(setpoint_delay)
    limited = finite(actuator.force_limit, actuator.stall_force)
    limited |= actuator.lowest_force is not None
    ideal = bool(np.any(np.isinf(np.asarray(actuator.natural_frequency))))
    return DriveOptions(
        substeps=substeps,
        command_slots=_delay.slots(total, period),
        measurement_slots=_delay.slots(sensor.delay, period) if measured_late else 0,
        setpoint_slots=_delay.slots(setpoint_delay, period) + 1 if commanded_late else 0,
        sensor=SensorOptions(
            differenced=differenced,
            noise=used(sensor.position_noise, sensor.velocity_noise),
            walk=used(sensor.position_bias_walk, sensor.velocity_bias_walk),
            quantise=used(sensor.position_resolution, sensor.velocity_resolution),
        ),
        quantised_command=used(drive.controller.command_resolution),
        limited=limited,
        ideal=ideal and limited and used(total),
        rate_limited=finite(actuator.force_rate_limit),
        clamped_setpoint=drive.controller.lowest_setpoint is not None,
        speed_limited=finite(actuator.stall_force),
        held_setpoint=bool(np.any(np.asarray(drive.policy_period) > 1.5 * np.asarray(period))),
    )
