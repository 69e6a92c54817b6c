"""Small displacements of a MuJoCo configuration, in the tangent space that MuJoCo's velocities use.

A free joint has seven coordinates and six degrees of freedom, a ball joint four and three: their
orientation is a unit quaternion, and a small rotation ``w`` [rad] in the body's own frame turns

    q into q * exp(w / 2),     exp(w / 2) = (cos(|w| / 2), sin(|w| / 2) w / |w|)

Source: MuJoCo's documentation, "Computation", floating objects (mj_integratePos and
mj_differentiatePos do the same in C).
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco

_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)


def _product(a: jax.Array, b: jax.Array) -> jax.Array:
    """Product of two quaternions (w, x, y, z), shape (4,)."""
    scalar = a[0] * b[0] - jnp.dot(a[1:], b[1:])
    vector = a[0] * b[1:] + b[0] * a[1:] + jnp.cross(a[1:], b[1:])
    return jnp.concatenate([scalar[None], vector])


def _exponential(w: jax.Array) -> jax.Array:
    """Unit quaternion of a rotation vector [rad], shape (4,); smooth at 0."""
    square = jnp.dot(w, w)
    small = square < 1e-12
    angle = jnp.sqrt(jnp.where(small, 1.0, square))
    cosine = jnp.where(small, 1.0 - square / 8.0, jnp.cos(0.5 * angle))
    share = jnp.where(small, 0.5 - square / 48.0, jnp.sin(0.5 * angle) / angle)
    return jnp.concatenate([cosine[None], share * w])


def _rotation(a: jax.Array, b: jax.Array) -> jax.Array:
    """Rotation vector [rad] from quaternion `a` to `b`, shape (3,); smooth where they are equal."""
    turn = _product(a * jnp.array([1.0, -1.0, -1.0, -1.0], a.dtype), b)
    turn = jnp.where(turn[0] < 0.0, -turn, turn)
    square = jnp.dot(turn[1:], turn[1:])
    small = square < 1e-12
    size = jnp.sqrt(jnp.where(small, 1.0, square))
    share = jnp.where(small, 2.0 / turn[0], 2.0 * jnp.arctan2(size, turn[0]) / size)
    return share * turn[1:]


def displaced(kinds: Sequence[int], qpos: jax.Array, amount: jax.Array) -> jax.Array:
    """A configuration moved by a small displacement.

    Args:
        kinds: MuJoCo's type of each joint; static.
        qpos: configuration, shape (nq,).
        amount: displacement [m or rad], shape (nv,).

    Returns:
        shape (nq,).
    """
    parts, at, dof = [], 0, 0
    for kind in kinds:
        if kind == _FREE:
            parts.append(qpos[at : at + 3] + amount[dof : dof + 3])
            at, dof = at + 3, dof + 3
        if kind in (_FREE, _BALL):
            turn = _exponential(amount[dof : dof + 3])
            parts.append(_product(qpos[at : at + 4], turn))
            at, dof = at + 4, dof + 3
        else:
            parts.append(qpos[at : at + 1] + amount[dof : dof + 1])
            at, dof = at + 1, dof + 1
    return jnp.concatenate(parts)


def difference(kinds: Sequence[int], before: jax.Array, after: jax.Array) -> jax.Array:
    """The displacement from one configuration to another, the inverse of `displaced`.

    Args:
        kinds: MuJoCo's type of each joint; static.
        before, after: configurations, shape (nq,).

    Returns:
        [m or rad], shape (nv,).
    """
    parts, at = [], 0
    for kind in kinds:
        if kind == _FREE:
            parts.append(after[at : at + 3] - before[at : at + 3])
            at += 3
        if kind in (_FREE, _BALL):
            parts.append(_rotation(before[at : at + 4], after[at : at + 4]))
            at += 4
        else:
            parts.append(after[at : at + 1] - before[at : at + 1])
            at += 1
    return jnp.concatenate(parts)
