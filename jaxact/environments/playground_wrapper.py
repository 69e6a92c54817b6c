"""The drive in environments of MuJoCo Playground: between the policy's action and the joints."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
from brax.envs.base import Wrapper as BraxWrapper
from mujoco import mjx
from mujoco_playground._src import mjx_env
from mujoco_playground._src.wrapper import (
    BraxAutoResetWrapper,
    BraxDomainRandomizationVmapWrapper,
    Wrapper,
)

from jaxact.drive import threefry
from jaxact.environments import environment_drive
from jaxact.environments.driven_step import DrivenStep
from jaxact.errors import UserError, shown

KEY = "jaxact"
"""Where `state.info` has what the next draws follow from."""
# Wrappers around many environments, or that begin them anew.
_OF_TRAINING = (BraxWrapper, BraxAutoResetWrapper, BraxDomainRandomizationVmapWrapper)
# Folded into a reset's key: a number that no environment's own splitting comes to.
_OWN_KEYS = int.from_bytes(b"jxac")
# `mjx_env.step` is a global of Playground, which one environment at a time replaces while it steps.
_STEPPING = threading.RLock()


class DrivenEnvironment(Wrapper):
    """An environment whose actuators are driven; see `jaxact.environments.playground`.

    The state of the drive is in `state.data.userdata`, which whatever restores `data` restores.

    Attributes:
        drive: parameters, ranges and actuators.
    """

    def __init__(self, env: Any, drive: environment_drive.EnvironmentDrive) -> None:
        super().__init__(env)
        self.drive = drive
        self._driven = DrivenStep(drive, mjx.step)

    def reset(self, rng: jax.Array) -> mjx_env.State:
        """As the environment does, with drives that have not begun."""
        state = self.env.reset(rng)  # with the key itself: it begins as it does without a drive
        own = jax.random.fold_in(rng, _OWN_KEYS)
        info = {**state.info, KEY: {"key": own, "count": jnp.zeros((), jnp.int32)}}
        return state.replace(data=self._driven.fresh(state.data), info=info)

    def step(self, state: mjx_env.State, action: jax.Array) -> mjx_env.State:
        """As the environment does, its physics steps under the drive."""
        own = self._info(state, action)
        steps: list[int] = []
        plain = mjx_env.step

        def driven(model: Any, data: Any, control: jax.Array, n_substeps: int = 1) -> Any:
            if not data.userdata.shape[-1]:  # the environment resets by itself
                return plain(model, data, control, n_substeps)
            words = jax.random.key_data(own["key"])
            key = threefry.folded(threefry.folded(words, own["count"]), len(steps))
            steps.append(n_substeps)
            return self._driven.step(model, data, control, n_substeps, key)

        with _replaced(driven):
            after = self.env.step(state, action)
        if not steps:
            raise UserError(
                f"{type(self.env.unwrapped).__name__}: does not step through mjx_env.step, so its"
                " drive would be left out; put jaxact.drive_around into its step instead"
            )
        info = {**after.info, KEY: {**own, "count": own["count"] + 1}}
        return after.replace(info=info)

    def _info(self, state: mjx_env.State, action: jax.Array) -> dict[str, jax.Array]:
        """What the next draws follow from.

        Raises:
            UserError: a state of another environment, or an action that is none of this one's.
        """
        name = type(self.env.unwrapped).__name__
        if KEY not in state.info:
            raise UserError(
                f"{name}: the state is not from the driven environment; begin with its own reset"
            )
        if jnp.shape(action) != (self.action_size,):
            raise UserError(
                f"{name}: an action of shape {jnp.shape(action)}; give {(self.action_size,)}, one"
                " number for each actuator (of several environments under jax.vmap)"
            )
        return state.info[KEY]

    @property
    def unwrapped(self) -> Any:
        """Itself: wrappers that randomise the model go through here, and would leave it out."""
        return self

    @property
    def _mjx_model(self) -> mjx.Model:
        return self.env.unwrapped._mjx_model

    @_mjx_model.setter
    def _mjx_model(self, model: mjx.Model) -> None:
        self.env.unwrapped._mjx_model = model


@contextlib.contextmanager
def _replaced(step: Callable[..., Any]) -> Iterator[None]:
    """Playground's step function, replaced within the block."""
    with _STEPPING:
        own = mjx_env.step
        mjx_env.step = step
        try:
            yield
        finally:
            mjx_env.step = own


def _demand_single(env: Any) -> str:
    """The name of an environment of Playground that has no drive, and is none of many at once.

    Raises:
        UserError: it is anything else.
    """
    layers = [env]
    while isinstance(layers[-1], Wrapper | BraxWrapper):
        layers.append(layers[-1].__dict__.get("env"))
    name = type(layers[-1]).__name__
    if any(isinstance(one, DrivenEnvironment) for one in layers):
        raise UserError(f"{name}: has a drive already")
    if not isinstance(layers[-1], mjx_env.MjxEnv):
        raise UserError(
            f"env: {shown(env)} of type {type(env).__name__} is not an environment of MuJoCo"
            ' Playground; load one, e.g. registry.load("CartpoleBalance")'
        )
    if any(isinstance(one, _OF_TRAINING) for one in layers):
        raise UserError(
            f"{name}: is wrapped for training already; put the drive in first, then"
            " wrapper.wrap_for_brax_training around it"
        )
    return name


def wrap(env: Any, **options: Any) -> DrivenEnvironment:
    """See `jaxact.environments.playground`."""
    name = _demand_single(env)
    drive = environment_drive.build(env.mj_model, name, options.pop("parameters"), **options)
    drive.ticks(env.n_substeps)
    wrapped = DrivenEnvironment(env, drive)
    state = jax.eval_shape(wrapped.reset, jax.random.PRNGKey(0))
    action = jax.ShapeDtypeStruct((env.action_size,), jnp.result_type(float))
    jax.eval_shape(wrapped.step, state, action)
    return wrapped
