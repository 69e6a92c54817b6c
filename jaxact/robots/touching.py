"""Which geoms of a model may touch each other."""

from __future__ import annotations

import mujoco
import numpy as np

from jaxact.robots.findings import named

Pairs = dict[tuple[int, int], list[tuple[int, int]]]
"""Pairs of geoms by their types, the lower type first."""


def touching(model: mujoco.MjModel, types: np.ndarray, affinities: np.ndarray) -> Pairs:
    """Pairs of geoms that MuJoCo tests for contact; <pair> elements left out.

    Args:
        model: of the robot.
        types, affinities: contype and conaffinity of its geoms, shape (ngeom,).
    """
    first, second = np.triu_indices(model.ngeom, 1)
    wanted = (types[first] & affinities[second]) | (types[second] & affinities[first])
    body1, body2 = model.geom_bodyid[first], model.geom_bodyid[second]
    weld1, weld2 = model.body_weldid[body1], model.body_weldid[body2]
    apart = weld1 != weld2
    if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
        parent1 = model.body_weldid[model.body_parentid[weld1]]
        parent2 = model.body_weldid[model.body_parentid[weld2]]
        related = (weld1 == parent2) | (weld2 == parent1)
        apart &= ~(related & (weld1 != 0) & (weld2 != 0))
    low, high = np.minimum(body1, body2), np.maximum(body1, body2)
    apart &= ~np.isin((low << 16) + high, model.exclude_signature)
    groups: Pairs = {}
    for pair in np.stack([first, second], 1)[(wanted != 0) & apart].tolist():
        kinds = sorted(int(model.geom_type[geom]) for geom in pair)
        groups.setdefault((kinds[0], kinds[1]), []).append(tuple(pair))
    return groups


def on_planes(model: mujoco.MjModel) -> list[tuple[tuple[int, int], float]]:
    """Pairs of a plane and a box or mesh that may touch, with their contact's margin [m]."""
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return []
    by_type = touching(model, model.geom_contype, model.geom_conaffinity)
    found = [
        (pair, float(model.geom_margin[list(pair)].sum()))
        for kinds in _ON_PLANES
        for pair in by_type.get(kinds, [])
    ]
    for index in range(model.npair):
        pair = int(model.pair_geom1[index]), int(model.pair_geom2[index])
        kinds = sorted(int(model.geom_type[geom]) for geom in pair)
        if (kinds[0], kinds[1]) in _ON_PLANES:
            found.append((pair, float(model.pair_margin[index])))
    return found


_ON_PLANES = [
    (int(mujoco.mjtGeom.mjGEOM_PLANE), int(kind))
    for kind in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_MESH)
]


def pair_name(model: mujoco.MjModel, pairs: list[tuple[int, int]]) -> str:
    """The first pair of some as messages name it, and how many more there are."""
    where = " and ".join(_name(model, geom) for geom in pairs[0])
    return where + (f" (and {len(pairs) - 1} more such pairs)" if len(pairs) > 1 else "")


def _name(model: mujoco.MjModel, geom: int) -> str:
    name = model.geom(geom).name
    if name:
        return named("geom", name, geom)
    body = int(model.geom_bodyid[geom])
    return f"{named('geom', '', geom)} of {named('body', model.body(body).name, body)}"
