"""One closed loop over time with every physics step kept, for plots and files.

of_loop    from parameters
follow     from a state
metrics_of the metrics of a loop that was followed
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
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
from jaxact.simulation import rollout
from jaxact.simulation.falling import Fall
from jaxact.simulation.metrics import SEGMENTS, Metrics
from jaxact.simulation.settling import staying
from jaxact.simulation.stopping import parted
from jaxact.simulation.verdicts import Judgement


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


def of_loop(
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
        options, ticks, setpoint, key, setpoints: as for `of_loop`.
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
    rubs: jax.Array | bool = False,
    others: Judgement | None = None,
    fell: Fall | None = None,
) -> tuple[Metrics, Judgement]:
    """Metrics of a loop that was followed, and its own judgement.

    Args:
        outputs: from `follow`, a multiple of `jaxact.simulation.metrics.SEGMENTS` of them.
        start: joint positions before the first tick [m or rad], shape (joints,).
        setpoint, active_ticks, setpoints, prepared, options, growth_rate, rest_amplitude, rubs,
            others: as for `jaxact.simulation.rollout.evaluate`.
        linear_plant: static; whether the plant is linear.
        fell: from `jaxact.simulation.falling.fall`.
    """
    reference = _metrics.reference(start, setpoint.position)
    ticks = outputs.position.shape[0]

    def tick(carry, inputs):
        running, envelope = carry
        periods = [rollout.period_of(inputs[0], reference, *inputs[1:], active_ticks)]
        return _metrics.update(running, envelope, periods), None

    def segment(carry, inputs):
        (running, envelope), _ = jax.lax.scan(tick, carry, inputs)
        return (running, _envelope.following(envelope)), envelope

    rows = outputs, jnp.arange(ticks, dtype=jnp.int32), setpoints
    carry = _metrics.init(start), _envelope.init(start)
    (running, _), envelopes = jax.lax.scan(segment, carry, parted(rows, SEGMENTS))
    period = prepared.drive.drive.control_period
    if setpoints is None:
        end = outputs.position[-1], outputs.velocity[-1]
        running = staying(running, reference, period, ticks, end)
    return _metrics.finish(
        running,
        envelopes,
        reference,
        growth_rate,
        period=period,
        ticks=ticks,
        counted=ticks if active_ticks is None else active_ticks,
        scale=rollout.scale_of(prepared, options, linear_plant, reference, rest_amplitude, rubs),
        others=others,
        fell=fell,
        told=setpoints is not None,
    )
