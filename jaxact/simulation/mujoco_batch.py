"""Samples of a robot whose physics runs in C MuJoCo: one batch of a sweep.

The counterpart of `jaxact.simulation.kernel` for the engine "mujoco"; parameters, drive and metrics
are the same code.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.compilation.programs import Program, building
from jaxact.drive import step as _drive
from jaxact.drive.controller import Setpoint
from jaxact.drive.step import Coefficients
from jaxact.engines import MUJOCO
from jaxact.loops import bodies, joint_ranges
from jaxact.loops.conversion import drive_of
from jaxact.loops.robots import Scene
from jaxact.loops.specification import Setting
from jaxact.loops.template import Template
from jaxact.parameters import (
    CONTACT_FRICTION,
    CONTROL_RATE,
    INITIAL_POSITION,
    INITIAL_VELOCITY,
    KP,
    PAYLOAD,
    SETPOINT,
    base,
)
from jaxact.plants import softness, variation
from jaxact.plants.mujoco import Impulse, JointPush, Simulations
from jaxact.plants.variation import Variation
from jaxact.simulation import batch_rollout, kernel
from jaxact.simulation import metrics as _metrics
from jaxact.simulation import starts as _starts
from jaxact.simulation.batch_rollout import BatchState
from jaxact.simulation.kernel import Case
from jaxact.simulation.metrics import Metrics
from jaxact.simulation.rollout import RolloutOptions
from jaxact.simulation.starts import Outcomes
from jaxact.simulation.trajectory import Trajectory
from jaxact.simulation.verdicts import Judgement

Observer = Callable[[int, BatchState, jax.Array], None]


@functools.lru_cache(maxsize=4)
def template(case: Case, setting: Setting) -> Template:
    """What the samples share; it holds no JAX arrays, so any precision may use it."""
    return kernel.template_of(replace(case, engine=MUJOCO), setting, "metrics")


def at_joints(case: Case, setting: Setting, values: Mapping[str, np.ndarray], name: str):
    """A change of the model for every sample and joint, shape (n, joints)."""
    made = template(case, setting)
    joints = len(made.scene.labels) if made.scene is not None else 1
    found = np.repeat(np.asarray(values[name], float)[:, None], joints, axis=1)
    for key, which in made.masks.items():  # in order, the last that matches counts
        if base(key) == name:
            mine = np.asarray(values[key], float)[:, None]
            found = np.where(which & ~np.isnan(mine), mine, found)
    return found


def changed(case: Case, scene: Scene, row: np.ndarray) -> Any:
    """A copy of the robot's model with the changes of one sample, shape (varied, joints)."""
    model = copy.copy(scene.robot.model)
    for field, value in _fields(case, scene, row).items():
        getattr(model, field)[:] = value
    return model


def _fields(case: Case, scene: Scene, row: np.ndarray) -> dict[str, np.ndarray]:
    """The model's fields that a sample's changes replace."""
    given = {
        name: values[0] if name in (PAYLOAD, CONTACT_FRICTION) else values
        for name, values in zip(case.varied, row, strict=True)
    }
    joints, model = scene.robot.joints, scene.robot.model
    with jax.enable_x64(True):
        fields = _changed(
            {name: getattr(model, name) for name in variation.FIELDS},
            given,
            dofs=tuple(joint.dof for joint in joints),
            bodies=tuple(joint.body for joint in joints),
            payload_body=scene.payload_body,
            body_parentid=tuple(model.body_parentid.tolist()),
            dof_jntid=tuple(model.dof_jntid.tolist()),
        )
    arrays = {name: np.asarray(value) for name, value in fields.items()}
    if not softness.DEPENDS.intersection(arrays):
        return arrays
    changed = copy.copy(scene.robot.model)
    for name, value in arrays.items():
        getattr(changed, name)[:] = value
    return arrays | softness.compiled(scene.robot.model, changed)


@Program
def _changed(fields: dict[str, jax.Array], given: dict[str, jax.Array], **static: Any):
    """What `jaxact.plants.variation.changed` gives of a model's fields, in one call."""
    places = {name: np.array(static.pop(name)) for name in ("body_parentid", "dof_jntid")}
    return variation.changed(SimpleNamespace(**fields, **places), Variation(**given), **static)


def metrics(
    case: Case,
    setting: Setting,
    values: Mapping[str, np.ndarray],
    growth_rate: np.ndarray,
    seed: int,
    numbers: np.ndarray,
    *,
    watch: Callable[[Simulations, Coefficients], Observer] | None = None,
    push: JointPush | None = None,
) -> Metrics:
    """Metrics of a batch of samples; see `jaxact.simulation.kernel.metrics`, which does one.

    Args:
        case, setting: static.
        values: of the samples, shape (n,) each.
        growth_rate: [1/s], shape (n,).
        seed: of the sweep.
        numbers: of the samples, shape (n,); one that occurs several times is simulated once.
        watch: makes the observer that `jaxact.simulation.batch_rollout.evaluate` calls at every
        physics step.
        push: on the joints, beside what the specification asks for.
    """
    loops = values, growth_rate, seed, numbers
    found, _ = _judged(case, setting, *loops, watch=watch, push=push)
    return _metrics.worst(found)


def _judged(
    case: Case,
    setting: Setting,
    values: Mapping[str, np.ndarray],
    growth_rate: np.ndarray,
    seed: int,
    numbers: np.ndarray,
    *,
    watch: Callable[[Simulations, Coefficients], Observer] | None = None,
    push: JointPush | None = None,
) -> tuple[Metrics, Judgement]:
    """Metrics (n, joints), and what came of each start, the own one first, (n, starts, joints)."""
    loops = values, growth_rate, seed, numbers
    quiet = replace(setting, motion=None)
    each = [_rolled(case, quiet, *loops, start=name)[1] for name in case.starts]
    others = jax.tree.map(lambda *rows: jnp.stack(rows, axis=1), *each) if each else None
    found, own = _rolled(case, setting, *loops, watch=watch, push=push, others=others)
    own = jax.tree.map(lambda leaf: leaf[:, None], own)
    if others is None:
        return found, own
    return found, jax.tree.map(lambda *rows: jnp.concatenate(rows, axis=1), own, others)


def _rolled(
    case: Case,
    setting: Setting,
    values: Mapping[str, np.ndarray],
    growth_rate: np.ndarray,
    seed: int,
    numbers: np.ndarray,
    *,
    start: str = "",
    watch: Callable[[Simulations, Coefficients], Observer] | None = None,
    push: JointPush | None = None,
    others: Judgement | None = None,
) -> tuple[Metrics, Judgement]:
    """A batch of rollouts from one start, by default the samples' own; see `_judged`."""
    made = template(case, setting)
    scene = made.scene
    assert scene is not None
    dtype = jnp.result_type(float)
    arrays = {name: jnp.asarray(value, dtype) for name, value in values.items()}
    loops = arrays, np.uint32(seed), jnp.asarray(numbers, jnp.uint32)
    prepared = _prepare(*loops, **_beginning(case, setting, start))
    fields = {}
    if case.varied:
        rows = np.stack([at_joints(case, setting, values, name) for name in case.varied], axis=1)
        each = [_fields(case, scene, row) for row in rows]
        fields = {name: np.stack([one[name] for one in each]) for name in each[0]}
    simulations = Simulations(
        scene.robot,
        scene.posture,
        case.step,
        len(numbers),
        same=numbers,  # a batch is filled up with one of its samples
        fields=fields,
        impulse=_impulse(setting, scene),
        push=push,
        corrected=setting.corrected,
    )
    coefficients, state, begun, setpoint, setpoints, keys, rest, rubs = prepared
    active = np.ceil(case.duration * np.asarray(values[CONTROL_RATE], float) - 1e-4)
    return batch_rollout.evaluate(
        simulations,
        coefficients,
        case.drive,
        case.rollout.ticks,
        state,
        (np.asarray(begun[0], float), np.asarray(begun[1], float)),
        setpoint,
        jnp.asarray(growth_rate, dtype),
        keys,
        active_ticks=jnp.asarray(active, dtype),
        masked=case.masked,
        rest_amplitude=rest,
        rubs=rubs,
        setpoints=setpoints,
        observe=None if watch is None else watch(simulations, coefficients),
        others=others,
        bases=made.bases,
    )


def _impulse(setting: Setting, scene: Scene) -> Impulse | None:
    push = setting.push
    if push is None:
        return None
    number = bodies.pushed(scene.robot, push.body)
    return Impulse(number, np.array(push.force), push.time, push.duration)


def _beginning(case: Case, setting: Setting, start: str) -> dict[str, Any]:
    """What the beginning of a batch depends on: the drive, the robot, and how it is moved."""
    ticks = case.rollout.ticks if setting.motion is not None else 0
    begun = Case(
        MUJOCO, case.drive, RolloutOptions(ticks), False, 0.0, case.model, step=case.step,
        starts=(start,) if start else (),
    )  # fmt: skip
    return {"case": begun, "setting": replace(setting, push=None)}


@building
def _prepare(*, case: Case, setting: Setting) -> Callable:
    """The function that makes everything a batch starts from out of its parameters."""
    made = template(case, setting)

    def one(values: Mapping[str, jax.Array], seed: jax.Array, number: jax.Array):
        resolved = kernel.resolved(made, values)
        drive = drive_of(resolved)
        trembling = _starts.rest_amplitude(case.drive, resolved, drive, robot=True)
        if case.starts:
            given = _starts.given(case.starts, resolved, drive, _starts.friction(made))
            resolved = {**resolved, **{name: row[0] for name, row in given.items()}}
        rest = jnp.asarray(made.position, values[KP].dtype)
        force = jnp.asarray(made.force, rest.dtype)
        coefficients = _drive.prepare(drive, case.drive, rest.shape)
        position = rest + resolved[INITIAL_POSITION]
        velocity = jnp.broadcast_to(resolved[INITIAL_VELOCITY], rest.shape)
        zero = jnp.zeros_like(rest)
        state = _drive.init(
            coefficients, case.drive, position, velocity, command=force,
            setpoint=Setpoint(position, zero, force),
        )  # fmt: skip
        asked = joint_ranges.within(resolved, rest + resolved[SETPOINT])
        setpoint = Setpoint(asked, zero, force)
        return (
            coefficients,
            state,
            (position, velocity),
            setpoint,
            kernel.setpoints(made, values, case.rollout.ticks),
            jax.random.fold_in(jax.random.key(seed), number),
            jnp.broadcast_to(trembling, rest.shape),
            _starts.rubs(made, resolved),
        )

    return jax.vmap(one, in_axes=(0, None, 0))


def followed(
    case: Case,
    setting: Setting,
    values: Mapping[str, np.ndarray],
    growth_rate: np.ndarray,
    seed: int,
    numbers: np.ndarray,
    push: JointPush | None = None,
) -> tuple[Metrics, Trajectory, Outcomes]:
    """Metrics of a few samples, and every physics step; see `jaxact.simulation.trajectory.follow`.

    Args:
        case, setting, values, growth_rate, seed, numbers, push: as for `metrics`.

    Returns:
        The metrics; NumPy arrays with a leading axis for the loops, the configuration at every
        control tick; and what came of each start, as `jaxact.simulation.single` has it.
    """
    rows: list[tuple[np.ndarray, ...]] = []
    configurations: list[np.ndarray] = []

    def watch(simulations: Simulations, coefficients: Coefficients) -> Observer:
        older_share = np.asarray(coefficients.older_share)

        def observe(place: int, state: BatchState, force: jax.Array) -> None:
            position, velocity = np.moveaxis(simulations.measure(), 1, 0)
            share = older_share[:, place]
            older, newer = np.asarray(state.drive.older), np.asarray(state.drive.newer)
            with np.errstate(invalid="ignore", over="ignore"):  # of a loop that has diverged
                delayed = share * older + (1.0 - share) * newer
            # Copies, as these are views of everything that the loops carry.
            slow = state.drive.held  # by a policy
            given = state.setpoint if slow is None else slow.setpoint
            held = np.array(given.position), np.array(state.command)
            rows.append((held[0], position, velocity, held[1], delayed, np.asarray(force)))
            if place == 0:
                configurations.append(simulations.configuration())

        return observe

    found, judged = _judged(
        case, setting, values, growth_rate, seed, numbers, watch=watch, push=push
    )
    names = (SETPOINT, "position", "velocity", "command", "delayed_command", "force")
    columns = zip(names, zip(*rows, strict=True), strict=True)
    arrays: dict[str, Any] = {name: np.stack(column, axis=1) for name, column in columns}
    arrays["time"] = np.broadcast_to(case.step * np.arange(len(rows)), (len(numbers), len(rows)))
    arrays["configuration"] = np.stack(configurations, axis=1)
    return _metrics.worst(found), Trajectory(**arrays), _starts.of_joints(judged)
