"""What a robot's links do to each of its joints along a log, from the robot's own model.

    (M_ii(q) + armature) q_i'' = f_i - friction_i - l_i,
    l_i = sum_{j != i} M_ij(q) q_j'' + (gravity, Coriolis and centrifugal force)_i

M and the forces are MuJoCo's, for the motion that was measured, smoothed between the gaps of its
log, through the rows in which the position is new. Joints that were not recorded stay at the
model's posture; the base is fixed, and nothing touches the robot. The joints' own armature, damping
and friction are left out: those are what is identified.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np
from scipy import signal as _signal
from scipy.interpolate import CubicSpline

from jaxact.errors import UserError, nearest, shown
from jaxact.identification.log import LINKS, Log, between_gaps, missing, new_rows, stretches
from jaxact.parameters import SETPOINT
from jaxact.robots.robot import Joint, Robot

# By how much a joint is moved for its own stiffness [rad or m].
_STEP = 1e-4
# Over how long a motion is smoothed [s], and the fewest rows.
_SMOOTHED, _FEWEST = 0.02, 5


def joint_of(robot: Robot, name: str) -> Joint:
    """The driven joint of this name, or with an actuator of it.

    Raises:
        UserError: there is none.
    """
    for joint in robot.joints:
        if name in (joint.name, joint.actuator):
            return joint
    known = [joint.name for joint in robot.joints]
    raise UserError(f"joint {shown(name)} is not in {robot.path.name}; {nearest(name, known)}")


def bare(robot: Robot) -> mujoco.MjModel:
    """The model of the links alone, without what belongs to the drives, and without contact."""
    model = copy.copy(robot.model)
    for values in (model.dof_armature, model.dof_damping, model.dof_frictionloss):
        values[:] = 0.0
    return model


def with_links(logs: Sequence[Log], robot: Robot) -> list[Log]:
    """The logs of a robot's joints, recorded together, with what its links do to each.

    Where too little lies between two gaps to be used (`stretches`), they are computed as at rest.

    Args:
        logs: of the joints in one file.
        robot: with its base fixed.

    Raises:
        UserError: a joint is not in the model, or has no position.
    """
    for log in logs:
        if "position" not in log:
            raise UserError(f"{log.title}: has no position; every joint of a robot needs one")
    joints = [joint_of(robot, log.joint) for log in logs]
    motion = {joint.dof: _motion(log) for joint, log in zip(joints, logs, strict=True)}
    places = {joint.dof: joint.qpos for joint in joints}
    found = _along(bare(robot), robot, motion, places, len(logs[0]))
    return [
        replace(log, signals={**log.signals, **dict(zip(LINKS, found[joint.dof], strict=True))})
        for joint, log in zip(joints, logs, strict=True)
    ]


def levelled(logs: Sequence[Log], found: Mapping[str, float]) -> list[Log]:
    """The logs without the constant force of each joint, so that several can share a drive.

    Args:
        logs: from `with_links`.
        found: constant forces by joint, from `constant_forces`.
    """
    inertia, force, stiffness = LINKS
    return [
        replace(log, signals={**log.signals, force: log[force] - found[log.joint]}) for log in logs
    ]


def constant_forces(logs: Sequence[Log]) -> dict[str, float]:
    """The constant force on each joint [N or N m]: of cables, or of an encoder's zero.

    By least squares over what a joint's motion leaves of its command,

        f - M_ii q'' - l = armature q'' + viscous q' + coulomb sign(q') - constant

    Args:
        logs: from `with_links`, with a command, or with setpoint and gains.
    """
    rows: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for log in itertools.chain.from_iterable(map(stretches, logs)):
        position, velocity, acceleration = _smoothed(log)
        kp, kd = log.gains
        closed = SETPOINT in log and kp is not None
        force = log["command"] if not closed else (
            kp * (log[SETPOINT] - position) - (kd or 0.0) * velocity
        )  # fmt: skip
        rest = force - log[LINKS[0]] * acceleration - log[LINKS[1]]
        columns = [acceleration, velocity, np.sign(velocity), -np.ones(len(log))]
        rows.setdefault(log.joint, []).append((np.stack(columns, axis=1), rest))
    found = {}
    for joint, parts in rows.items():
        matrix, rest = (np.concatenate(each) for each in zip(*parts, strict=True))
        found[joint] = float(np.linalg.lstsq(matrix, rest)[0][-1])
    return found


def _motion(log: Log) -> np.ndarray:
    """Position, velocity and acceleration at each row, shape (3, rows).

    No cubic goes across a gap: the way that was made in it would be one of a single row.
    """
    found = np.stack([log["position"], np.zeros(len(log)), np.zeros(len(log))])
    for first, end in between_gaps(log):
        found[:, first:end] = _smoothed(log.part(first, end))
    return found


def _smoothed(log: Log) -> np.ndarray:
    """Position, velocity and acceleration of a log without gaps, shape (3, rows).

    By cubics through some of the rows in which the position is new; single rows that are missing
    lie on a spline through the others.
    """
    fresh, number = new_rows(log["position"])
    ticks = _ticks(log)
    even = np.arange(ticks[fresh[0]], ticks[fresh[-1]] + 1, number)
    position = CubicSpline(ticks[fresh], log["position"][fresh])(even)
    period = number * log.period
    window = max(2 * round(0.5 * _SMOOTHED / period) + 1, _FEWEST)
    window = min(window, (len(even) - 1) // 2 * 2 + 1)
    given = {"window_length": window, "polyorder": 3, "delta": period}
    each = [_signal.savgol_filter(position, deriv=order, **given) for order in range(3)]
    return np.stack([np.interp(ticks, even, values) for values in each])


def _ticks(log: Log) -> np.ndarray:
    """Number of each row among those that were written and those that are missing."""
    late = missing(log)
    steps = np.ones(len(log), int)
    steps[late] = np.rint(np.diff(log.time)[late - 1] / log.period)
    return np.cumsum(steps) - 1


def _along(
    model: mujoco.MjModel,
    robot: Robot,
    motion: Mapping[int, np.ndarray],
    places: Mapping[int, int],
    rows: int,
) -> dict[int, np.ndarray]:
    """Inertia, force and stiffness at each row by degree of freedom, shape (3, rows) each."""
    data = mujoco.MjData(model)
    dofs = list(motion)
    addresses = [places[dof] for dof in dofs]
    found = {dof: np.empty((3, rows)) for dof in dofs}
    whole = np.zeros((model.nv, model.nv))
    acceleration = np.zeros(model.nv)
    data.qpos[:] = robot.qpos
    for row in range(rows):
        for dof, at in zip(dofs, addresses, strict=True):
            data.qpos[at], data.qvel[dof], acceleration[dof] = motion[dof][:, row]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fullM(model, data, whole)
        own = np.diag(whole).copy()
        forces = whole @ acceleration - own * acceleration + data.qfrc_bias - data.qfrc_passive
        for dof, at in zip(dofs, addresses, strict=True):
            found[dof][0, row], found[dof][1, row] = own[dof], forces[dof]
            found[dof][2, row] = _stiffness(model, data, dof, at)
    return found


def _stiffness(model: mujoco.MjModel, data: mujoco.MjData, dof: int, at: int) -> float:
    """How the gravity and springs of a joint change with its position, by central differences."""
    place, speed = data.qpos[at], data.qvel.copy()
    data.qvel[:] = 0.0
    ends = []
    for sign in (1.0, -1.0):
        data.qpos[at] = place + sign * _STEP
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        ends.append(data.qfrc_bias[dof] - data.qfrc_passive[dof])
    data.qpos[at], data.qvel[:] = place, speed
    return float(ends[0] - ends[1]) / (2.0 * _STEP)
