"""The drive in environments of gymnasium on C MuJoCo, and in their vectors."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jaxact.drive import sensor as _sensor
from jaxact.drive import step as _drive
from jaxact.drive.controller import Setpoint
from jaxact.drive.options import DriveOptions
from jaxact.drive.step import Coefficients, DriveState
from jaxact.environments import environment_drive
from jaxact.environments.actuators import Actuators
from jaxact.environments.driven_step import begun_with
from jaxact.environments.environment_drive import EnvironmentDrive
from jaxact.errors import UserError, shown
from jaxact.loops.conversion import drive_of
from jaxact.plants.linear import hermite

_STEP = "_step_mujoco_simulation"
# What a drive's gains and limits follow from.
_FIELDS = (
    "actuator_gear", "actuator_gainprm", "actuator_biasprm", "actuator_forcelimited",
    "actuator_forcerange", "actuator_ctrllimited", "actuator_ctrlrange", "jnt_actfrclimited",
    "jnt_actfrcrange", "dof_damping",
)  # fmt: skip
Pair = tuple[jax.Array, jax.Array]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Carry:
    """A drive between two physics steps.

    Attributes:
        state: of the drive.
        tick: number of control periods that have begun, int32.
        before: positions and velocities of the joints when the last physics step began.
        late: the same at the measuring instant of this period, as far as it has come.
    """

    state: DriveState
    tick: jax.Array
    before: Pair
    late: Pair


class DrivenEnvironment(gymnasium.Wrapper):
    """An environment whose actuators are driven; see `jaxact.environments.gymnasium`.

    Attributes:
        drive: parameters, ranges and actuators.
        values: the parameters that the last reset drew, by short name.
    """

    def __init__(self, env: gymnasium.Env, drive: EnvironmentDrive) -> None:
        super().__init__(env)
        self.drive = drive
        self.values: dict[str, Any] = {}
        self._carry: Carry | None = None
        self._draws, self._key, self._calls = jnp.zeros(drive.draws), jax.random.PRNGKey(0), 0
        self._known: tuple[bytes, ...] = ()
        self._time = -np.inf  # at the end of the last step

    def reset(self, **options: Any) -> Any:
        """As the environment does, with drives that have not begun, and parameters drawn anew."""
        found = self.env.reset(**options)
        seed = int(self.unwrapped.np_random.integers(2**31))
        drawing, self._key = jax.random.split(jax.random.PRNGKey(seed))
        self._draws, self._carry, self._known, self._calls = self.drive.draw(drawing), None, (), 0
        self._time = -np.inf
        self._look(self.unwrapped.model)
        return found

    def step(self, action: Any) -> Any:
        """As the environment does, its physics steps under the drive."""
        before = self._calls
        with _replaced(self.unwrapped, self._driven):
            found = self.env.step(action)
        if self._calls == before:
            raise UserError(
                f"{type(self.unwrapped).__name__}: does not step through {_STEP}, so its drive"
                " would be left out; put jaxact.drive_around into its step instead"
            )
        return found

    def _look(self, model: mujoco.MjModel) -> None:
        """The drive's parameters, again where the model's gains are others than before."""
        step = float(model.opt.timestep)
        if step != self.drive.physics_step:
            raise UserError(
                f"{type(self.unwrapped).__name__}: its physics step is {step:g} s, and was"
                f" {self.drive.physics_step:g} s when its drive was made; change it before that"
            )
        known = tuple(getattr(model, name).tobytes() for name in _FIELDS)
        known = (*known, b"%d" % model.opt.disableflags)
        if known != self._known:
            found = self.drive.values(self._draws, model)
            dtype = jnp.result_type(float)
            self._known, self.values = known, {k: jnp.asarray(v, dtype) for k, v in found.items()}
            joints = len(self.drive.actuators.names)
            self._coefficients = _prepared(self.drive.options, joints, self.values)

    def _driven(self, control: Any, frames: int) -> None:
        """In place of the environment's own: physics steps under the drive."""
        model, data = self.unwrapped.model, self.unwrapped.data
        own = self.drive.actuators
        self.drive.ticks(frames)
        self._look(model)
        self._calls += 1
        moments = own.moments(model)
        setpoint = _asked(self.drive, model, np.asarray(control, float))
        if data.time < self._time:  # begun anew beneath, as copies of some environments are
            self._carry = None
        if self._carry is None:
            begun = _begun(self.drive.options, self._coefficients, setpoint, *_joints(data, own))
            self._carry = begun
        data.ctrl[:] = control
        with _as_motors(model, own, damping=self.drive.damping):
            for frame in range(frames):
                place = frame % self.drive.options.substeps
                self._carry, force = _forced(
                    self.drive.options, self._coefficients, self._carry, setpoint,
                    *_joints(data, own), self._key, place=place,
                )  # fmt: skip
                data.ctrl[own.controls] = np.asarray(force, float) / moments
                mujoco.mj_step(model, data)
        data.ctrl[:] = control
        self._time = data.time
        mujoco.mj_rnePostConstraint(model, data)  # as the environment's own step does


def _asked(own: EnvironmentDrive, model: mujoco.MjModel, control: np.ndarray) -> Setpoint:
    """What controls ask for: zeros where one is not a number, as MuJoCo takes them; a drive would
    keep it for ever."""
    found = own.setpoint(model, control, np)
    parts = found.position, found.velocity, found.force
    if all(np.isfinite(part).all() for part in parts):
        return found
    return own.setpoint(model, np.zeros_like(control), np)


def _joints(data: mujoco.MjData, own: Actuators) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of the driven joints."""
    return data.qpos[own.positions], data.qvel[own.velocities]


# Compiled for all environments whose drives are alike; one of an environment's own could not be
# pickled with it.
@functools.partial(jax.jit, static_argnames=("options", "joints"))
def _prepared(options: DriveOptions, joints: int, values: dict[str, Any]) -> Coefficients:
    return _drive.prepare(drive_of(values), options, (joints,))


@functools.partial(jax.jit, static_argnames="options")
def _begun(
    options: DriveOptions, coefficients: Coefficients, setpoint: Setpoint, position: jax.Array,
    velocity: jax.Array,
) -> Carry:  # fmt: skip
    """A drive that has held for ever what the setpoint asks for at once."""
    state = begun_with(coefficients, options, setpoint, position, velocity)
    now = position + jnp.zeros_like(state.force), velocity + jnp.zeros_like(state.force)
    return Carry(state, jnp.zeros((), jnp.int32), now, now)


@functools.partial(jax.jit, static_argnames=("options", "place"))
def _forced(
    options: DriveOptions, coefficients: Coefficients, carry: Carry, setpoint: Setpoint,
    position: jax.Array, velocity: jax.Array, key: jax.Array, *, place: int,
) -> tuple[Carry, jax.Array]:  # fmt: skip
    """The joints' mean forces over the physics step that begins now.

    Args:
        place: of the physics step in its control period, static.
    """
    now, state, late, tick = (position, velocity), carry.state, carry.late, carry.tick
    capture = coefficients.capture
    if capture is not None:  # the measuring instant, if it was in the step that ends now
        there = hermite(carry.before, now, capture.offset, coefficients.step)
        here = capture.here[place - 1] > 0.0
        late = (jnp.where(here, there[0], late[0]), jnp.where(here, there[1], late[1]))
    if place == 0:
        if state.measurements is not None:
            captured = _drive.capture(state, *late)
            # nothing has been measured before the first period
            state = jax.tree.map(lambda a, b: jnp.where(tick > 0, a, b), captured, state)
        late = now
        like = jnp.asarray(coefficients.drive.controller.kp)
        draws = _sensor.draw(options.sensor, key, tick, like)
        state, _ = _drive.tick(coefficients, options, state, *now, setpoint, draws)
        tick = tick + 1
    responses, _ = _drive.at_substep(coefficients)
    response = jax.tree.map(lambda leaf: leaf[place], responses)
    state, force = _drive.actuate(coefficients, options, state, response, velocity)
    return Carry(state, tick, now, late), force.mean


@contextlib.contextmanager
def _replaced(env: Any, step: Callable[..., None]) -> Iterator[None]:
    """The environment's own step of the physics, replaced within the block."""
    setattr(env, _STEP, step)
    try:
        yield
    finally:
        delattr(env, _STEP)


@contextlib.contextmanager
def _as_motors(model: mujoco.MjModel, own: Any, *, damping: bool) -> Iterator[None]:
    """The driven actuators are motors within the block, and as before after it."""
    changed = own.as_motors(model, damping=damping)
    before = {name: getattr(model, name).copy() for name in changed}
    try:
        for name, value in changed.items():
            getattr(model, name)[:] = value
        yield
    finally:
        for name, value in before.items():
            getattr(model, name)[:] = value


def wrap(env: gymnasium.Env, **options: Any) -> DrivenEnvironment:
    """See `jaxact.environments.gymnasium`."""
    if not isinstance(env, gymnasium.Env):
        raise UserError(
            f"env: {shown(env)} of type {type(env).__name__} is not an environment of gymnasium;"
            ' make one, e.g. gymnasium.make("Ant-v5")'
        )
    inner = env.unwrapped
    name = type(inner).__name__
    for needed in (_STEP, "model", "data", "frame_skip"):
        if not hasattr(inner, needed):
            raise UserError(f"{name}: is not an environment of gymnasium on MuJoCo (no {needed})")
    layer: Any = env
    while isinstance(layer, gymnasium.Wrapper):
        if isinstance(layer, DrivenEnvironment):
            raise UserError(f"{name}: has a drive already")
        layer = layer.env
    drive = environment_drive.build(inner.model, name, options.pop("parameters"), **options)
    drive.ticks(inner.frame_skip)
    return DrivenEnvironment(env, drive)
