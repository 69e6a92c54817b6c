"""How soft constraints are: the inverse inertias that MuJoCo scales them by, when inertias change.

MuJoCo computes them when it compiles a model, of every body, degree of freedom and tendon in the
default configuration (`mj_setConst`), and keeps them. A model whose inertias are changed afterwards
would have contacts, limits and dry friction of the old softness: it would not be the robot that is
compiled with those inertias.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

DEPENDS = frozenset({"body_mass", "body_inertia", "dof_armature"})
"""Fields of a model that they follow from."""
FIELDS = ("body_invweight0", "dof_invweight0", "tendon_invweight0")
"""Fields of a model that keep them."""
_LEAST = 1e-15  # an inverse inertia of what does not move, MuJoCo's mjMINVAL


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Softness:
    """A robot in the default configuration: what its inverse inertias follow from.

    Attributes:
        bodies: Jacobians of the centres of mass, along the world's axes and about the axes of the
            inertias, shape (bodies, 6, nv).
        tendons: derivatives of the lengths, shape (tendons, nv).
        rest: part of the inertia matrix that neither bodies nor armature cause, shape (nv, nv).
        counted: 0 where MuJoCo leaves out the armature of all but tendons (bodies that only
            slide, of `body_simple` 2), otherwise 1; shape (nv,).
        shares: that a degree of freedom takes of the others' in its joint, shape (nv, nv).
    """

    bodies: Any
    tendons: Any
    rest: Any
    counted: Any
    shares: Any

    def changed(self, model: Any, fields: dict[str, Any]) -> dict[str, jax.Array]:
        """Inverse inertias after a change of masses, inertias or armature.

        What the model has is scaled: a robot on a stand keeps the softness of its free base.

        Args:
            model: before; MuJoCo's or MJX's.
            fields: of the model that replace its own.
        """

        def of(name: str) -> jax.Array:
            return jnp.asarray(fields.get(name, getattr(model, name)))

        names = "body_mass", "body_inertia", "dof_armature"
        before = self._inverses(*(jnp.asarray(getattr(model, name)) for name in names))
        after = self._inverses(*(of(name) for name in names))
        return {
            name: jnp.asarray(getattr(model, name)) * _ratio(new, old)
            for name, new, old in zip(FIELDS, after, before, strict=True)
        }

    def _inverses(self, mass: jax.Array, inertia: jax.Array, armature: jax.Array):
        """Of bodies (bodies, 2), degrees of freedom (nv,), and tendons (tendons,)."""
        weights = jnp.concatenate([jnp.repeat(mass[:, None], 3, axis=1), inertia], axis=1)
        matrix = jnp.einsum("bki,bk,bkj->ij", self.bodies, weights, self.bodies)
        matrix = matrix + self.rest
        inverse = jnp.linalg.inv(matrix + jnp.diag(self.counted * armature))
        whole = jnp.linalg.inv(matrix + jnp.diag(armature))
        each = jnp.einsum("bki,ij,bkj->bk", self.bodies, inverse, self.bodies)
        bodies = each.reshape(-1, 2, 3).mean(axis=2)
        # MuJoCo takes the other one where a body cannot move, or not turn.
        bodies = jnp.where(bodies > _LEAST, bodies, jnp.flip(bodies, axis=1))
        tendons = jnp.einsum("ti,ij,tj->t", self.tendons, whole, self.tendons)
        return bodies, self.shares @ jnp.diag(inverse), tendons


def of(model: mujoco.MjModel) -> Softness:
    """What the inverse inertias of this model follow from."""
    data = mujoco.MjData(model)
    mujoco.mj_resetData(model, data)
    mujoco.mj_fwdPosition(model, data)
    jacobians = np.zeros((model.nbody, 6, model.nv))
    for body in range(model.nbody):
        mujoco.mj_jacBodyCom(model, data, jacobians[body, :3], jacobians[body, 3:], body)
        jacobians[body, 3:] = data.ximat[body].reshape(3, 3).T @ jacobians[body, 3:]
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    weights = np.concatenate([np.repeat(model.body_mass[:, None], 3, 1), model.body_inertia], 1)
    own = np.einsum("bki,bk,bkj->ij", jacobians, weights, jacobians)
    tendons = np.zeros((model.ntendon, model.nv))
    for tendon in range(model.ntendon):
        begin = model.ten_J_rowadr[tendon]
        entries = slice(begin, begin + model.ten_J_rownnz[tendon])
        tendons[tendon, model.ten_J_colind[entries]] = data.ten_J[entries]
    rest = full - own - np.diag(model.dof_armature)
    counted = np.where(model.body_simple[model.dof_bodyid] == 2, 0.0, 1.0)
    return Softness(jacobians, tendons, rest, counted, _shares(model))


def compiled(model: mujoco.MjModel, changed: mujoco.MjModel) -> dict[str, np.ndarray]:
    """The same by MuJoCo itself, and the inertia that C keeps of bodies without children.

    Args:
        model: before.
        changed: after, with what was derived before; it is not written to.
    """
    before, after = copy.copy(model), copy.copy(changed)
    for each in (before, after):
        mujoco.mj_setConst(each, mujoco.MjData(each))
    return {
        name: getattr(model, name) * np.asarray(_ratio(getattr(after, name), getattr(before, name)))
        for name in FIELDS
    } | {"dof_M0": after.dof_M0.copy()}


def _shares(model: mujoco.MjModel) -> np.ndarray:
    """Averages over the three axes of a ball, and of a free body's motion and turning."""
    shares = np.eye(model.nv)
    for joint, kind in enumerate(model.jnt_type):
        first = model.jnt_dofadr[joint]
        free = kind == int(mujoco.mjtJoint.mjJNT_FREE)
        if free or kind == int(mujoco.mjtJoint.mjJNT_BALL):
            for begin in (first, first + 3)[: 2 if free else 1]:
                shares[begin : begin + 3, begin : begin + 3] = 1.0 / 3.0
    return shares


def _ratio(new: Any, old: Any) -> Any:
    """Where there is nothing to divide by, nothing changes."""
    xp = jnp if isinstance(new, jax.Array) else np
    there = old > _LEAST
    return xp.where(there, new / xp.where(there, old, 1.0), 1.0)
