"""Plant and drive closed to a loop: one control period, as a pure function over pytrees.

    step(prepared, options, state, setpoint, draws) -> (state, output)

The controller ticks once, then physics takes `options.substeps` steps under the force of the drive.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from jaxact.drive import step as _drive
from jaxact.drive.controller import Setpoint
from jaxact.drive.joint_motion import Joint
from jaxact.drive.sensor import Draws
from jaxact.drive.step import NO_DRAWS, Coefficients, Drive, DriveOptions, DriveState


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Loop:
    """Parameters of a closed loop.

    Attributes:
        plant: what the force acts on; see `jaxact.plants`.
        drive: everything between setpoint and force.
    """

    plant: Any
    drive: Drive


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Prepared:
    """A loop with all coefficients of one control period computed; see `prepare`."""

    plant: Any
    drive: Coefficients

    @property
    def joint(self) -> Joint | None:
        """The joint, where it has damping or stiffness of its own and is not a model; else None."""
        return getattr(self.plant, "joint", None)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LoopState:
    """State of a closed loop between two control periods."""

    plant: Any
    drive: DriveState


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Output:
    """What happened in one control period, each of shape (joints,).

    Attributes:
        position_before, velocity_before: of the plant at its beginning [m or rad] and per second.
        position, velocity: of the plant at the end of the period [m or rad] and per second.
        command: issued at its beginning [N or N m].
        peak_force: largest magnitude of the mean force of its physics steps [N or N m].
        square_force: mean square of the force over the period [N^2 or (N m)^2].
    """

    position_before: jax.Array
    velocity_before: jax.Array
    position: jax.Array
    velocity: jax.Array
    command: jax.Array
    peak_force: jax.Array
    square_force: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Record:
    """The physics steps of a period, each of shape (substeps, joints).

    Attributes:
        position, velocity: at the beginning of the step [m or rad] and per second.
        force: mean over the step [N or N m].
    """

    position: jax.Array
    velocity: jax.Array
    force: jax.Array


def prepare(loop: Loop, options: DriveOptions) -> Prepared:
    """Compute once what does not change during a rollout.

    Args:
        loop: parameters; leaves scalars or of shape (joints,), may be traced.
        options: static, from `jaxact.drive.step.options`.
    """
    joint, body = (getattr(loop.plant, name, None) for name in ("joint", "body"))
    coefficients = _drive.prepare(loop.drive, options, loop.plant.shape, joint, body)
    dtype = coefficients.step.dtype
    plant = jax.tree.map(
        lambda leaf: jnp.asarray(leaf, dtype) if isinstance(leaf, float) else leaf, loop.plant
    )
    return Prepared(plant=plant.prepare(coefficients.step), drive=coefficients)


def init(
    prepared: Prepared,
    options: DriveOptions,
    position: jax.Array,
    velocity: jax.Array,
    *,
    command: jax.Array | float = 0.0,
) -> LoopState:
    """State of a loop that has come to `position` at a constant velocity, `command` held for ever.

    Args:
        prepared: from `prepare`.
        options: static.
        position: [m or rad], shape (joints,).
        velocity: [m/s or rad/s], shape (joints,); the sensors have seen it before time 0, too.
        command: past command [N or N m], shape (joints,) or a number: the force that the setpoint
            so far, where the joints are, came with.
    """
    dtype = prepared.drive.step.dtype
    like = jnp.zeros_like(prepared.drive.drive.controller.kp)
    position = jnp.asarray(position, dtype) + like
    velocity = jnp.asarray(velocity, dtype) + like
    return LoopState(
        plant=prepared.plant.init(position, velocity),
        drive=_drive.init(
            prepared.drive,
            options,
            position,
            velocity,
            command=command,
            setpoint=Setpoint(position, like, command),
        ),  # fmt: skip
    )


Values = TypeVar("Values")


def stage(options: DriveOptions, values: Values) -> Values:
    """The same values, kept apart from what is computed from them where `options.staged`."""
    return jax.lax.optimization_barrier(values) if options.staged else values


def _physics(prepared: Prepared, options: DriveOptions, carry, at):
    """One physics step; carries (loop state, delayed measurement)."""
    state, late = carry
    response, here = at
    before = state.plant
    position, velocity = prepared.plant.measure(before)
    drive, force = _drive.actuate(
        prepared.drive, options, state.drive, response, velocity, position
    )
    force = stage(options, force)
    after = stage(options, prepared.plant.advance(before, force))
    if here is not None:
        offset = prepared.drive.capture.offset
        there = prepared.plant.between(before, after, force, offset)
        late = tuple(jnp.where(here > 0.0, new, old) for new, old in zip(there, late, strict=True))
    return (LoopState(after, drive), late), Record(position, velocity, force.mean)


def step(
    prepared: Prepared,
    options: DriveOptions,
    state: LoopState,
    setpoint: Setpoint,
    draws: Draws = NO_DRAWS,
) -> tuple[LoopState, tuple[Output, Record]]:
    """One control period of the closed loop.

    Args:
        prepared: from `prepare`.
        options: static.
        state: from `init` or the previous step.
        setpoint: given at this tick.
        draws: random numbers of this tick, from `jaxact.drive.sensor.draw`; needed only where
            `options.random`.

    Returns:
        The next state, and (what happened, each physics step of it).
    """
    before = prepared.plant.measure(state.plant)
    drive, command = _drive.tick(prepared.drive, options, state.drive, *before, setpoint, draws)
    drive, command = stage(options, (drive, command))
    carry = LoopState(state.plant, drive), before
    substeps = _drive.at_substep(prepared.drive)
    if options.substeps == 1:
        carry, record = _physics(prepared, options, carry, jax.tree.map(lambda x: x[0], substeps))
        record = jax.tree.map(lambda x: x[None], record)
    else:
        carry, record = jax.lax.scan(
            lambda carry, at: _physics(prepared, options, carry, at), carry, substeps
        )
    state, late = carry
    if state.drive.measurements is not None:
        state = LoopState(state.plant, _drive.capture(state.drive, *late))
    position, velocity = prepared.plant.measure(state.plant)
    output = Output(
        position_before=before[0],
        velocity_before=before[1],
        position=position,
        velocity=velocity,
        command=command,
        peak_force=jnp.max(jnp.abs(record.force), axis=0),
        square_force=jnp.mean(record.force * record.force, axis=0),
    )
    return state, (output, record)
