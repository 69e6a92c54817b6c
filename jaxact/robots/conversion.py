"""Turning a user's model into one whose driven actuators are unit motors on their joints.

Works on MuJoCo's own specification (`mujoco.MjSpec`) in memory; the user's file is never touched.
"""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from jaxact.robots import actuators, assets, motors, selection
from jaxact.robots.actuators import Law
from jaxact.robots.findings import ASKED, EMULATED, ENGINES, MJX, WARP, Finding, named, refused
from jaxact.robots.parity import ITERATIONS, SEARCHES, ends_early, switched_off
from jaxact.robots.robot import Joint
from jaxact.robots.selection import Driven

IN_JOINT, IN_DRIVE = "joint", "drive"
DAMPING = (IN_JOINT, IN_DRIVE)
"""Where the viscous damping of driven joints acts: in the joint, at once, or in the drive's kd."""

_DISABLE, _ENABLE = mujoco.mjtDisableBit, mujoco.mjtEnableBit
_HARMLESS = _ENABLE.mjENBL_ENERGY | _ENABLE.mjENBL_FWDINV | _ENABLE.mjENBL_SLEEP


def convert(
    spec: mujoco.MjSpec, original: mujoco.MjModel, driven: Sequence[Driven]
) -> mujoco.MjModel:
    """Compile the specification with these actuators turned into unit motors.

    Besides, so that every engine simulates the same: actuator inertia and damping become the
    joint's or tendon's; delays and sensors go; actuators that are switched off by their group give
    no force, nor does any that is not driven where a flag switches all off; springs and dampers
    that are switched off have coefficients 0; nothing sleeps, and a motion that diverges is not
    reset to the start as if nothing had happened.

    Args:
        spec: what `original` was compiled from; changed.
        driven: become motors with gear 1, gain 1, no limits and no delay on their joint, whose own
            limits go where they are the drive's alone; those that they take in give no force.

    Raises:
        ValueError: it cannot be compiled; with MuJoCo's reason.
    """
    settle_spring_dampers(spec, original)
    _lift_inertia(spec, original)
    _switch_off_passive_forces(spec)
    for actuator in spec.actuators:
        actuator.delay, actuator.nsample, actuator.interp = 0.0, 0, 0
        actuator.actearly &= actuator.dyntype == mujoco.mjtDyn.mjDYN_DCMOTOR  # which must have it
    for item in driven:
        _make_motor(spec, item.law)
        if not selection.shares(original, item):
            spec.joints[item.law.joint].actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        for partner in item.partners:
            _make_motor(spec, partner)
            _silence(spec.actuators[partner.index])
    all_off = bool(original.opt.disableflags & _DISABLE.mjDSBL_ACTUATION)
    for index in range(original.nactuator):
        if switched_off(original, index) or (all_off and index not in taken(driven)):
            _silence(spec.actuators[index])
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    _set_options(spec.option)
    _rewrite_keyframes(spec, original, taken(driven))
    model, _ = assets.compile_model(spec)
    return model


def _set_options(option: mujoco.MjOption) -> None:
    option.enableflags &= ~int(_HARMLESS)
    option.disableflags |= int(_DISABLE.mjDSBL_AUTORESET)
    option.disableflags &= ~int(_DISABLE.mjDSBL_ACTUATION)  # or the drives' forces would be nothing
    option.disableactuator = 0
    option.noslip_iterations = 0
    if option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICIT:
        option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if option.solver == mujoco.mjtSolver.mjSOL_PGS:
        option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    if ends_early(option):
        option.iterations, option.ls_iterations = ITERATIONS, SEARCHES
    if option.density == option.viscosity == 0.0:
        option.wind = np.zeros(3)  # moves nothing, but MJX takes it for a fluid


def taken(driven: Sequence[Driven]) -> set[int]:
    """The actuators that drives replace, with those that they take in."""
    return {law.index for item in driven for law in (item.law, *item.partners)}


def _make_motor(spec: mujoco.MjSpec, law: Law) -> None:
    target = spec.joints[law.joint]
    if not target.name:
        target.name = motors.free_name(f"joint {law.joint}", {other.name for other in spec.joints})
    _add_damping(target, law.viscous)
    motor = spec.actuators[law.index]
    motor.set_to_motor()
    motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    motor.target = target.name
    motor.gear = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    motor.inheritrange = motor.armature = 0.0
    motor.damping = np.zeros(3)
    for limited in ("ctrllimited", "forcelimited", "actlimited"):
        setattr(motor, limited, mujoco.mjtLimited.mjLIMITED_FALSE)
    motor.ctrlrange = motor.forcerange = motor.actrange = [0.0, 0.0]


def _silence(actuator: mujoco.MjsActuator) -> None:
    actuator.gainprm = np.zeros(10)
    actuator.biastype = mujoco.mjtBias.mjBIAS_NONE


def settle_spring_dampers(spec: mujoco.MjSpec, original: mujoco.MjModel) -> None:
    """What `springdamper` compiles to, before anything is added that it would overwrite."""
    for index, joint in enumerate(spec.joints):
        if np.any(np.array(joint.springdamper)):
            joint.springdamper = np.zeros(2)
            joint.stiffness = np.array([original.jnt_stiffness[index], 0.0, 0.0])
            dof = original.jnt_dofadr[index]
            joint.damping = np.array([original.dof_damping[dof], 0.0, 0.0])


def _lift_inertia(spec: mujoco.MjSpec, original: mujoco.MjModel) -> None:
    """Actuator inertia and damping act at its length: at the joint they count gear^2 times.

    Where no single joint or tendon can carry them, they stay with the actuator.
    """
    for index in range(original.nactuator):
        target = _holder(spec, original, index)
        actuator = spec.actuators[index]
        if target is not None:
            gear = float(original.actuator_gear[original.actuator_outadr[index], 0])
            target.armature += gear**2 * float(original.actuator_armature[index])
            _add_damping(target, gear**2 * float(original.actuator_damping[index]))
            actuator.armature = 0.0
            actuator.damping = [0.0, *original.actuator_dampingpoly[index]]


def _add_damping(target: mujoco.MjsJoint, amount: float) -> None:
    damping = np.array(target.damping)
    damping[0] += amount
    target.damping = damping


def _switch_off_passive_forces(spec: mujoco.MjSpec) -> None:
    """Springs or dampers that a flag disables: MJX would leave out all passive forces.

    With both disabled, MuJoCo itself leaves out the others too: gravity compensation and fluid.
    """
    off = spec.option.disableflags & int(_DISABLE.mjDSBL_SPRING | _DISABLE.mjDSBL_DAMPER)
    spec.option.disableflags &= ~off
    for holder in (*spec.joints, *spec.tendons):
        if off & _DISABLE.mjDSBL_SPRING:
            holder.stiffness = np.zeros(3)
        if off & _DISABLE.mjDSBL_DAMPER:
            holder.damping = np.zeros(3)
    if off == _DISABLE.mjDSBL_SPRING | _DISABLE.mjDSBL_DAMPER:
        for body in spec.bodies:
            body.gravcomp = 0.0
        spec.option.density = spec.option.viscosity = 0.0
        spec.option.wind = np.zeros(3)


def damping_to_drives(
    model: mujoco.MjModel, joints: Sequence[Joint]
) -> tuple[tuple[Joint, ...], list[Finding]]:
    """Move the viscous damping of driven joints into the gains that the model brings.

    kp (r - q) - kd v - d v is the law with kd + d; its last part is sampled and delayed then, as
    it is where the damping stands for a drive's kd. Damping that grows with speed, and that of
    tendons, stays.

    Args:
        model: converted; changed.
        joints: the driven ones.

    Returns:
        The joints with their gains, and what is said of it.
    """
    moved, findings = [], []
    for joint in joints:
        damping = float(model.dof_damping[joint.dof])
        if damping == 0.0:
            moved.append(joint)
            continue
        model.dof_damping[joint.dof] = 0.0
        kd = damping + (0.0 if math.isnan(joint.kd) else joint.kd)
        # The same force at rest asks for a slower setpoint velocity of the higher gain.
        slower = 0.0 if math.isnan(joint.kd) else joint.kd / kd
        velocity = joint.setpoint_velocity * slower
        moved.append(replace(joint, kd=kd, setpoint_velocity=velocity))
        advice = f"moved into the drive's kd, which is {kd:g} unless another one is given"
        findings.append(
            Finding(
                named("joint", model.joint(joint.joint).name, joint.joint), "damping",
                f"{damping:g}", "has it act in the joint, at once", ASKED, advice,
            )
        )  # fmt: skip
    return tuple(moved), findings


def _holder(spec: mujoco.MjSpec, model: mujoco.MjModel, index: int) -> Any:
    """The joint or tendon that can carry an actuator's inertia and damping; None if none can."""
    target = int(model.actuator_trnid[index, 0])
    if model.actuator_trntype[index] == mujoco.mjtTrn.mjTRN_TENDON:
        return spec.tendons[target]
    try:
        joint, _ = actuators.transmission(model, index)
    except actuators.UndrivableError:
        return None
    return spec.joints[joint]


def findings(model: mujoco.MjModel, driven: Container[int]) -> list[Finding]:
    """What is said about the inertia and damping of actuators; MJX ignores both.

    Args:
        model: as the user's file compiles.
        driven: its actuators that drives replace.
    """
    found = []
    for index in range(model.nactuator):
        for field in ("armature", "damping"):
            value = float(getattr(model, f"actuator_{field}")[index])
            if value != 0.0:
                found.append(_inertia_finding(model, index, field, f"{value:g}"))
        poly = model.actuator_dampingpoly[index]
        if np.any(poly):
            text = " ".join(f"{number:g}" for number in poly)
            engines = ENGINES if index in driven else (MJX,)
            found.append(_refused(model, index, "damping (polynomial)", text, engines))
    return found


def _inertia_finding(model: mujoco.MjModel, index: int, field: str, value: str) -> Finding:
    tendon = model.actuator_trntype[index] == mujoco.mjtTrn.mjTRN_TENDON
    gear = float(model.actuator_gear[model.actuator_outadr[index], 0])
    try:
        if not tendon:
            actuators.transmission(model, index)
    except actuators.UndrivableError:
        # MJX-Warp ignores the one, and simulates the other.
        return _refused(model, index, field, value, (MJX, WARP) if field == "armature" else (MJX,))
    holder = "tendon" if tendon else "joint"
    advice = f"added to the {holder}'s own {field}, times gear^2 (gear {gear:g})"
    return Finding(actuators.label(model, index), field, value, "ignores it", EMULATED, advice)


def _refused(
    model: mujoco.MjModel, index: int, field: str, value: str, engines: tuple[str, ...]
) -> Finding:
    advice = f"give {field.partition(' ')[0]} to the joints instead, as one number"
    return refused(actuators.label(model, index), field, value, "ignores it", advice, engines)


def _rewrite_keyframes(spec: mujoco.MjSpec, original: mujoco.MjModel, driven: set[int]) -> None:
    """Controls and activations of the actuators that stay as they are; 0 for the driven ones."""
    for index, key in enumerate(spec.keys):
        key.ctrl, key.act = remaining(
            original, driven, original.key_ctrl[index], original.key_act[index]
        )


def remaining(
    model: mujoco.MjModel, driven: set[int], ctrl: np.ndarray, act: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Controls and activations of the original model as the converted one orders them."""
    controls: list[float] = []
    activations: list[float] = []
    for index in range(model.nactuator):
        if index in driven:
            controls.append(0.0)
            continue
        first, number = int(model.actuator_ctrladr[index]), int(model.actuator_ctrlnum[index])
        controls.extend(ctrl[first : first + number])
        first, number = int(model.actuator_actadr[index]), int(model.actuator_actnum[index])
        if first >= 0:
            activations.extend(act[first : first + number])
    return np.array(controls, float), np.array(activations, float)
