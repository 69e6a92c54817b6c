"""Whether a robot that stood on the ground has fallen over, or sunk.

A base that has fallen over points elsewhere than up. One that has sunk is lower by a good part of
the height at which the robot's mass was, though its setpoints did not ask for it: legs have folded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.robots.base import Base
from jaxact.simulation.envelope import Envelope

# A base that has tilted by more than this has fallen [rad]; turning about the vertical is no tilt.
TILTED = 1.0
# One that is lower by more than this part of its height has sunk, if nothing asked it to.
SUNK = 0.25


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Fall:
    """What has become of a robot that stood, each of shape (...).

    Attributes:
        over: whether it has fallen over.
        lower: whether it is so low that it has sunk, unless it was told to.
    """

    over: jax.Array
    lower: jax.Array

    def happened(self, envelopes: Envelope, target: jax.Array, asked: jax.Array) -> jax.Array:
        """Whether it fell: over, or down with a joint that does not follow.

        Args:
            envelopes: of the segments of the rollout, shape (segments, joints).
            target: setpoints [m or rad], shape (joints,).
            asked: how far they are from where the joints began [m or rad], shape (joints,).
        """
        last = jax.tree.map(lambda leaf: leaf[-1], envelopes)
        away = jnp.abs(0.5 * (last.lowest + last.highest) - target)
        return self.over | (self.lower & jnp.any(away > asked + last.amplitude, axis=-1))


def fall(bases: tuple[Base, ...], start: Any, end: Any, *, told: bool = False) -> Fall | None:
    """What has become of a robot on its way from a start to an end.

    Args:
        bases: static; from `jaxact.robots.standing.bases`, none of what cannot fall.
        start, end: of a plant in MuJoCo, states with a `qpos`, or configurations, shape (..., nq).
        told: static; setpoints move, so that nothing is said of what is lower.

    Returns:
        None of what cannot fall; nothing is true where it is not known.
    """
    if not bases:
        return None
    moments = [jnp.asarray(getattr(one, "qpos", one)) for one in (start, end)]
    over = lower = jnp.zeros(moments[0].shape[:-1], bool)
    for base in bases:
        up = jnp.asarray(base.up, moments[0].dtype)
        sights = [_seen(one[..., base.place + 3 : base.place + 7], up) for one in moments]
        over |= jnp.sum(sights[0] * sights[1], axis=-1) < math.cos(TILTED)
        before, after = (one[..., base.place : base.place + 3] @ up for one in moments)
        lower |= before - after > SUNK * base.height
    return Fall(over, lower & (not told))


def _seen(quaternion: jax.Array, up: jax.Array) -> jax.Array:
    """A direction as a base of this orientation w, x, y, z sees it, shape (..., 3)."""
    w, back = quaternion[..., :1], -quaternion[..., 1:]
    size = jnp.sum(quaternion * quaternion, axis=-1, keepdims=True)
    up = jnp.broadcast_to(up, back.shape)
    across = jnp.cross(back, up)
    return up + 2.0 * (w * across + jnp.cross(back, across)) / size
