"""Where a robot rests whose controllers do not know of a change of its model, a payload say.

The controllers use the nominal model: their setpoint is the nominal posture q0, their feedforward
f0 what holds the nominal robot there. The changed robot gives way until its joints carry it,

    h(q) = kp (q0 - q) + f0,     h: weight, springs and contacts of the changed robot

Delay, actuators and damping do not matter there. It is found in C MuJoCo, as a posture is settled
(`jaxact.robots.posture`): with these springs, and joints that are damped enough to come to rest.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from jaxact.robots import friction, posture
from jaxact.robots.posture import Posture
from jaxact.robots.robot import Robot
from jaxact.robots.silence import silenced

# Natural frequency of the springs with the inertia that is added to the joints [rad/s], and its
# product with the physics step at most. Faster is sooner at rest, and less well integrated.
_RATE, _MOST = 40.0, 0.25
# How far joints that are held give way under the whole robot's weight [rad].
_HELD = 1e-3
# Rate at which the damping of joints that nothing drives ends their swinging [rad/s].
_CALM = 5.0
# Physics steps between two looks at whether it rests.
_STRIDE = 10
# [m or rad] for the stiffness about a posture by central differences.
_DIFFERENCE = 1e-6
# Negative stiffness, of a joint's own, that is not rounding.
_SOFT = 1e-6


@dataclass(frozen=True)
class Springs:
    """What holds the joints, shape (joints,) each.

    Attributes:
        stiffness: kp [N/m or N m/rad]; joints with none, or an infinite one, are held where they
            are.
        feedforward: added to what holds the nominal robot [N or N m].
        lowest, highest: that the joints can exert [N or N m].
    """

    stiffness: np.ndarray
    feedforward: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray


@dataclass(frozen=True)
class Rest:
    """Where a changed robot rests.

    Attributes:
        posture: there; where it does not come to rest, the one that its joints would hold if they
            were stiff.
        sag: how far the driven joints are from their nominal positions there [m or rad], shape
            (joints,).
        leaves: why it does not come to rest, in words; "" where it does.
    """

    posture: Posture
    sag: np.ndarray
    leaves: str = ""


def resting(robot: Robot, model: mujoco.MjModel, nominal: Posture, springs: Springs) -> Rest:
    """Where the robot rests with another model, its joints held by springs about the nominal one.

    Args:
        robot: from `jaxact.robots.model.read`.
        model: of the same sizes; its dry friction does not count, as MuJoCo's creeps under load.
        nominal: posture of the robot as it is.
        springs: of its joints.
    """
    gravity = max(float(np.linalg.norm(model.opt.gravity)), 1.0)
    stiff = posture.under(robot, model, nominal)
    none = np.zeros(len(robot.joints))
    elastic = np.isfinite(springs.stiffness) & (springs.stiffness > 0.0)
    # A posture that was no equilibrium to begin with is left under any load.
    balanced = nominal.settled or nominal.residual < posture.NEARLY * gravity
    force = nominal.force + springs.feedforward
    other = _at(robot, friction.without(model), nominal)
    if not (elastic.any() and balanced) or _holds(other, force, gravity):
        return Rest(stiff, none)
    held = replace(springs, stiffness=np.where(elastic, springs.stiffness, np.inf))
    if _topples(other, held.stiffness):
        return Rest(stiff, none, "the gains do not hold it up there")
    there = _settled(other, held, force, gravity)
    if there is None:
        return Rest(stiff, none, "it falls, or does not come to rest")
    if weak := _overloaded(other, held, there):
        return Rest(stiff, none, weak)
    return Rest(there, there.joints(robot) - nominal.joints(robot))


def _at(robot: Robot, model: mujoco.MjModel, where: Posture) -> Robot:
    """The robot with another model, which starts in a posture."""
    return replace(
        robot, model=model, qpos=where.qpos, qvel=where.qvel, act=where.act, ctrl=where.ctrl
    )


def _holds(robot: Robot, force: np.ndarray, gravity: float) -> bool:
    """Whether joint forces keep the robot at rest where it is."""
    return posture.under_force(robot, force).residual < posture.AT_REST * gravity


def _topples(robot: Robot, stiffness: np.ndarray) -> bool:
    """Whether a robot without a free base leaves its posture whatever the damping.

    What it leaves it for may be far away and well damped, and tells nothing of the posture. It does
    where springs and weight together have a direction in which they push away,

        K = dh/dq + diag(kp),     an eigenvalue of K < 0
    """
    model = robot.model
    if np.any(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)):
        return False  # known by how far it goes, see `posture.fallen`
    dofs = [joint.dof for joint in robot.joints]
    weight = np.zeros((model.nv, model.nv))
    for dof in range(model.nv):
        ends = [_needed(robot, dof, end * _DIFFERENCE) for end in (1.0, -1.0)]
        weight[:, dof] = (ends[0] - ends[1]) / (2.0 * _DIFFERENCE)
    held = ~np.isfinite(stiffness)
    weight[dofs, dofs] += np.where(held, 0.0, stiffness)
    free = np.setdiff1d(np.arange(model.nv), np.array(dofs)[held])
    own = weight[np.ix_(free, free)]
    least = float(np.min(np.linalg.eigvalsh(0.5 * (own + own.T)), initial=0.0))
    return least < -_SOFT * float(np.max(np.abs(own), initial=0.0))


def _needed(robot: Robot, dof: int, by: float) -> np.ndarray:
    """What keeps the robot at rest with one degree of freedom displaced, shape (nv,)."""
    data = posture.start(robot, robot.model)
    move = np.zeros(robot.model.nv)
    move[dof] = by
    mujoco.mj_integratePos(robot.model, data.qpos, move, 1.0)
    data.qvel[:] = 0.0
    mujoco.mj_forward(robot.model, data)
    passive = data.qfrc_actuator.copy()
    data.qacc[:] = 0.0
    mujoco.mj_inverse(robot.model, data)
    return data.qfrc_inverse - passive


def _settled(robot: Robot, springs: Springs, force: np.ndarray, gravity: float) -> Posture | None:
    """Where the springs bring the robot to rest; None where they do not."""
    model, stiffness = _sprung(robot, springs, gravity)
    data = posture.start(robot, model)
    data.qvel[:] = 0.0
    qpos = [joint.qpos for joint in robot.joints]
    held = data.qpos[qpos].copy()
    data.ctrl[[joint.index for joint in robot.joints]] = force + stiffness * held
    for _ in range(round(posture.LONGEST / (_STRIDE * model.opt.timestep))):
        with silenced():
            mujoco.mj_step(model, data, _STRIDE)
        motion = np.abs(np.concatenate([data.qvel, data.qacc]))
        if not np.isfinite(motion).all() or posture.fallen(robot, data.qpos):
            return None
        if np.max(motion, initial=0.0) < posture.AT_REST * gravity:
            break
    there = replace(robot, qpos=data.qpos.copy(), qvel=np.zeros(model.nv), act=data.act.copy())
    found = posture.under_force(there, force + stiffness * (held - data.qpos[qpos]))
    return found if found.residual < posture.NEARLY * gravity else None


def _sprung(robot: Robot, springs: Springs, gravity: float) -> tuple[mujoco.MjModel, np.ndarray]:
    """A model whose driven joints are springs about the setpoint in `ctrl`, and their stiffness.

    Inertia is added, so that the physics step bears the stiffness, and damping; where it comes to
    rest does not depend on them.
    """
    model = copy.copy(robot.model)
    model.opt.iterations = max(model.opt.iterations, 100)
    model.opt.ls_iterations = max(model.opt.ls_iterations, 50)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # damping is implicit
    dofs = np.array([joint.dof for joint in robot.joints])
    weight = float(model.body_mass.sum()) * gravity * float(model.stat.extent)
    stiffness = np.where(np.isfinite(springs.stiffness), springs.stiffness, weight / _HELD)
    rate = min(_RATE, _MOST / model.opt.timestep)
    model.dof_armature[dofs] += stiffness / rate**2
    data = posture.start(robot, model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    inertia = np.diag(full)
    damping = np.where(_free(model), 0.0, 2.0 * _CALM * inertia)
    damping[dofs] = 2.0 * np.sqrt(stiffness * inertia[dofs])
    model.dof_damping[:] += damping
    # The motors themselves are the springs, so that MuJoCo takes several steps at once.
    actuators = [joint.index for joint in robot.joints]
    model.actuator_biastype[actuators] = int(mujoco.mjtBias.mjBIAS_AFFINE)
    model.actuator_biasprm[actuators, 1] = -stiffness
    return model, stiffness


def _free(model: mujoco.MjModel) -> np.ndarray:
    """Degrees of freedom of free bodies, shape (nv,)."""
    return model.jnt_type[model.dof_jntid] == int(mujoco.mjtJoint.mjJNT_FREE)


def _overloaded(robot: Robot, springs: Springs, there: Posture) -> str:
    """The joint that would have to exert most beyond what it can, in words; "" for none."""
    slack = 1e-6 * np.maximum(1.0, np.abs(there.force))
    beyond = np.maximum(springs.lowest - there.force, there.force - springs.highest) - slack
    beyond = np.where(np.isfinite(springs.stiffness), beyond, -np.inf)
    worst = int(np.argmax(beyond))
    if beyond[worst] <= 0.0:
        return ""
    force = there.force[worst]
    limit = springs.highest[worst] if force > 0.0 else springs.lowest[worst]
    return (
        f"{robot.joints[worst].name} would have to bear {abs(force):.4g} and has {abs(limit):.4g}"
    )
