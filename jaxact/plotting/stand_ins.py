"""Links that have no shape to look at, drawn as the boxes that have their inertia.

A link's shape is mostly a mesh, and meshes are what is missing where only a model's XML was
published. Its mass, inertia and joints are there all the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import mujoco

# Shades of links, so that neighbours in the tree are told apart; of the bars between their joints.
_SHADES = ((0.34, 0.55, 0.78, 1.0), (0.62, 0.75, 0.88, 1.0))
_BAR = (0.35, 0.35, 0.38, 1.0)
_THICKNESS = 0.008  # of a bar, as a share of the model's extent
_THINNEST = 0.004  # half a box's edge, likewise
_LIKE_NOTHING = 1e-6  # of the robot's mass: no link, a frame


@dataclass(frozen=True)
class StandIns:
    """What is drawn in place of shapes.

    Attributes:
        bodies: ids of the bodies that are drawn as boxes, shape (n,).
        sizes: half edges of the boxes along the principal axes [m], shape (n, 3).
        joined: pairs (parent, child) of bodies whose origins a bar joins, shape (m, 2).
        links: bodies that move or belong to a robot, drawn as boxes or with a shape of their own.
    """

    bodies: np.ndarray
    sizes: np.ndarray
    joined: np.ndarray
    links: int


def stand_ins(model: mujoco.MjModel) -> StandIns:
    """Boxes for the bodies with mass that have no geom in a group that is shown by default."""
    shown = np.flatnonzero((model.geom_group < 3) & (model.geom_rgba[:, 3] > 0.0))
    seen = np.zeros(model.nbody, bool)
    seen[model.geom_bodyid[shown]] = True
    heavy = model.body_mass > _LIKE_NOTHING * max(float(model.body_mass.sum()), 1e-12)
    heavy[0] = False
    bodies = np.flatnonzero(heavy & ~seen)
    thinnest = _THINNEST * model.stat.extent
    sizes = [np.maximum(half_edges(model.body_mass[b], model.body_inertia[b]), thinnest)
             for b in bodies]  # fmt: skip
    joined = [
        (parent, body)
        for body in bodies
        if (parent := int(model.body_parentid[body])) > 0 and not seen[parent]
    ]
    return StandIns(
        bodies=bodies,
        sizes=np.reshape(sizes, (-1, 3)),
        joined=np.reshape(joined, (-1, 2)).astype(int),
        links=int(np.count_nonzero(heavy)),
    )


def half_edges(mass: float, inertia: np.ndarray) -> np.ndarray:
    """Half edges of the uniform box of a mass and principal moments of inertia [m], shape (3,).

    I1 = m (b^2 + c^2) / 3 and so on, for half edges a, b, c: a^2 = 3 (I2 + I3 - I1) / (2 m).
    Moments that no rigid body has give an edge of 0.

    Args:
        mass: [kg].
        inertia: principal moments [kg m^2], shape (3,).
    """
    squares = 1.5 * (inertia.sum() - 2.0 * inertia) / mass
    return np.sqrt(np.maximum(squares, 0.0))


def extent(model: mujoco.MjModel, own: StandIns) -> float:
    """Longest edge of the box around what is drawn of a model at its default posture [m].

    MuJoCo's own extent does not know of the boxes.
    """
    import mujoco

    if not len(own.bodies):
        return float(model.stat.extent)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    centres, radii = data.xipos[own.bodies], np.linalg.norm(own.sizes, axis=1)[:, None]
    edges = (centres + radii).max(axis=0) - (centres - radii).min(axis=0)
    return max(float(model.stat.extent), float(edges.max()))


def add(scene: mujoco.MjvScene, model: mujoco.MjModel, data: mujoco.MjData, own: StandIns) -> None:
    """Append the boxes and bars to a scene that MuJoCo has filled.

    Args:
        data: of the model, its kinematics and centres of mass up to date.
        own: from `stand_ins`.
    """
    import mujoco

    depth = _depths(model)
    for body, size in zip(own.bodies, own.sizes, strict=True):
        if (geom := _next(scene)) is not None:
            mujoco.mjv_initGeom(
                geom, mujoco.mjtGeom.mjGEOM_BOX.value, size, data.xipos[body], data.ximat[body],
                np.asarray(_SHADES[depth[body] % 2], np.float32),
            )  # fmt: skip
    width = _THICKNESS * model.stat.extent
    nowhere = np.zeros(3), np.zeros(3), np.eye(3).ravel()
    for parent, body in own.joined:
        start, end = data.xpos[parent], data.xpos[body]
        if np.linalg.norm(end - start) > width and (geom := _next(scene)) is not None:
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE.value
            mujoco.mjv_initGeom(geom, kind, *nowhere, np.asarray(_BAR, np.float32))
            mujoco.mjv_connector(geom, kind, width, start, end)


def _next(scene: mujoco.MjvScene) -> mujoco.MjvGeom | None:
    """The next free geom of a scene, None where it is full."""
    if scene.ngeom >= scene.maxgeom:
        return None
    scene.ngeom += 1
    return scene.geoms[scene.ngeom - 1]


def _depths(model: mujoco.MjModel) -> np.ndarray:
    """How many links there are from the world to each body, shape (nbody,)."""
    depth = np.zeros(model.nbody, int)
    for body in range(1, model.nbody):
        depth[body] = depth[model.body_parentid[body]] + 1
    return depth
