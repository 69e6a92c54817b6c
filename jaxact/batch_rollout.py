"""Rollouts whose plant is stepped outside JAX, in C MuJoCo: the same drive, the same metrics.

Drive and metrics of all loops are one compiled function of the batch, called once per control
period; physics runs in between.

    tick, actuate -> force -> C -> (actuate -> force -> C ...) -> capture, metrics
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact import drive as _drive
from jaxact import metrics as _metrics
from jaxact import sensor as _sensor
from jaxact.controller import Setpoint
from jaxact.drive import Coefficients, DriveOptions, DriveState
from jaxact.loop import Output
from jaxact.metrics import SEGMENTS, Envelope, Metrics, Reference, Running
from jaxact.plants.linear import hermite
from jaxact.plants.mujoco import Simulations
from jaxact.sensor import Draws

Pair = tuple[Any, Any]  # arrays of either kind: NumPy's where C has just written them


@dataclass(frozen=True)
class BatchState:
    """What a loop carries from one control period to the next.

    Attributes:
        drive: its state.
        running, envelope: accumulators of the metrics.
        late: measurement captured in this period, position and velocity; None without delay.
        before: position and velocity at the beginning of the period.
        command: issued at the beginning of the period [N or N m].
        peak_force, square_force: of the period's physics steps so far.
    """

    drive: DriveState
    running: Running
    envelope: Envelope
    late: Pair | None
    before: Pair
    command: jax.Array
    peak_force: jax.Array
    square_force: jax.Array


jax.tree_util.register_dataclass(
    BatchState, data_fields=[item.name for item in fields(BatchState)], meta_fields=[]
)


def _actuated(
    coefficients: Coefficients, options: DriveOptions, state: BatchState, place: int, velocity
) -> tuple[BatchState, jax.Array]:
    """One physics step's force, of the `place`-th step of a period."""
    response, _ = jax.tree.map(lambda leaf: leaf[place], _drive.at_substep(coefficients))
    drive, force = _drive.actuate(coefficients, options, state.drive, response, velocity)
    size = jnp.abs(force.mean)
    state = replace(
        state,
        drive=drive,
        peak_force=jnp.maximum(state.peak_force, size),
        square_force=state.square_force + size * size / options.substeps,
    )
    return state, force.mean


def _begin(coefficients, options, state: BatchState, now: Pair, setpoint: Setpoint, draws: Draws):
    """The controller's tick and the first physics step's force."""
    drive, command = _drive.tick(coefficients, options, state.drive, *now, setpoint, draws)
    zero = jnp.zeros_like(command)
    late = now if coefficients.capture is not None else None
    state = replace(
        state,
        drive=drive,
        late=late,
        before=now,
        command=command,
        peak_force=zero,
        square_force=zero,
    )
    return _actuated(coefficients, options, state, 0, now[1])


def _captured(coefficients: Coefficients, state: BatchState, place: int, ends: tuple[Pair, Pair]):
    """The measurement, if it falls into this physics step; `ends` are its two states."""
    capture = coefficients.capture
    if capture is None or state.late is None:
        return state
    position, velocity = hermite(*ends, capture.offset, coefficients.step)
    here = capture.here[place] > 0.0
    late = jnp.where(here, position, state.late[0]), jnp.where(here, velocity, state.late[1])
    return replace(state, late=late)


def _end(coefficients, options, state: BatchState, now: Pair, reference: Reference, count, weight):
    """What the period was, taken into the metrics."""
    drive = state.drive
    if state.late is not None:
        drive = _drive.capture(drive, *state.late)
    output = Output(
        position_before=state.before[0],
        velocity_before=state.before[1],
        position=now[0],
        velocity=now[1],
        command=state.command,
        peak_force=state.peak_force,
        square_force=state.square_force,
    )
    return replace(
        state,
        drive=drive,
        running=_metrics.update(state.running, reference, output, count, weight),
        envelope=_metrics.update_envelope(state.envelope, output, count),
    )


@dataclass(frozen=True)
class _Stages:
    """The compiled functions of a batch."""

    first: Callable
    turn: Callable
    middle: Callable
    last: Callable


@functools.cache
def _stages(options: DriveOptions, masked: bool, moving: bool) -> _Stages:
    """The functions between which the physics runs; batched over loops.

    `first` begins a rollout, `turn` ends a period and begins the next one, `middle` is the force of
    a later physics step of a period, `last` ends a rollout.
    """
    final = options.substeps - 1

    def draws_of(key, number, like):
        if not options.random:
            return Draws()
        return _sensor.draw(options.sensor, jax.random.fold_in(key, number), like)

    def first(coefficients, state, now, setpoint, key):
        draws = draws_of(key, 0, now[0])
        return _begin(coefficients, options, state, now, setpoint, draws)

    def end(coefficients, state, ends, setpoint, reference, active, number):
        state = _captured(coefficients, state, final, ends)
        weight = None if not masked else (number <= active).astype(ends[1][0].dtype)
        aim = replace(reference, target=setpoint.position) if moving else reference
        count = number.astype(ends[1][0].dtype)
        return _end(coefficients, options, state, ends[1], aim, count, weight)

    def turn(coefficients, state, ends, setpoints, reference, active, key, number):
        ended, begun = setpoints
        state = end(coefficients, state, ends, ended, reference, active, number)
        draws = draws_of(key, number, ends[1][0])
        return _begin(coefficients, options, state, ends[1], begun, draws)

    def middle(coefficients, state, ends, place):
        state = _captured(coefficients, state, place - 1, ends)
        return _actuated(coefficients, options, state, place, ends[1][1])

    def batched(function: Callable, axes: tuple) -> Callable:
        return jax.jit(jax.vmap(function, in_axes=axes))

    return _Stages(
        first=batched(first, (0, 0, 0, 0, 0)),
        turn=batched(turn, (0, 0, 0, 0, 0, 0, 0, None)),
        middle=jax.jit(
            lambda coefficients, state, ends, place: jax.vmap(
                functools.partial(middle, place=place)
            )(coefficients, state, ends),
            static_argnums=3,
        ),
        last=batched(end, (0, 0, 0, 0, 0, 0, None)),
    )


def evaluate(
    simulations: Simulations,
    coefficients: Coefficients,
    options: DriveOptions,
    ticks: int,
    state: DriveState,
    start: tuple[np.ndarray, np.ndarray],
    setpoint: Setpoint,
    growth_rate: jax.Array,
    keys: jax.Array,
    *,
    active_ticks: jax.Array,
    masked: bool,
    rest_amplitude: jax.Array,
    setpoints: Setpoint | None = None,
    observe: Callable[[int, Setpoint, BatchState, jax.Array], None] | None = None,
) -> Metrics:
    """Metrics of a batch of loops; every leaf has a leading axis for the loops.

    Args:
        simulations: of the plants.
        coefficients: from `jaxact.drive.prepare`, one for each loop.
        options: static.
        ticks: control periods, a multiple of `jaxact.metrics.SEGMENTS`.
        state: of the drives, from `jaxact.drive.init`.
        start: joint positions [m or rad] and velocities, shape (loops, joints).
        setpoint: constant setpoint.
        growth_rate: [1/s], known already, shape (loops,).
        keys: of the samples' random numbers, shape (loops,).
        active_ticks: integrals stop after this many ticks where `masked`, shape (loops,).
        rest_amplitude: a motion smaller than this counts as at rest [m or rad], shape (loops,).
        setpoints: one for every tick instead, leaves (loops, ticks, joints).
        observe: called before each physics step with the number of the step in its period, the
            setpoint, the state of the loops, and the mean force on the joints.

    Returns:
        See `jaxact.metrics.Metrics`; shape (loops,) or (loops, joints).
    """
    stages = _stages(options, masked, setpoints is not None)
    simulations.start(*start)
    now = _pair(start)
    like = jnp.asarray(now[0])
    reference = jax.vmap(_metrics.reference)(like, jnp.broadcast_to(setpoint.position, like.shape))
    zero = jnp.zeros_like(like)
    held = BatchState(
        state, _metrics.init(like), _metrics.init_envelope(like), None, now, zero, zero, zero
    )
    envelopes = []
    wanted = _at(setpoint, setpoints, 0)
    held, force = stages.first(coefficients, held, now, wanted, keys)
    for number in range(1, ticks + 1):
        for place in range(options.substeps):
            if observe is not None:
                observe(place, wanted, held, force)
            before = now
            simulations.advance(np.asarray(force, float))
            now = _pair(simulations.measure())
            if place + 1 < options.substeps:
                held, force = stages.middle(coefficients, held, (before, now), place + 1)
        ends, count = (before, now), np.int32(number)
        if number == ticks:
            held = stages.last(coefficients, held, ends, wanted, reference, active_ticks, count)
        else:
            following = _at(setpoint, setpoints, number)
            held, force = stages.turn(
                coefficients, held, ends, (wanted, following), reference, active_ticks, keys, count
            )
            wanted = following
        if number % (ticks // SEGMENTS) == 0:
            envelopes.append(held.envelope)
            held = replace(held, envelope=_metrics.init_envelope(like))
    period = jnp.asarray(coefficients.drive.control_period)
    counted = active_ticks if masked else jnp.full(period.shape, float(ticks), like.dtype)
    return _finish(ticks)(
        held.running, envelopes, reference, growth_rate, period, counted, rest_amplitude
    )


@functools.cache
def _finish(ticks: int) -> Callable[..., Metrics]:
    """The compiled end of a rollout of so many control periods."""

    def finished(running, envelopes, reference, growth_rate, period, counted, rest_amplitude):
        return _metrics.finish(
            running,
            jax.tree.map(lambda *leaves: jnp.stack(leaves), *envelopes),
            reference,
            growth_rate,
            linear=False,
            period=period,
            ticks=ticks,
            counted=counted,
            rest_amplitude=rest_amplitude,
        )

    return jax.jit(jax.vmap(finished))


def _pair(state: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions and velocities in JAX's precision, what is beyond it at its end."""
    dtype = jnp.result_type(float)
    most = float(np.finfo(dtype).max)
    position, velocity = (np.clip(part, -most, most).astype(dtype) for part in state)
    return position, velocity


def _at(setpoint: Setpoint, setpoints: Setpoint | None, tick: int) -> Setpoint:
    return setpoint if setpoints is None else jax.tree.map(lambda row: row[:, tick], setpoints)
