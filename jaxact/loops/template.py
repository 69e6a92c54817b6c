"""What the loops of one compiled kernel share: the plant before its parameters are known.

Everything here is static or constant; the values of a sample are put in by
`jaxact.simulation.kernel`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from jaxact.engines import Engine
from jaxact.loops.specification import Setting
from jaxact.parameters import JOINT_FRICTION
from jaxact.robots.base import Base

if TYPE_CHECKING:
    from jaxact.loops.robots import Scene
    from jaxact.plants.linear import LinearPlant
    from jaxact.plants.linearize import Linearisation


@dataclass(frozen=True)
class Template:
    """What the samples of a kernel share.

    Attributes:
        plant: a loaded MJX plant, None for the mass.
        linear: the plant linearised at its posture in float64, for growth rates; None where the
            plant itself serves.
        basis: of the linear plant in the plant's own coordinates, shape (n, kept).
        residual: largest acceleration at the linearised posture [rad/s^2 or m/s^2].
        position: of the driven joints at rest [m or rad], shape (joints,), or 0.
        force: of the driven joints at rest [N or N m], shape (joints,), or 0.
        defaults: parameters that the robot's model brings, shape (joints,) each.
        masks: which joints a key for some joints is meant for, shape (joints,) each.
        profile: setpoint over time as a share of its amplitude, shape (ticks,), or None for a step.
        track: setpoint over time that is added to the posture [m or rad], (ticks, joints), or None.
        scene: the robot, None for the built-in plants.
        bases: of a robot that may fall, from `jaxact.robots.standing.bases`.
    """

    plant: Any = None
    linear: LinearPlant | None = None
    basis: np.ndarray | None = None
    residual: float = 0.0
    position: np.ndarray | float = 0.0
    force: np.ndarray | float = 0.0
    defaults: Mapping[str, np.ndarray] = field(default_factory=dict)
    masks: Mapping[str, np.ndarray] = field(default_factory=dict)
    profile: np.ndarray | None = None
    track: np.ndarray | None = None
    scene: Scene | None = None
    bases: tuple[Base, ...] = ()


def built_in(engine: Engine, *, corrected: bool = False) -> Template:
    """The template of a built-in plant, in the precision that JAX has at this moment."""
    if not engine.impl:
        return Template()
    from jaxact.plants.mjx import plant as mjx  # imports MuJoCo, which the mass plant does not need

    return Template(plant=replace(mjx.load(), corrected=corrected))


def of_robot(
    setting: Setting,
    engine: Engine,
    *,
    varied: tuple[str, ...],
    step: float,
    period: float,
    ticks: int,
    growth: bool,
) -> Template:
    """The template of a robot, in the precision that JAX has at this moment.

    Args:
        setting: with a plant.
        engine: for robots.
        varied: changes of the model that differ between samples.
        step: physics step [s].
        period: control period [s].
        ticks: control periods.
        growth: the linear plant is wanted.

    Raises:
        UserError: the robot, or what is said of it, cannot be used.
    """
    from jaxact.loops import motions, robots
    from jaxact.robots import standing

    assert setting.plant is not None
    scene = robots.scene(setting.plant)
    bases = standing.bases(scene.robot, scene.posture.qpos)
    plant = found = None
    # What has no derivatives is linearised in C.
    if engine.impl and (engine.differentiable or not growth):
        plant = _placed(setting, scene, varied, engine.impl)
    # Where models differ, each is linearised in C, in the coordinates of the nominal one there.
    if growth:
        found = _linear(setting, scene, None if varied else plant, step)
    profile, track = motions.sampled(setting.motion, scene, period, ticks)
    return Template(
        plant=plant,
        linear=None if found is None else found.plant,
        basis=None if found is None else found.basis,
        residual=0.0 if found is None else found.residual,
        position=scene.positions,
        force=scene.posture.force,
        defaults=robots.brought(scene),
        masks={key: robots.matched(scene, key) for key in setting.keys},
        profile=profile,
        track=track,
        scene=scene,
        bases=bases,
    )


def _linear(setting: Setting, scene: Scene, plant: Any, step: float) -> Linearisation:
    """The robot linearised where it stands: by MJX if it has a plant there, else in C."""
    from jaxact.loops import robots
    from jaxact.plants import linearize

    moving = robots.linearised(scene, setting.plant)
    if plant is not None:
        if moving is not scene:
            plant = _placed(setting, moving, (), "jax")
        found = linearize.linearise(replace(plant, push=None), moving.posture.force, step)
        if found is not None:
            return found
    return linearize.linear_c(moving.robot, moving.posture, step, corrected=setting.corrected)


def _placed(setting: Setting, scene: Scene, varied: tuple[str, ...], impl: str) -> Any:
    """The MJX plant of a robot, its push included."""
    from jaxact.loops import bodies
    from jaxact.plants.mjx import plant as mjx

    plant = mjx.place(
        scene.robot,
        scene.posture,
        payload_body=scene.payload_body,
        dry_friction=JOINT_FRICTION in varied,
        impl=impl,
    )
    plant = replace(plant, corrected=setting.corrected)
    push = setting.push
    if push is None:
        return plant
    force = jnp.asarray(push.force)
    number = bodies.pushed(scene.robot, push.body)
    start, duration = jnp.asarray(push.time), jnp.asarray(push.duration)
    return replace(plant, push=mjx.Push(force, start, duration, number))
