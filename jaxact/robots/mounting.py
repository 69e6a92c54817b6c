"""How a robot's base is mounted: free as the model has it, on a stand, or held.

On a stand (`FIXED`) the base is welded where the keyframe has it and nothing touches the robot:
what remains are its joints and their drives. `HELD` welds the base where the robot stands, and
keeps its contacts. Works on MuJoCo's own specification (`mujoco.MjSpec`) in memory.

The base of a robot is what moves it as a whole: the free joint of the tree that its driven joints
belong to, or, of a robot that moves in a plane or along a rail, the slide joints between the world
and the first joint with an actuator or a spring, and the hinges among them. A passive hinge or ball
joint alone is not a base but a joint. Loose objects and other robots keep their free joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from jaxact.errors import UserError
from jaxact.robots import actuators, conversion, motors
from jaxact.robots.findings import ASKED, Finding, named
from jaxact.robots.robot import Robot

FREE, FIXED, HELD = "free", "fixed", "held"
BASES = (FREE, FIXED, HELD)

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
_QPOS_SIZE, _DOF_SIZE = {_FREE: 7, 1: 4}, {_FREE: 6, 1: 3}  # 1: a ball joint


def base_joints(model: mujoco.MjModel, indices: Sequence[int]) -> list[int]:
    """The joints that move the base of the robot that these actuators drive.

    Raises:
        UserError: an actuator acts on the base itself.
    """
    return _base(model, _bodies(model, indices))


def floats(robot: Robot) -> bool:
    """Whether the base of a robot moves, and nothing acts on it but the world."""
    try:
        return bool(_base(robot.model, [joint.body for joint in robot.joints]))
    except UserError:
        return False


def _base(model: mujoco.MjModel, bodies: Sequence[int]) -> list[int]:
    """Joints of the base, from the world on, of the bodies that driven joints move."""
    acted = _acted(model)
    found: list[int] = []
    for path in _paths(model, bodies):
        chain: list[int] = []
        for joint in _joints_of(model, path):
            free = int(model.jnt_type[joint]) == _FREE
            if free and joint in acted:
                raise UserError(
                    f"base: an actuator acts on the free {_named(model, joint)}, so the base is "
                    'driven itself and can be neither fixed nor held; base = "free"'
                )
            if joint in acted or model.jnt_stiffness[joint] != 0.0:
                break
            chain.append(joint)
        if any(int(model.jnt_type[joint]) in (_FREE, _SLIDE) for joint in chain):
            found += chain
    return sorted(set(found))


def _acted(model: mujoco.MjModel) -> set[int]:
    """Joints that an actuator acts on, directly or through a tendon."""
    direct = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    found: set[int] = set()
    for index in range(model.nactuator):
        target = int(model.actuator_trnid[index, 0])
        kind = mujoco.mjtTrn(model.actuator_trntype[index])
        if kind in direct:
            found.add(target)
        elif kind == mujoco.mjtTrn.mjTRN_TENDON:
            first = int(model.tendon_adr[target])
            wraps = np.arange(first, first + int(model.tendon_num[target]))
            fixed = wraps[model.wrap_type[wraps] == int(mujoco.mjtWrap.mjWRAP_JOINT)]
            found |= {int(joint) for joint in model.wrap_objid[fixed]}
    return found


def _bodies(model: mujoco.MjModel, indices: Sequence[int]) -> list[int]:
    """The bodies that the joints of these actuators move."""
    found = []
    for index in indices:
        try:
            joint, _ = actuators.transmission(model, index)
        except actuators.UndrivableError:
            continue
        found.append(int(model.jnt_bodyid[joint]))
    return found


def _paths(model: mujoco.MjModel, bodies: Sequence[int]) -> list[list[int]]:
    """Of each tree with driven joints: the bodies that carry all of them, from the root on."""
    carrying: dict[int, set[int]] = {}
    for body in bodies:
        above, parent = {body}, body
        while parent := int(model.body_parentid[parent]):
            above.add(parent)
        root = min(above)
        carrying[root] = carrying.get(root, above) & above
    return [sorted(each) for each in carrying.values()]


def _joints_of(model: mujoco.MjModel, bodies: Sequence[int]) -> list[int]:
    return [int(joint) for body in bodies for joint in np.flatnonzero(model.jnt_bodyid == body)]


def _named(model: mujoco.MjModel, joint: int) -> str:
    return named("joint", model.joint(joint).name, joint)


def weld(
    spec: mujoco.MjSpec, model: mujoco.MjModel, joints: Sequence[int], qpos: np.ndarray
) -> None:
    """Take these joints out of the specification, their bodies where they are at `qpos`.

    Args:
        spec: what `model` was compiled from; changed. Its keyframes keep all other joints.
        model: as compiled.
        joints: of the base, from `base_joints`.
        qpos: a configuration of the model.
    """
    data = mujoco.MjData(model)
    data.qpos = model.qpos0
    for joint in joints:
        at = _addresses(model, [joint], _QPOS_SIZE, model.jnt_qposadr)
        data.qpos[at] = qpos[at]
    mujoco.mj_kinematics(model, data)
    motors.name_joints(spec)  # their numbers change
    _keep_numbers(spec, model)
    _keep_filters(spec, model, joints)
    gone = [spec.joints[joint] for joint in joints]
    names = {joint.name for joint in gone}
    for body in {joint.parent.id: joint.parent for joint in gone}.values():
        parent = int(model.body_parentid[body.id])
        turned = np.empty(4)
        mujoco.mju_negQuat(turned, data.xquat[parent])
        place, turn = np.empty(3), np.empty(4)
        mujoco.mju_rotVecQuat(place, data.xpos[body.id] - data.xpos[parent], turned)
        mujoco.mju_mulQuat(turn, turned, data.xquat[body.id])
        body.set_frame(body.parent.add_frame())  # a frame of its own that does not move it
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        body.pos, body.quat = place, turn
    for sensor in list(spec.sensors):
        if sensor.objtype == mujoco.mjtObj.mjOBJ_JOINT and sensor.objname in names:
            spec.delete(sensor)
    for joint in gone:
        spec.delete(joint)
    spec.compiler.fusestatic = False  # a welded body stays a body of its own
    for index, key in enumerate(spec.keys):
        kept = without(model, joints, model.key_qpos[index], model.key_qvel[index])
        key.qpos, key.qvel = kept
        key.ctrl, key.act = model.key_ctrl[index].copy(), model.key_act[index].copy()


def _keep_filters(spec: mujoco.MjSpec, model: mujoco.MjModel, joints: Sequence[int]) -> None:
    """A body does not touch its parent; MuJoCo does not apply this to a parent that is fixed."""
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
        return
    weld, parent = model.body_weldid, model.body_parentid
    known = {frozenset((item.bodyname1, item.bodyname2)) for item in spec.excludes}
    for group in {int(weld[model.jnt_bodyid[joint]]) for joint in joints}:
        bases = np.flatnonzero(weld == group)
        for base in bases:
            for child in np.flatnonzero(weld[parent[weld]] == group):
                pair = [_body_name(spec, int(number)) for number in (base, child)]
                if child not in bases and frozenset(pair) not in known:
                    spec.add_exclude(bodyname1=pair[0], bodyname2=pair[1])


def _body_name(spec: mujoco.MjSpec, number: int) -> str:
    body = spec.bodies[number]
    if not body.name:
        body.name = motors.free_name(f"body {number}", {other.name for other in spec.bodies})
    return str(body.name)


def _keep_numbers(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """What the compiler derives from inertias, which a free base shares: `dampratio` and such."""
    conversion.settle_spring_dampers(spec, model)
    for index, actuator in enumerate(spec.actuators):
        actuator.gainprm = model.actuator_gainprm[index]
        actuator.biasprm = model.actuator_biasprm[index]


def keep_softness(model: mujoco.MjModel, original: mujoco.MjModel, joints: Sequence[int]) -> None:
    """Give contacts, limits and dry friction the softness that they have with a free base.

    MuJoCo scales it by inverse inertias in the default posture, which a fixed base changes; a
    robot that stands would press its feet into the ground otherwise when it is held.

    Args:
        model: without these joints; changed.
        original: with them, bodies in the same order.
        joints: that were taken out.
    """
    dofs = _addresses(original, joints, _DOF_SIZE, original.jnt_dofadr)
    model.body_invweight0[:] = original.body_invweight0
    model.dof_invweight0[:] = np.delete(original.dof_invweight0, dofs)
    model.tendon_invweight0[:] = original.tendon_invweight0


def without(
    model: mujoco.MjModel, joints: Sequence[int], qpos: np.ndarray, qvel: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of a model that lacks these joints, from those of the model."""
    return (
        np.delete(qpos, _addresses(model, joints, _QPOS_SIZE, model.jnt_qposadr)),
        np.delete(qvel, _addresses(model, joints, _DOF_SIZE, model.jnt_dofadr)),
    )


def _addresses(
    model: mujoco.MjModel, joints: Sequence[int], sizes: dict[int, int], first: np.ndarray
) -> list[int]:
    return [
        int(first[joint]) + offset
        for joint in joints
        for offset in range(sizes.get(int(model.jnt_type[joint]), 1))
    ]


def untouched(spec: mujoco.MjSpec, model: mujoco.MjModel, indices: Sequence[int]) -> None:
    """Let nothing touch the robot that these actuators drive: neither the world nor itself.

    Args:
        spec: what `model` was compiled from, bodies in the same order; changed.
        model: as compiled.
        indices: of actuators.
    """
    roots = {path[0] for path in _paths(model, _bodies(model, indices))}
    bodies = {body for body in range(model.nbody) if int(model.body_rootid[body]) in roots}
    own = [geom for geom in spec.geoms if geom.parent.id in bodies]
    for geom in own:
        geom.contype = geom.conaffinity = 0
    names = {geom.name for geom in own}
    for pair in list(spec.pairs):
        if names & {pair.geomname1, pair.geomname2}:
            spec.delete(pair)


def finding(model: mujoco.MjModel, joints: Sequence[int], base: str, at: str) -> Finding:
    """What is said of the base.

    Args:
        model: as the file has it.
        joints: of its base.
        base: `FIXED` or `HELD`.
        at: where the base is welded, in words.
    """
    touching = "nothing touches the robot" if base == FIXED else "contacts stay"
    if not joints:
        advice = "the base does not move in the model either; " + touching
        return Finding("model", "base", base, "keeps it as it is", ASKED, advice)
    first = _named(model, joints[0])
    where = first if len(joints) == 1 else f"{first} and {len(joints) - 1} more"
    return Finding(where, "base", base, "lets it move", ASKED, f"welded {at}; {touching}")
