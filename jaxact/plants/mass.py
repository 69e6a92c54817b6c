"""One exact linear degree of freedom: ``m q'' = f``.

Driven with the mean and the moment of the force over a step, both of which the drive computes in
closed form, the update is the exact solution, whatever the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.drive.step import Force


@dataclass(frozen=True)
class Mass:
    """The plant's parameters.

    Attributes:
        mass: [kg], or moment of inertia [kg m^2] of a rotary joint, shape (joints,).
    """

    mass: jax.Array | float

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the joint quantities."""
        return jnp.shape(self.mass)

    def prepare(self, step: jax.Array) -> SteppedMass:
        """Coefficients for a physics step [s]."""
        return SteppedMass(
            step=step,
            mean_gain=step / self.mass,
            moment_gain=0.5 * step * step / self.mass,
            compliance=1.0 / self.mass,
        )


@dataclass(frozen=True)
class SteppedMass:
    """A mass with the coefficients of one physics step; state: (position, velocity).

    Attributes:
        step: h [s].
        mean_gain: h / m [s/kg].
        moment_gain: h^2 / (2 m) [s^2/kg].
        compliance: 1 / m [1/kg].
    """

    step: jax.Array
    mean_gain: jax.Array
    moment_gain: jax.Array
    compliance: jax.Array

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the joint quantities."""
        return jnp.shape(self.compliance)

    def prepare(self, step: jax.Array) -> SteppedMass:
        """The same mass for another physics step [s]."""
        return Mass(1.0 / self.compliance).prepare(step)

    def init(self, position: jax.Array, velocity: jax.Array) -> tuple[jax.Array, jax.Array]:
        """State with this position [m or rad] and velocity [m/s or rad/s]."""
        return position, velocity

    def measure(self, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        """Position [m or rad] and velocity [m/s or rad/s]."""
        return state

    def advance(
        self, state: tuple[jax.Array, jax.Array], force: Force
    ) -> tuple[jax.Array, jax.Array]:
        """State one step later; exact."""
        position, velocity = state
        return (
            position + self.step * velocity + self.moment_gain * force.moment,
            velocity + self.mean_gain * force.mean,
        )

    def between(
        self,
        before: tuple[jax.Array, jax.Array],
        after: tuple[jax.Array, jax.Array],
        force: Force,
        offset: jax.Array,
    ) -> tuple[jax.Array, jax.Array]:
        """State `offset` [s] into the step; exact, from the force up to that instant."""
        position, velocity = before
        mean, moment = force.partial
        accelerated = offset * self.compliance
        return (
            position + offset * velocity + 0.5 * offset * accelerated * moment,
            velocity + accelerated * mean,
        )


for _class, _fields in (
    (Mass, ["mass"]),
    (SteppedMass, ["step", "mean_gain", "moment_gain", "compliance"]),
):
    jax.tree_util.register_dataclass(_class, data_fields=_fields, meta_fields=[])
