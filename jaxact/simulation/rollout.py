"""One closed loop over time: a scan over control periods, with metrics or a trajectory.

run        step response with metrics accumulated on the way, no trajectory kept
trajectory the physics steps of one loop, for plots and files
judged     what comes of one start, for the verdict
metrics_of the metrics of a loop whose trajectory was kept
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.drive import sensor as _sensor
from jaxact.drive.controller import Setpoint
from jaxact.drive.step import DriveOptions
from jaxact.loops import loop as _loop
from jaxact.loops.loop import Loop, LoopState, Output, Prepared
from jaxact.simulation import envelope as _envelope
from jaxact.simulation import metrics as _metrics
from jaxact.simulation import stopping
from jaxact.simulation import verdicts as _verdicts
from jaxact.simulation.envelope import Envelope
from jaxact.simulation.falling import fallen
from jaxact.simulation.growth import rate as _growth
from jaxact.simulation.growth.rate import GrowthOptions
from jaxact.simulation.metrics import SEGMENTS, Metrics, Period, Reference, Running
from jaxact.simulation.stopping import parted
from jaxact.simulation.verdicts import Judgement, Scale


@dataclass(frozen=True)
class RolloutOptions:
    """The static side of a rollout.

    Attributes:
        ticks: control periods; a multiple of `jaxact.simulation.metrics.SEGMENTS`.
        unroll: largest number of control periods in one iteration of the compiled loop.
        linear_plant: whether the plant is linear, so that a linear drive makes a linear loop.
        stops: end early where no loop of a batch has finite metrics any more; it changes no result
            and leaves no derivative in reverse.
    """

    ticks: int
    unroll: int = 1
    linear_plant: bool = True
    stops: bool = False


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Trajectory:
    """One simulated loop at the times of its physics steps.

    Attributes:
        time: beginning of each step [s], shape (steps,).
        setpoint: [m or rad], shape (steps, joints).
        position, velocity: at the beginning of the step [m or rad] and per second.
        command: held by the controller [N or N m].
        delayed_command: as it enters the force loop, mean over the step [N or N m].
        force: on the plant, mean over the step [N or N m].
        configuration: of the whole plant at each control tick, (ticks, ...), where asked for.
    """

    time: jax.Array
    setpoint: jax.Array
    position: jax.Array
    velocity: jax.Array
    command: jax.Array
    delayed_command: jax.Array
    force: jax.Array
    configuration: jax.Array | None = None


def whole_ticks(duration: float, control_period: float) -> int:
    """Smallest number of ticks that covers a duration [s] and can be cut into segments."""
    segment = duration / control_period / SEGMENTS
    return SEGMENTS * max(1, int(-(-(segment - 1e-9) // 1)))


def _period(
    output: Output,
    reference: Reference,
    number: jax.Array,
    given: Setpoint | None,
    active_ticks: jax.Array | None,
) -> Period:
    """A control period as the metrics take it; `number` of its tick, `given` where it moves."""
    count = (number + 1).astype(reference.start.dtype)
    weight = None if active_ticks is None else (count <= active_ticks).astype(count.dtype)
    aim = reference if given is None else replace(reference, target=given.position)
    return Period(output, aim, count, weight)


def run(
    prepared: Prepared,
    options: DriveOptions,
    rollout: RolloutOptions,
    state: LoopState,
    setpoint: Setpoint,
    key: jax.Array | None = None,
    *,
    active_ticks: jax.Array | None = None,
    setpoints: Setpoint | None = None,
) -> tuple[LoopState, Running, Envelope]:
    """Simulate a loop and accumulate its metrics.

    Args:
        prepared: from `jaxact.loops.loop.prepare`.
        options: static, of the drive.
        rollout: static, of the rollout.
        state: from `jaxact.loops.loop.init`.
        setpoint: constant; the response is measured as a step from the present position.
        key: of this sample; needed only where `options.random`.
        active_ticks: integrals stop after this many ticks; None for all.
        setpoints: one for every tick instead, leaves of shape (ticks, joints); errors are measured
            against them, the rest against the constant one.

    Returns:
        The final state, the accumulators of the rollout, and those of its segments, stacked.

    Raises:
        ValueError: the number of ticks is not a multiple of the number of segments, or a random
            drive has no key.
    """
    if rollout.ticks % SEGMENTS:
        raise ValueError(f"ticks must be a multiple of {SEGMENTS}, got {rollout.ticks}")
    start, _ = prepared.plant.measure(state.plant)
    reference = _metrics.reference(start, jnp.broadcast_to(setpoint.position, start.shape))
    length = rollout.ticks // SEGMENTS

    together = stopping.together(length, rollout.unroll)
    span = stopping.stretch(length, together) if rollout.stops else length

    def tick(state, inputs):
        number, given = inputs
        wanted = setpoint if given is None else given
        draws = _loop.stage(options, _sensor.draw(options.sensor, key, number, start))
        state, (output, _) = _loop.step(prepared, options, state, wanted, draws)
        return _loop.stage(options, state), _period(output, reference, number, given, active_ticks)

    def ticks(carry, inputs):
        state, running, envelope = carry
        periods = []
        for place in range(together):
            state, period = tick(state, jax.tree.map(operator.itemgetter(place), inputs))
            periods.append(period)
        running, envelope = _metrics.update(running, envelope, periods)
        return (state, running, envelope), None

    def stretch(carry, inputs):
        """A number of ticks; `inputs` are those of the first one and the setpoints of all."""
        first, given = inputs
        numbers = first + jnp.arange(span, dtype=jnp.int32)
        return jax.lax.scan(ticks, carry, parted((numbers, given), span // together))[0], None

    def segment(carry, inputs):
        first, given = inputs
        firsts = first + span * jnp.arange(length // span, dtype=jnp.int32)
        over = stopping.until_lost if rollout.stops else jax.lax.scan
        (state, running, envelope), _ = over(stretch, carry, (firsts, parted(given, len(firsts))))
        return (state, running, _envelope.following(envelope)), envelope

    carry = state, _metrics.init(start), _envelope.init(start)
    firsts = length * jnp.arange(SEGMENTS, dtype=jnp.int32)
    parts = parted(setpoints, SEGMENTS)
    (state, running, _), envelopes = jax.lax.scan(segment, carry, (firsts, parts))
    return state, running, envelopes


def evaluate(
    prepared: Prepared,
    options: DriveOptions,
    rollout: RolloutOptions,
    state: LoopState,
    setpoint: Setpoint,
    key: jax.Array | None = None,
    *,
    growth_rate: jax.Array | None = None,
    active_ticks: jax.Array | None = None,
    growth: GrowthOptions | None = None,
    setpoints: Setpoint | None = None,
    rest_amplitude: jax.Array | float = 0.0,
    others: Judgement | None = None,
    upright: int | None = None,
) -> Metrics:
    """Metrics of a step response, verdict and growth rate included.

    Args:
        prepared, options, rollout, state, setpoint, key, active_ticks, setpoints: as for `run`.
        rest_amplitude: a motion smaller than this counts as at rest [m or rad], shape (joints,).
        others: from `judged`, of other starts of the same loop, shape (starts, joints).
        growth_rate: [1/s] if it is known already (in float64, say), else it is measured here.
        growth: static; how it is measured; None for the usual way.
        upright: static; as for `jaxact.simulation.falling.fallen`.
    """
    if growth_rate is None:
        # Whether a policy holds the setpoint is none of the loop's business.
        free = replace(state, drive=replace(state.drive, held=None))
        drive, how = replace(options, held_setpoint=False), growth or GrowthOptions()
        growth_rate = _growth.growth_rate(prepared, drive, free, setpoint, how)
    start, _ = prepared.plant.measure(state.plant)
    end, running, envelopes = run(
        prepared, options, rollout, state, setpoint, key,
        active_ticks=active_ticks, setpoints=setpoints,
    )  # fmt: skip
    reference = _metrics.reference(start, jnp.broadcast_to(setpoint.position, start.shape))
    found, _ = _metrics.finish(
        running,
        envelopes,
        reference,
        growth_rate,
        period=prepared.drive.drive.control_period,
        ticks=rollout.ticks,
        counted=rollout.ticks if active_ticks is None else active_ticks,
        scale=_scale(prepared, options, rollout.linear_plant, reference, rest_amplitude),
        others=others,
        fallen=fallen(upright, state.plant, end.plant),
    )
    return found


def _scale(
    prepared: Prepared,
    options: DriveOptions,
    linear_plant: bool,
    reference: Reference,
    rest_amplitude: jax.Array | float,
) -> Scale | None:
    """What the motions of a loop are measured with; None of one that is linear, but for noise."""
    if options.additive and linear_plant:
        return None
    size = jnp.maximum(jnp.abs(reference.start), jnp.abs(reference.target))
    drive, joint = prepared.drive.drive, prepared.joint
    return _verdicts.scale(drive, size, rest_amplitude, linear_plant=linear_plant, joint=joint)


def judged(
    prepared: Prepared,
    options: DriveOptions,
    rollout: RolloutOptions,
    state: LoopState,
    setpoint: Setpoint,
    key: jax.Array | None = None,
    *,
    growth_rate: jax.Array,
    rest_amplitude: jax.Array | float = 0.0,
    upright: int | None = None,
) -> Judgement:
    """What comes of one start, for `others` of `evaluate`; arguments as there, (joints,)."""
    start, _ = prepared.plant.measure(state.plant)
    end, running, envelopes = run(prepared, options, rollout, state, setpoint, key)
    reference = _metrics.reference(start, jnp.broadcast_to(setpoint.position, start.shape))
    return _metrics.judge(
        running,
        envelopes,
        reference,
        growth_rate,
        period=prepared.drive.drive.control_period,
        ticks=rollout.ticks,
        scale=_scale(prepared, options, rollout.linear_plant, reference, rest_amplitude),
        fallen=fallen(upright, state.plant, end.plant),
    )


def trajectory(
    loop: Loop,
    options: DriveOptions,
    ticks: int,
    setpoint: Setpoint,
    key: jax.Array | None = None,
    *,
    position: jax.Array | float = 0.0,
    velocity: jax.Array | float = 0.0,
    setpoints: Setpoint | None = None,
) -> Trajectory:
    """Simulate a loop from its parameters and keep every physics step.

    Args:
        loop: parameters.
        options: static.
        ticks: static; number of control periods.
        setpoint: constant setpoint.
        key: of this sample; needed only where `options.random`.
        position: to start from [m or rad], shape (joints,) or a number.
        velocity: to start with [m/s or rad/s], shape (joints,) or a number.
        setpoints: one for every tick instead, leaves of shape (ticks, joints).

    Returns:
        The trajectory; differentiable with respect to every parameter.
    """
    prepared = _loop.prepare(loop, options)
    state = _loop.init(prepared, options, position, velocity)
    return follow(prepared, options, ticks, state, setpoint, key, setpoints=setpoints)[0]


def follow(
    prepared: Prepared,
    options: DriveOptions,
    ticks: int,
    state: LoopState,
    setpoint: Setpoint,
    key: jax.Array | None = None,
    *,
    setpoints: Setpoint | None = None,
    configuration: Callable[[Any], jax.Array] | None = None,
) -> tuple[Trajectory, Output, LoopState]:
    """Simulate a loop from a state and keep every physics step.

    Args:
        prepared: from `jaxact.loops.loop.prepare`.
        options, ticks, setpoint, key, setpoints: as for `trajectory`.
        state: to start from.
        configuration: static; what to keep of the plant's state at every control tick.

    Returns:
        The trajectory, what `metrics_of` needs, leaves (ticks, joints), and the final state.
    """
    start, _ = prepared.plant.measure(state.plant)
    step, shape = prepared.drive.step, (options.substeps, *start.shape)
    numbers = jnp.arange(ticks, dtype=jnp.int32)

    def tick(state, inputs):
        number, given = inputs
        given = setpoint if given is None else given
        draws = _sensor.draw(options.sensor, key, number, start)
        kept = None if configuration is None else configuration(state.plant)
        state, (output, record) = _loop.step(prepared, options, state, given, draws)
        share = jnp.broadcast_to(prepared.drive.older_share, shape)
        older, newer = state.drive.older[None], state.drive.newer[None]
        delayed = share * older + (1.0 - share) * newer
        # What a slower policy said last.
        given = given if state.drive.held is None else state.drive.held.setpoint
        held = jnp.broadcast_to(given.position, shape), jnp.broadcast_to(output.command, shape)
        row = (held[0], record.position, record.velocity, held[1], delayed, record.force)
        return state, (row, kept, output)

    end, (rows, kept, outputs) = jax.lax.scan(tick, state, (numbers, setpoints))
    rows = [row.reshape((ticks * options.substeps, *start.shape)) for row in rows]
    time = step * jnp.arange(ticks * options.substeps)
    return Trajectory(time, *rows, configuration=kept), outputs, end


def metrics_of(
    outputs: Output,
    start: jax.Array,
    setpoint: Setpoint,
    growth_rate: jax.Array,
    *,
    prepared: Prepared,
    options: DriveOptions,
    linear_plant: bool,
    active_ticks: jax.Array | None = None,
    setpoints: Setpoint | None = None,
    rest_amplitude: jax.Array | float = 0.0,
    others: Judgement | None = None,
    fell: jax.Array | None = None,
) -> tuple[Metrics, Judgement]:
    """Metrics of a loop that was followed, as `evaluate` gives them, and its own judgement.

    Args:
        outputs: from `follow`, a multiple of `jaxact.simulation.metrics.SEGMENTS` of them.
        start: joint positions before the first tick [m or rad], shape (joints,).
        setpoint, active_ticks, setpoints, prepared, options: as for `run`.
        growth_rate, rest_amplitude, others: as for `evaluate`.
        linear_plant: static; whether the plant is linear.
        fell: whether it has fallen over, shape (); None of what cannot.
    """
    reference = _metrics.reference(start, jnp.broadcast_to(setpoint.position, start.shape))
    ticks = outputs.position.shape[0]

    def tick(carry, inputs):
        running, envelope = carry
        periods = [_period(inputs[0], reference, *inputs[1:], active_ticks)]
        return _metrics.update(running, envelope, periods), None

    def segment(carry, inputs):
        (running, envelope), _ = jax.lax.scan(tick, carry, inputs)
        return (running, _envelope.following(envelope)), envelope

    rows = outputs, jnp.arange(ticks, dtype=jnp.int32), setpoints
    carry = _metrics.init(start), _envelope.init(start)
    (running, _), envelopes = jax.lax.scan(segment, carry, parted(rows, SEGMENTS))
    return _metrics.finish(
        running,
        envelopes,
        reference,
        growth_rate,
        period=prepared.drive.drive.control_period,
        ticks=ticks,
        counted=ticks if active_ticks is None else active_ticks,
        scale=_scale(prepared, options, linear_plant, reference, rest_amplitude),
        others=others,
        fallen=fell,
    )
