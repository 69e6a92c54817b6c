"""The margins of a robot as a specification describes it, its samples one by one."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.analysis.robot.delay import DelayBorne, delay_borne
from jaxact.analysis.robot.margins import RobotMargins, robot_margins
from jaxact.analysis.robot.modes import Robot
from jaxact.analysis.robot.multiloop import Curves, Matrices, curves, multiloop
from jaxact.compilation.programs import building
from jaxact.drive.step import DriveOptions
from jaxact.loops.robots import Scene
from jaxact.loops.samples import Samples, expand
from jaxact.loops.specification import Setting, Specification
from jaxact.loops.template import Template
from jaxact.parameters import CONTROL_RATE, JOINT_FRICTION
from jaxact.plants.engines import MUJOCO
from jaxact.robots import friction, mounting
from jaxact.simulation import engines, kernel, mujoco_batch, plans, robot_loop
from jaxact.simulation.kernel import Case


@dataclass(frozen=True)
class WholeRobot:
    """A robot's linearised loop with the parameters of one sample, and its margins.

    Attributes:
        robot: the loop.
        kp, kd: gains of the joints, shape (joints,) each.
        residual: largest acceleration left at the posture [rad/s^2 or m/s^2]; 0 at an equilibrium.
        left_out: largest dry friction that the linearised robot does without [N or N m], 0 if none.
        neutral: number of rigid-body modes, in which a displaced robot stays where it is; left out.
        floating: whether its base moves.
        physics_step: [s].
        engine: that the plant was linearised in, "mujoco" or "mjx".
    """

    robot: Robot
    kp: np.ndarray
    kd: np.ndarray
    residual: float
    left_out: float
    neutral: int
    floating: bool
    physics_step: float
    engine: str

    @functools.cached_property
    def margins(self) -> RobotMargins:
        """All of them, computed when they are first asked for."""
        return robot_margins(self.robot)

    @functools.cached_property
    def delay_borne(self) -> DelayBorne:
        """The delay margin by itself, which takes a part of the time."""
        return delay_borne(self.robot)

    @property
    def curves(self) -> Curves:
        """Sensitivities over frequency."""
        return curves(multiloop(*self.robot.matrices, self.robot.period), self.robot.names)


def evaluate(specification: Specification, samples: Samples | None = None) -> list[WholeRobot]:
    """The margins of every sample of a specification with a [plant], or of others.

    Args:
        specification: of the robot.
        samples: loops to look at; None for the specification's own.

    Raises:
        UserError: as `jaxact.simulation.plans.groups`.
    """
    specification = engines.resolved(specification)
    samples = expand(specification) if samples is None else samples
    found: dict[int, WholeRobot] = {}
    for plan in plans.groups(specification, samples):
        numbers = np.concatenate([batch[:n] for batch, n in plans.batches(plan, samples)])
        case, setting = kernel.linear_part(plan.case, specification.setting)
        with jax.enable_x64(True):
            template = _template(case, setting)
        moved = mujoco_batch.moved(plan.case, specification.setting, samples.take(numbers))
        for place, number in enumerate(numbers):
            values = {
                name: float(row[0]) for name, row in samples.take(numbers[place, None]).items()
            }
            own = None if moved is None else tuple(part[place] for part in moved)
            found[int(number)] = _one(case, setting, template, values, own)
    return [found[number] for number in range(len(samples))]


def _options(case: Case) -> DriveOptions:
    """Lines with room for up to a period of delay more."""
    return replace(case.drive, command_slots=case.drive.command_slots + 2)


@functools.lru_cache(maxsize=8)
def _template(case: Case, setting: Setting) -> Template:
    """What the samples share, in float64."""
    return kernel.template_of(case, setting, "growth_rate")


@building
def _matrices(*, case: Case, setting: Setting) -> Callable:
    """From parameters and an extra delay to the loop's matrices, inertias, gains and delays."""
    template = _template(case, setting)
    options = _options(case)

    def matrices(values, moved, extra):
        loop = kernel.linear_loop(case, template, values, moved)
        found = robot_loop.period_map(robot_loop.with_later_commands(loop, extra), options)
        like = jnp.zeros(loop.plant.shape)
        gains, delay = loop.drive.controller, loop.drive.actuator.delay
        inertias = robot_loop.effective_inertias(loop.plant)
        return found, inertias, gains.kp + like, gains.kd + like, delay + like

    return matrices


def _left_out(setting: Setting, scene: Scene, values: dict[str, float]) -> float:
    """Dry friction that is not in the linear plant [N or N m]; see `jaxact.robots.friction`."""
    if setting.plant is None or setting.plant.friction == "stuck":
        return 0.0
    added = [value for key, value in values.items() if key.partition("@")[0] == JOINT_FRICTION]
    return friction.largest(scene.robot.model) + float(np.max(np.nan_to_num(added), initial=0.0))


def _one(
    case: Case, setting: Setting, template: Template, values: dict[str, float], moved
) -> WholeRobot:
    def computed(extra: float):
        with jax.enable_x64(True):
            inputs = {name: jnp.asarray(value, float) for name, value in values.items()}
            own = None if moved is None else tuple(jnp.asarray(part, float) for part in moved)
            loop = inputs, own, jnp.asarray(extra, float)
            return jax.tree.map(np.asarray, _matrices(*loop, case=case, setting=setting))

    def matrices(extra: float) -> Matrices:
        found = computed(extra)[0]
        return found.M, found.N, found.C

    found, inertias, kp, kd, delay = computed(0.0)
    scene, basis = template.scene, template.basis
    assert scene is not None and basis is not None
    robot = Robot(
        matrices=(found.M, found.N, found.C),
        positions=found.positions,
        velocities=found.velocities,
        inertias=inertias,
        names=scene.labels,
        period=1.0 / values[CONTROL_RATE],
        later_by=matrices,
        delay=float(delay.min()),
    )
    return WholeRobot(
        robot=robot,
        kp=kp,
        kd=kd,
        residual=template.residual,
        left_out=_left_out(setting, scene, values),
        neutral=basis.shape[0] - basis.shape[1],
        floating=mounting.floats(scene.robot),
        physics_step=case.step,
        engine=(case.engine if case.engine.differentiable else MUJOCO).name,
    )
