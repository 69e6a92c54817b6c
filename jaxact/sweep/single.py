"""A few loops simulated with every step kept, beside the figures that a sweep gives of them."""

from __future__ import annotations

import dataclasses
from contextlib import nullcontext
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxact import rollout
from jaxact.controller import Setpoint
from jaxact.errors import UserError
from jaxact.rollout import Trajectory
from jaxact.sweep import execute, kernel
from jaxact.sweep.kernel import Case
from jaxact.sweep.samples import Samples
from jaxact.sweep.specification import Specification

# Physics steps whose trajectory is kept; each is seven numbers a joint.
MOST_STEPS = 5_000_000


@dataclass(frozen=True)
class Single:
    """One loop and what it did.

    trajectory: NumPy arrays; time (steps,), all others (steps, joints)
    results: the variables of a sweep by name; figures of several joints are their worst
    values: every parameter of the loop by its short name
    rotary: of each joint, whether it is measured in rad and N m instead of m and N
    """

    trajectory: Trajectory
    results: dict[str, float]
    values: dict[str, float]
    rotary: tuple[bool, ...]


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
    plans = execute.plans(one, samples)
    most = max(plan.case.rollout.ticks * plan.case.drive.substeps for plan in plans)
    if most * len(samples) > MOST_STEPS:
        raise UserError(
            f"duration = {specification.duration:g} s makes {most * len(samples):,} physics steps;"
            f" up to {MOST_STEPS:,} can be kept"
        )
    results = execute.run(one, samples)
    found: dict[int, Single] = {}
    for plan in plans:
        members = np.arange(len(samples)) if plan.members is None else plan.members
        values = {name: array[members] for name, array in samples.values.items()}
        kept, rotary = _trajectories(specification, plan.case, values, members)
        for place, number in enumerate(members):
            found[int(number)] = Single(
                trajectory=jax.tree.map(lambda leaf, place=place: leaf[place], kept),
                results={name: float(array[number]) for name, array in results.items()},
                values={name: float(array[place]) for name, array in values.items()},
                rotary=rotary,
            )
    return [found[number] for number in range(len(samples))]


def _trajectories(
    specification: Specification, case: Case, values: dict[str, np.ndarray], numbers: np.ndarray
) -> tuple[Trajectory, tuple[bool, ...]]:
    """Trajectories with a leading axis for the loops, time (loops, steps); which joints turn."""
    double = specification.precision == "float64"
    with jax.enable_x64(True) if double else nullcontext():
        dtype = np.float64 if double else np.float32
        template = kernel.plant_template(specification.engine, specification.model)

        def simulated(values: dict[str, jax.Array], number: jax.Array) -> Trajectory:
            return rollout.trajectory(
                kernel.loop_of(values, template, own_mass=case.own_mass),
                case.drive,
                case.rollout.ticks,
                Setpoint(values["setpoint"]),
                jax.random.fold_in(jax.random.key(specification.seed), number),
                position=values["initial_position"],
                velocity=values["initial_velocity"],
            )

        inputs = {name: jnp.asarray(value, dtype) for name, value in values.items()}
        kept = jax.jit(jax.vmap(simulated))(inputs, jnp.asarray(numbers, jnp.uint32))
        kept = jax.tree.map(np.asarray, kept)
    rows = {
        name: getattr(kept, name).reshape((*kept.time.shape, -1))
        for name in Trajectory.__dataclass_fields__
        if name != "time"
    }
    return Trajectory(time=kept.time, **rows), _rotary(template)


def _rotary(template: object) -> tuple[bool, ...]:
    """Of each driven joint, whether it is a hinge; the mass slides."""
    if template is None:
        return (False,)
    import mujoco

    model = template.model  # type: ignore[attr-defined]
    joints = np.asarray(model.dof_jntid)[np.array(template.dofs)]  # type: ignore[attr-defined]
    return tuple(np.asarray(model.jnt_type)[joints] == int(mujoco.mjtJoint.mjJNT_HINGE))
