"""Changes of a MuJoCo model that differ from sample to sample: payload, inertia, damping, friction.

Only fields that vary are replaced, so that a batch shares all others. What MuJoCo derives from
inertias when it compiles a model is `jaxact.plants.softness`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.parameters import (
    JOINT_ARMATURE,
    JOINT_DAMPING,
    JOINT_FRICTION,
    JOINT_STIFFNESS,
)

FIELDS = (
    "body_mass", "body_inertia", "body_subtreemass", "dof_damping", "jnt_stiffness",
    "dof_armature", "dof_frictionloss", "geom_friction",
)  # fmt: skip
"""Of a model, that `changed` may replace."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Variation:
    """Changes of a model; None for what is as in the model.

    Attributes:
        payload: mass added at the centre of the payload's body [kg], shape ().
        inertia_scale: factor on mass and inertia of the bodies that a driven joint moves: its own,
            and what hangs on that without a driven joint between; shape () or (joints,).
        joint_damping: added to the driven joints' viscous damping [N s/m or N m s/rad].
        joint_stiffness: added to the driven joints' stiffness, whose springs rest where the model
            has them rest [N/m or N m/rad].
        joint_armature: added to the driven joints' armature [kg or kg m^2].
        joint_friction: added to the driven joints' dry friction [N or N m].
        contact_friction: factor on the friction coefficients of all geoms, shape ().
    """

    payload: jax.Array | float | None = None
    inertia_scale: jax.Array | float | None = None
    joint_damping: jax.Array | float | None = None
    joint_stiffness: jax.Array | float | None = None
    joint_armature: jax.Array | float | None = None
    joint_friction: jax.Array | float | None = None
    contact_friction: jax.Array | float | None = None


def changed(
    model: Any,
    variation: Variation,
    *,
    dofs: tuple[int, ...],
    bodies: tuple[int, ...],
    payload_body: int,
) -> dict[str, jax.Array]:
    """The fields of a model that a variation replaces.

    Args:
        model: MuJoCo's or MJX's; only its fields are read.
        variation: leaves may be traced.
        dofs, bodies: of the driven joints; static.
        payload_body: the body that carries the payload; static.

    Returns:
        New values by the name of the field.
    """
    at = np.array(dofs)
    new: dict[str, Any] = {}
    if variation.payload is not None or variation.inertia_scale is not None:
        mass = jnp.asarray(model.body_mass)
        inertia = jnp.asarray(model.body_inertia)
        before = mass
        if variation.inertia_scale is not None:
            scale = jnp.broadcast_to(jnp.asarray(variation.inertia_scale), at.shape)
            joint = _moved_by(np.asarray(model.body_parentid), bodies)
            factors = jnp.where(joint < 0, jnp.ones_like(mass), scale[joint])
            mass, inertia = mass * factors, inertia * factors[:, None]
        if variation.payload is not None:
            mass = mass.at[payload_body].add(variation.payload)
        new["body_mass"], new["body_inertia"] = mass, inertia
        above = jnp.asarray(_ancestors(np.asarray(model.body_parentid)), mass.dtype)
        new["body_subtreemass"] = model.body_subtreemass + above @ (mass - before)
    joints = np.asarray(model.dof_jntid)[at]
    for name, field, where in (
        (JOINT_DAMPING, "dof_damping", at),
        (JOINT_STIFFNESS, "jnt_stiffness", joints),
        (JOINT_ARMATURE, "dof_armature", at),
        (JOINT_FRICTION, "dof_frictionloss", at),
    ):
        added = getattr(variation, name)
        if added is not None:
            new[field] = jnp.asarray(getattr(model, field)).at[where].add(added)
    if variation.contact_friction is not None:
        new["geom_friction"] = jnp.asarray(model.geom_friction) * variation.contact_friction
    return new


def _moved_by(parents: np.ndarray, bodies: tuple[int, ...]) -> np.ndarray:
    """Of every body the driven joint that moves it, the nearest above; -1 for none."""
    own = {body: joint for joint, body in enumerate(bodies)}
    found = np.full(parents.size, -1)
    for body in range(1, parents.size):  # MuJoCo numbers a parent before its children
        found[body] = own.get(body, found[parents[body]])
    return found


def _ancestors(parents: np.ndarray) -> np.ndarray:
    """1 where a body carries another one or is it itself, shape (bodies, bodies)."""
    carries = np.zeros((parents.size, parents.size))
    for body in range(parents.size):
        above = body
        carries[above, body] = 1.0
        while above:
            above = int(parents[above])
            carries[above, body] = 1.0
    return carries
