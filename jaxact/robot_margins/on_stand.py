"""How much delay the gains that a robot's model brings bear, and what its damping does to that.

On a stand, where only the joints and their drives are left; and of a base that is free, whether the
robot stands at all. Ideal actuators, unless the model or an identified drive brings others. What is
asked is about the robot and not about its simulation, so MuJoCo's integrator is corrected for: it
has positions half a physics step ahead of velocities, which margins take for that much less delay.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np

from jaxact import parameters
from jaxact.analysis.robot import modes
from jaxact.analysis.robot.delay import DelayBorne
from jaxact.errors import UserError
from jaxact.loops import edges, robots, strength
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Plant, Specification
from jaxact.parameters import CONTROL_RATE
from jaxact.robot_margins import whole_robot
from jaxact.robots import friction, mounting
from jaxact.robots.robot import Joint, Robot

Velocity = Literal["sampled", "differenced"]


@dataclass(frozen=True)
class Loop:
    """A loop of the gains that the model brings.

    Attributes:
        borne: the delay that it bears, and the motion in which it is lost.
        names: of the joints.
    """

    borne: DelayBorne
    names: tuple[str, ...]

    @property
    def shares(self) -> dict[str, float]:
        """The joints' shares in that motion, the one that moves most first."""
        shares = self.borne.participation
        return {self.names[place]: float(shares[place]) for place in modes.ranked(shares)}


@dataclass(frozen=True)
class OnStand:
    """What is known of a robot's own gains; None for what does not apply, or is asked for already.

    Attributes:
        drive: parameters of the drives beside the gains, the control rate [Hz] among them.
        as_it_is: on a stand.
        in_drive: on a stand, with the joints' damping in the drives.
        hidden: the joints whose damping stands for a drive's kd, see `hidden_gains`.
        stuck: on a stand, with dry friction as MuJoCo linearises it at rest.
        friction: largest dry friction of the model [N or N m].
        friction_unit: of it.
        outside: joints outside their ranges, see `jaxact.loops.robots.at_stops`.
        edges: what is said of joints on a limit, from `jaxact.loops.edges.said`.
        weak: joints too weak for the posture, from `jaxact.loops.strength.overloaded`.
        free: with its base free, where it is.
        falls: why there is no such loop: the robot does not come to rest; "" where there is.
    """

    drive: Mapping[str, float]
    as_it_is: Loop
    in_drive: Loop | None
    hidden: tuple[Joint, ...]
    stuck: Loop | None
    friction: float
    friction_unit: str
    outside: tuple[str, ...]
    edges: tuple[str, ...]
    weak: tuple[str, ...]
    free: Loop | None
    falls: str

    @property
    def control_rate(self) -> float:
        """Of the controllers [Hz]."""
        return self.drive[CONTROL_RATE]


def hidden_gains(robot: Robot) -> tuple[Joint, ...]:
    """The driven joints with a kp, no kd, and damping of their own: a D gain, most likely.

    Simulators integrate it implicitly and at once; the drive of the hardware computes it.
    """
    damping = robot.model.dof_damping
    return tuple(
        joint
        for joint in robot.joints
        if joint.kp > 0.0 and joint.kd == 0.0 and damping[joint.dof] > 0.0
    )


def brings_gains(robot: Robot) -> bool:
    """Whether the model brings all gains, so that there is a loop to look at."""
    return bool(robot.joints) and not any(
        math.isnan(joint.kp) or math.isnan(joint.kd) for joint in robot.joints
    )


def loop(plant: Plant, drive: Mapping[str, float], velocity: Velocity = "sampled") -> Loop:
    """The loop of the gains that the model brings.

    Args:
        plant: the robot.
        drive: parameters of the drives beside the gains, by short name.
        velocity: that the controllers see, "sampled" or "differenced".

    Raises:
        UserError: as `jaxact.robot_margins.whole_robot.evaluate`.
    """
    model = robots.scene(plant).robot.model
    specification = Specification(
        engine="mujoco",
        plant=plant,
        velocity=velocity,
        parameters={name: parameters.check(name, value) for name, value in drive.items()},
        integrator_correction=model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4,
    )
    along = {name: np.array([value]) for name, value in specification.nominal.items()}
    samples = Samples(along, ("loop",), (1,), {})
    (found,) = whole_robot.evaluate(specification, samples)
    return Loop(found.delay_borne, found.robot.names)


def on_stand(
    plant: Plant, robot: Robot, drive: Mapping[str, float], velocity: Velocity = "sampled"
) -> OnStand:
    """What the gains that the model brings bear.

    Args:
        plant: the robot.
        robot: the same, read.
        drive: parameters of the drives beside the gains, the control rate among them.
        velocity: that the controllers see, "sampled" or "differenced".

    Raises:
        UserError: as `jaxact.robot_margins.whole_robot.evaluate`, of the robot on a stand; or the
            posture has joints outside their ranges, and another keyframe has not.
    """
    stand = replace(plant, base="fixed")
    outside = _outside(stand)
    hidden = hidden_gains(robot)
    rubs = plant.friction == "moving" and friction.rubs(robot.model)
    of = functools.partial(loop, drive=drive, velocity=velocity)
    free, falls = _free(plant, of) if mounting.floats(robot) else (None, "")
    # What its joints carry is less on a stand than where it stands.
    scenes = [robots.scene(each) for each in ([stand] if free is None else [stand, plant])]
    along = {name: np.array([value]) for name, value in drive.items()}
    return OnStand(
        drive=dict(drive),
        as_it_is=of(stand),
        in_drive=of(replace(stand, damping="drive")) if hidden else None,
        hidden=hidden,
        stuck=of(replace(stand, friction="stuck")) if rubs else None,
        friction=friction.largest(robot.model),
        friction_unit=friction_unit(robot.model),
        outside=outside,
        edges=tuple(dict.fromkeys(line for scene in scenes for line in edges.said(scene, along))),
        weak=strength.overloaded(scenes[-1], along),
        free=free,
        falls=falls,
    )


def _outside(stand: Plant) -> tuple[str, ...]:
    """The joints outside their ranges, where no keyframe has them within."""
    scene = robots.scene(stand)
    outside = robots.at_stops(scene.robot, scene.posture.qpos)
    if outside and (names := robots.keyframes_within(scene.robot)):
        raise UserError(f"{robots.held_by_limits(outside)}; {robots.keyframe_advice(names)}")
    return outside


def friction_unit(model: mujoco.MjModel) -> str:
    """Of the dry friction of a model's joints and tendons: N m, N, or both."""
    kinds = model.jnt_type[model.dof_jntid[model.dof_frictionloss > 0.0]]
    slides = kinds == int(mujoco.mjtJoint.mjJNT_SLIDE)
    units = {"N" if slide else "N m" for slide in slides}
    units |= {"N"} if np.any(model.tendon_frictionloss > 0.0) else set()
    return " or ".join(sorted(units, reverse=True))


def _free(plant: Plant, of: Callable[[Plant], Loop]) -> tuple[Loop | None, str]:
    try:
        return of(plant), ""
    except UserError as error:
        return None, str(error)
