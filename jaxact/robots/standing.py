"""Whether robots stand on the ground with bases that are free to fall over, or to sink."""

from __future__ import annotations

import mujoco
import numpy as np

from jaxact.robots.base import Base
from jaxact.robots.model import Robot


def bases(robot: Robot, qpos: np.ndarray) -> tuple[Base, ...]:
    """The free bases of the robot that stand on something.

    Args:
        robot: from `jaxact.robots.model.read`.
        qpos: where it stands.

    Returns:
        None of a robot without a free base, without gravity, or that touches nothing there.
    """
    model = robot.model
    own = {int(model.body_rootid[joint.body]) for joint in robot.joints}
    gravity = float(np.linalg.norm(model.opt.gravity))
    if gravity == 0.0:
        return ()
    up = -model.opt.gravity / gravity
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    touching = model.body_rootid[model.geom_bodyid[data.contact.geom]]
    found = []
    for joint in np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)):
        root = int(model.jnt_bodyid[joint])
        # Parts of the robot that touch each other carry nothing.
        carries = np.any(touching == root, axis=1) & (touching[:, 0] != touching[:, 1])
        if root not in own or not carries.any():
            continue
        height = up @ data.subtree_com[root] - np.min(data.contact.pos[carries] @ up)
        place = int(model.jnt_qposadr[joint])
        found.append(Base(place, float(height) if height > 0.0 else np.inf, tuple(up.tolist())))
    return tuple(found)
