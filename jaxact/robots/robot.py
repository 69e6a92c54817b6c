"""A robot ready to be driven: its joints, its model, where it starts, and what is said of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.robots.findings import ENGINES, GROUP_OFF, INEXACT, MJX, Finding


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
        gear: what a position servo's input is, in setpoints at the joint; 1 of other actuators.
        own_armature, own_damping: of the actuator itself, which the converted model has in its
            joint, as an actuator of that gear would have them [kg or kg m^2], [N s/m or N m s/rad].
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
    gear: float = 1.0
    own_armature: float = 0.0
    own_damping: float = 0.0


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
        base: how it is mounted, of `jaxact.robots.mounting.BASES`.
        damping: where the joints' own viscous damping acts, of `jaxact.robots.conversion.DAMPING`.
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
    base: str = "free"
    damping: str = "joint"


def suits(robot: Robot, engine: str) -> bool:
    """Whether this engine can simulate the robot: "mjx", "mujoco" or "warp"."""
    return not any(engine in item.engines for item in robot.findings)


def exact(robot: Robot, engine: str) -> bool:
    """Whether this engine can simulate the robot, and does so as MuJoCo does but for rounding."""
    return suits(robot, engine) and (engine != MJX or not inexact(robot))


def inexact(robot: Robot) -> list[Finding]:
    """What MJX simulates otherwise than MuJoCo, the first element of each kind."""
    found = {item.field: item for item in reversed(robot.findings) if item.action == INEXACT}
    return list(reversed(found.values()))


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
        off = next((item for item in robot.findings if item.field == GROUP_OFF), None)
        why = f", as <option {off.field}> switches off {off.where} ({off.value})" if off else ""
        raise UserError(f"{robot.path.name}: no actuator of the model can be driven{why}")
    return robot
