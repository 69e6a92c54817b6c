"""The drive: everything between setpoint and joint force, as one step over pytrees.

    tick (each control period T):  sense -> control -> hold
    actuate (each physics step):   delayed command -> force loop -> limits -> force on the plant

This is the only implementation. Every plant, engine and wrapper calls `tick` once per control
period and `actuate` once per physics step, and passes the force on.

The output delay is applied before the force loop instead of after it: the loop and its limits do
not change with time, so they commute with a delay, and the delay of a *held* command is exact where
that of a force would have to be interpolated. Only the force-speed line sees the difference: it
takes the velocity when the force acts, not when it was commanded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from jaxact.drive import actuator as _actuator
from jaxact.drive import controller as _controller
from jaxact.drive import delay as _delay
from jaxact.drive import joint_motion as _joint
from jaxact.drive import limiting as _limiting
from jaxact.drive import sensor as _sensor
from jaxact.drive import setpoint_path as _setpoint
from jaxact.drive.actuator import Response
from jaxact.drive.controller import Setpoint
from jaxact.drive.measuring_instant import Capture, capture_at, measured_before, older_for
from jaxact.drive.options import Drive, DriveOptions, options
from jaxact.drive.sensor import Draws, SensorCoefficients, SensorState

__all__ = [
    "Capture",
    "Coefficients",
    "Drive",
    "DriveOptions",
    "DriveState",
    "Force",
    "actuate",
    "at_substep",
    "capture",
    "init",
    "options",
    "prepare",
    "tick",
]


NO_DRAWS = Draws()
"""The random numbers of a drive without noise and walking biases: none."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DriveState:
    """What a drive remembers; arrays of shape (joints,), None where the part does not exist.

    Attributes:
        commands: line of held commands [N or N m].
        older, newer: delayed command before and after its switch in this period [N or N m].
        force, rate: state of the force loop [N or N m] and per second.
        applied: force at the end of the last step, after the limits [N or N m] (rate limit only).
        sensor: state of the sensor.
        measurements: lines of positions and velocities as they were captured.
        setpoints: line of setpoints.
        held: setpoint that the policy gave last (a policy slower than the controller only).
    """

    commands: _delay.Line
    older: jax.Array
    newer: jax.Array
    force: jax.Array
    rate: jax.Array
    applied: jax.Array | None
    sensor: SensorState
    measurements: tuple[_delay.Line, _delay.Line] | None
    setpoints: tuple[_delay.Line, _delay.Line, _delay.Line] | None
    held: _setpoint.Held | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Coefficients:
    """All that follows from the parameters and stays the same during a rollout; see `prepare`.

    Attributes:
        drive: the parameters.
        step: physics step h [s].
        responses: of the force loop; coefficients of shape (substeps, joints).
        older_share: share of each physics step under the older command [-]; (substeps, joints).
        command_at, measurement_at, setpoint_at: selectors of the delay lines.
        setpoint_share: share of the older setpoint [-].
        policy_ticks: control ticks in a period of the policy [-]; None where it is as fast.
        capture: where the measurement is taken; None without measurement delay.
        sensor: coefficients of the sensor.
        body: that the force accelerates, where its inertia is known and the force-speed line of
            `jaxact.drive.limiting` asks for it; else None.
    """

    drive: Drive
    step: jax.Array
    responses: Response
    older_share: jax.Array
    command_at: tuple[jax.Array, ...] | jax.Array
    measurement_at: tuple[jax.Array, ...] | jax.Array | None
    setpoint_at: tuple | None
    setpoint_share: jax.Array | None
    policy_ticks: jax.Array | None
    capture: Capture | None
    sensor: SensorCoefficients
    body: _joint.Joint | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Force:
    """The force over one physics step, [N or N m], shape (joints,).

    Attributes:
        mean: mean over the step; its product with the step is the exact impulse.
        moment: (2/h^2) int_0^h (h - t) f dt.
        partial: the same pair from the start of the step to the measuring instant; None without
            measurement delay.
        motion, partial_motion: what the step, and its part until that instant, do to a joint with
            damping and stiffness of its own; None of any other plant.
    """

    mean: jax.Array
    moment: jax.Array
    partial: tuple[jax.Array, jax.Array] | None
    motion: _joint.Motion | None = None
    partial_motion: _joint.Motion | None = None


def _broadcast(drive: Drive, shape: tuple[int, ...]) -> Drive:
    """The drive with every leaf but the control period in the shape of its joints."""
    dtype = jnp.result_type(float)
    period = jnp.asarray(drive.control_period, dtype)
    leaves = jax.tree.leaves(replace(drive, control_period=0.0))
    shape = jnp.broadcast_shapes(shape, *(jnp.shape(leaf) for leaf in leaves))
    drive = jax.tree.map(lambda leaf: jnp.broadcast_to(jnp.asarray(leaf, dtype), shape), drive)
    return replace(drive, control_period=period)


def prepare(
    drive: Drive,
    options: DriveOptions,
    shape: tuple[int, ...] = (),
    joint: _joint.Joint | None = None,
    body: _joint.Joint | None = None,
) -> Coefficients:
    """All coefficients of a drive, computed once, before the scan over time.

    Args:
        drive: parameters, leaves broadcastable against each other; may be traced.
        options: static.
        shape: of the joints, (joints,) or (), where no leaf has it.
        joint: that the drive moves, if it has damping or stiffness of its own; see
            `jaxact.plants.mass`.
        body: the joint, bare or not, where the force accelerates nothing else: of such a one the
            force-speed line is that of each moment, of another one that of each step's beginning.

    Returns:
        The coefficients that `tick` and `actuate` take.
    """
    drive = _broadcast(drive, shape)
    actuator, period = drive.actuator, drive.control_period
    step = period / options.substeps
    whole, switch = _delay.split(actuator.delay + drive.output_delay, period)
    switched = _delay.split(switch, step)
    older = jnp.stack([older_for(step, switched, i) for i in range(options.substeps)])
    body = jax.tree.map(lambda leaf: jnp.asarray(leaf, step.dtype), body)
    body = body if options.speed_limited else None

    def response(share: jax.Array) -> Response:
        wn, zeta = actuator.natural_frequency, actuator.damping_ratio
        own = _actuator.response(wn, zeta, step, share, joint)
        return replace(own, limits=_limiting.span(options, actuator, step, share, body))

    responses = jax.vmap(response)(older)
    measurement_at = capture = setpoint_at = share = None
    if options.measurement_slots:
        late, remainder = _delay.split(drive.sensor.delay, period)
        measurement_at = _delay.weights(late, options.measurement_slots)
        capture = capture_at(drive, options, step, switched, remainder, joint, body)
    if options.setpoint_slots:
        late, remainder = _delay.split(drive.controller.setpoint_delay, period)
        setpoint_at = (
            _delay.weights(late, options.setpoint_slots),
            _delay.weights(late + 1.0, options.setpoint_slots),
        )
        share = remainder / period
    return Coefficients(
        drive=drive,
        step=step,
        responses=responses,
        older_share=older / step,
        command_at=_delay.weights(whole, options.command_slots),
        measurement_at=measurement_at,
        setpoint_at=setpoint_at,
        setpoint_share=share,
        policy_ticks=(
            _setpoint.ticks_of_policy(jnp.asarray(drive.policy_period), period)
            if options.held_setpoint
            else None
        ),
        capture=capture,
        sensor=_sensor.prepare(drive.sensor, period),
        body=body,
    )


def init(
    coefficients: Coefficients,
    options: DriveOptions,
    position: jax.Array,
    velocity: jax.Array,
    *,
    command: jax.Array | float = 0.0,
    setpoint: Setpoint | None = None,
) -> DriveState:
    """State of a drive that has held `command` for ever in front of a plant at constant velocity.

    It has measured that plant at x0 + v0 t, t < 0, x0 and v0 its position and velocity now.

    Args:
        coefficients: from `prepare`.
        options: static.
        position: of the plant [m or rad], shape (joints,).
        velocity: of the plant [m/s or rad/s], shape (joints,).
        command: past command [N or N m]; the force is what limits leave of it.
        setpoint: so far; None for the position, at rest.

    Returns:
        The state before the first tick.
    """
    zero = jnp.zeros_like(position)
    command = zero + command
    drive, applied, measurements, setpoints = coefficients.drive, None, None, None
    if options.rate_limited:
        applied = jnp.clip(command, *_actuator.limits(drive.actuator, zero + velocity))
    if options.measurement_slots:
        measurements = measured_before(drive, options.measurement_slots, position, velocity)
    if options.setpoint_slots:
        asked = setpoint or Setpoint(position, zero, zero)
        values = (asked.position, asked.velocity, asked.force)
        setpoints = tuple(_delay.init(zero + one, options.setpoint_slots) for one in values)
    return DriveState(
        commands=_delay.init(command, options.command_slots),
        older=command,
        newer=command,
        force=command,
        rate=zero,
        applied=applied,
        sensor=_sensor.init(drive.sensor, options.sensor, position, velocity, drive.control_period),
        measurements=measurements,
        setpoints=setpoints,
        held=None
        if coefficients.policy_ticks is None
        else _setpoint.begin(position, coefficients.policy_ticks),
    )


def tick(
    coefficients: Coefficients,
    options: DriveOptions,
    state: DriveState,
    position: jax.Array,
    velocity: jax.Array,
    setpoint: Setpoint,
    draws: Draws = NO_DRAWS,
) -> tuple[DriveState, jax.Array]:
    """Sense and control, once per control period.

    Args:
        coefficients: from `prepare`.
        options: static.
        state: of the drive.
        position: of the plant now [m or rad], shape (joints,); with a measurement delay the drive
            uses what `capture` stored instead.
        velocity: of the plant now [m/s or rad/s], shape (joints,).
        setpoint: given now; it reaches the controller after the setpoint delay, where a policy is
            slower than the controller only if it ticks now.
        draws: random numbers of this tick, from `jaxact.drive.sensor.draw`; needed only where
            `options.random`.

    Returns:
        The next state, and the command [N or N m], shape (joints,).
    """
    if state.measurements is not None:
        where = coefficients.measurement_at
        position, velocity = (_delay.read(line, where) for line in state.measurements)
    if options.clamped_setpoint:
        setpoint = _controller.accepted(coefficients.drive.controller, setpoint)
    held, setpoints = state.held, state.setpoints
    if held is not None:
        held = _setpoint.hold(held, setpoint, coefficients.policy_ticks)
        setpoint = held.setpoint
    if setpoints is not None:
        at, share = coefficients.setpoint_at, coefficients.setpoint_share
        setpoints, setpoint = _setpoint.late(setpoints, setpoint, at, share, velocity)
    sensor, (measured, rate) = _sensor.step(
        coefficients.sensor, options.sensor, state.sensor, position, velocity, draws
    )
    command = _controller.step(
        coefficients.drive.controller,
        setpoint,
        measured,
        rate,
        quantised=options.quantised_command,
    )
    commands = _delay.push(state.commands, command)
    newer = _delay.read(commands, coefficients.command_at)
    state = replace(
        state,
        commands=commands,
        older=state.newer,
        newer=newer,
        sensor=sensor,
        setpoints=setpoints,
        held=held,
    )
    return state, command


def at_substep(coefficients: Coefficients) -> tuple[Response, jax.Array | None]:
    """What differs between the physics steps of a period, stacked along axis 0, for a scan.

    Returns:
        (responses, capture flags or None), each leaf of shape (substeps, joints).
    """
    capture = coefficients.capture
    return coefficients.responses, None if capture is None else capture.here


def actuate(
    coefficients: Coefficients,
    options: DriveOptions,
    state: DriveState,
    response: Response,
    velocity: jax.Array,
    position: jax.Array | None = None,
) -> tuple[DriveState, Force]:
    """Move the force loop by one physics step; exact for the held, delayed command.

    Args:
        coefficients: from `prepare`.
        options: static.
        state: of the drive, after the tick of this period.
        response: of this physics step, from `at_substep`.
        velocity: of the plant now [m/s or rad/s], shape (joints,); for the force-speed line.
        position: of the plant now [m or rad], shape (joints,); for the force-speed line of a body
            with stiffness only.

    Returns:
        The next state, and the force on the plant over this step. What limits leave of it is of
        second order in the step, and exact in some cases, see `jaxact.drive.limiting`; but the
        force-speed line of a plant whose inertia the drive does not know is of first order.
    """
    actuator, line = coefficients.drive.actuator, velocity if coefficients.body is None else None
    commands = _limiting.limited(options, actuator, state.older, state.newer, line)
    inputs = state.force, state.rate, *commands
    resistance: jax.Array | float = 0.0
    if coefficients.body is not None and position is not None:
        resistance = coefficients.body.damping * velocity + coefficients.body.stiffness * position

    def over(span: Response) -> tuple:
        """Mean and moment, motion, and the limited force at the end, over a span."""
        pair = _actuator.impulse(span, *inputs)
        motion = None if span.joint is None else _joint.motion(span.joint, *inputs)
        if options.unlimited:
            return pair, motion, None
        return _limiting.held(
            options, actuator, span, inputs, state.applied, velocity, resistance, motion
        )

    (mean, moment), motion, end = over(response)
    partial = partial_motion = None
    if coefficients.capture is not None:
        partial, partial_motion, _ = over(coefficients.capture.response)
    force, rate = _actuator.advance(response, *inputs)
    acting = Force(mean, moment, partial, motion, partial_motion)
    return replace(state, force=force, rate=rate, applied=end), acting


def capture(state: DriveState, position: jax.Array, velocity: jax.Array) -> DriveState:
    """Store the plant's state at the measuring instant of this period, [m or rad] and per second.

    Called once per control period, after its physics steps, where a measurement delay exists.
    """
    lines = tuple(
        _delay.push(line, value)
        for line, value in zip(state.measurements, (position, velocity), strict=True)
    )
    return replace(state, measurements=lines)
