"""A few loops simulated with every step kept, beside the figures that a sweep gives of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxact import rollout
from jaxact.errors import UserError
from jaxact.programs import Program
from jaxact.rollout import Trajectory
from jaxact.sweep import execute, kernel, plans
from jaxact.sweep.kernel import Case
from jaxact.sweep.samples import Samples
from jaxact.sweep.specification import Specification

# Physics steps whose trajectory is kept; each is seven numbers a joint.
MOST_STEPS = 5_000_000


@dataclass(frozen=True)
class Joint:
    """A driven joint.

    name: of the joint
    rotary: it is measured in rad and N m instead of m and N
    """

    name: str
    rotary: bool


@dataclass(frozen=True)
class Single:
    """One loop and what it did.

    trajectory: NumPy arrays; time (steps,), all others (steps, joints)
    results: the variables of a sweep by name; figures of several joints are their worst
    values: every parameter of the loop by its short name
    joints: the driven ones
    """

    trajectory: Trajectory
    results: dict[str, float]
    values: dict[str, float]
    joints: tuple[Joint, ...]

    @property
    def rotary(self) -> tuple[bool, ...]:
        """Of each joint, whether it is measured in rad and N m."""
        return tuple(joint.rotary for joint in self.joints)


def simulate(specification: Specification) -> Single:
    """Simulate the nominal loop of a specification: its fixed values, whatever its axes vary.

    specification: checked

    Raises UserError as `jaxact.sweep.execute.run`, and for more steps than can be kept.
    """
    arrays = {name: np.array([value]) for name, value in specification.nominal.items()}
    return simulate_all(specification, Samples(arrays, ("loop",), (1,), {}))[0]


def simulate_all(specification: Specification, samples: Samples) -> list[Single]:
    """Simulate every sample and keep its trajectory; for a few loops, side by side.

    specification: checked
    samples: the loops

    The random draws of a trajectory are those of its figures, and those of the sample with that
    number in a sweep with this seed.

    Raises UserError as `jaxact.sweep.execute.run`, and for more steps than can be kept.
    """
    one = dataclasses.replace(specification, devices=1, tile=None)
    groups = plans.groups(one, samples)
    most = max(plan.case.rollout.ticks * plan.case.drive.substeps for plan in groups)
    if most * len(samples) > MOST_STEPS:
        raise UserError(
            f"duration = {specification.duration:g} s makes {most * len(samples):,} physics steps;"
            f" up to {MOST_STEPS:,} can be kept"
        )
    joints = _joints(one)
    results = execute.run(one, samples)
    found: dict[int, Single] = {}
    for plan in groups:
        members = np.concatenate([batch[:n] for batch, n in plans.batches(plan, samples)])
        values = samples.take(members)
        kept = _trajectories(specification, plan.case, values, members)
        for place, number in enumerate(members):
            found[int(number)] = Single(
                trajectory=jax.tree.map(lambda leaf, place=place: leaf[place], kept),
                results={name: float(array[number]) for name, array in results.items()},
                values={name: float(array[place]) for name, array in values.items()},
                joints=joints,
            )
    return [found[number] for number in range(len(samples))]


def _trajectories(
    specification: Specification, case: Case, values: dict[str, np.ndarray], numbers: np.ndarray
) -> Trajectory:
    """Trajectories with a leading axis for the loops, time (loops, steps)."""
    double = specification.precision == "float64"
    # Never one alone, as in `jaxact.sweep.execute`.
    twice = np.resize(np.arange(len(numbers)), max(2, len(numbers)))
    values = {name: array[twice] for name, array in values.items()}
    with jax.enable_x64(True) if double else nullcontext():
        kept = _simulated(specification, case, values, numbers[twice])
    rows = {
        name: getattr(kept, name).reshape((*kept.time.shape, -1))
        for name in Trajectory.__dataclass_fields__
        if name not in ("time", "configuration")
    }
    return Trajectory(time=kept.time, **rows, configuration=kept.configuration)


def _simulated(
    specification: Specification, case: Case, values: dict[str, np.ndarray], numbers: np.ndarray
) -> Trajectory:
    setting, seed = specification.setting, specification.seed
    if case.engine == "mujoco":
        from jaxact.sweep import outside  # imports MuJoCo

        return outside.trajectories(case, setting, values, seed, numbers)
    robot = setting.plant is not None

    def make() -> Callable[..., Trajectory]:
        template = kernel.template_of(case, setting, "metrics")

        def simulated(values: dict[str, jax.Array], number: jax.Array) -> Trajectory:
            prepared, state, setpoint = kernel.start(case, template, values)
            return rollout.follow(
                prepared,
                case.drive,
                case.rollout.ticks,
                state,
                setpoint,
                jax.random.fold_in(jax.random.key(seed), number),
                setpoints=kernel.setpoints(template, values, case.rollout.ticks),
                configuration=(lambda plant: plant.qpos) if robot else None,
            )

        return jax.vmap(simulated)

    dtype = jnp.result_type(float)
    inputs = {name: jnp.asarray(value, dtype) for name, value in values.items()}
    program = Program(make, None if case.engine == "warp" else ("follow", case, setting, seed))
    kept = program(inputs, jnp.asarray(numbers, jnp.uint32))
    return jax.tree.map(np.asarray, kept)


def names(specification: Specification) -> tuple[str, ...]:
    """Of the driven joints."""
    return tuple(joint.name for joint in _joints(specification))


def _joints(specification: Specification) -> tuple[Joint, ...]:
    """The driven joints; the mass and the built-in slide joint slide."""
    if specification.plant is None:
        return (Joint("joint", rotary=False),)
    import mujoco

    from jaxact.sweep import robots

    robot = robots.scene(specification.plant).robot
    hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
    kinds = [int(robot.model.jnt_type[joint.joint]) for joint in robot.joints]
    return tuple(
        Joint(joint.name, rotary=kind == hinge)
        for joint, kind in zip(robot.joints, kinds, strict=True)
    )
