"""What a joint's drive has to move, and how fast the PD loop around it is.

The joint's inverse inertia at a posture is the diagonal of M^-1 [1/(kg m^2)]: every other joint and
a floating base give way, contacts are left out. With everything else held it is M's own diagonal.

The loop kp + kd s over J s^2 has the bandwidth at which |L| = 1:

    w^2 = (kd^2 + sqrt(kd^4 + 4 J^2 kp^2)) / (2 J^2)
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from jaxact.robots.model import Robot


def inertias(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Inertia that each driven joint moves at the start posture.

    Returns:
        Two arrays [kg m^2, or kg for a slide joint], shape (joints,): with all else free to move,
        and with all else held.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos = robot.qpos
    mujoco.mj_fwdPosition(model, data)
    dofs = [joint.dof for joint in robot.joints]
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    units = np.eye(model.nv)[dofs]
    answers = np.zeros_like(units)
    mujoco.mj_solveM(model, data, answers, units)
    free = np.array([1.0 / answers[row, dof] for row, dof in enumerate(dofs)])
    return free, full[dofs, dofs]


def bandwidth(kp: float, kd: float, inertia: float) -> float:
    """Gain crossover of a PD loop on a free inertia [rad/s]; nan without gains.

    Args:
        kp: [N m/rad].
        kd: [N m s/rad].
        inertia: [kg m^2].
    """
    squared = (kd**2 + math.hypot(kd**2, 2.0 * inertia * kp)) / (2.0 * inertia**2)
    return math.sqrt(squared)
