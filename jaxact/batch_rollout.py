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
from jaxact.metrics import SEGMENTS, Envelope, Metrics, Period, Reference, Running
from jaxact.packing import pack, unpack
from jaxact.plants.linear import hermite
from jaxact.plants.mujoco import Simulations
from jaxact.programs import Program
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


def _captured(coefficients: Coefficients, state: BatchState, place: int, ends: Pair):
    """The measurement, if it falls into this physics step; `ends` are its two states."""
    capture = coefficients.capture
    if capture is None or state.late is None:
        return state
    before, after = ((end[0], end[1]) for end in ends)
    position, velocity = hermite(before, after, capture.offset, coefficients.step)
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
    periods = [Period(output, reference, count, weight)]
    return replace(
        state,
        drive=drive,
        running=_metrics.update(state.running, periods),
        envelope=_metrics.update_envelope(state.envelope, periods),
    )


@dataclass(frozen=True)
class _Fixed:
    """What stays the same during the rollout of a loop.

    Attributes:
        coefficients: from `jaxact.drive.prepare`.
        setpoint: constant setpoint.
        reference: of the metrics.
        active_ticks: integrals stop after this many.
        key: of the random numbers.
    """

    coefficients: Coefficients
    setpoint: Setpoint
    reference: Reference
    active_ticks: jax.Array
    key: jax.Array


jax.tree_util.register_dataclass(
    _Fixed, data_fields=[item.name for item in fields(_Fixed)], meta_fields=[]
)


@dataclass(frozen=True)
class _Stages:
    """The compiled functions of a batch; states and `_Fixed` are packed."""

    first: Program
    turn: Program
    middle: tuple[Program, ...]
    last: Program


@functools.cache
def _stages(options: DriveOptions, masked: bool) -> _Stages:
    """The functions between which the physics runs; batched over loops.

    `first` begins a rollout, `turn` ends a period and begins the next one, `middle` is the force of
    a later physics step of a period, `last` ends a rollout.
    """
    final = options.substeps - 1

    def begin(fixed: _Fixed, state, now, given, number):
        draws = Draws()
        if options.random:
            draws = _sensor.draw(options.sensor, fixed.key, number, now[0])
        setpoint = fixed.setpoint if given is None else Setpoint(*given)
        return _begin(fixed.coefficients, options, state, (now[0], now[1]), setpoint, draws)

    def end(fixed: _Fixed, state, ends, given, number):
        state = _captured(fixed.coefficients, state, final, ends)
        count = number.astype(ends[1].dtype)
        weight = None if not masked else (number <= fixed.active_ticks).astype(count.dtype)
        aim = fixed.reference if given is None else replace(fixed.reference, target=given[0])
        period = fixed.coefficients, options, state, (ends[1][0], ends[1][1])
        return _end(*period, aim, count, weight)

    def first(fixed, state, now, given, number):
        state, force = begin(unpack(fixed), unpack(state), now, given, number)
        return pack(state), force

    def turn(fixed, state, ends, ended, begun, number):
        fixed = unpack(fixed)
        state = end(fixed, unpack(state), ends, ended, number)
        state, force = begin(fixed, state, ends[1], begun, number)
        return pack(state), force

    def middle(fixed, state, ends, place):
        coefficients = unpack(fixed).coefficients
        state = _captured(coefficients, unpack(state), place - 1, ends)
        state, force = _actuated(coefficients, options, state, place, ends[1][1])
        return pack(state), force

    def last(fixed, state, ends, ended, number):
        return pack(end(unpack(fixed), unpack(state), ends, ended, number))

    def program(stage: Callable, *axes: int | None, **static: int) -> Program:
        name = (stage.__name__, options, masked, static)
        return Program(lambda: jax.vmap(functools.partial(stage, **static), axes), name)

    return _Stages(
        first=program(first, 0, 0, 0, 0, None),
        turn=program(turn, 0, 0, 0, 0, 0, None),
        middle=tuple(program(middle, 0, 0, 0, place=place) for place in range(1, options.substeps)),
        last=program(last, 0, 0, 0, 0, None),
    )


_packed = Program(lambda: jax.vmap(pack), "pack")
_unpacked = Program(lambda: jax.vmap(unpack), "unpack")


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
    stages = _stages(options, masked)
    simulations.start(*start)
    dtype = np.dtype(jnp.result_type(float))
    now = _pair(start, dtype)
    like = jnp.asarray(now[:, 0])
    reference = jax.vmap(_metrics.reference)(like, jnp.broadcast_to(setpoint.position, like.shape))
    fixed = _packed(_Fixed(coefficients, setpoint, reference, active_ticks, keys))
    zero = jnp.zeros_like(like)
    held = _packed(
        BatchState(
            drive=state,
            running=_metrics.init(like),
            envelope=_metrics.init_envelope(like),
            late=None,
            before=(like, jnp.asarray(now[:, 1])),
            command=zero,
            peak_force=zero,
            square_force=zero,
        )
    )
    rows = None if setpoints is None else _rows(setpoints)
    envelopes = []
    wanted = None if rows is None else rows[0]
    held, force = stages.first(fixed, held, now, wanted, np.int32(0))
    middle = [stage.compiled(fixed, held, (now, now)) for stage in stages.middle]
    turn = stages.turn.compiled(fixed, held, (now, now), wanted, wanted, np.int32(0))
    for number in range(1, ticks + 1):
        for place in range(options.substeps):
            if observe is not None:
                given = setpoint if wanted is None else Setpoint(*np.moveaxis(wanted, 1, 0))
                observe(place, given, _unpacked(held), force)
            before = now
            simulations.advance(np.asarray(force, float))
            now = _pair(simulations.measure(), dtype)
            ends = before, now
            if place + 1 < options.substeps:
                held, force = middle[place](fixed, held, ends)
        count = np.int32(number)
        if number == ticks:
            held = stages.last(fixed, held, ends, wanted, count)
        else:
            following = None if rows is None else rows[number]
            held, force = turn(fixed, held, ends, wanted, following, count)
            wanted = following
        if number % (ticks // SEGMENTS) == 0:
            whole = _unpacked(held)
            envelopes.append(whole.envelope)
            held = _packed(replace(whole, envelope=_metrics.init_envelope(like)))
    period = jnp.asarray(coefficients.drive.control_period)
    counted = active_ticks if masked else jnp.full(period.shape, float(ticks), like.dtype)
    return _finish(ticks)(
        _unpacked(held).running, envelopes, reference, growth_rate, period, counted, rest_amplitude
    )


@functools.cache
def _finish(ticks: int) -> Program:
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

    return Program(lambda: jax.vmap(finished), ("finish", ticks))


def _pair(state: tuple[np.ndarray, np.ndarray], dtype: np.dtype) -> np.ndarray:
    """Joint positions and velocities in a precision, what is beyond it at its end.

    Returns:
        shape (loops, 2, joints).
    """
    most = float(np.finfo(dtype).max)
    # `np.clip` does the same, and takes longer than all the rest for a few loops.
    return np.minimum(np.maximum(np.stack(state, axis=1), -most), most).astype(dtype)


def _rows(setpoints: Setpoint) -> np.ndarray:
    """The setpoints of every tick: position, velocity, force; (ticks, loops, 3, joints)."""
    parts = (setpoints.position, setpoints.velocity, setpoints.force)
    return np.moveaxis(np.stack([np.asarray(part) for part in parts], axis=2), 1, 0).copy()
