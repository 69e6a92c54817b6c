"""Reading a user's robot: MJCF or URDF in, joints to drive and a model to simulate out.

Everything goes through MuJoCo's own compiler. What the actuators of the model are (gains, limits,
gears, delays) becomes parameters of the drive; in the model they become unit motors, so that the
control of a driven actuator is the joint force.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.plants import actuators, assets, conversion, parity, selection
from jaxact.plants.actuators import FORCE, POSITION, VELOCITY, Law
from jaxact.plants.findings import EMULATED, ENGINES, HARMLESS, LIFTED, Finding
from jaxact.plants.selection import Driven

__all__ = ["Finding", "Joint", "Robot", "demand", "read", "suits"]


@dataclass(frozen=True)
class Joint:
    """One driven joint; SI units, angles in rad, everything at the joint (gear applied).

    Attributes:
        name: of the joint; "joint 3" if it has none.
        actuator: the actuator's name; "actuator 2" if it has none.
        kind: what the model has there: "motor", "position", "velocity", "general", "pid", ...
        index: of the actuator's control in the converted model.
        joint: id of the joint.
        qpos, dof, body: addresses of its position, its velocity, and the body it moves.
        kp, kd: gains that the model brings; nan where it brings none (a motor).
        force_low, force_high: limits of the force, +-inf where none.
        setpoint_low, setpoint_high: limits of the position setpoint, +-inf where none.
        delay: of the force command, lifted from a motor's own delay [s].
        setpoint: position setpoint that the keyframe's ctrl asks for; nan if none.
        setpoint_velocity: velocity setpoint that the keyframe's ctrl asks for; 0 if none.
        setpoint_delay: of the setpoint, lifted from a servo's own delay [s].
        natural_frequency, damping_ratio: force loop lifted from a motor's filter; nan if none.
    """

    name: str
    actuator: str
    kind: str
    index: int
    joint: int
    qpos: int
    dof: int
    body: int
    kp: float
    kd: float
    force_low: float
    force_high: float
    setpoint_low: float
    setpoint_high: float
    delay: float
    setpoint: float
    setpoint_velocity: float = 0.0
    setpoint_delay: float = 0.0
    natural_frequency: float = math.nan
    damping_ratio: float = math.nan


@dataclass(frozen=True)
class Robot:
    """A robot ready to be driven.

    Attributes:
        path: the file it was read from.
        model: driven actuators are unit motors (gear 1, gain 1, no limits, no delay); the others
            are as the file has them. It has no sensors: the drive brings its own.
        joints: the driven ones, in the order of their actuators.
        findings: fields that need a word, refusals among them.
        qpos, qvel, ctrl, act: start posture: the keyframe, else qpos0 at rest. ctrl holds what the
            undriven actuators keep getting, and 0 for the driven ones.
        digest: fingerprint of what the file compiles to, with all that it includes.
    """

    path: Path
    model: mujoco.MjModel
    joints: tuple[Joint, ...]
    findings: tuple[Finding, ...]
    qpos: np.ndarray
    qvel: np.ndarray
    ctrl: np.ndarray
    act: np.ndarray
    digest: str


@dataclass(frozen=True)
class _Posture:
    """A keyframe of the model as its file has it; `commanded` if it says what ctrl is."""

    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    ctrl: np.ndarray
    commanded: bool


def read(
    path: Path | str, *, keyframe: str | int | None = None, joints: Sequence[str] = (".*",)
) -> Robot:
    """Read a robot.

    Args:
        path: MJCF or URDF file; never changed.
        keyframe: name or number of the posture to start from; qpos0 at rest without one.
        joints: regular expressions; a joint is driven whose name, or whose actuator's, one of them
            matches in full. Other actuators stay undriven: at the keyframe's ctrl.

    Returns:
        The robot. What stands in the way of a simulation is among its findings as "refused":
        see `demand`.

    Raises:
        UserError: the file is missing or MuJoCo refuses it, no such keyframe, no actuators, or a
            pattern that matches nothing.
    """
    path = Path(path)
    spec = _parse(path)
    bare = _is_urdf(path) and _add_motors(spec)
    commanded = [len(key.ctrl) > 0 for key in spec.keys]
    original, findings = _compile(spec, path)
    if original.nactuator == 0:
        raise UserError(f"{path}: the model has no actuators, so there is nothing to drive")
    posture = _posture(path, original, keyframe, commanded)
    kinds = [actuator.type.name.removeprefix("mjACTUATOR_").lower() for actuator in spec.actuators]
    laws, unfit = selection.laws(original, selection.chosen(path, original, joints), kinds)
    driven, clashes = selection.one_to_a_joint(original, laws)
    try:
        model = conversion.convert(spec, original, driven)
    except ValueError as error:
        raise UserError(f"{path}: cannot be converted: {_one_line(error)}") from error
    findings += [*unfit, *clashes, *([_NO_ACTUATORS] if bare else ())]
    findings += [finding for item in driven for finding in _lifted(original, item)]
    taken = conversion.taken(driven)
    findings += conversion.findings(original, taken)
    said = {item.where for item in findings if item.engines}
    findings += [
        item
        for item in parity.findings(original, taken)
        if item.field != parity.ACTUATOR_TYPE or item.where not in said
    ]
    ctrl, act = conversion.remaining(original, taken, posture.ctrl, posture.act)
    return Robot(
        path=path,
        model=model,
        joints=tuple(_joint(original, model, posture, item) for item in driven),
        findings=tuple(findings),
        qpos=posture.qpos,
        qvel=posture.qvel,
        ctrl=ctrl,
        act=act,
        digest=_digest(original),
    )


def suits(robot: Robot, engine: str) -> bool:
    """Whether this engine can simulate the robot: "mjx", "mujoco" or "warp"."""
    return not any(engine in item.engines for item in robot.findings)


def demand(robot: Robot, engine: str = "mjx") -> Robot:
    """The robot, if this engine can simulate it: "mjx", "mujoco" or "warp".

    Raises:
        UserError: it cannot; says why in one line.
    """
    if engine not in ENGINES:
        raise UserError(f"unknown engine {shown(engine)}; {nearest(engine, ENGINES)}")
    stops = [item for item in robot.findings if engine in item.engines]
    if stops:
        first = stops[0]
        more = f" (and {len(stops) - 1} more, see `jaxact check`)" if len(stops) > 1 else ""
        raise UserError(f"{robot.path.name}: {first.where}: {first.advice}{more}")
    if not robot.joints:
        raise UserError(f"{robot.path.name}: no actuator of the model can be driven")
    return robot


def _parse(path: Path) -> mujoco.MjSpec:
    if not path.is_file():
        raise UserError(f"{path}: no such model file")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise UserError(f"{path}: MuJoCo cannot read this model: {_one_line(error)}") from error
    assets.find_packages(spec)
    return spec


def _compile(spec: mujoco.MjSpec, path: Path) -> tuple[mujoco.MjModel, list[Finding]]:
    try:
        return assets.compile_model(spec)
    except ValueError as error:
        raise UserError(f"{path}: MuJoCo cannot compile this model: {_one_line(error)}") from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _is_urdf(path: Path) -> bool:
    text = re.sub(rb"<!--.*?-->", b"", path.read_bytes(), flags=re.DOTALL)
    root = re.search(rb"<([A-Za-z][\w.:-]*)", text)
    return root is not None and root[1] == b"robot"


_NO_ACTUATORS = Finding(
    "model", "actuator", "none in a URDF", "has nothing to drive", EMULATED,
    "every hinge and slide joint gets a motor, within the joint's effort limit",
)  # fmt: skip


def _add_motors(spec: mujoco.MjSpec) -> bool:
    """A motor for each hinge and slide joint, if there are no actuators; says whether it did."""
    if spec.actuators:
        return False
    single = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    for joint in spec.joints:
        if joint.type in single:
            motor = spec.add_actuator(name=joint.name, target=joint.name)
            motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
            motor.set_to_motor()
    return True


def _posture(
    path: Path, model: mujoco.MjModel, keyframe: str | int | None, commanded: Sequence[bool]
) -> _Posture:
    if keyframe is None:
        rest = np.zeros(model.nv), np.zeros(model.na), np.zeros(model.nu)
        return _Posture(model.qpos0.copy(), *rest, False)
    index = _keyframe_index(path, model, keyframe)
    qpos = model.key_qpos[index].copy()
    mujoco.mj_normalizeQuat(model, qpos)
    return _Posture(
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


def _joint(
    original: mujoco.MjModel, model: mujoco.MjModel, posture: _Posture, driven: Driven
) -> Joint:
    law = driven.law
    motor = law.commands == FORCE
    kd = law.kd + sum(partner.kd for partner in driven.partners)
    position, _ = _asked(original, posture, law)
    asked = [(each.kd, _asked(original, posture, each)[1]) for each in (law, *driven.partners)]
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
    )


def _asked(model: mujoco.MjModel, posture: _Posture, law: Law) -> tuple[float, float]:
    """Position [m or rad] (nan if none) and velocity that the keyframe's controls ask for."""
    if not posture.commanded or law.commands == FORCE:
        return math.nan, 0.0
    first = int(model.actuator_ctrladr[law.index])
    given = posture.ctrl[first]
    if law.integrated:
        given = posture.act[int(model.actuator_actadr[law.index])]
    asked = float(np.clip(law.offset + law.scale * given, law.low, law.high))
    if law.commands == VELOCITY:
        return math.nan, asked
    if not law.velocity_scale:
        return asked, 0.0
    second = posture.ctrl[first + 1]
    if model.actuator_ctrllimited[first + 1]:
        second = np.clip(second, *model.actuator_ctrlrange[first + 1])
    return asked, float(law.velocity_scale * second)


def _lifted(model: mujoco.MjModel, driven: Driven) -> list[Finding]:
    """What is said about the fields of a driven actuator that became the drive's."""
    law = driven.law
    where = actuators.label(model, law.index)
    findings = []
    if law.delay > 0.0:
        which = "command delay" if law.commands == FORCE else "setpoint delay"
        given = float(model.actuator_delay[law.index])
        advice = f"the drive's {which} is {law.delay:g} s"
        if abs(law.delay - given) > 1e-9:
            advice += f", which MuJoCo makes of {given:g} s in whole steps and its buffer"
        findings.append(Finding(where, "delay", f"{given:g} s", "ignores it", LIFTED, advice))
    if law.integrated:
        findings.append(
            Finding(
                where,
                "dyntype",
                "integrator",
                "simulates it",
                LIFTED,
                "the drive holds the position setpoint that the integrated control has reached",
            )  # fmt: skip
        )
    if law.viscous > 0.0:
        findings.append(
            Finding(
                where,
                "biasprm",
                f"{law.viscous:g} at the joint",
                "simulates it",
                EMULATED,
                "the motor's own damping is added to the joint's",
            )  # fmt: skip
        )
    if law.lag > 0.0:
        findings.append(_lag_finding(where, law))
    findings += [
        Finding(
            actuators.label(model, partner.index),
            "kv",
            f"{partner.kd:g}",
            "simulates it",
            LIFTED,
            f"its damping is part of the drive of {where}",
        )  # fmt: skip
        for partner in driven.partners
    ]
    return findings


def _lag_finding(where: str, law: Law) -> Finding:
    value = f"filter, {law.lag:g} s"
    if law.commands != FORCE:
        return Finding(
            where, "dyntype", value, "simulates it", HARMLESS,
            "it smooths the setpoint, outside the loop; the drive follows its setpoint directly",
        )  # fmt: skip
    wn, zeta = law.lag_as_loop
    return Finding(
        where, "dyntype", value, "simulates it", LIFTED,
        f"the drive's actuator is wn = {wn:.4g} rad/s, zeta = {zeta:.4g} unless given otherwise",
    )  # fmt: skip


def _digest(model: mujoco.MjModel) -> str:
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()
