"""Rollouts whose plant is stepped outside JAX, in C MuJoCo: the same drive, the same metrics.

Drive and metrics of all loops are one compiled function of the batch, called once per control
period; physics runs in between.

    tick, actuate -> force -> C -> (actuate -> force -> C ...) -> capture, metrics
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.compilation.packing import Packed, pack, unpack
from jaxact.compilation.programs import Program, building
from jaxact.compilation.single_kernel import single_kernel
from jaxact.drive import sensor as _sensor
from jaxact.drive import step as _drive
from jaxact.drive.controller import Setpoint
from jaxact.drive.sensor import Draws
from jaxact.drive.step import Coefficients, DriveOptions, DriveState
from jaxact.loops.loop import Output
from jaxact.plants.linear import hermite
from jaxact.plants.mujoco import Simulations
from jaxact.robots.base import Base
from jaxact.robots.silence import silenced
from jaxact.simulation import envelope as _envelope
from jaxact.simulation import metrics as _metrics
from jaxact.simulation import scales as _scales
from jaxact.simulation.envelope import Envelope
from jaxact.simulation.falling import fall
from jaxact.simulation.metrics import SEGMENTS, Metrics, Period, Reference, Running
from jaxact.simulation.settling import staying
from jaxact.simulation.verdicts import Judgement

Pair = tuple[Any, Any]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BatchState:
    """What a loop carries from one control period to the next.

    Attributes:
        drive: its state.
        running, envelope: accumulators of the metrics.
        ticks: that have been, whole.
        late: measurement captured in this period, position and velocity; None without delay.
        before: position and velocity at the beginning of the period.
        latest: the same at the beginning of the physics step; None without.
        setpoint: of the period.
        command: issued at the beginning of the period [N or N m].
        peak_force, square_force: of the period's physics steps so far.
    """

    drive: DriveState
    running: Running
    envelope: Envelope
    ticks: jax.Array
    late: Pair | None
    before: Pair
    latest: Pair | None
    setpoint: Setpoint
    command: jax.Array
    peak_force: jax.Array
    square_force: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Fixed:
    """What stays the same during the rollout of a loop.

    Attributes:
        coefficients: from `jaxact.drive.step.prepare`.
        setpoint: constant setpoint.
        reference: of the metrics.
        active_ticks: integrals stop after this many.
        key: words of the random key; a key of its own type takes longer to hand over.
    """

    coefficients: Coefficients
    setpoint: Setpoint
    reference: Reference
    active_ticks: jax.Array
    key: jax.Array


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
        latest=late,
        setpoint=setpoint,
        command=command,
        peak_force=zero,
        square_force=zero,
    )
    return _actuated(coefficients, options, state, 0, now[1])


def _captured(coefficients: Coefficients, state: BatchState, place: int, now: Pair):
    """The measurement, if it falls into the physics step that has led to `now`."""
    capture = coefficients.capture
    if capture is None or state.late is None or state.latest is None:
        return state
    position, velocity = hermite(state.latest, now, capture.offset, coefficients.step)
    here = capture.here[place] > 0.0
    late = jnp.where(here, position, state.late[0]), jnp.where(here, velocity, state.late[1])
    return replace(state, late=late, latest=now)


def _end(
    fixed: _Fixed, options: DriveOptions, state: BatchState, now: Pair, masked: bool
) -> BatchState:
    """What the period was, taken into the metrics."""
    drive, ticks = state.drive, state.ticks + 1
    count = ticks.astype(now[0].dtype)
    weight = (ticks <= fixed.active_ticks).astype(count.dtype) if masked else None
    # The last wish, which differs from the reference where the setpoint moves.
    reference = replace(fixed.reference, target=state.setpoint.position)
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
    running, envelope = _metrics.update(state.running, state.envelope, periods)
    return replace(state, drive=drive, ticks=ticks, running=running, envelope=envelope)


@building
def _stage(*, name: str, options: DriveOptions, masked: bool) -> Callable:
    """One of the functions between which the physics runs, batched over loops; trees are packed.

    `first` begins a rollout, `turn` ends a period and begins the next one, `middle` is the force of
    a later physics step of a period, the `place`-th, `last` ends a rollout. Each takes what `_seen`
    gives: of what a call costs, most is for the arrays that are handed over.
    """
    final = options.substeps - 1

    def begin(fixed: _Fixed, state: BatchState, seen: jax.Array):
        draws = Draws()
        if options.random:
            key = jax.random.wrap_key_data(fixed.key)
            draws = _sensor.draw(options.sensor, key, state.ticks, seen[0])
        setpoint = fixed.setpoint if len(seen) == 2 else Setpoint(*seen[2:])
        state, force = _begin(fixed.coefficients, options, state, _now(seen), setpoint, draws)
        return pack(state), force

    def end(fixed: _Fixed, state: BatchState, seen: jax.Array) -> BatchState:
        state = _captured(fixed.coefficients, state, final, _now(seen))
        return _end(fixed, options, state, _now(seen), masked)

    def first(fixed, state, seen):
        return begin(unpack(fixed), unpack(state), seen)

    def turn(fixed, state, seen):
        fixed = unpack(fixed)
        return begin(fixed, end(fixed, unpack(state), seen), seen)

    def middle(fixed, state, seen, place):
        coefficients = unpack(fixed).coefficients
        state = _captured(coefficients, unpack(state), place - 1, _now(seen))
        state, force = _actuated(coefficients, options, state, place, seen[1])
        return pack(state), force

    def last(fixed, state, seen):
        return pack(end(unpack(fixed), unpack(state), seen))

    stages: dict[str, Callable] = {"first": first, "turn": turn, "middle": middle, "last": last}
    axes = (0, 0, 0, None) if name == "middle" else (0, 0, 0)
    return single_kernel(jax.vmap(stages[name], in_axes=axes))


def _now(seen: jax.Array) -> Pair:
    return seen[0], seen[1]


@Program
def _packed(trees: Any) -> Packed:
    return jax.vmap(pack)(trees)


def _unpacked(packed: Packed) -> Any:
    """The tree as NumPy's arrays: taking it apart is not work that is worth compiling."""
    return unpack(jax.tree.map(np.asarray, packed))


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
    rubs: jax.Array,
    setpoints: Setpoint | None = None,
    observe: Callable[[int, BatchState, jax.Array], None] | None = None,
    others: Judgement | None = None,
    bases: tuple[Base, ...] = (),
) -> tuple[Metrics, Judgement]:
    """Metrics of a batch of loops; every leaf has a leading axis for the loops.

    Args:
        simulations: of the plants.
        coefficients, options: from `jaxact.drive.step.prepare`, one for each loop; static.
        ticks: control periods, a multiple of `jaxact.simulation.metrics.SEGMENTS`.
        state: of the drives, from `jaxact.drive.step.init`.
        start: joint positions [m or rad] and velocities, shape (loops, joints).
        setpoint: constant setpoint.
        growth_rate: [1/s], known already, shape (loops,).
        keys: of the samples' random numbers, shape (loops,).
        active_ticks: integrals stop after this many ticks where `masked`, shape (loops,).
        rest_amplitude: a motion smaller than this counts as at rest [m or rad], (loops, joints).
        rubs: whether dry friction acts in the robot, shape (loops,).
        setpoints: one for every tick instead, leaves (loops, ticks, joints).
        observe: called before each physics step with its number in its period, the state of the
            loops as NumPy arrays, and the mean force on the joints.
        others: what came of other starts, from calls before, shape (loops, starts, joints).
        bases: as for `jaxact.simulation.falling.fall`.

    Returns:
        See `jaxact.simulation.metrics.Metrics`, shape (loops,) or (loops, joints); and what came of
        this start alone, shape (loops, joints).
    """
    static = {"options": options, "masked": masked}
    aims = None if setpoints is None else _rows(setpoints)
    dtype = np.dtype(jnp.result_type(float))
    with silenced():
        simulations.start(*start)
        begun = simulations.configuration()
        seen = _seen(simulations, dtype, None if aims is None else aims[0])
        fixed = _fixed(coefficients, setpoint, active_ticks, keys, seen)
        held = _packed(_before(state, setpoint, seen))
        held, force = _stage(fixed, held, seen, name="first", **static)
        if options.substeps > 1:
            middle = _stage.compiled(fixed, held, seen, np.int32(1), name="middle", **static)
        turn = _stage.compiled(fixed, held, seen, name="turn", **static)
        envelopes = []
        for number in range(1, ticks + 1):
            for place in range(options.substeps):
                if observe is not None:
                    observe(place, _unpacked(held), force)
                simulations.advance(np.asarray(force, float))
                aim = None if aims is None else aims[min(number, ticks - 1)]
                seen = _seen(simulations, dtype, aim)
                if place + 1 < options.substeps:
                    held, force = middle(fixed, held, seen, np.int32(place + 1))
            if number < ticks:
                held, force = turn(fixed, held, seen)
            else:
                held = _stage(fixed, held, seen, name="last", **static)
            if number % (ticks // SEGMENTS) == 0:
                whole = _unpacked(held)
                envelopes.append(whole.envelope)
                with np.errstate(over="ignore", invalid="ignore"):  # of loops that blow up
                    fresh = _envelope.following(whole.envelope)
                held = _packed(replace(whole, envelope=fresh))
    period = jnp.asarray(coefficients.drive.control_period)
    counted = active_ticks if masked else jnp.full(period.shape, float(ticks), dtype)
    reference, running = _unpacked(fixed).reference, _unpacked(held).running
    end = (seen[:, 0], seen[:, 1]) if aims is None else None
    fell = fall(bases, begun, simulations.configuration(), told=setpoints is not None)
    loops = running, end, envelopes, reference, growth_rate, period, counted, rest_amplitude, rubs
    return _finish(np.int32(ticks), *loops, coefficients.drive, others, fell)


def _fixed(
    coefficients: Coefficients,
    setpoint: Setpoint,
    active_ticks: jax.Array,
    keys: jax.Array,
    seen: np.ndarray,
) -> Packed:
    """What stays the same, packed, of loops that start as `_seen`."""
    position = jnp.asarray(seen[:, 0])
    target = jnp.broadcast_to(setpoint.position, position.shape)
    reference = jax.vmap(_metrics.reference)(position, target)
    words = jax.random.key_data(keys)
    return _packed(_Fixed(coefficients, setpoint, reference, active_ticks, words))


def _before(drive: DriveState, setpoint: Setpoint, seen: np.ndarray) -> BatchState:
    """What loops that start as `_seen` carry into their first period."""
    position, velocity = (jnp.asarray(seen[:, place]) for place in range(2))
    zero = jnp.zeros_like(position)
    return BatchState(
        drive=drive,
        running=_metrics.init(position),
        envelope=_envelope.init(position),
        ticks=jnp.zeros(len(seen), jnp.int32),
        late=None,
        before=(position, velocity),
        latest=None,
        setpoint=jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, zero.shape), setpoint),
        command=zero,
        peak_force=zero,
        square_force=zero,
    )


@Program
def _finish(ticks: jax.Array, *loops: Any) -> tuple[Metrics, Judgement]:
    return jax.vmap(_finished, (None, *(0,) * 12))(ticks, *loops)


def _finished(
    ticks, running, end, envelopes, reference, growth_rate, period, counted, rest, rubs, drive,
    others, fell,
) -> tuple[Metrics, Judgement]:  # fmt: skip
    """The end of a rollout of so many control periods."""
    if end is not None:
        running = staying(running, reference, period, ticks, end)
    size = jnp.maximum(jnp.abs(reference.start), jnp.abs(reference.target))
    return _metrics.finish(
        running,
        jax.tree.map(lambda *leaves: jnp.stack(leaves), *envelopes),
        reference,
        growth_rate,
        period=period,
        ticks=ticks,
        counted=counted,
        scale=_scales.scale(drive, size, rest, linear_plant=False, rubs=rubs),
        others=others,
        fell=fell,
        told=end is None,
    )


def _seen(simulations: Simulations, dtype: np.dtype, aim: np.ndarray | None) -> np.ndarray:
    """What the drive is told of a moment: joint positions and velocities, and a setpoint.

    Args:
        simulations, dtype: of the plants; of the result, what is beyond it is put at its end.
        aim: position, velocity, and force of the setpoint, (loops, 3, joints); None if constant.

    Returns:
        Shape (loops, 2 or 5, joints).
    """
    most = float(np.finfo(dtype).max)
    state = simulations.measure()
    # `np.clip` does the same, and takes longer than all the rest for a few loops.
    np.minimum(np.maximum(state, -most, out=state), most, out=state)
    if aim is not None:
        return np.concatenate([state, aim], axis=1, dtype=dtype)
    return state.astype(dtype)


def _rows(setpoints: Setpoint) -> np.ndarray:
    """The setpoints of every tick: position, velocity, force; (ticks, loops, 3, joints)."""
    parts = (setpoints.position, setpoints.velocity, setpoints.force)
    return np.moveaxis(np.stack([np.asarray(part) for part in parts], axis=2), 1, 0).copy()
