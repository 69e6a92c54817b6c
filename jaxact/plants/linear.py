"""A plant linearised about an equilibrium: small deviations over one physics step.

    x' = A x + B (f - f0),     q - q0 = C_q x,     v = C_v x

with the mean joint force f over the step. `jaxact.plants.linearize` makes it from a MuJoCo model,
in the tangent space of its configuration.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax

from jaxact.drive.step import Force


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LinearPlant:
    """A linear plant at one physics step; its state is the deviation x, shape (n,).

    Positions and forces are deviations from the equilibrium's, so that its setpoint is 0.

    Attributes:
        A: shape (n, n).
        B: per joint force [1/N or 1/(N m)], shape (n, joints).
        positions, velocities: rows C_q and C_v of the driven joints, shape (joints, n).
        step: the physics step that A and B belong to [s], shape ().
    """

    A: jax.Array
    B: jax.Array
    positions: jax.Array
    velocities: jax.Array
    step: jax.Array | float

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the joint quantities: (joints,)."""
        return (self.positions.shape[-2],)

    def prepare(self, step: jax.Array) -> LinearPlant:
        """The plant itself: it is good for its own physics step only, which `step` must be."""
        return self

    def init(self, position: jax.Array, velocity: jax.Array) -> jax.Array:
        """State with only the joints displaced [m or rad] and moving, shape (n,)."""
        return position @ self.positions + velocity @ self.velocities

    def measure(self, state: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Deviations of the joints' positions [m or rad] and velocities, shape (joints,)."""
        return self.positions @ state, self.velocities @ state

    def advance(self, state: jax.Array, force: Force) -> jax.Array:
        """State one physics step later under the mean force."""
        return self.A @ state + self.B @ force.mean

    def between(
        self, before: jax.Array, after: jax.Array, force: Force, offset: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """State `offset` [s] into a step: cubic Hermite position, linear velocity, as for MJX."""
        return hermite(self.measure(before), self.measure(after), offset, self.step)


def hermite(
    before: tuple[jax.Array, jax.Array],
    after: tuple[jax.Array, jax.Array],
    offset: jax.Array,
    step: jax.Array | float,
) -> tuple[jax.Array, jax.Array]:
    """Position and velocity `offset` [s] into a step of length `step` [s].

    The position is the cubic through both ends with both velocities, the velocity is linear: for a
    smooth motion of fourth and second order in the step.
    """
    (q0, v0), (q1, v1) = before, after
    s = offset / step
    rise = s * s * (3.0 - 2.0 * s)
    position = q0 + rise * (q1 - q0) + step * s * (1.0 - s) * ((1.0 - s) * v0 - s * v1)
    return position, v0 + s * (v1 - v0)
