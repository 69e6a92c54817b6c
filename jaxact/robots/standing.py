"""Whether a robot stands on the ground with a base that is free to fall over."""

from __future__ import annotations

import mujoco
import numpy as np

from jaxact.robots.model import Robot


def base(robot: Robot, qpos: np.ndarray) -> int | None:
    """Where in a configuration the orientation of the base is, four numbers w, x, y, z.

    Args:
        robot: from `jaxact.robots.model.read`.
        qpos: where it stands.

    Returns:
        None of a robot without a free base, without gravity, or that touches nothing there.
    """
    model = robot.model
    own = {int(model.body_rootid[joint.body]) for joint in robot.joints}
    free = [
        joint
        for joint in np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
        if int(model.jnt_bodyid[joint]) in own
    ]
    if len(free) != 1 or not np.any(model.opt.gravity):
        return None
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    # Parts of the robot that touch each other carry nothing.
    touching = model.body_rootid[model.geom_bodyid[data.contact.geom]]
    stands = np.any(touching[:, 0] != touching[:, 1])
    return int(model.jnt_qposadr[free[0]]) + 3 if stands else None
