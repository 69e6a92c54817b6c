"""Simulated tracking as a term of a robot's objective, beside the margins; and its gradient.

    value - weight ln(rms),    rms = sqrt(mean of (q - r)^2)

over ticks, joints, members and situations, in nonlinear rollouts in MJX after a push, with the
drive's delays, noise and limits, and contacts. The weight says how many per cent of the objective
one per cent less of the error is worth; the constraints stay what they are. It is not an objective
of its own: for a sluggish actuator the error is smaller at gains that are nearly unstable.

The error is a function of the log-gains of g groups, x = (ln kp_1 ... ln kp_g, ln kd_1 ...), and
differentiable forwards and backwards (`jaxact.plants.mjx.smooth`); quantisation, which has no
derivative, is left out. Forwards, every log-gain adds a tangent to the rollout: for p of them

    forward = 1 + FORWARD p   times the work of a rollout, memory of p + 1 states;
    reverse = REVERSE         times, memory of the states between chunks and of one chunk's steps.

The rollout is cut into chunks of about the square root of its length. Backwards, only the states
between chunks are kept and a chunk at a time is computed again.

Source: Griewank & Walther, "Evaluating Derivatives", 2nd ed., chapter 12 (checkpointing).
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.loops import robots
from jaxact.loops.samples import explicit
from jaxact.loops.specification import Specification
from jaxact.loops.template import Template
from jaxact.parameters import COMMAND_RESOLUTION, KD, KP, POSITION_RESOLUTION, VELOCITY_RESOLUTION
from jaxact.plants.mjx.smooth import smooth
from jaxact.simulation import kernel, plans, rollout
from jaxact.simulation.kernel import Case
from jaxact.simulation.metrics import SEGMENTS
from jaxact.simulation.rollout import RolloutOptions
from jaxact.tuning.goal import DERIVATIVES
from jaxact.tuning.groups import Groups
from jaxact.tuning.robot.loops import Situation
from jaxact.tuning.rollouts.exposure import exposed
from jaxact.tuning.rollouts.validation import checked_members, with_gains

# Length of the rollouts, whose first tenth ends with the push [s], and actuators in each situation.
SECONDS, MEMBERS = 0.4, 2
FORWARD, REVERSE = 1.0, 9.4
"""Work of a tangent, and of a rollout with its derivatives backwards, in rollouts: measured on a
quadruped with contacts on a CPU."""
_QUANTISED = (POSITION_RESOLUTION, VELOCITY_RESOLUTION, COMMAND_RESOLUTION)


@dataclass(frozen=True, eq=False)
class Term:
    """A robot's simulated tracking in one posture.

    Attributes:
        error: from x, shape (2 g,), to the mean squared error [rad^2], shape (); to be called
            where JAX computes in float64.
        groups: number of groups.
        ticks: control periods that are simulated.
        chunk: control periods that are computed again at a time.
    """

    error: Callable[[jax.Array], jax.Array]
    groups: int
    ticks: int
    chunk: int


@dataclass(frozen=True)
class Tracked:
    """Simulated tracking errors, rms over ticks, joints, members and situations [rad or m].

    Attributes:
        weight: of the term in the objective.
        mode: of its derivatives.
        rms: of the gains.
        aside: of the gains that the margins alone lead to.
        before: of the start; NaN where it is unstable, None where none was given.
    """

    weight: float
    mode: str
    rms: float
    aside: float
    before: float | None


@dataclass(frozen=True, eq=False)
class Tracking:
    """Tracking in several situations, in rollouts that are set up.

    Attributes:
        terms: of the situations.
        weight: of ln(rms) in the objective.
        mode: of the derivatives, "forward" or "reverse".
    """

    terms: tuple[Term, ...]
    weight: float
    mode: str

    def log_rms(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """ln of the rms error at log-gains x, and its slope, shape (2 g,); inf if it diverges."""
        return _log_rms(self, np.asarray(x, float).tobytes())

    def tracked(
        self,
        stable: Callable[[np.ndarray], bool],
        x: np.ndarray,
        aside: np.ndarray,
        before: np.ndarray | None,
    ) -> Tracked:
        """The errors at some log-gains, as `Tracked` names them."""

        def rms(x: np.ndarray) -> float:
            return float(np.exp(self.log_rms(x)[0])) if stable(x) else math.nan

        start = None if before is None else rms(before)
        return Tracked(self.weight, self.mode, rms(x), rms(aside), start)


def check(weight: float, derivative: str, groups: int) -> str:
    """The mode of the derivatives.

    Raises:
        UserError: a weight or a mode that makes no sense.
    """
    if not (weight >= 0.0 and math.isfinite(weight)):
        raise UserError(f"`tracking_weight` {weight:g}: give a positive number, 0 for none")
    try:
        return chosen(derivative, 2 * groups)
    except UserError as mistake:
        raise UserError(f"`derivative`: {mistake}") from None


def work(parameters: int) -> dict[str, float]:
    """What a gradient by so many parameters costs in each mode, in rollouts."""
    return {"forward": 1.0 + FORWARD * parameters, "reverse": REVERSE}


def chosen(mode: str, parameters: int) -> str:
    """The mode that is asked for, or the cheaper one for "auto".

    Raises:
        UserError: another mode.
    """
    if mode not in DERIVATIVES:
        raise UserError(f"mode {shown(mode)}; {nearest(mode, DERIVATIVES)}")
    costs = work(parameters)
    return min(costs, key=lambda name: costs[name]) if mode == "auto" else mode


def tracking(
    situations: Sequence[Situation],
    fractions: Sequence[np.ndarray],
    groups: Groups,
    weight: float,
    mode: str,
) -> Tracking:
    """Rollouts of every situation, with some of its actuators.

    Args:
        fractions: of the ranges of the box for each situation, shape (n, ranges); the first are
            taken.
        weight: of ln(rms) in the objective.
        mode: of the derivatives, "forward" or "reverse".
    """
    terms = tuple(
        term(
            exposed(one.specification, duration=SECONDS), groups.members,
            one.columns(fraction[:MEMBERS]),
        )
        for one, fraction in zip(situations, fractions, strict=True)
    )  # fmt: skip
    return Tracking(terms, weight, mode)


@functools.lru_cache(maxsize=64)
def _log_rms(tracking: Tracking, at: bytes) -> tuple[float, np.ndarray]:
    found = [value_and_gradient(one, np.frombuffer(at), tracking.mode) for one in tracking.terms]
    mean = float(np.mean([value for value, _ in found]))
    slope = np.mean([gradient for _, gradient in found], axis=0)
    if not (np.isfinite(mean) and np.isfinite(slope).all()):
        return math.inf, np.zeros_like(slope)
    return 0.5 * math.log(mean), 0.5 * slope / mean


def value_and_gradient(term: Term, x: np.ndarray, mode: str = "auto") -> tuple[float, np.ndarray]:
    """The mean squared error [rad^2] and its gradient by log-gains x, shape (2 g,), in float64.

    Args:
        mode: "forward", "reverse", or "auto" by counting.
    """
    with jax.enable_x64(True):
        differentiate = _compiled(term, chosen(mode, 2 * term.groups))
        gradient, value = differentiate(jnp.asarray(x, float))
        return float(value), np.asarray(gradient)


@functools.lru_cache(maxsize=8)
def _compiled(term: Term, mode: str) -> Callable:
    def twice(x: jax.Array):
        value = term.error(x)
        return value, value

    return jax.jit((jax.jacfwd if mode == "forward" else jax.grad)(twice, has_aux=True))


def term(
    specification: Specification,
    groups: Sequence[int] | np.ndarray,
    members: Mapping[str, np.ndarray],
    *,
    differentiable: bool = True,
) -> Term:
    """The tracking of a robot in one posture, averaged over members.

    Args:
        specification: with a plant, as for `jaxact.tuning.rollouts.validation.validate`; its
            duration is rounded up to whole chunks.
        groups: number of the group of each joint, shape (m,).
        members: values of the parameters in which they differ by key, shape (n,) each.
        differentiable: False takes MJX's steps as they are, whose values are the same: for
            differences.

    Raises:
        UserError: as `validate`, and for a robot that MJX cannot simulate or differentiate.
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
        for half, name in enumerate((KP, KD))
        for joint, label in enumerate(scene.labels)
    ]

    def error(x: jax.Array) -> jax.Array:
        """Mean squared error over the members at the logarithms of the gains."""
        gains = {key: jnp.exp(x[place]) for key, place in keys}

        def member(own: Mapping[str, jax.Array], number: jax.Array) -> jax.Array:
            key = jax.random.fold_in(jax.random.key(asked.seed), number)
            return _error(case, made, chunk, chunks, {**own, **gains}, key)

        own = {name: jnp.asarray(value) for name, value in values.items() if name not in gains}
        if len(samples) == 1:
            # XLA's simplifier goes round in circles over batches of one.
            return member({name: value[0] for name, value in own.items()}, jnp.asarray(0))
        return jnp.mean(jax.vmap(member)(own, jnp.arange(len(samples))))

    return Term(error, int(which.max()) + 1, chunk * chunks, chunk)


def _chunked(case: Case) -> tuple[Case, int, int]:
    """The case with whole chunks, the control periods in one of them, and their number."""
    ticks = case.rollout.ticks
    chunk = SEGMENTS * max(1, round(math.sqrt(ticks) / SEGMENTS))
    chunks = -(-ticks // chunk)
    return replace(case, rollout=replace(case.rollout, ticks=chunk * chunks)), chunk, chunks


def _error(
    case: Case, template: Template, chunk: int, chunks: int, values: Mapping[str, Any], key
) -> jax.Array:
    """Mean squared error of one member, shape ()."""
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
        return state, jnp.mean(running.squared_error)

    # Chunks are iterations of a loop, which the compiler does not merge.
    advance = jax.checkpoint(advance, prevent_cse=False)
    _, sums = jax.lax.scan(advance, state, (jnp.arange(chunks), parts))
    return jnp.sum(sums) / (chunk * chunks)
