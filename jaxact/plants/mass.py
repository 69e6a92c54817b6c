"""One exact linear degree of freedom: ``m q'' + c q' + k q = f``.

Driven with the mean and the moment of the force over a step, both of which the drive computes in
closed form, the update of a bare mass is the exact solution, whatever the step. What the force does
to a joint with damping or stiffness of its own the drive computes as a whole; that is exact too.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.drive.joint_motion import Joint, moved
from jaxact.drive.step import Force


class _Measured:
    """A plant whose state is what is measured of it: (position, velocity)."""

    def init(self, position: jax.Array, velocity: jax.Array) -> tuple[jax.Array, jax.Array]:
        """State with this position [m or rad] and velocity [m/s or rad/s]."""
        return position, velocity

    def measure(self, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        """Position [m or rad] and velocity [m/s or rad/s]."""
        return state


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Mass:
    """The plant's parameters.

    Attributes:
        mass: m [kg], or moment of inertia [kg m^2] of a rotary joint, shape (joints,).
        damping: c [N s/m or N m s/rad]; None: none, whatever the parameters.
        stiffness: k [N/m or N m/rad], negative where gravity topples the joint; None as before.
    """

    mass: jax.Array | float
    damping: jax.Array | float | None = None
    stiffness: jax.Array | float | None = None

    @property
    def joint(self) -> Joint | None:
        """The joint that the drive is prepared for; None for a bare mass."""
        return None if self.damping is None and self.stiffness is None else self.body

    @property
    def body(self) -> Joint:
        """What the force accelerates, bare or not."""
        c, k = (0.0 if a is None else a for a in (self.damping, self.stiffness))
        return Joint(self.mass, c, k)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the joint quantities."""
        own = (self.mass, self.damping, self.stiffness)
        return jnp.broadcast_shapes(*(jnp.shape(a) for a in own if a is not None))

    def prepare(self, step: jax.Array) -> SteppedMass | SprungMass:
        """Coefficients for a physics step [s]."""
        if self.joint is not None:
            return SprungMass(self.joint)
        return SteppedMass(
            step=step,
            mean_gain=step / self.mass,
            moment_gain=0.5 * step * step / self.mass,
            compliance=1.0 / self.mass,
        )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SteppedMass(_Measured):
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

    def prepare(self, step: jax.Array) -> SteppedMass | SprungMass:
        """The same mass for another physics step [s]."""
        return Mass(1.0 / self.compliance).prepare(step)

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


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SprungMass(_Measured):
    """A joint with damping and stiffness of its own; state: (position, velocity).

    Attributes:
        joint: its parameters, of which the drive has computed what each step does.
    """

    joint: Joint

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the joint quantities."""
        return jnp.broadcast_shapes(*(jnp.shape(leaf) for leaf in jax.tree.leaves(self.joint)))

    def prepare(self, step: jax.Array) -> SprungMass:
        """The joint itself: its steps are the drive's."""
        return self

    def advance(
        self, state: tuple[jax.Array, jax.Array], force: Force
    ) -> tuple[jax.Array, jax.Array]:
        """State one step later; exact."""
        return moved(force.motion, state)

    def between(
        self,
        before: tuple[jax.Array, jax.Array],
        after: tuple[jax.Array, jax.Array],
        force: Force,
        offset: jax.Array,
    ) -> tuple[jax.Array, jax.Array]:
        """State at the measuring instant, `offset` [s] into the step; exact."""
        return moved(force.partial_motion, before)
