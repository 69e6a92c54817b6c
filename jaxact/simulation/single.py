"""A few loops simulated with every step kept, beside the metrics that a sweep gives of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.compilation.programs import building
from jaxact.errors import UserError
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Setting, Specification
from jaxact.loops.template import Template
from jaxact.simulation import execute, kernel, plans, spectra, starts
from jaxact.simulation import metrics as _metrics
from jaxact.simulation import trajectory as _trajectory
from jaxact.simulation.falling import fall
from jaxact.simulation.kernel import Case
from jaxact.simulation.metrics import Metrics
from jaxact.simulation.starts import Outcomes
from jaxact.simulation.trajectory import Trajectory
from jaxact.status import Verdict

# Physics steps whose trajectory is kept; each is seven numbers a joint.
MOST_STEPS = 5_000_000

_NAMES = tuple(Metrics.__dataclass_fields__)


@dataclass(frozen=True)
class Joint:
    """A driven joint.

    Attributes:
        name: of the joint.
        rotary: it is measured in rad and N m instead of m and N.
    """

    name: str
    rotary: bool


@dataclass(frozen=True)
class Start:
    """What came of one start of a loop.

    Attributes:
        name: empty of the loop's own, else as in `jaxact.simulation.starts`.
        verdict: of that start alone.
        moving: it still moved at the end, and went on.
        resting: it had come to rest; what neither moves nor rests decays.
        amplitude, frequency: of that motion [m or rad], [rad/s].
        narrowing, widening: it was still getting smaller, or wider.
        joint: number of the joint whose motion that is, the one that moves most.
    """

    name: str
    verdict: Verdict
    moving: bool
    resting: bool
    amplitude: float
    frequency: float
    narrowing: bool = False
    widening: bool = False
    joint: int = 0


@dataclass(frozen=True)
class Single:
    """One loop and what it did.

    Attributes:
        trajectory: NumPy arrays; time (steps,), all others (steps, joints).
        results: the variables of a sweep by name; metrics of several joints are their worst.
        values: every parameter of the loop by its short name.
        joints: the driven ones.
        starts: from which it was judged, its own first.
        limited: some loop simulated beside it, or itself, has a limit of its force or its rate.
        told: its setpoints move on, so that its own start is judged by the growth rate.
    """

    trajectory: Trajectory
    results: dict[str, float]
    values: dict[str, float]
    joints: tuple[Joint, ...]
    starts: tuple[Start, ...]
    limited: bool = False
    told: bool = False

    @property
    def rotary(self) -> tuple[bool, ...]:
        """Of each joint, whether it is measured in rad and N m."""
        return tuple(joint.rotary for joint in self.joints)


def simulate(specification: Specification) -> Single:
    """Simulate the nominal loop of a specification: its fixed values, whatever its axes vary.

    Args:
        specification: checked.

    Raises:
        UserError: as `jaxact.simulation.execute.run`, and for more steps than can be kept.
    """
    arrays = {name: np.array([value]) for name, value in specification.nominal.items()}
    return simulate_all(specification, Samples(arrays, ("loop",), (1,), {}))[0]


def simulate_all(specification: Specification, samples: Samples) -> list[Single]:
    """Simulate every sample and keep its trajectory; for a few loops, side by side.

    Args:
        specification: checked.
        samples: the loops.

    Raises:
        UserError: as `jaxact.simulation.execute.run`, and for more steps than can be kept.
    """
    groups = _groups(specification, samples)
    most = max(plan.case.rollout.ticks * plan.case.drive.substeps for plan in groups)
    if most * len(samples) > MOST_STEPS:
        raise UserError(
            f"duration = {specification.duration:g} s makes {most * len(samples):,} physics steps;"
            f" up to {MOST_STEPS:,} can be kept"
        )
    found = dict(each(specification, samples))
    return [found[number] for number in range(len(samples))]


def _groups(specification: Specification, samples: Samples) -> list[plans.Plan]:
    one = dataclasses.replace(specification, devices=1, tile=None)
    return plans.groups(one, samples, alone=True)


def each(
    specification: Specification, samples: Samples, *, starts: bool = True
) -> Iterator[tuple[int, Single]]:
    """Simulate sample by sample, in batches of about a second of work.

    The random draws of a trajectory are those of its metrics, and those of the sample with that
    number in a sweep with this seed.

    Args:
        specification: checked.
        samples: the loops.
        starts: whether they are judged from other starts, too.

    Yields:
        The number of a sample and what it did, in no particular order.

    Raises:
        UserError: as `jaxact.simulation.execute.run`.
    """
    joints = _joints(specification)
    for plan in _groups(specification, samples):
        case = plan.case if starts else dataclasses.replace(plan.case, starts=())
        for batch, count in plans.batches(plan, samples):
            rates = spectra.rates_batch(plan, specification, samples, batch)
            values = samples.take(batch)
            numbers = samples.first + batch
            row, kept, judged = _followed(specification, case, values, rates.growth, numbers)
            rows = {name: np.asarray(getattr(row, name)) for name in _NAMES}
            if not plans.steps_only(specification):
                rows = execute.without_step(rows)
            rows = execute.with_rates(rows, rates)
            for place, number in enumerate(batch[:count].tolist()):
                yield (
                    number,
                    Single(
                        trajectory=jax.tree.map(lambda leaf, place=place: leaf[place], kept),
                        results={name: float(row[place]) for name, row in rows.items()},
                        values={name: float(array[place]) for name, array in values.items()},
                        joints=joints,
                        starts=_started(case, judged, place),
                        limited=not case.drive.unlimited,
                        told=not plans.steps_only(specification),
                    ),
                )


def _started(case: Case, judged: Outcomes, place: int) -> tuple[Start, ...]:
    """What came of each start of the loop at this place of a batch."""
    names = ("", *(name for name in case.starts if name != starts.LINEAR))
    return tuple(
        Start(
            name=name,
            verdict=Verdict(int(judged.verdict[place, row])),
            moving=bool(judged.moving[place, row]),
            resting=bool(judged.resting[place, row]),
            amplitude=float(judged.amplitude[place, row]),
            frequency=float(judged.frequency[place, row]),
            narrowing=bool(judged.narrowing[place, row]),
            widening=bool(judged.widening[place, row]),
            joint=0 if judged.joint is None else int(judged.joint[place, row]),
        )
        for row, name in enumerate(names)
    )


def _followed(
    specification: Specification,
    case: Case,
    values: dict[str, np.ndarray],
    growth: np.ndarray,
    numbers: np.ndarray,
) -> tuple[Metrics, Trajectory, Outcomes]:
    """Metrics, trajectories, time (loops, steps), and starts (loops, starts) of some samples.

    Args:
        growth: their growth rates [1/s].
    """
    loops = specification.setting, values, growth, specification.seed, numbers
    double = specification.precision == "float64"
    with jax.enable_x64(True) if double else nullcontext():
        if not case.engine.in_jax:
            from jaxact.simulation import mujoco_batch  # imports MuJoCo

            found, kept, judged = mujoco_batch.followed(case, *loops)
        else:
            found, kept, judged = _in_jax(case, *loops)
    rows = {
        name: getattr(kept, name).reshape((*kept.time.shape, -1))
        for name in Trajectory.__dataclass_fields__
        if name not in ("time", "configuration")
    }
    trajectory = Trajectory(time=kept.time, **rows, configuration=kept.configuration)
    return found, trajectory, jax.tree.map(np.asarray, judged)


def _in_jax(
    case: Case,
    setting: Setting,
    values: dict[str, np.ndarray],
    growth: np.ndarray,
    seed: int,
    numbers: np.ndarray,
) -> tuple[Metrics, Trajectory, Outcomes]:
    """The counterpart of `jaxact.simulation.mujoco_batch.followed` for plants in JAX."""

    dtype = jnp.result_type(float)
    inputs = {name: jnp.asarray(value, dtype) for name, value in values.items()}
    setting, push = kernel.split_push(setting, dtype)
    loops = inputs, jnp.asarray(growth, dtype), np.uint32(seed), jnp.asarray(numbers, jnp.uint32)
    # A model of MJX is where JAX has put it.
    where = {"devices": 1} if case.engine.impl else {}
    return jax.tree.map(np.asarray, _all(push, *loops, case=case, setting=setting, **where))


@building
def _all(
    *, case: Case, setting: Setting, devices: int = 1
) -> Callable[..., tuple[Metrics, Trajectory, Outcomes]]:
    del devices
    template = kernel.template_of(case, setting, "metrics")

    def one(shared, values, *loop):
        return _one(case, template, {**shared, **values}, *loop)

    return jax.vmap(one, in_axes=(None, 0, 0, None, 0))


def _one(
    case: Case,
    template: Template,
    values: Mapping[str, jax.Array],
    growth_rate: jax.Array,
    seed: jax.Array,
    number: jax.Array,
) -> tuple[Metrics, Trajectory, Outcomes]:
    """What `jaxact.simulation.kernel.metrics` gives, the trajectory, and what came of each start.

    Arguments as there. The starts are the loop's own and `Case.starts`, without that for noise, the
    worst over the joints: shape (starts,).
    """
    key = jax.random.fold_in(jax.random.key(seed), number)
    prepared, state, setpoint = kernel.start(case, template, values)
    moving = kernel.setpoints(template, values, case.rollout.ticks)
    begin, _ = prepared.plant.measure(state.plant)
    growth_rate = growth_rate.astype(begin.dtype)
    others, rest, rubs = kernel.other_starts(case, template, values, growth_rate, key)
    trajectory, outputs, end = _trajectory.follow(
        prepared,
        case.drive,
        case.rollout.ticks,
        state,
        setpoint,
        key,
        setpoints=moving,
        configuration=None if template.scene is None else lambda plant: plant.qpos,
    )
    result, own = _trajectory.metrics_of(
        outputs,
        begin,
        setpoint,
        growth_rate,
        prepared=prepared,
        options=case.drive,
        linear_plant=case.rollout.linear_plant,
        active_ticks=kernel.active_ticks(case, values),
        setpoints=moving,
        rest_amplitude=rest,
        rubs=rubs,
        others=others,
        fell=fall(template.bases, state.plant, end.plant, told=moving is not None),
    )
    return _metrics.worst(result), trajectory, starts.listed(own, others)


def names(specification: Specification) -> tuple[str, ...]:
    """Of the driven joints."""
    return tuple(joint.name for joint in _joints(specification))


def _joints(specification: Specification) -> tuple[Joint, ...]:
    """The driven joints; a single one slides unless it is said to be rotary."""
    if specification.plant is None:
        return (Joint("joint", rotary=specification.unit == "rad"),)
    import mujoco

    from jaxact.loops import robots

    robot = robots.scene(specification.plant).robot
    hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
    kinds = [int(robot.model.jnt_type[joint.joint]) for joint in robot.joints]
    return tuple(
        Joint(joint.name, rotary=kind == hinge)
        for joint, kind in zip(robot.joints, kinds, strict=True)
    )
