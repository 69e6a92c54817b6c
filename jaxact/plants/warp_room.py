"""How much room simulations of a robot need for contacts and constraints, where it is fixed.

MJX-Warp takes the pairs of geoms whose bounding volumes meet, and the contacts they have, into
lists whose lengths must be said beforehand.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

# Room for contacts that is given without thinking twice, on average over simulations and in each.
_SHARED, _OWN = 64, 32
# The posture may change: more room than it takes there.
_MARGIN = 4

_GEOM = mujoco.mjtGeom
_UNBOUNDED = (int(_GEOM.mjGEOM_PLANE), int(_GEOM.mjGEOM_HFIELD), int(_GEOM.mjGEOM_SDF))
_ROUND = (int(_GEOM.mjGEOM_SPHERE), int(_GEOM.mjGEOM_ELLIPSOID))


@dataclass(frozen=True)
class Room:
    """Room of one simulation.

    Attributes:
        contacts: in the list that the simulations of a batch share; as many for each.
        rows: scalar constraints: contacts take several, limits, friction and equalities the rest.
    """

    contacts: int
    rows: int


def room(model: mujoco.MjModel, start: mujoco.MjData) -> Room:
    """Room for a robot's contacts and constraints.

    Where all contacts that its shapes could ever have at once fit, for all of them; else for a
    multiple of those whose bounding spheres meet in the posture.

    Args:
        model: compiled.
        start: at the posture, after `mujoco.mj_forward`.
    """
    pairs = list(_pairs(model))
    most = sum(_most(model, *pair) for pair in pairs)
    near = sum(_most(model, *pair) for pair in pairs if _meet(model, start, *pair))
    own = min(most, max(_OWN, _MARGIN * start.ncon))
    return Room(
        contacts=max(1, min(most, max(_SHARED, _MARGIN * near))),
        rows=max(1, _rows_without_contacts(model) + own * _rows_of_a_contact(model)),
    )


def _pairs(model: mujoco.MjModel) -> Iterator[tuple[int, int]]:
    """Geoms that may touch, at least all those that MuJoCo tests."""
    yield from zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
    first, second = np.triu_indices(model.ngeom, 1)
    types, affinities = model.geom_contype, model.geom_conaffinity
    wanted = (types[first] & affinities[second]) | (types[second] & affinities[first])
    weld = model.body_weldid[model.geom_bodyid]
    apart = weld[first] != weld[second]
    yield from np.stack([first, second], 1)[(wanted != 0) & apart].tolist()


def _most(model: mujoco.MjModel, first: int, second: int) -> int:
    """Contacts that two geoms have at most."""
    kinds = {int(model.geom_type[first]), int(model.geom_type[second])}
    if kinds & set(_UNBOUNDED[1:]):
        return int(mujoco.mjMAXCONPAIR)
    if kinds & set(_ROUND):
        return 1
    return 4 if kinds & {int(_GEOM.mjGEOM_PLANE), int(_GEOM.mjGEOM_CAPSULE)} else 8


def _meet(model: mujoco.MjModel, start: mujoco.MjData, first: int, second: int) -> bool:
    """Whether the bounding spheres of two geoms meet, margins included."""
    reach = model.geom_rbound[[first, second]].sum() + model.geom_margin[[first, second]].sum()
    reach += model.geom_gap[[first, second]].sum()
    offset = start.geom_xpos[second] - start.geom_xpos[first]
    for geom, towards in ((first, offset), (second, -offset)):
        if model.geom_type[geom] == _GEOM.mjGEOM_PLANE:
            normal = start.geom_xmat[geom].reshape(3, 3)[:, 2]
            return bool(normal @ towards < reach)
    if {int(model.geom_type[first]), int(model.geom_type[second])} & set(_UNBOUNDED):
        return True
    return bool(np.linalg.norm(offset) < reach)


def _rows_of_a_contact(model: mujoco.MjModel) -> int:
    dims = np.concatenate([[1], model.geom_condim, model.pair_dim])
    largest = int(dims.max())
    if model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL:
        return max(1, 2 * (largest - 1))
    return largest


def _rows_without_contacts(model: mujoco.MjModel) -> int:
    """Constraints of equalities, dry friction, and limits on both sides, if all act at once."""
    equalities = 6 * model.neq
    friction = np.sum(model.dof_frictionloss > 0.0) + np.sum(model.tendon_frictionloss > 0.0)
    limits = 2 * (np.sum(model.jnt_limited) + np.sum(model.tendon_limited))
    return int(equalities + friction + limits)
