"""The margins of a robot as a specification describes it, its samples one by one."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from jaxact.analysis.robot.delay import DelayBorne, delay_borne
from jaxact.analysis.robot.margins import RobotMargins, robot_margins
from jaxact.analysis.robot.modes import Robot
from jaxact.analysis.robot.multiloop import Curves, Matrices, curves, multiloop
from jaxact.engines import MUJOCO
from jaxact.loops import robots
from jaxact.loops.robots import Scene
from jaxact.loops.samples import Samples, expand
from jaxact.loops.specification import Setting, Specification
from jaxact.loops.template import Template
from jaxact.parameters import CONTROL_RATE, JOINT_FRICTION, OF_PLANT, PARAMETERS, base
from jaxact.robot_margins import stiction
from jaxact.robot_margins.stiction import Stiction
from jaxact.robots import friction, mounting
from jaxact.robots.rest import Rest
from jaxact.simulation import changed_models, kernel, plans, robot_loop
from jaxact.simulation.kernel import Case
from jaxact.simulation.plans import Plan


@dataclass(frozen=True)
class WholeRobot:
    """A robot's linearised loop with the parameters of one sample, and its margins.

    Attributes:
        robot: the loop.
        kp, kd: gains of the joints, shape (joints,) each.
        case: static options.
        nominal_residual: largest acceleration left at the posture of the robot as its model has it
            [rad/s^2 or m/s^2].
        left_out: largest dry friction that the linearised robot does without [N or N m], 0 if none.
        neutral: number of rigid-body modes, in which a displaced robot stays where it is; left out.
        physics_step: [s].
        engine: that the plant was linearised in, "mujoco" or "mjx".
        specification: of the robot.
        values: parameters of the sample by key.
    """

    robot: Robot
    kp: np.ndarray
    kd: np.ndarray
    case: Case
    nominal_residual: float
    left_out: float
    neutral: int
    physics_step: float
    engine: str
    specification: Specification
    values: Mapping[str, float]

    @functools.cached_property
    def margins(self) -> RobotMargins:
        """All of them, computed when they are first asked for."""
        return robot_margins(self.robot)

    @functools.cached_property
    def rest(self) -> Rest | None:
        """Where it rests with the changes of its model; None where it has none."""
        return rest(self.case, self.specification.setting, self.values)

    @property
    def leaves(self) -> str:
        """Why it does not rest with the changes of its model, in words; "" where it does."""
        moved = set(changed_models.STATIC).intersection(self.case.varied)
        return self.rest.leaves if moved and self.rest is not None else ""

    @property
    def residual(self) -> float:
        """Largest acceleration where it is linearised [rad/s^2 or m/s^2]; 0 at an equilibrium."""
        return self.nominal_residual if self.rest is None else self.rest.posture.residual

    @functools.cached_property
    def delay_borne(self) -> DelayBorne:
        """The delay margin by itself, which takes a part of the time."""
        return delay_borne(self.robot)

    @property
    def floating(self) -> bool:
        """Whether its base moves."""
        assert self.specification.plant is not None
        return mounting.floats(robots.scene(self.specification.plant).robot)

    @functools.cached_property
    def stiction(self) -> Stiction | None:
        """What dry friction holds that would shake once it moves, by simulation."""
        return stiction.held(self.specification, self.values, self.robot, self.margins)

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
    samples = expand(specification) if samples is None else samples
    found: dict[int, WholeRobot] = {}
    for number, case, template, values, own in linearised(specification, samples):
        found[number] = one(case, specification, template, values, own)
    return [found[number] for number in range(len(samples))]


Moved = tuple[np.ndarray, np.ndarray]


def linearised(
    specification: Specification,
    samples: Samples,
    chosen: np.ndarray | None = None,
    groups: Sequence[Plan] | None = None,
) -> Iterator[tuple[int, Case, Template, dict[str, float], Moved | None]]:
    """Every sample with what its linear loop is made of.

    Args:
        specification: of the robot.
        samples: of it.
        chosen: numbers of those that are wanted, rising; None for all.
        groups: of all samples, from `jaxact.simulation.plans.groups`, where they are known.

    Yields:
        The sample's number, static options, what its group shares, its parameters by key, and A and
        B of its plant where models differ from sample to sample; see `kernel.linear_loop`.

    Raises:
        UserError: as `evaluate`.
    """
    for plan in plans.groups(specification, samples) if groups is None else groups:
        parts = [batch[:n] for batch, n in plans.batches(plan, samples, chosen)]
        if not parts:
            continue
        numbers = np.concatenate(parts)
        setting, rows, moved = specification.setting, samples.take(numbers), None
        if plan.case.varied:
            moved = changed_models.moved(plan.case, setting, rows)
        case, setting = kernel.linear_part(plan.case, setting)
        template = robot_loop.template(case, setting)
        for place, number in enumerate(numbers):
            values = {name: float(row[place]) for name, row in rows.items()}
            own = None if moved is None else (moved[0][place], moved[1][place])
            yield int(number), case, template, values, own


def nominal(specification: Specification) -> WholeRobot:
    """The margins of the nominal loop of a specification with a [plant], as `evaluate`."""
    along = {name: np.array([value]) for name, value in specification.nominal.items()}
    return evaluate(specification, Samples(along, ("loop",), (1,), {}))[0]


def rest(case: Case, setting: Setting, values: Mapping[str, float]) -> Rest | None:
    """Where a sample rests with the changes of its model; None where it has none.

    Args:
        case, setting: static.
        values: parameters of the sample by key.
    """
    if not case.varied:
        return None
    along = {name: np.array([value]) for name, value in values.items()}
    return changed_models.rests(case, setting, along)[0]


def changed(specification: Specification) -> bool:
    """Whether the nominal loop of a robot has a changed model."""
    nominal = specification.nominal
    return any(
        base(name) in OF_PLANT and not nominal[name] == PARAMETERS[base(name)].default
        for name in nominal
    )  # fmt: skip


def _left_out(setting: Setting, scene: Scene, values: dict[str, float]) -> float:
    """Dry friction that is not in the linear plant [N or N m]; see `jaxact.robots.friction`."""
    if setting.plant is None or setting.plant.friction == "stuck":
        return 0.0
    added = [value for key, value in values.items() if key.partition("@")[0] == JOINT_FRICTION]
    return friction.largest(scene.robot.model) + float(np.max(np.nan_to_num(added), initial=0.0))


def computing(
    case: Case, specification: Specification, values: Mapping[str, float], moved: Moved | None
) -> Callable[[float], Any]:
    """A function from an extra delay of all commands [s] to what `robot_loop.matrices` returns.

    Args:
        case, values, moved: of the sample, from `linearised`.
        specification: of the robot.
    """
    _, setting = kernel.linear_part(case, specification.setting)
    with jax.enable_x64(True):
        inputs = {name: np.asarray(value, float) for name, value in values.items()}
        own = None if moved is None else tuple(np.asarray(part, float) for part in moved)
        run = robot_loop.matrices.compiled(inputs, own, np.zeros(()), case=case, setting=setting)

    def computed(extra: float) -> Any:
        with jax.enable_x64(True):
            return jax.tree.map(np.asarray, run(inputs, own, np.asarray(extra)))

    return computed


def one(
    case: Case, specification: Specification, template: Template, values: dict[str, float],
    moved: Moved | None,
) -> WholeRobot:  # fmt: skip
    """A sample's loop; its margins are computed once they are asked for.

    Args:
        specification: of the robot.
        case, template, values, moved: of the sample, from `linearised`.
    """
    setting = specification.setting
    computed = computing(case, specification, values, moved)

    # Newton's method asks for the same delay at several frequencies.
    @functools.lru_cache(maxsize=8)
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
        case=case,
        nominal_residual=template.residual,
        left_out=_left_out(setting, scene, values),
        neutral=basis.shape[0] - basis.shape[1],
        physics_step=case.step,
        engine=(case.engine if case.engine.differentiable else MUJOCO).name,
        specification=specification,
        values=values,
    )
