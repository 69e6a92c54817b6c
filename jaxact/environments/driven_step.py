"""A driven step of MJX, whose whole state fits into `data.userdata`.

    userdata = (begun, draws, drive)

Environments restore `data` at a reset, so the drive begins anew exactly when its environment does:
zeros mean that it has not begun. What is drawn of its parameters is kept until then.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from jaxact.drive import sensor as _sensor
from jaxact.drive import step as _drive
from jaxact.drive import threefry
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.step import DriveState
from jaxact.environments.environment_drive import EnvironmentDrive
from jaxact.loops import loop as _loop
from jaxact.loops.around import Simulator
from jaxact.loops.conversion import drive_of
from jaxact.loops.loop import Loop, LoopState, Prepared
from jaxact.parameters import CONTROL_RATE, FEEDFORWARD, KD, KP, POLICY_RATE


@dataclass(frozen=True)
class DrivenStep:
    """Steps of MJX under the drive.

    Attributes:
        drive: of the environment.
        advance: (model, data) of MJX -> data a physics step later.
    """

    drive: EnvironmentDrive
    advance: Any

    @property
    def size(self) -> int:
        """Length of `userdata`."""
        joints = len(self.drive.actuators.names)
        shape = jax.ShapeDtypeStruct((joints,), jnp.result_type(float))
        state = jax.eval_shape(self._flat_of_rest, shape)
        return 1 + self.drive.draws + state.shape[0]

    def _flat_of_rest(self, zero: jax.Array) -> jax.Array:
        drive = _coefficients(self.drive, zero)
        return ravel_pytree(_tick(_drive.init(drive, self.drive.options, zero, zero)))[0]

    def fresh(self, data: Any) -> Any:
        """The data of MJX with drives that have not begun."""
        return data.replace(userdata=jnp.zeros(self.size, data.qpos.dtype))

    def step(self, model: Any, data: Any, control: jax.Array, substeps: int, key: jax.Array) -> Any:
        """Several physics steps under a control that is held.

        Args:
            model, data: of MJX; `data.userdata` from `fresh` or the step before.
            control: of all actuators, shape (nu,).
            substeps: number of physics steps.
            key: two random words, shape (2,), others at every call.

        Returns:
            The data, with the control in `ctrl` as the environment's own step leaves it.
        """
        parts, own = self.drive, self.drive.actuators
        ticks = parts.ticks(substeps)
        begun = data.userdata[0] > 0.0
        drawing, sensing = (threefry.folded(key, which) for which in range(2))
        draws = jnp.where(begun, data.userdata[1 : 1 + parts.draws], parts.draw(drawing))
        setpoint = own.setpoint(model, control, jnp)
        prepared = self._prepared(model, control, draws)
        position, velocity = prepared.plant.measure(data)
        first = held(prepared.drive.drive.controller, setpoint, position, velocity)
        rest = _tick(_drive.init(prepared.drive, parts.options, position, velocity, command=first))
        flat, unravel = ravel_pytree(rest)
        state, tick = unravel(jnp.where(begun, data.userdata[1 + parts.draws :], flat))

        def period(carry: Any, _: None) -> tuple[Any, None]:
            state, tick = carry
            like = jnp.asarray(prepared.drive.drive.controller.kp)
            drawn = _sensor.draw(parts.options.sensor, sensing, tick, like)
            state, _output = _loop.step(prepared, parts.options, state, setpoint, drawn)
            return (state, tick + 1), None

        carry = (LoopState(data, state), tick)
        (after, tick), _ = jax.lax.scan(period, carry, None, length=ticks)
        flat, _ = ravel_pytree((after.drive, tick))
        userdata = jnp.concatenate([jnp.ones(1, flat.dtype), draws.astype(flat.dtype), flat])
        return after.plant.replace(ctrl=control, userdata=userdata.astype(data.userdata.dtype))

    def _prepared(self, model: Any, control: jax.Array, draws: jax.Array) -> Prepared:
        """The drive of these draws around the physics steps of this model."""
        own = self.drive.actuators
        motors = model.tree_replace(own.as_motors(model, damping=self.drive.damping))
        moments = own.moments(model)

        def advance(data: Any, force: jax.Array) -> Any:
            driven = jnp.asarray(control).at[own.controls].set(force / moments)
            return self.advance(motors, data.replace(ctrl=driven))

        def measure(data: Any) -> tuple[jax.Array, jax.Array]:
            return data.qpos[own.positions], data.qvel[own.velocities]

        plant = Simulator(jnp.asarray(self.drive.physics_step), advance, measure, len(own.names))
        return _loop.prepare(Loop(plant, self.drive.drive(draws, model)), self.drive.options)


def _coefficients(drive: EnvironmentDrive, zero: jax.Array) -> _drive.Coefficients:
    """Coefficients of the shapes that a drive's have, whatever the model and the draws."""
    values: dict[str, Any] = {name: low + zero for name, low in drive.low.items()}
    values |= {KP: zero, KD: zero, FEEDFORWARD: 0.0, POLICY_RATE: np.inf}
    values[CONTROL_RATE] = float(drive.low[CONTROL_RATE])
    return _drive.prepare(drive_of(values), drive.options, zero.shape)


def _tick(state: DriveState) -> tuple[DriveState, jax.Array]:
    return state, jnp.zeros((), jnp.int32)


def held(
    controller: Controller, setpoint: Setpoint, position: jax.Array, velocity: jax.Array
) -> jax.Array:
    """The command that a controller without delay would give: as if it had been held before."""
    return (
        controller.kp * (setpoint.position - position)
        + controller.kd * (setpoint.velocity - velocity)
        + setpoint.force
    )
