"""How well a robot tracks in nonlinear simulation, by the gains of the groups of its joints.

    tracking = mean of (q - r)^2,   effort = mean of u^2   over ticks, joints and members

with the drive's delays, noise and limits, contacts and a push, in MJX. x = (ln kp_1 ... ln kp_g,
ln kd_1 ... ln kd_g) are the log-gains of g groups. The function is differentiable forwards and
backwards (`jaxact.plants.mjx.smooth`); quantisation, which has no derivative, is left out. It is a
term beside the margins and no objective of its own: for a sluggish actuator the tracking error is
smaller at gains that are nearly unstable.

The rollout is cut into chunks of about the square root of its length. Backwards, only the states
between chunks are kept and a chunk at a time is computed again.

Source: Griewank & Walther, "Evaluating Derivatives", 2nd ed., chapter 12 (checkpointing).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.errors import UserError
from jaxact.loops import robots
from jaxact.loops.samples import explicit
from jaxact.loops.specification import Specification
from jaxact.loops.template import Template
from jaxact.plants.mjx.smooth import smooth
from jaxact.simulation import kernel, plans, rollout
from jaxact.simulation.kernel import Case
from jaxact.simulation.metrics import SEGMENTS
from jaxact.simulation.rollout import RolloutOptions
from jaxact.tuning.rollouts.validation import checked_members, with_gains

_QUANTISED = ("position_resolution", "velocity_resolution", "command_resolution")


@dataclass(frozen=True, eq=False)
class Term:
    """A robot's simulated tracking; n members, g groups.

    costs: from x of shape (2 g,) to tracking [rad^2] and effort [(N m)^2], shape () each; pure, to
        be called where JAX computes in float64
    effort_weight: of the effort in the objective [rad^2/(N m)^2]
    groups: number of groups
    ticks: control periods that are simulated
    chunk: control periods that are computed again at a time
    """

    costs: Callable[[jax.Array], tuple[jax.Array, jax.Array]]
    effort_weight: float
    groups: int
    ticks: int
    chunk: int

    def objective(self, x: jax.Array) -> jax.Array:
        """tracking + effort_weight * effort at log-gains x, shape (2 g,) -> ()."""
        tracking, effort = self.costs(x)
        return tracking + self.effort_weight * effort


def term(
    specification: Specification,
    groups: Sequence[int] | np.ndarray,
    members: Mapping[str, np.ndarray],
    *,
    effort_weight: float = 0.0,
    differentiable: bool = True,
) -> Term:
    """The tracking of a robot in one posture, averaged over members.

    specification: with a plant, as for `jaxact.tuning.rollouts.validation.validate`; its
        duration is rounded up to whole chunks
    groups: number of the group of each joint, shape (m,)
    members: values of the parameters in which they differ by key, shape (n,) each
    effort_weight: of the mean squared command [rad^2/(N m)^2]
    differentiable: False takes MJX's steps as they are, whose values are the same: for differences

    Raises UserError as `validate`, and for a robot that MJX cannot simulate or differentiate.
    """
    if specification.plant is None:
        raise UserError("tracking: only of a robot; give one below [plant]")
    scene = robots.scene(specification.plant)
    which = np.asarray(groups, int)
    columns = {
        key: np.zeros_like(values) if key in _QUANTISED else values
        for key, values in checked_members(members).items()
    }
    one = np.ones(len(scene.labels))
    asked = with_gains(specification, scene, scene.labels, one, one, columns)
    asked = replace(
        asked, engine="mjx", precision="float64", devices=1,
        parameters={**asked.parameters, **dict.fromkeys(_QUANTISED, 0.0)},
    )  # fmt: skip
    samples = explicit(asked, columns)
    kinds = plans.groups(asked, samples)
    if len(kinds) > 1:
        raise UserError("tracking: the members' control rates need different physics steps")
    case, chunk, chunks = _chunked(kinds[0].case)
    with jax.enable_x64(True):
        made = kernel.template_of(case, asked.setting, "metrics")
        if differentiable:
            made = replace(made, plant=smooth(made.plant))
    values = samples.take(np.arange(len(samples)))
    keys = [
        (f"{name}@{re.escape(label)}", half * (which.max() + 1) + which[joint])
        for half, name in enumerate(("kp", "kd"))
        for joint, label in enumerate(scene.labels)
    ]

    def costs(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Tracking error and effort, means over the members, at the logarithms of the gains."""
        gains = {key: jnp.exp(x[place]) for key, place in keys}

        def member(own: Mapping[str, jax.Array], number: jax.Array):
            key = jax.random.fold_in(jax.random.key(asked.seed), number)
            return _costs(case, made, chunk, chunks, {**own, **gains}, key)

        own = {name: jnp.asarray(value) for name, value in values.items() if name not in gains}
        if len(samples) == 1:
            # XLA's simplifier goes round in circles over batches of one.
            return member({name: value[0] for name, value in own.items()}, jnp.asarray(0))
        each = jax.vmap(member)(own, jnp.arange(len(samples)))
        tracking, effort = (jnp.mean(part) for part in each)
        return tracking, effort

    return Term(costs, effort_weight, int(which.max()) + 1, chunk * chunks, chunk)


def _chunked(case: Case) -> tuple[Case, int, int]:
    """The case with whole chunks, the control periods in one of them, and their number."""
    ticks = case.rollout.ticks
    chunk = SEGMENTS * max(1, round(math.sqrt(ticks) / SEGMENTS))
    chunks = -(-ticks // chunk)
    return replace(case, rollout=replace(case.rollout, ticks=chunk * chunks)), chunk, chunks


def _costs(
    case: Case, template: Template, chunk: int, chunks: int, values: Mapping[str, Any], key
) -> tuple[jax.Array, jax.Array]:
    """Mean squared error and mean squared command of one member, shape () each."""
    prepared, state, setpoint = kernel.start(case, template, values)
    options = RolloutOptions(ticks=chunk, linear_plant=False)
    wanted = kernel.setpoints(template, values, chunk * chunks)
    parts = jax.tree.map(lambda row: row.reshape((chunks, chunk, *row.shape[1:])), wanted)

    def advance(state, inputs):
        """One control period."""
        number, given = inputs
        own = jax.random.fold_in(key, number)
        state, running, _ = rollout.run(
            prepared, case.drive, options, state, setpoint, own, setpoints=given
        )
        return state, (jnp.mean(running.squared_error), jnp.mean(running.effort))

    # Chunks are iterations of a loop, which the compiler does not merge.
    advance = jax.checkpoint(advance, prevent_cse=False)
    _, sums = jax.lax.scan(advance, state, (jnp.arange(chunks), parts))
    error, effort = (jnp.sum(part) / (chunk * chunks) for part in sums)
    return error, effort
