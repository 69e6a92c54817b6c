"""The drive around any simulator: `jaxact.drive_around`.

    drive = jaxact.drive_around(step, loop, measure=measure, physics_step=0.002, joints=12)
    state = drive.init(data)                         # data: the simulator's own state
    state, output = drive.step(state, setpoint)      # one control period
    data = state.simulator

It is the same step as everywhere: the controller ticks once, then the simulator takes its physics
steps under the force of the drive, and where a measurement is delayed it is captured in between.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.drive import options as _options
from jaxact.drive import sensor as _sensor
from jaxact.drive import step as _drive
from jaxact.drive.controller import Setpoint, accepted
from jaxact.drive.options import Drive, DriveOptions
from jaxact.errors import UserError
from jaxact.loops import around_checks as _checks
from jaxact.loops import loop as _loop
from jaxact.loops.control_loop import ControlLoop
from jaxact.loops.conversion import drive_of, within_bounds
from jaxact.loops.longest import defined_where, fitting
from jaxact.loops.loop import Loop, LoopState, Output, Prepared
from jaxact.loops.simulator import Measure, Simulator, Step, with_arrays
from jaxact.parameters import GAIN_SCALE, KD, KP


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DrivenState:
    """A simulator and its drives between two control periods.

    Attributes:
        loop: of both.
        tick: number of control periods so far, int32.
    """

    loop: LoopState
    tick: jax.Array

    @property
    def simulator(self) -> Any:
        """The simulator's own state."""
        return self.loop.plant


@dataclass(frozen=True)
class Driven:
    """A simulator with drives around it; a pytree of the drives' coefficients.

    Attributes:
        prepared: coefficients, and the simulator.
        options: static side of the drives.
    """

    prepared: Prepared
    options: DriveOptions

    def init(
        self, state: Any, *, command: jax.Array | float = 0.0,
        setpoint: Setpoint | jax.Array | None = None,
    ) -> DrivenState:  # fmt: skip
        """Drives that have held a command for ever, around a simulator in this state.

        Their sensors have seen its joints come to where they are at the velocities that they have.

        Args:
            state: the simulator's own.
            command: past command [N or N m], shape (joints,) or a number; the force is what limits
                leave of it. 0 unless it is given.
            setpoint: past setpoint, as for `step`; it matters where there is a setpoint delay. The
                positions that the joints have unless it is given.

        Raises:
            UserError: the command is not of finite numbers, or one of both of another number of
                joints.
        """
        command = _checks.command_of(command, self.prepared.plant.shape)
        if setpoint is not None:
            setpoint = _checks.setpoint_of(setpoint, self.prepared.plant.shape)
            if self.options.clamped_setpoint:
                setpoint = accepted(self.prepared.drive.drive.controller, setpoint)
        state = with_arrays(state)
        position, velocity = self.prepared.plant.measure(state)
        drive = _drive.init(
            self.prepared.drive, self.options, position, velocity, command=command,
            setpoint=setpoint,
        )  # fmt: skip
        return DrivenState(LoopState(state, drive), jnp.zeros((), jnp.int32))

    def step(
        self, state: DrivenState, setpoint: Setpoint | jax.Array, key: jax.Array | None = None
    ) -> tuple[DrivenState, Output]:
        """One control period: the controllers tick, and the simulator takes its physics steps.

        Args:
            state: from `init` or the step before.
            setpoint: joint positions [m or rad], a number or of shape (joints,), or a
                `jaxact.Setpoint` with velocities and forces.
            key: random key of this simulator, the same at every step; needed only with noise.

        Returns:
            The state a control period later, and what happened.

        Raises:
            UserError: the state is not from `init`, the setpoint not of this number of joints, or
                the key is missing or none.
        """
        if not isinstance(state, DrivenState):
            raise UserError(
                f"state: a value of type {type(state).__name__} is not the state of a drive; give "
                "drive.init(...), or what the step before gave first"
            )
        setpoint = _checks.setpoint_of(setpoint, self.prepared.plant.shape)
        if self.options.random:
            _checks.demand_key(key)
        like = self.prepared.drive.drive.controller.kp
        draws = _sensor.draw(self.options.sensor, key, state.tick, like)
        loop, (output, _) = _loop.step(self.prepared, self.options, state.loop, setpoint, draws)
        return DrivenState(loop, state.tick + 1), output


jax.tree_util.register_dataclass(Driven, data_fields=["prepared"], meta_fields=["options"])


def drive_around(
    step: Step,
    loop: ControlLoop | Drive,
    *,
    measure: Measure,
    physics_step: float,
    joints: int | None = None,
    longest: ControlLoop | Drive | None = None,
) -> Driven:
    """Put the drive around a function that advances a simulator by one physics step.

    Two hinges in MJX, for a second at the 1000 Hz that a loop has by default::

        drive = jaxact.drive_around(
            lambda data, force: mjx.step(model, data.replace(qfrc_applied=force)), loop,
            measure=lambda data: (data.qpos, data.qvel), physics_step=5e-4, joints=2,
        )
        state = drive.init(mjx.make_data(model))
        for _ in range(1000):  # control periods
            state, output = drive.step(state, setpoint)
        data = state.simulator

    Everything can be compiled, mapped and differentiated, as far as the simulator can.

    Args:
        step: (state, forces of shape (joints,)) -> the state one physics step later. The forces
            are the actuators' means over that physics step, not those at its end.
        loop: gains, actuator, delays, sensing, limits and control rate, of which a value is a
            number or has the shape (joints,); the plant's own parameters do not count. Of
            `jaxact.robot`, the driven joints' in their order; setpoints beyond what a position
            servo of its model accepts are clamped there.
        measure: state -> joint positions [m or rad] and velocities, shape (joints,) each.
        physics_step: that `step` takes [s], which nothing here can check (of MuJoCo
            `model.opt.timestep`); the control period is a multiple of it.
        joints: number of driven joints, None for a robot's own, and otherwise for a single one
            whose quantities have no axis.
        longest: where values of `loop` are traced or change later: a loop with the longest delays
            and with every part (noise, resolution, limits) that may occur. Its control rate is the
            loop's unless it is given; a traced one must be that of `longest`. Where a traced delay
            is longer all the same, a traced value out of its bounds, or a traced rate another one
            or not divided by the policy's, the forces are not a number.

    Returns:
        `init(data, command=0.0)` begins, the drives having held that command [N or N m] for ever: 0
        is limp, and a robot that stands has its holding forces. `step(state, setpoint, key)` takes
        a control period towards joint positions [m or rad], a number or of shape (joints,), or a
        `jaxact.Setpoint` with velocities and forces; it returns the state, in which `simulator` is
        yours, and a `jaxact.loops.loop.Output`: `command`, `peak_force`, the
        `position` and `velocity` at the end of the period, ... With noise, `key` is the
        simulator's: the same one at every step.

    Raises:
        UserError: the control period is not a multiple of the physics step, or the policy's rate
            does not divide the control rate, shapes do not fit, the loop is neither a loop nor a
            drive, or a robot's that is a batch, a joint has half a torque-speed line, or `longest`
            has not all that the loop has, or another control rate.
        TypeError: the loop is traced, and `longest` is not given, or is traced as well.
    """
    static = loop if longest is None else longest
    _checks.demand_loop("loop", loop)
    _checks.demand_loop("longest", static)
    _checks.demand_known(loop, longest)
    _checks.demand_numbers(physics_step, joints)
    for name, own in (("step", step), ("measure", measure)):
        if not callable(own):
            raise UserError(f"{name}: a value of type {type(own).__name__} is not a function")
    drive, known = _drive_in(loop), _drive_in(static)
    names = _names(static)
    joints = (len(names) or None) if joints is None else joints
    plant = Simulator(jnp.asarray(physics_step), step, measure, joints)
    _checks.demand_shapes(drive, plant.shape)
    _checks.demand_line(drive, names)
    known = replace(known, control_period=_checks.control_period(drive, known, longest))
    substeps = _checks.substeps_in(known.control_period, physics_step)
    for one in (drive, known):
        _checks.demand_policy(one, known.control_period)
    differenced = _differenced(static)
    if longest is not None and _differenced(loop) != differenced:
        raise UserError("longest: has another velocity than the loop; give both the same")
    options = _options.options(known, substeps=substeps, differenced=differenced)
    prepared = _loop.prepare(Loop(plant, drive), options)
    if longest is not None:
        fits = fitting(drive, known, options) & _within_bounds(loop)
        if _checks.traced(loop):  # what is known, and has been refused, needs no more operations
            prepared = replace(prepared, drive=defined_where(fits, prepared.drive))
    return Driven(prepared, options)


def _differenced(loop: ControlLoop | Drive) -> bool:
    return isinstance(loop, ControlLoop) and loop.kind.velocity == "differenced"


def _drive_in(loop: ControlLoop | Drive) -> Drive:
    if isinstance(loop, Drive):
        return loop
    if _checks.traced(loop):
        return _drive_of(loop)
    with jax.ensure_compile_time_eval():  # what is known stays so while others are traced
        return _drive_of(loop)


def _drive_of(loop: ControlLoop) -> Drive:
    values = loop.parameters
    if loop.kind.plant is not None:
        from jaxact.loops import robots  # imports MuJoCo, which a joint does not need

        values = robots.of_drives(loop.kind.plant, values)
    scale = values[GAIN_SCALE]
    return drive_of({**values, KP: scale * values[KP], KD: scale * values[KD]})


def _within_bounds(loop: ControlLoop | Drive) -> jax.Array:
    """Whether the traced values of a loop are what they may be; a drive has no bounds."""
    if isinstance(loop, Drive):
        return jnp.asarray(True)
    traced = [name for name, value in loop.values.items() if _checks.traced(value)]
    return within_bounds(loop.values, traced)


def _names(loop: ControlLoop | Drive) -> tuple[str, ...]:
    """The driven joints of a robot's loop; () of a joint's."""
    if isinstance(loop, Drive) or loop.kind.plant is None:
        return ()
    from jaxact.loops import robots  # as above

    return tuple(joint.name for joint in robots.driven(loop.kind.plant).joints)
