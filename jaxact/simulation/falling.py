"""Whether a robot that stood on the ground has fallen over: its base points elsewhere than up."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp

# A base that has tilted by more than this has fallen [rad]; turning about the vertical is no tilt.
TILTED = 1.0


def fallen(upright: int | None, start: Any, end: Any) -> jax.Array | None:
    """Whether a robot has fallen over on its way from a start to an end, shape (...).

    Args:
        upright: static; from `jaxact.robots.standing.base`, None of what cannot fall.
        start, end: of a plant in MuJoCo, states with a `qpos`, or configurations, shape (..., nq).

    Returns:
        None of what cannot fall; not true where it is not known.
    """
    if upright is None:
        return None
    before, after = (_upwards(getattr(one, "qpos", one), upright) for one in (start, end))
    return jnp.sum(before * after, axis=-1) < math.cos(TILTED)


def _upwards(qpos: Any, place: int) -> jax.Array:
    """The vertical as the base sees it, shape (..., 3); its quaternion w, x, y, z is at a place."""
    w, x, y, z = jnp.moveaxis(jnp.asarray(qpos)[..., place : place + 4], -1, 0)
    size = w * w + x * x + y * y + z * z
    up = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z
    return jnp.stack([part / size for part in up], axis=-1)
