"""`jaxact.check`: what will be driven in a robot, and what its model has that engines ignore."""

from __future__ import annotations

import functools
import json
import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from jaxact.errors import UserError
from jaxact.loops import conversion, robots
from jaxact.loops.control_loop import ControlLoop, demand
from jaxact.parameters import (
    CONTROL_RATE,
    DELAY,
    JOINT_DAMPING,
    JOINT_FRICTION,
    KD,
    KP,
    SETPOINT,
    SETPOINT_DELAY,
    base,
)
from jaxact.plants import warp
from jaxact.plants.mjx import refusals as mjx_refusals
from jaxact.robots import inertia as _inertia
from jaxact.robots.findings import ENGINES, WARP, Finding, refused
from jaxact.robots.robot import Robot
from jaxact.verbs import check_gains, check_tables

if TYPE_CHECKING:
    from jaxact.robot_margins.on_stand import OnStand


@dataclass(frozen=True, repr=False)
class RobotCheck:
    """What is known of a robot before anything is simulated; printed, it is a report.

    Attributes:
        loop: what was asked about.
        robot: as it is read, all findings in it: each with what it is about, what MJX would do with
            it, and what jaxact does: lifted into the drive, emulated, ignored harmlessly, refused.
        on_stand: how much delay the model's own gains bear, and what its damping and friction do
            to that; or why that is not known, "" where the model brings no gains.
    """

    loop: ControlLoop
    robot: Robot
    on_stand: OnStand | str

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What needs a word."""
        return self.robot.findings

    @property
    def refused(self) -> bool:
        """Whether an engine refuses the robot as it is."""
        return any(item.engines for item in self.findings)

    @property
    def control_period(self) -> float:
        """Of the loop [s]."""
        return 1.0 / conversion.one(self.loop)[CONTROL_RATE]

    @property
    def physics_step(self) -> float:
        """The step that the robot is simulated with [s], the model's own where that fits."""
        from jaxact.simulation.plans import fewest  # with JAX's programs

        given, period = self.loop.kind.physics_step, self.control_period
        own = float(self.robot.model.opt.timestep)
        return period / int(fewest(1.0 / period, own)) if given is None else given

    @property
    def engines(self) -> list[str]:
        """The engines that can simulate the robot; `warp` only where MJX-Warp is installed."""
        stopped = {engine for item in self.findings for engine in item.engines}
        if warp.lacking():
            stopped.add(WARP)
        return [name for name in ENGINES if name not in stopped and self.robot.joints]

    @functools.cached_property
    def joints(self) -> list[dict[str, Any]]:
        """What is driven, one joint a row: gains, limits, inertia, bandwidth, delays, in SI units.

        Not a number: None.
        """
        free, held = _inertia.inertias(self.robot)
        model = self.robot.model
        return [
            {
                "name": joint.name,
                "actuator": joint.actuator,
                "kind": joint.kind,
                KP: _number(joint.kp),
                KD: _number(joint.kd),
                "force_limits": [_number(joint.force_low), _number(joint.force_high)],
                "setpoint_limits": [_number(joint.setpoint_low), _number(joint.setpoint_high)],
                SETPOINT: _number(joint.setpoint),
                "setpoint_velocity": joint.setpoint_velocity,
                DELAY: joint.delay,
                SETPOINT_DELAY: joint.setpoint_delay,
                "natural_frequency": _number(joint.natural_frequency),
                "damping_ratio": _number(joint.damping_ratio),
                "inertia": float(free[row]),
                "inertia_others_held": float(held[row]),
                JOINT_DAMPING: float(model.dof_damping[joint.dof]),
                JOINT_FRICTION: float(model.dof_frictionloss[joint.dof]),
                "armature": float(model.dof_armature[joint.dof]),
                "bandwidth": _number(_inertia.bandwidth(joint.kp, joint.kd, float(free[row]))),
            }
            for row, joint in enumerate(self.robot.joints)
        ]

    def to_json(self) -> str:
        """Everything as one JSON object."""
        known, plant, model = self.on_stand, self.loop.kind.plant, self.robot.model
        return json.dumps(
            {
                "model": str(self.robot.path),
                "keyframe": None if plant is None else plant.keyframe,
                "digest": self.robot.digest,
                "physics_step": self.physics_step,
                "degrees_of_freedom": int(model.nv),
                "engines": self.engines,
                "on_stand": check_gains.as_json(known),
                "on_stand_not_known": known if isinstance(known, str) and known else None,
                "joints": self.joints,
                "findings": [asdict(item) for item in self.findings],
            },
            indent=2,
            allow_nan=False,
        )

    def __repr__(self) -> str:
        """The report of the command line."""
        return check_tables.text(self)


def check(loop: ControlLoop) -> RobotCheck:
    """What will be driven in a robot and how, and every field that engines would ignore.

        jaxact.check(jaxact.robot("go1.xml", keyframe="home", control_rate=500))

    Args:
        loop: of a robot; the gains are those that the model brings, whatever the loop's.

    Raises:
        UserError: no loop, a loop of a joint, or a robot that cannot be read.
    """
    demand(loop)
    plant = loop.kind.plant
    if plant is None:
        raise UserError("only a robot is checked; make one with jaxact.robot(model, ...)")
    robot = robots.read(plant)
    own = conversion.one(loop)
    asked = {name: own[name] for name in loop.values if base(name) not in (KP, KD)}
    drive = {CONTROL_RATE: own[CONTROL_RATE], **asked}
    known = check_gains.found(plant, robot, drive, loop.kind.velocity)
    more = (*mjx_refusals.find(robot.model), *_of_warp(robot))
    return RobotCheck(loop, replace(robot, findings=(*robot.findings, *more)), known)


def _of_warp(robot: Robot) -> list[Finding]:
    """What MJX-Warp refuses by itself, where it is there to be asked."""
    known = any(WARP in item.engines for item in robot.findings)
    reason = "" if known or warp.lacking() else warp.refusal(robot.model)
    if not reason:
        return []
    advice = "MJX-Warp refuses it; choose another engine"
    return [refused("model", "MJX-Warp", reason, "is not asked", advice, (WARP,))]


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
