"""The interface of a plant: a shape and five pure functions over its own parameters and state."""

from __future__ import annotations

from typing import Any, Protocol

import jax

from jaxact.drive.step import Force

State = Any


class Plant(Protocol):
    """Something that moves under a joint force; a frozen dataclass that is also a pytree.

    All joint quantities have the shape (joints,) of the drive that acts on it.
    """

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the joint quantities: (joints,), or () for a single joint."""
        ...

    def prepare(self, step: jax.Array) -> Plant:
        """The plant for a physics step [s], with what does not change computed once."""
        ...

    def init(self, position: jax.Array, velocity: jax.Array) -> State:
        """State with these joint positions [m or rad] and velocities [m/s or rad/s]."""
        ...

    def measure(self, state: State) -> tuple[jax.Array, jax.Array]:
        """Joint positions [m or rad] and velocities [m/s or rad/s]."""
        ...

    def advance(self, state: State, force: Force) -> State:
        """State one physics step later under this force [N or N m]."""
        ...

    def between(
        self, before: State, after: State, force: Force, offset: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Joint positions and velocities `offset` [s] into the step from `before` to `after`."""
        ...
