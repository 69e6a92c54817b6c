"""The drive around any simulator: `jaxact.drive_around`.

    drive = jaxact.drive_around(step, loop, measure=measure, physics_step=0.002, joints=12)
    state = drive.init(data)                         # data: the simulator's own state
    state, output = drive.step(state, setpoint)      # one control period
    data = state.simulator

It is the same step as everywhere: the controller ticks once, then the simulator takes its physics
steps under the force of the drive, and where a measurement is delayed it is captured in between.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.drive import options as _options
from jaxact.drive import sensor as _sensor
from jaxact.drive import step as _drive
from jaxact.drive.controller import Setpoint
from jaxact.drive.options import Drive, DriveOptions
from jaxact.drive.step import Force
from jaxact.errors import UserError
from jaxact.loops import loop as _loop
from jaxact.loops.control_loop import ControlLoop, demand, is_traced
from jaxact.loops.conversion import drive_of, within_bounds
from jaxact.loops.longest import fitting
from jaxact.loops.loop import Loop, LoopState, Output, Prepared
from jaxact.parameters import GAIN_SCALE, KD, KP
from jaxact.plants.linear import hermite

Step = Callable[[Any, jax.Array], Any]
"""(state of a simulator, joint forces [N or N m], shape (joints,)) -> state a step later."""
Measure = Callable[[Any], tuple[jax.Array, jax.Array]]
"""State of a simulator -> joint positions [m or rad] and velocities, shape (joints,) each."""

_ROUNDING = 1e-6


@dataclass(frozen=True)
class Simulator:
    """Somebody's simulator as a plant; see `jaxact.plants.base.Plant`.

    Attributes:
        time_step: physics step [s].
        advance_by: as `Step`.
        measured: as `Measure`.
        joints: number of driven joints, None for one without an axis.
    """

    time_step: jax.Array | float
    advance_by: Step
    measured: Measure
    joints: int | None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the joint quantities."""
        return () if self.joints is None else (self.joints,)

    def prepare(self, step: jax.Array) -> Simulator:
        """The same: a simulator's step is its own."""
        return self

    def measure(self, state: Any) -> tuple[jax.Array, jax.Array]:
        """Joint positions [m or rad] and velocities [m/s or rad/s].

        Raises:
            UserError: `measure` gives something else, or of another number of joints.
        """
        found = self.measured(state)
        shapes = [jnp.shape(part) for part in found] if isinstance(found, tuple | list) else []
        if shapes != [self.shape, self.shape]:
            given = " and ".join(map(str, shapes)) or f"one {type(found).__name__}"
            raise UserError(
                f"measure: gives {given}; needed are (positions, velocities) of shape {self.shape} "
                f"each, as joints = {self.joints}"
            )
        return found[0], found[1]

    def advance(self, state: Any, force: Force) -> Any:
        """State one physics step later under the mean force, so that the impulse is exact.

        Raises:
            UserError: `step` gives something else than a state.
        """
        after = self.advance_by(state, force.mean)
        if jax.tree.structure(after) != jax.tree.structure(state):
            raise UserError(
                f"step: gives a value of type {type(after).__name__}, other than the state of type "
                f"{type(state).__name__} that it is given; needed is the state a physics step later"
            )
        return after

    def between(
        self, before: Any, after: Any, force: Force, offset: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """State `offset` [s] into a step: cubic Hermite position, linear velocity."""
        return hermite(self.measured(before), self.measured(after), offset, self.time_step)


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

    def init(self, state: Any, *, command: jax.Array | float = 0.0) -> DrivenState:
        """Drives that have held a command for ever, around a simulator in this state.

        Args:
            state: the simulator's own.
            command: past command, and the force it gives [N or N m], shape (joints,) or a number;
                0 unless it is given.
        """
        position, velocity = self.prepared.plant.measure(state)
        drive = _drive.init(self.prepared.drive, self.options, position, velocity, command=command)
        return DrivenState(LoopState(state, drive), jnp.zeros((), jnp.int32))

    def step(
        self, state: DrivenState, setpoint: Setpoint | jax.Array, key: jax.Array | None = None
    ) -> tuple[DrivenState, Output]:
        """One control period: the controllers tick, and the simulator takes its physics steps.

        Args:
            state: from `init` or the step before.
            setpoint: joint positions [m or rad], shape (joints,), or with velocities and forces.
            key: random key of this simulator, the same at every step; needed only with noise.

        Returns:
            The state a control period later, and what happened.
        """
        if not isinstance(setpoint, Setpoint):
            setpoint = Setpoint(jnp.asarray(setpoint))
        shape, own = jnp.shape(setpoint.position), self.prepared.plant.shape
        if shape not in ((), own):
            raise UserError(f"setpoint: has shape {shape}; the joints' is {own}")
        if key is None and self.options.random:
            raise UserError(
                "key: a drive with noise needs one at every step, e.g. jax.random.key(0)"
            )
        like = self.prepared.drive.drive.controller.kp
        draws = _sensor.draw(self.options.sensor, key, state.tick, like)
        loop, (output, _) = _loop.step(self.prepared, self.options, state.loop, setpoint, draws)
        return DrivenState(loop, state.tick + 1), output


jax.tree_util.register_dataclass(
    Simulator, data_fields=["time_step"], meta_fields=["advance_by", "measured", "joints"]
)
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
        step: (state, forces of shape (joints,)) -> the state one physics step later.
        loop: gains, actuator, delays, sensing, limits and control rate, of which a value is a
            number or has the shape (joints,); the plant's own parameters do not count. Of
            `jaxact.robot`, the driven joints' in their order.
        measure: state -> joint positions [m or rad] and velocities, shape (joints,) each.
        physics_step: of the simulator [s]; the control period is a multiple of it.
        joints: number of driven joints, None for a robot's own, and otherwise for a single one
            whose quantities have no axis.
        longest: where values of `loop` are traced or change later: a loop with the longest delays
            and with every part (noise, resolution, limits) that may occur. Where a traced delay is
            longer all the same, or a traced value out of its bounds, the forces are not a number.

    Returns:
        `init(data, command=0.0)` begins, the drives having held that command for ever, and
        `step(state, setpoint, key)` takes a control period; it returns the state, in which
        `simulator` is yours, and a `jaxact.loops.loop.Output`: `command`, `peak_force`, the
        `position` and `velocity` at the end of the period, ... With noise, `key` is the
        simulator's: the same one at every step.

    Raises:
        UserError: the control period is not a multiple of the physics step, shapes do not fit, the
            loop is neither a loop nor a drive, or a robot's that is a batch, or `longest` has not
            all that the loop has.
        TypeError: the loop is traced, and `longest` is not given.
    """
    if isinstance(loop, ControlLoop) and is_traced(loop) and longest is None:
        raise TypeError(
            "values of the loop are traced: give longest, a loop with the longest delays and with "
            "every part that may occur"
        )
    static = loop if longest is None else longest
    _demand_loop("loop", loop)
    _demand_loop("longest", static)
    _demand_numbers(physics_step, joints)
    for name, own in (("step", step), ("measure", measure)):
        if not callable(own):
            raise UserError(f"{name}: a value of type {type(own).__name__} is not a function")
    drive, known = _drive_in(loop), _drive_in(static)
    joints = _number(static) if joints is None else joints
    plant = Simulator(jnp.asarray(physics_step), step, measure, joints)
    _demand_shapes(drive, plant.shape)
    periods = np.unique(np.asarray(known.control_period, float))
    ratio = float(periods[0]) / physics_step
    substeps = round(ratio)
    if len(periods) > 1 or substeps < 1 or abs(ratio - substeps) > _ROUNDING * ratio:
        raise UserError(
            f"control_rate: its period {periods[0]:g} s is not a multiple of the physics step "
            f"{physics_step:g} s; allowed e.g. control_rate = "
            f"{1 / (max(substeps, 1) * physics_step):.9g}"
        )
    differenced = _differenced(static)
    if longest is not None and _differenced(loop) != differenced:
        raise UserError("longest: has another velocity than the loop; give both the same")
    options = _options.options(known, substeps=substeps, differenced=differenced)
    if longest is not None:
        drive = fitting(drive, known, options)
    return Driven(_loop.prepare(Loop(plant, drive), options), options)


def _differenced(loop: ControlLoop | Drive) -> bool:
    return isinstance(loop, ControlLoop) and loop.kind.velocity == "differenced"


def _drive_in(loop: ControlLoop | Drive) -> Drive:
    if isinstance(loop, Drive):
        return loop
    values = loop.parameters
    if loop.kind.plant is not None:
        from jaxact.loops import robots  # imports MuJoCo, which a joint does not need

        values = robots.of_drives(loop.kind.plant, values)
    scale = values[GAIN_SCALE]
    traced = [name for name, value in loop.values.items() if isinstance(value, jax.core.Tracer)]
    if traced:  # what is out of its bounds gives forces that are not a number
        scale = jnp.where(within_bounds(loop.values, traced), scale, jnp.nan)
    return drive_of({**values, KP: scale * values[KP], KD: scale * values[KD]})


def _number(loop: ControlLoop | Drive) -> int | None:
    """Driven joints of a robot's loop; None of a joint's."""
    if isinstance(loop, Drive) or loop.kind.plant is None:
        return None
    from jaxact.loops import robots  # as above

    return len(robots.read(loop.kind.plant).joints)


def _demand_loop(name: str, loop: Any) -> None:
    """Raise UserError for what is not a loop, and for robots whose batch would pass for joints."""
    if isinstance(loop, Drive):
        return
    demand(loop, name)
    if loop.kind.plant is not None and loop.shape:
        raise UserError(
            f"{name}: a batch of robots of shape {loop.shape}; give one (several: jax.vmap; "
            'gains per joint: kp={"knee": 80.0})'
        )


def _demand_numbers(physics_step: Any, joints: Any) -> None:
    """Raise UserError for a step that no simulator has, and for what is not a number of joints."""
    number = isinstance(physics_step, float | int | np.number | np.ndarray | jax.Array)
    if not number or np.ndim(physics_step) or not 0.0 < float(physics_step) < math.inf:
        raise UserError(
            f"physics_step: {physics_step!r} is not a physics step; give seconds above 0, "
            "e.g. 0.002"
        )
    whole = isinstance(joints, int | np.integer) and not isinstance(joints, bool)
    if joints is not None and not (whole and joints > 0):
        raise UserError(
            f"joints: {joints!r} is not a number of joints; give 1 or more, or None for one "
            "joint without an axis"
        )


def _demand_shapes(drive: Drive, shape: tuple[int, ...]) -> None:
    """Raise UserError where a drive's value is neither a number nor of this shape."""
    for path, value in jax.tree_util.tree_flatten_with_path(drive)[0]:
        if jnp.shape(value) not in ((), shape):
            name = jax.tree_util.keystr(path, simple=True, separator=".")
            raise UserError(
                f"loop: its {name} has shape {jnp.shape(value)}; give a number, or an array of "
                f"shape {shape}, one for each of the simulator's joints (several loops: jax.vmap)"
            )
