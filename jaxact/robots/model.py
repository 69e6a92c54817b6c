"""Reading a user's robot: MJCF or URDF in, joints to drive and a model to simulate out.

Everything goes through MuJoCo's own compiler. What the actuators of the model are (gains, limits,
gears, delays) becomes parameters of the drive; in the model they become unit motors, so that the
control of a driven actuator is the joint force.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.robots import (
    assets,
    conversion,
    lifting,
    motors,
    mounting,
    parity,
    posture,
    refusals,
    selection,
)
from jaxact.robots.actuators import FORCE, POSITION, VELOCITY, Law
from jaxact.robots.conversion import DAMPING, IN_DRIVE, IN_JOINT
from jaxact.robots.findings import Finding
from jaxact.robots.posture import Posture
from jaxact.robots.robot import Joint, Robot, demand, exact, inexact, suits
from jaxact.robots.selection import Driven

__all__ = ["Finding", "Joint", "Robot", "demand", "exact", "inexact", "read", "suits"]


@dataclass(frozen=True)
class _Start:
    """A keyframe of the model as its file has it; `commanded` if it says what ctrl is."""

    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    ctrl: np.ndarray
    commanded: bool


def read(
    path: Path | str,
    *,
    keyframe: str | int | None = None,
    joints: Sequence[str] = (".*",),
    base: str = mounting.FREE,
    damping: str = IN_JOINT,
    settle: bool = True,
) -> Robot:
    """Read a robot.

    Args:
        path: MJCF or URDF file; never changed.
        keyframe: name or number of the posture to start from; qpos0 at rest without one.
        joints: regular expressions; a joint is driven whose name, or whose actuator's, one of them
            matches in full. Other actuators stay undriven: at the keyframe's ctrl.
        base: "free" as the model has it; "fixed" on a stand, at the keyframe, where nothing touches
            the robot; "held" where the robot stands, in contact. See `jaxact.robots.mounting`.
        damping: "joint" leaves the driven joints' viscous damping in the joints, where it acts at
            once; "drive" moves it into the gains kd that the model brings, where it is sampled and
            delayed.
        settle: where a held base is held: where the robot has come to rest, or at the keyframe.

    Returns:
        The robot. What stands in the way of a simulation is among its findings as "refused":
        see `demand`.

    Raises:
        UserError: the file is missing or MuJoCo refuses it, no such keyframe, no actuators, a
            pattern that matches nothing, or a robot to be held that does not come to rest.
    """
    for name, value, known in (("base", base, mounting.BASES), ("damping", damping, DAMPING)):
        if value not in known:
            raise UserError(f"{name} = {shown(value)}; {nearest(value, known)}")
    opened = _opened(Path(path), keyframe, joints, base)
    if base == mounting.FREE:
        return _driven(opened, damping)
    moving = mounting.base_joints(opened.model, opened.indices)
    rest = None
    if base == mounting.HELD and settle and moving:
        rest = posture.standing(read(path, keyframe=keyframe, joints=joints))
    robot = _driven(_mounted(opened, moving, base, rest), damping)
    mounting.keep_softness(robot.model, opened.model, moving)
    return replace(robot, base=base)


@dataclass(frozen=True)
class _Opened:
    """A model file that MuJoCo has compiled.

    Attributes:
        path: the file.
        spec: what it says; changed on the way to the robot.
        model: what it compiles to.
        start: where it starts.
        indices: of the actuators that are chosen.
        findings: what is said of it so far.
        digest: fingerprint of what the file compiles to.
    """

    path: Path
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    start: _Start
    indices: tuple[int, ...]
    findings: tuple[Finding, ...]
    digest: str


def _opened(path: Path, keyframe: str | int | None, joints: Sequence[str], base: str) -> _Opened:
    spec = _parse(path)
    added = motors.add(spec, path, joints)
    commanded = [len(key.ctrl) > 0 for key in spec.keys]
    model, findings = _compile(spec, path, untouched=base == mounting.FIXED)
    if model.nactuator == 0:
        raise UserError(
            f"{path}: the model has no actuators, and no hinge or slide joints that could get "
            "motors, so there is nothing to drive"
        )
    return _Opened(
        path=path,
        spec=spec,
        model=model,
        start=_start(path, model, keyframe, commanded),
        indices=tuple(selection.chosen(path, model, joints)),
        findings=(*findings, *added),
        digest=_digest(model),
    )


def _mounted(opened: _Opened, joints: Sequence[int], base: str, rest: Posture | None) -> _Opened:
    """The same without the joints of the base, which is fixed or held.

    Args:
        rest: where the robot stands; None: it is mounted where it starts.
    """
    spec, original, start = opened.spec, opened.model, opened.start
    at = "at the start posture"
    if rest is not None:
        at = "where the robot stands"
        start = replace(start, qpos=rest.qpos, qvel=rest.qvel)
    if base == mounting.FIXED:
        mounting.untouched(spec, original, opened.indices)
    mounting.weld(spec, original, joints, start.qpos)
    qpos, qvel = mounting.without(original, joints, start.qpos, start.qvel)
    try:
        model, _ = assets.compile_model(spec)
    except ValueError as error:
        raise UserError(
            f'{opened.path}: base = "{base}": the model cannot do without the joints of its base: '
            f"{_reason(error, opened.path)}"
        ) from error
    said = mounting.finding(original, joints, base, at)
    return replace(
        opened,
        model=model,
        start=replace(start, qpos=qpos, qvel=qvel),
        findings=(*opened.findings, said),
    )


def _driven(opened: _Opened, damping: str) -> Robot:
    """The robot with drives in place of the actuators that are chosen."""
    spec, original, start = opened.spec, opened.model, opened.start
    kinds = [actuator.type.name.removeprefix("mjACTUATOR_").lower() for actuator in spec.actuators]
    laws, unfit = selection.laws(original, opened.indices, kinds)
    driven, clashes = selection.one_to_a_joint(original, laws)
    try:
        model = conversion.convert(spec, original, driven)
    except ValueError as error:
        raise UserError(
            f"{opened.path}: cannot be converted: {_reason(error, opened.path)}"
        ) from error
    findings = [*opened.findings, *unfit, *clashes, *_findings(original, driven)]
    joints = tuple(_joint(original, model, start, item) for item in driven)
    if damping == IN_DRIVE:
        joints, moved = conversion.damping_to_drives(model, joints)
        findings += moved
    ctrl, act = conversion.remaining(original, conversion.taken(driven), start.ctrl, start.act)
    return Robot(
        path=opened.path,
        model=model,
        joints=joints,
        findings=tuple(findings),
        qpos=start.qpos,
        qvel=start.qvel,
        ctrl=ctrl,
        act=act,
        digest=opened.digest,
        damping=damping,
    )


def _findings(original: mujoco.MjModel, driven: Sequence[Driven]) -> list[Finding]:
    """What is said of the model's own fields."""
    findings = [finding for item in driven for finding in lifting.findings(original, item)]
    taken = conversion.taken(driven)
    findings += conversion.findings(original, taken)
    said = {item.where for item in findings if item.engines}
    findings += [
        item
        for item in parity.findings(original, taken)
        if item.field != parity.ACTUATOR_TYPE or item.where not in said
    ]
    return findings


def _parse(path: Path) -> mujoco.MjSpec:
    if not path.is_file():
        raise UserError(f"{path}: no such model file")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise UserError(f"{path}: MuJoCo cannot read this model: {_reason(error, path)}") from error
    assets.find_packages(spec)
    return spec


def _compile(
    spec: mujoco.MjSpec, path: Path, *, untouched: bool
) -> tuple[mujoco.MjModel, list[Finding]]:
    try:
        return assets.compile_model(spec, untouched=untouched)
    except ValueError as error:
        raise UserError(
            f"{path}: MuJoCo cannot compile this model: {_reason(error, path)}"
        ) from error


def _reason(error: Exception, path: Path) -> str:
    return refusals.explained(error, urdf=motors.is_urdf(path))


def _start(
    path: Path, model: mujoco.MjModel, keyframe: str | int | None, commanded: Sequence[bool]
) -> _Start:
    if keyframe is None:
        rest = np.zeros(model.nv), np.zeros(model.na), np.zeros(model.nu)
        return _Start(model.qpos0.copy(), *rest, False)
    index = _keyframe_index(path, model, keyframe)
    qpos = model.key_qpos[index].copy()
    mujoco.mj_normalizeQuat(model, qpos)
    return _Start(
        qpos,
        model.key_qvel[index].copy(),
        model.key_act[index].copy(),
        model.key_ctrl[index].copy(),
        # keyframes of attached models appear when it is compiled
        commanded[index] if index < len(commanded) else True,
    )


def _keyframe_index(path: Path, model: mujoco.MjModel, keyframe: str | int) -> int:
    names = [model.key(index).name for index in range(model.nkey)]
    if keyframe in names:
        return names.index(str(keyframe))
    number = int(keyframe) if str(keyframe).isdecimal() else -1
    if 0 <= number < model.nkey:
        return number
    if not names:
        raise UserError(f"{path}: no keyframe {shown(keyframe)}; the model has no keyframes")
    known = [name or str(index) for index, name in enumerate(names)]
    raise UserError(f"{path}: no keyframe {shown(keyframe)}; {nearest(keyframe, known)}")


def _joint(original: mujoco.MjModel, model: mujoco.MjModel, start: _Start, driven: Driven) -> Joint:
    law = driven.law
    motor = law.commands == FORCE
    kd = law.kd + sum(partner.kd for partner in driven.partners)
    position, _ = _asked(original, start, law)
    asked = [(each.kd, _asked(original, start, each)[1]) for each in (law, *driven.partners)]
    pushed = 0.0 if motor else sum(gain * velocity for gain, velocity in asked)
    limited = law.commands == POSITION
    low, high = selection.joint_limits(original, driven)
    wn, zeta = law.lag_as_loop if motor else (math.nan, math.nan)
    return Joint(
        name=original.joint(law.joint).name or f"joint {law.joint}",
        actuator=original.actuator(law.index).name or f"actuator {law.index}",
        kind=law.kind,
        index=int(model.actuator_ctrladr[law.index]),
        joint=law.joint,
        qpos=int(model.jnt_qposadr[law.joint]),
        dof=int(model.jnt_dofadr[law.joint]),
        body=int(model.jnt_bodyid[law.joint]),
        kp=law.kp,
        kd=kd,
        force_low=max(law.force_low, low),
        force_high=min(law.force_high, high),
        setpoint_low=law.low if limited else -math.inf,
        setpoint_high=law.high if limited else math.inf,
        delay=law.delay if motor else 0.0,
        setpoint=position,
        setpoint_velocity=pushed / kd if kd > 0.0 else 0.0,
        setpoint_delay=0.0 if motor else law.delay,
        natural_frequency=wn,
        damping_ratio=zeta,
        **selection.own(original, law),
    )


def _asked(model: mujoco.MjModel, start: _Start, law: Law) -> tuple[float, float]:
    """Position [m or rad] (nan if none) and velocity that the keyframe's controls ask for."""
    if not start.commanded or law.commands == FORCE:
        return math.nan, 0.0
    first = int(model.actuator_ctrladr[law.index])
    given = start.ctrl[first]
    if law.integrated:
        given = start.act[int(model.actuator_actadr[law.index])]
    asked = float(np.clip(law.offset + law.scale * given, law.low, law.high))
    if law.commands == VELOCITY:
        return math.nan, asked
    if not law.velocity_scale:
        return asked, 0.0
    second = start.ctrl[first + 1]
    if model.actuator_ctrllimited[first + 1]:
        second = np.clip(second, *model.actuator_ctrlrange[first + 1])
    return asked, float(law.velocity_scale * second)


def _digest(model: mujoco.MjModel) -> str:
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()
