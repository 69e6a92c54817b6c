"""The motion of a joint with damping and stiffness of its own behind the force loop.

    m q'' + c q' + k q = f,    f'' + 2 zeta wn f' + wn^2 f = wn^2 u,    u held

Joint and force loop together are linear while the command is held, so that a step of the joint is
exact: its coefficients follow from the exponential of both. A bare mass needs only the mean and the
moment of the force, and nothing of this.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.matrix_exponential import exponential_less_one


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Joint:
    """A joint that is not a bare mass; every field a float or an array of shape (joints,).

    Attributes:
        mass: m [kg or kg m^2].
        damping: c [N s/m or N m s/rad].
        stiffness: k [N/m or N m/rad], also negative.
    """

    mass: jax.Array | float
    damping: jax.Array | float
    stiffness: jax.Array | float


Row = tuple[jax.Array, ...]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Rows:
    """Position and velocity after a step as the sum of six terms, coefficients of shape (joints,).

    Attributes:
        position, velocity: factors of position, velocity, e = f - newer, f', d = older - newer, and
            newer before the step, as in `jaxact.drive.actuator.Response`.
    """

    position: Row
    velocity: Row


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Motion:
    """What a step does to a joint: (factor of position, factor of velocity, share of the force).

    Attributes:
        position, velocity: after the step, each of shape (joints,).
    """

    position: tuple[jax.Array, jax.Array, jax.Array]
    velocity: tuple[jax.Array, jax.Array, jax.Array]


def _transition(
    joint: Joint, natural_frequency: jax.Array, damping_ratio: jax.Array, time: jax.Array
) -> jax.Array:
    """Rows of position and velocity by (q, v, f, f', u), one joint; shape (2, 5).

    With the time as unit, and the force as an acceleration a = f/m, the rates are those of

        (q, v t, a t^2, a' t^2/wn, a_u t^2),   x = wn t
    """
    ideal = jnp.isinf(natural_frequency)
    wn = jnp.where(ideal, 1.0, natural_frequency)
    x = jnp.where(ideal, 0.0, wn * time)
    stiff, damped = joint.stiffness * time * time / joint.mass, joint.damping * time / joint.mass
    zero = jnp.zeros_like(x)
    free = jnp.where(ideal, 1.0, zero)
    rates = [
        [zero, zero + 1.0, zero, zero, zero],
        [-stiff, -damped, 1.0 - free, zero, free],
        [zero, zero, zero, x, zero],
        [zero, zero, -x, -2.0 * damping_ratio * x, x],
        [zero] * 5,
    ]
    E = exponential_less_one(jnp.stack([jnp.stack(row) for row in rates]))
    scale = jnp.stack([time * time, time]) / joint.mass
    return jnp.stack(
        [
            jnp.stack([1.0 + E[0, 0], -joint.stiffness / joint.mass * time * E[0, 1]]),
            jnp.stack([time * E[0, 1], 1.0 + E[1, 1]]),
            scale * E[:2, 2],
            scale * E[:2, 3] / wn,
            scale * E[:2, 4],
        ],
        axis=1,
    )


def rows(
    joint: Joint,
    natural_frequency: jax.Array,
    damping_ratio: jax.Array,
    step: jax.Array,
    older_for: jax.Array,
) -> Rows:
    """Exact coefficients of a step whose input is the older value for `older_for`, then the newer.

    The older value acts as the newer one and a pulse of height d, a step that begins with the step
    and one that ends it.

    Args:
        joint: leaves of shape (joints,) or scalar.
        natural_frequency: wn [rad/s], shape (joints,), may be inf.
        damping_ratio: zeta [-], shape (joints,).
        step: [s], shape (joints,) or ().
        older_for: [s], shape (joints,), between 0 and the step.
    """
    given = (
        joint.mass, joint.damping, joint.stiffness, natural_frequency, damping_ratio, step,
        older_for,
    )  # fmt: skip
    dtype = jnp.result_type(float, *given)
    arrays = jnp.broadcast_arrays(*(jnp.asarray(a, dtype) for a in given))

    def one(m, c, k, wn, zeta, step, older_for):
        times = jnp.stack([step, step - older_for])
        whole, rest = jax.vmap(lambda time: _transition(Joint(m, c, k), wn, zeta, time))(times)
        pulse, newer = whole[:, 4] - rest[:, 4], whole[:, 2] + whole[:, 4]
        return jnp.concatenate([whole[:, :4], jnp.stack([pulse, newer], axis=1)], axis=1)

    flat = jax.vmap(one)(*(array.reshape(-1) for array in arrays))
    of_q, of_v = (tuple(flat[:, i, j].reshape(arrays[0].shape) for j in range(6)) for i in range(2))
    return Rows(of_q, of_v)


def motion(
    rows: Rows, force: jax.Array, rate: jax.Array, older: jax.Array, newer: jax.Array
) -> Motion:
    """The motion of a step; state of the force loop and commands [N or N m], shape (joints,)."""

    def of(row: Row) -> tuple[jax.Array, jax.Array, jax.Array]:
        by_force = row[2] * (force - newer) + row[3] * rate + row[4] * (older - newer)
        return row[0], row[1], by_force + row[5] * newer

    return Motion(of(rows.position), of(rows.velocity))


def held_back(
    rows: Rows, motion: Motion, clipped: jax.Array, mean: jax.Array, moment: jax.Array
) -> Motion:
    """The motion where the force is `clipped`: that of what is left of it.

    Exact where that is constant; else the velocity is that of its mean and the position that of its
    moment, (2/h^2) int_0^h (h - t) f dt, which for a bare mass is exact, too.

    Args:
        rows, motion: of the step.
        clipped: bool, shape (joints,).
        mean, moment: of the force that is left [N or N m], shape (joints,).
    """

    def of(part: tuple[jax.Array, jax.Array, jax.Array], row: Row, force: jax.Array):
        return part[0], part[1], jnp.where(clipped, row[5] * force, part[2])

    return Motion(
        of(motion.position, rows.position, moment), of(motion.velocity, rows.velocity, mean)
    )


def pushed(rows: Rows, motion: Motion, mean: jax.Array, moment: jax.Array) -> Motion:
    """The motion under a force beside; its mean and moment as for `held_back`."""

    def of(part: tuple[jax.Array, jax.Array, jax.Array], row: Row, force: jax.Array):
        return part[0], part[1], part[2] + row[5] * force

    return Motion(
        of(motion.position, rows.position, moment), of(motion.velocity, rows.velocity, mean)
    )


def moved(motion: Motion, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Position [m or rad] and velocity after the step, from those before it; (joints,)."""
    position, velocity = (
        a * state[0] + b * state[1] + c for a, b, c in (motion.position, motion.velocity)
    )
    return position, velocity
