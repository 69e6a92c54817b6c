"""Somebody's simulator as a plant: a function that advances it, and one that measures it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.drive.step import Force
from jaxact.errors import UserError
from jaxact.plants.linear import hermite

Step = Callable[[Any, jax.Array], Any]
"""(state of a simulator, joint forces [N or N m], shape (joints,)) -> state a step later."""
Measure = Callable[[Any], tuple[jax.Array, jax.Array]]
"""State of a simulator -> joint positions [m or rad] and velocities, shape (joints,) each."""


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
        parts = found if isinstance(found, tuple | list) else (found,)
        position, velocity = map(as_numbers, parts) if len(parts) == 2 else (None, None)
        if position is None or velocity is None or not (
            position.shape == velocity.shape == self.shape
        ):  # fmt: skip
            given = " and ".join(_described(part) for part in parts) or "nothing"
            given = given if isinstance(found, tuple | list) else f"one {type(found).__name__}"
            remedy = ""
            if position is not None and velocity is not None:
                flat = position.ndim == 1 and position.shape == velocity.shape
                remedy = f"; give joints={position.size}" if flat else ""
            raise UserError(
                f"measure: gives {given}; needed are (positions, velocities) of shape {self.shape} "
                f"each, as joints = {self.joints}{remedy}"
            )
        return position, velocity

    def advance(self, state: Any, force: Force) -> Any:
        """State one physics step later under the mean force, so that the impulse is exact.

        Raises:
            UserError: `step` gives something else than a state of the same kind.
        """
        after = self.advance_by(state, force.mean)
        kinds: list[Any] = [jax.tree.structure(one) for one in (state, after)]
        if kinds[0] != kinds[1]:
            raise UserError(
                f"step: gives a value of type {type(after).__name__}, other than the state of type "
                f"{type(state).__name__} that it is given; needed is the state a physics step later"
            )
        for old, new in zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True):
            if _whole(old) and not _whole(new):
                raise UserError(
                    "step: gives a number with decimals where the state has a whole one; begin "
                    "with decimals there, e.g. drive.init((0.0, 0.0))"
                )
        return after

    def between(
        self, before: Any, after: Any, force: Force, offset: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """State `offset` [s] into a step: cubic Hermite position, linear velocity."""
        return hermite(self.measure(before), self.measure(after), offset, self.time_step)


jax.tree_util.register_dataclass(
    Simulator, data_fields=["time_step"], meta_fields=["advance_by", "measured", "joints"]
)


def as_numbers(value: Any) -> jax.Array | None:
    """A real number, or an array or list of them, as an array of floats; None for anything else."""
    if isinstance(value, str):  # older JAX takes it for the name of a type
        return None
    try:
        array = jnp.asarray(value)
    except (TypeError, ValueError, OverflowError):
        return None
    if jnp.issubdtype(array.dtype, jnp.floating):
        return array
    return array.astype(float) if jnp.issubdtype(array.dtype, jnp.integer) else None


def with_arrays(state: Any) -> Any:
    """The state of a simulator with arrays of JAX for its plain numbers; NumPy's stay its own."""

    def array(leaf: Any) -> Any:
        if isinstance(leaf, bool | int):  # a whole number that may become one with decimals
            return jnp.asarray(leaf)
        # by way of NumPy, so that its type is as fixed as that of what a step gives
        plain = isinstance(leaf, float | complex | np.number)
        return jnp.asarray(np.asarray(leaf)) if plain else leaf

    return jax.tree.map(array, state)


def _described(part: Any) -> str:
    """Its shape, or what it is where it is no array of numbers."""
    numbers = as_numbers(part)
    return f"a {type(part).__name__}" if numbers is None else str(numbers.shape)


def _whole(leaf: Any) -> bool:
    """Whether a leaf of a state is of whole numbers, or not of numbers at all."""
    kind = getattr(leaf, "dtype", None)
    if kind is None or getattr(leaf, "weak_type", False):
        return False
    return not jnp.issubdtype(kind, jnp.inexact)
