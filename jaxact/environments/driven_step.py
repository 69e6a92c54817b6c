"""A driven step of MJX, whose whole state fits into `data.userdata`.

    userdata = (begun, draws, timing, state)

Environments restore `data` at a reset, so the drive begins anew exactly when its environment does:
zeros mean that it has not begun. What is drawn of its parameters is kept until then, and with it
the coefficients that take long to compute from it. Those that follow from the model are its own at
every step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from jaxact.drive import history, threefry
from jaxact.drive import sensor as _sensor
from jaxact.drive import step as _drive
from jaxact.drive.controller import Setpoint, accepted
from jaxact.drive.options import DriveOptions
from jaxact.drive.step import Coefficients, DriveState
from jaxact.environments.environment_drive import EnvironmentDrive
from jaxact.loops import loop as _loop
from jaxact.loops.conversion import drive_of
from jaxact.loops.loop import Loop, LoopState, Prepared
from jaxact.loops.simulator import Simulator
from jaxact.parameters import CONTROL_RATE, KD, KP, POLICY_RATE


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
        return self._places[1] + _size(self._of_rest[1])

    @property
    def _of_rest(self) -> Any:
        """Shapes of what `_timing` takes of a drive's coefficients, and of its state."""

        def parts(zero: jax.Array) -> Any:
            drive = _coefficients(self.drive, zero)
            rest, _ = history.essential(_drive.init(drive, self.drive.options, zero, zero))
            return _timing(drive), rest

        return jax.eval_shape(parts, jnp.zeros(len(self.drive.actuators.names)))

    @property
    def _places(self) -> tuple[int, int]:
        """Where in `userdata` the timing and the state begin."""
        timing = 1 + self.drive.draws
        return timing, timing + _size(self._of_rest[0])

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
        parts = self.drive
        ticks = parts.ticks(substeps)
        begun = data.userdata[0] > 0.0
        drawing, sensing = (threefry.folded(key, which) for which in range(2))
        draws, timing = self._drawn(model, data.userdata, drawing)
        setpoint = parts.setpoint(model, control, jnp)
        prepared = self._prepared(model, control, draws)
        position, velocity = prepared.plant.measure(data)
        rest = begun_with(prepared.drive, parts.options, setpoint, position, velocity)
        rest, whole = history.essential(rest)
        flat, unravel = ravel_pytree(rest)
        at_timing = ravel_pytree(_timing(prepared.drive))[1]

        # The state as one array: each array that a loop carries may be copied at every turn.
        def period(carry: Any, number: jax.Array) -> tuple[Any, None]:
            data, flat = carry
            now = replace(prepared, drive=_with_timing(prepared.drive, at_timing(timing)))
            like = jnp.asarray(prepared.drive.drive.controller.kp)
            drawn = _sensor.draw(parts.options.sensor, sensing, number, like)
            state = LoopState(data, whole(unravel(flat)))
            state, _output = _loop.step(now, parts.options, state, setpoint, drawn)
            return (state.plant, ravel_pytree(history.essential(state.drive)[0])[0]), None

        flat = jnp.where(begun, data.userdata[self._places[1] :].astype(flat.dtype), flat)
        (after, flat), _ = jax.lax.scan(period, (data, flat), jnp.arange(ticks))
        userdata = jnp.concatenate([jnp.ones(1, flat.dtype), draws, timing, flat])
        return after.replace(ctrl=control, userdata=userdata.astype(data.userdata.dtype))

    def _drawn(
        self, model: Any, userdata: jax.Array, key: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Draws, and what `_timing` takes of their coefficients as one array; kept once begun."""
        joints, places = len(self.drive.actuators.names), self._places

        def draw(carry: Any) -> Any:
            _, key, _, _ = carry
            draws = self.drive.draw(key)
            drawn = self.drive.drive(draws, model)
            drive = _drive.prepare(drawn, self.drive.options, (joints,))
            timing, _ = ravel_pytree(_timing(drive))
            cast = userdata.dtype
            return True, threefry.folded(key, 0), draws.astype(cast), timing.astype(cast)

        # A loop of one turn or none: mapped over environments, it is passed by where all have
        # begun, while both sides of a condition would be computed at every step, which costs more
        # than all else of a drive.
        draws, timing, _ = jnp.split(userdata[1:], np.array(places) - 1)
        carry = userdata[0] > 0.0, key, draws, timing
        carry = jax.lax.stop_gradient(carry)
        _, _, draws, timing = jax.lax.while_loop(lambda carry: ~carry[0], draw, carry)
        return draws, timing

    def _prepared(self, model: Any, control: jax.Array, draws: jax.Array) -> Prepared:
        """The drive of these draws around the physics steps of this model."""
        own = self.drive.actuators
        motors = model.tree_replace(own.as_motors(model, damping=self.drive.damping))
        moments = own.moments(model)
        all_driven = np.array_equal(own.controls, np.arange(control.shape[0]))
        positions, velocities = _run(own.positions), _run(own.velocities)

        def advance(data: Any, force: jax.Array) -> Any:
            driven = force / moments
            if not all_driven:
                driven = jnp.asarray(control).at[own.controls].set(driven)
            return self.advance(motors, data.replace(ctrl=driven))

        def measure(data: Any) -> tuple[jax.Array, jax.Array]:
            return data.qpos[positions], data.qvel[velocities]

        plant = Simulator(jnp.asarray(self.drive.physics_step), advance, measure, len(own.names))
        return _loop.prepare(Loop(plant, self.drive.drive(draws, model)), self.drive.options)


def _timing(drive: _drive.Coefficients) -> Any:
    """The coefficients that follow from the drawn parameters alone and take long to compute."""
    return drive.responses, drive.capture


def _size(shapes: Any) -> int:
    return sum(part.size for part in jax.tree.leaves(shapes))


def _with_timing(drive: _drive.Coefficients, timing: Any) -> _drive.Coefficients:
    responses, capture = timing
    return replace(drive, responses=responses, capture=capture)


def _run(places: np.ndarray) -> slice | np.ndarray:
    """The places as a slice where they follow each other: cheaper to compile and to read."""
    first = int(places[0])
    return slice(first, first + len(places)) if np.all(np.diff(places) == 1) else places


def _coefficients(drive: EnvironmentDrive, zero: jax.Array) -> _drive.Coefficients:
    """Coefficients of the shapes that a drive's have, whatever the model and the draws."""
    values: dict[str, Any] = {name: low + zero for name, low in drive.low.items()}
    values |= {KP: zero, KD: zero, POLICY_RATE: np.inf}
    values[CONTROL_RATE] = float(drive.low[CONTROL_RATE])
    return _drive.prepare(drive_of(values), drive.options, zero.shape)


def begun_with(
    coefficients: Coefficients, options: DriveOptions, setpoint: Setpoint, position: jax.Array,
    velocity: jax.Array,
) -> DriveState:  # fmt: skip
    """A drive that has held for ever what the setpoint asks for at once, without delay."""
    controller = coefficients.drive.controller
    setpoint = accepted(controller, setpoint)
    command = (
        controller.kp * (setpoint.position - position)
        + controller.kd * (setpoint.velocity - velocity)
        + (controller.feedforward + setpoint.force)
    )
    return _drive.init(
        coefficients, options, position, velocity, command=command, setpoint=setpoint
    )
