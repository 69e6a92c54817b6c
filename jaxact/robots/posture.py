"""Where a robot starts: a posture at rest, and the joint forces that carry it there.

A posture is settled in C MuJoCo: stiff, well damped joints hold the keyframe until the robot has
come to rest on its contacts. What the joints then exert is the feedforward; with it, the settled
posture is an equilibrium of the closed loop whatever its gains.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from jaxact.errors import UserError
from jaxact.robots.findings import named
from jaxact.robots.robot import Robot
from jaxact.robots.silence import silenced

LONGEST = 20.0  # [s] to come to rest
AT_REST = 1e-6  # [1/s^2, relative to gravity] of the largest acceleration that counts as rest
NEARLY = 1e-2  # as much of it is let pass where the longest time is over
# How far a floating robot may move on its way to rest: of the model's size, and [rad].
_SUNK, _TURNED = 0.2, 0.5
# Overlap of bodies that is worth a word, of the model's size.
_DEEP = 0.005
# How far joints that hold the keyframe may give way under the robot's weight [rad].
_SAG = 0.1
# Natural frequency of the joints that hold the keyframe [rad/s], and its product with the physics
# step at most. The stiffer they are, the sooner the creep of MuJoCo's friction has ended.
_RATE, _MOST = 200.0, 0.25


@dataclass(frozen=True)
class Posture:
    """A state to start from.

    Attributes:
        qpos, qvel, act: as MuJoCo orders them.
        ctrl: of the actuators, zero for the driven ones.
        force: that the driven joints exert [N or N m], shape (joints,).
        residual: largest acceleration that is left under this force [rad/s^2 or m/s^2]; 0 for an
            equilibrium.
        settled: whether the robot was brought to rest.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    ctrl: np.ndarray
    force: np.ndarray
    residual: float
    settled: bool

    def joints(self, robot: Robot) -> np.ndarray:
        """Positions of the driven joints [m or rad], shape (joints,)."""
        return self.qpos[[joint.qpos for joint in robot.joints]]


def start(robot: Robot, model: mujoco.MjModel) -> mujoco.MjData:
    """MuJoCo's data at the keyframe; of this model, which has the robot's sizes."""
    data = mujoco.MjData(model)
    data.qpos, data.qvel, data.ctrl = robot.qpos, robot.qvel, robot.ctrl
    if robot.model.na:
        data.act = robot.act
    return data


def _places(robot: Robot) -> tuple[list[int], list[int], list[int]]:
    """Indices of the driven joints: positions, degrees of freedom, actuators."""
    rows = [(joint.qpos, joint.dof, joint.index) for joint in robot.joints]
    qpos, dofs, actuators = (list(column) for column in zip(*rows, strict=True))
    return qpos, dofs, actuators


def under_force(robot: Robot, force: np.ndarray) -> Posture:
    """The robot where it is, under joint forces [N or N m], shape (joints,).

    Args:
        robot: from `jaxact.robots.model.read`.
        force: that its driven joints exert.
    """
    return _posture(robot, start(robot, robot.model), force, settled=True)


def _posture(robot: Robot, data: mujoco.MjData, force: np.ndarray, *, settled: bool) -> Posture:
    """The posture of this state, with what is left of the accelerations under `force`."""
    _, _, actuators = _places(robot)
    data.ctrl[actuators] = force
    mujoco.mj_forward(robot.model, data)
    ctrl = data.ctrl.copy()
    ctrl[actuators] = 0.0
    return Posture(
        qpos=data.qpos.copy(),
        qvel=data.qvel.copy(),
        act=data.act.copy(),
        ctrl=ctrl,
        force=force.copy(),
        residual=float(np.max(np.abs(data.qacc), initial=0.0)),
        settled=settled,
    )


def given(robot: Robot) -> Posture:
    """The keyframe as it is, with the joint forces that inverse dynamics asks for.

    Forces on the unactuated degrees of freedom cannot be given; what is missing there is the
    residual.
    """
    data = start(robot, robot.model)
    _, dofs, _ = _places(robot)
    data.qacc[:] = 0.0
    mujoco.mj_forward(robot.model, data)
    passive = data.qfrc_actuator.copy()
    data.qacc[:] = 0.0
    mujoco.mj_inverse(robot.model, data)
    return _posture(robot, data, (data.qfrc_inverse - passive)[dofs], settled=False)


def settled(robot: Robot) -> Posture:
    """The keyframe brought to rest on its contacts, and the joint forces that hold it there.

    A keyframe that is at rest already stays as it is: on its way through a sag it might topple.

    Raises:
        UserError: the robot does not come to rest: it falls, or slides.
    """
    gravity = max(float(np.linalg.norm(robot.model.opt.gravity)), 1.0)
    there = given(robot)
    if not np.any(robot.qvel) and there.residual < AT_REST * gravity:
        return replace(there, settled=True)
    complaints = []
    # Stiff joints bear more weight, soft ones calm loose objects that they touch.
    for sag in (_SAG, np.inf):
        found = _rest(robot, gravity, sag)
        if falls := _fallen(robot, found.qpos):
            away = f"{falls} falls from its keyframe, or slides off it,"
            complaints.append(f"{away} before it comes to rest")
        elif not np.isfinite(found.residual) or found.residual > NEARLY * gravity:
            complaints.append(
                f"the posture does not come to rest within {LONGEST:g} s (residual acceleration "
                f"{found.residual:.3g}{_overlap(robot)})"
            )
        else:
            return found
    if there.residual <= NEARLY * gravity:  # an equilibrium that it leaves, upright for example
        return replace(there, settled=True)
    advice = 'give a keyframe at rest, or `posture="keyframe"` to start from it as it is'
    free = robot.model.jnt_bodyid[robot.model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)]
    if _own(robot).intersection(free.tolist()):
        advice = (
            'give a keyframe that stands by itself, `posture="keyframe"` to start from it as it '
            'is, or `base="fixed"` to put it on a stand'
        )
    raise UserError(f"{robot.path.name}: {complaints[0]}; {advice}")


# Where robots stand that were asked for last: it takes a simulation.
_STANDING: dict[tuple[object, ...], Posture] = {}
_REMEMBERED = 16


def standing(robot: Robot) -> Posture:
    """As `settled`, once for every robot and keyframe.

    Args:
        robot: as its file has it.
    """
    driven = tuple(joint.joint for joint in robot.joints)
    key = (robot.digest, robot.qpos.tobytes(), robot.ctrl.tobytes(), driven)
    if key not in _STANDING:
        while len(_STANDING) >= _REMEMBERED:
            del _STANDING[next(iter(_STANDING))]
        _STANDING[key] = settled(robot)
    return _STANDING[key]


def under(robot: Robot, model: mujoco.MjModel, nominal: Posture) -> Posture:
    """Where the robot rests with another model: with more weight to carry, for example.

    Args:
        robot: from `jaxact.robots.model.read`.
        model: of the same sizes.
        nominal: of the robot as it is. Where this is not settled, or the other model falls from
            it, the configuration stays, under the joint forces that inverse dynamics asks for.
    """
    other = replace(
        robot, model=model, qpos=nominal.qpos, qvel=nominal.qvel, act=nominal.act, ctrl=nominal.ctrl
    )
    if not nominal.settled:
        return given(other)
    try:
        return settled(other)
    except UserError:
        return given(other)


def _overlap(robot: Robot) -> str:
    """The pair of bodies that overlap most at the keyframe, if that is much; in words."""
    data = start(robot, robot.model)
    mujoco.mj_forward(robot.model, data)
    depth = -data.contact.dist
    if not depth.size or np.max(depth) < _DEEP * robot.model.stat.extent:
        return ""
    deepest = int(np.argmax(depth))
    bodies = robot.model.geom_bodyid[data.contact.geom[deepest]]
    first, second = (named("body", robot.model.body(body).name, body) for body in bodies)
    return f"; {first} and {second} overlap by {1e3 * depth[deepest]:.3g} mm at the keyframe"


def _rest(robot: Robot, gravity: float, sag: float) -> Posture:
    """Where the robot is when it has come to rest, or the longest time is over.

    Args:
        gravity: [m/s^2] that rest is relative to.
        sag: how far joints may give way under the robot's weight [rad].
    """
    model, spring, damping = _holding(robot, gravity, sag)
    qpos, dofs, actuators = _places(robot)
    data = start(robot, model)
    data.qvel[:] = 0.0
    held = data.qpos[qpos].copy()
    for _ in range(round(LONGEST / model.opt.timestep)):
        data.ctrl[actuators] = spring * (held - data.qpos[qpos]) - damping * data.qvel[dofs]
        with silenced():
            mujoco.mj_step(model, data)
        motion = np.abs(np.concatenate([data.qvel, data.qacc]))
        if not np.isfinite(motion).all() or np.max(motion, initial=0.0) < AT_REST * gravity:
            break
    there = start(robot, robot.model)
    there.qpos, there.act, there.time = data.qpos, data.act, data.time
    there.qvel[:] = 0.0  # and no accelerations: what the solver starts from
    return _posture(robot, there, spring * (held - data.qpos[qpos]), settled=True)


def _holding(
    robot: Robot, gravity: float, sag: float
) -> tuple[mujoco.MjModel, np.ndarray, np.ndarray]:
    """A model whose joints are stiff enough to hold the robot, their stiffness and damping.

    The joints get additional inertia, so that the physics step bears the stiffness: light joints
    that move each other would have to be soft otherwise, and the robot would collapse. Where it
    comes to rest does not depend on inertias.

    Args:
        sag: inf for the stiffness that the joints bear as they are.
    """
    model = copy.copy(robot.model)
    # A model may leave its solver unfinished in every step, for speed; it would not come to rest.
    model.opt.iterations = max(model.opt.iterations, 100)
    model.opt.ls_iterations = max(model.opt.ls_iterations, 50)
    data = start(robot, model)
    _, dofs, _ = _places(robot)
    mujoco.mj_forward(model, data)
    inertia, coupling = _inertia(model, data, dofs)
    if np.isfinite(sag):
        weight = float(model.body_mass.sum()) * gravity
        fastest = min(_RATE, _MOST / (2.0 * model.opt.timestep))
        least = weight * float(model.stat.extent) / sag / fastest**2
        model.dof_armature[dofs] += np.maximum(inertia, least)
        mujoco.mj_forward(model, data)
        inertia, coupling = _inertia(model, data, dofs)
    rate = min(_RATE, _MOST / (model.opt.timestep * coupling))
    return model, inertia * rate**2, 2.0 * inertia * rate


def fallen(robot: Robot, qpos: np.ndarray) -> bool:
    """Whether a floating robot has turned over, or sunk, on its way from its keyframe.

    Args:
        robot: from `jaxact.robots.model.read`.
        qpos: where it is now, as MuJoCo orders it.

    Returns:
        Never true of a fixed robot, or where it is not known (NaN).
    """
    return bool(_fallen(robot, qpos))


def _own(robot: Robot) -> set[int]:
    """The bodies that a free base of the robot moves with; others that are free are loose."""
    return {int(robot.model.body_rootid[joint.body]) for joint in robot.joints}


def _fallen(robot: Robot, qpos: np.ndarray) -> str:
    """What has turned over or sunk: the robot, or a body that is none of it; "" for nothing."""
    model = robot.model
    if not np.isfinite(qpos).all():
        return ""
    moved = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, moved, 1.0, robot.qpos, qpos)
    own = _own(robot)
    for joint in np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)):
        dof, body = model.jnt_dofadr[joint], int(model.jnt_bodyid[joint])
        sunk = np.linalg.norm(moved[dof : dof + 3]) > _SUNK * model.stat.extent
        if sunk or np.linalg.norm(moved[dof + 3 : dof + 6]) > _TURNED:
            return "the robot" if body in own else named("body", model.body(body).name, body)
    return ""


def _inertia(
    model: mujoco.MjModel, data: mujoco.MjData, dofs: list[int]
) -> tuple[np.ndarray, float]:
    """What each driven joint feels when the others are held [kg or kg m^2], shape (joints,).

    And how many times faster the fastest joint answers to damping in proportion to it when all are
    free, because they move each other.
    """
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    inertia = np.diag(full)[dofs].copy()
    answers = np.linalg.inv(full)[np.ix_(dofs, dofs)] * inertia
    return inertia, max(1.0, float(np.max(np.abs(np.linalg.eigvals(answers)))))
