"""How far a common factor on the gains is from the nearest edge of the stable set, by counting.

Raising the gains through a crossing moves roots: a pair where L crosses the negative real axis, and
a single real one where f kp + k passes zero, at rest. Counted from the roots as they are, either
way, a crossing is an edge where no unstable root is left on one of its sides.
"""

import jax
import jax.numpy as jnp

from jaxact.analysis.joint.frequency import JointLoop


def static_factor(kp: jax.Array, stiffness: jax.Array) -> tuple[jax.Array, jax.Array]:
    """ln f of the factor on the gains with f kp + k = 0 [-], and whether there is one.

    Args:
        kp: [N/m].
        stiffness: k of the joint [N/m].
    """
    there = kp * stiffness < 0
    ratio = jnp.where(there, -stiffness, 1.0) / jnp.where(there, kp, 1.0)
    return jnp.log(ratio), there


def static_move(loop: JointLoop) -> jax.Array:
    """Roots that become unstable where the gains are raised through `static_factor`: 1 or -1.

    Args:
        loop: sprung. The root goes to the left where the phase rises from rest: kd/kp > c/k + td +
            2 zeta/wn.
    """
    safe_kp = jnp.where(loop.kp == 0, 1.0, loop.kp)
    safe_k = jnp.where(loop.joint_stiffness == 0, 1.0, loop.joint_stiffness)
    lag = loop.delay + 2.0 * loop.damping_ratio / loop.natural_frequency
    rising = loop.kd / safe_kp - loop.joint_damping / safe_k > lag
    return jnp.where(rising, -1.0, 1.0)


def counted_distance(
    unstable: jax.Array, log_factor: jax.Array, moved: jax.Array, present: jax.Array
) -> jax.Array:
    """ln f to the nearest edge of the stable set, shape (1, ...): > 0 if stable, else < 0.

    Args:
        unstable: number of unstable roots, shape (1, ...).
        log_factor: ln f of the crossings [-], shape (k, ...).
        moved: roots that become unstable there as the gains are raised, shape (k, ...).
        present: which of them exist, shape (k, ...).
    """
    factor = jax.lax.stop_gradient(log_factor)
    one, other = factor[:, None], factor[None]
    up = present[None] & (other > 0) & (other < one)
    down = present[None] & (other <= 0) & (other > one)
    passed = jnp.sum(jnp.where(up, moved[None], 0.0) - jnp.where(down, moved[None], 0.0), axis=1)
    near = unstable + passed
    beyond = near + jnp.where(factor > 0, moved, -moved)
    edge = present & ((near == 0) | (beyond == 0))
    nearest = jnp.min(jnp.where(edge, jnp.abs(log_factor), jnp.inf), axis=0, keepdims=True)
    return jnp.where(unstable == 0, nearest, -nearest)
