"""One closed loop over time: a scan over control periods, with metrics and without a trajectory.

run        step response with metrics accumulated on the way
evaluate   its metrics, verdict and growth rate included
judged     what comes of one start, for the verdict
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.drive import sensor as _sensor
from jaxact.drive.controller import Setpoint
from jaxact.drive.step import DriveOptions
from jaxact.loops import loop as _loop
from jaxact.loops.loop import LoopState, Output, Prepared
from jaxact.robots.base import Base
from jaxact.simulation import envelope as _envelope
from jaxact.simulation import metrics as _metrics
from jaxact.simulation import own_ticks as _own_ticks
from jaxact.simulation import scales as _scales
from jaxact.simulation import stopping
from jaxact.simulation.envelope import Envelope
from jaxact.simulation.falling import fall
from jaxact.simulation.growth import rate as _growth
from jaxact.simulation.growth.rate import GrowthOptions
from jaxact.simulation.metrics import SEGMENTS, Metrics, Period, Reference, Running
from jaxact.simulation.own_ticks import Tick
from jaxact.simulation.scales import Scale
from jaxact.simulation.settling import staying
from jaxact.simulation.stopping import parted
from jaxact.simulation.verdicts import Judgement


@dataclass(frozen=True)
class RolloutOptions:
    """The static side of a rollout.

    Attributes:
        ticks: control periods; a multiple of `jaxact.simulation.metrics.SEGMENTS`.
        several: loops that are computed together have numbers of them of their own, up to `ticks`.
        unroll: largest number of control periods in one iteration of the compiled loop.
        linear_plant: whether the plant is linear, so that a linear drive makes a linear loop.
        stops: end early where no loop of a batch has finite metrics any more; it changes no result
            and leaves no derivative in reverse.
    """

    ticks: int
    unroll: int = 1
    linear_plant: bool = True
    stops: bool = False
    several: bool = False


def whole_ticks(duration: float, control_period: np.ndarray | float) -> np.ndarray:
    """Smallest numbers of ticks that cover a duration [s] and can be cut into segments.

    Args:
        duration: to be covered [s].
        control_period: [s], any shape.
    """
    segment = np.ceil(duration / np.asarray(control_period) / SEGMENTS - 1e-9)
    return SEGMENTS * np.maximum(segment, 1.0).astype(int)


def period_of(
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


def _tick_of(
    prepared: Prepared,
    options: DriveOptions,
    setpoint: Setpoint,
    key: jax.Array | None,
    start: jax.Array,
    reference: Reference,
    active_ticks: jax.Array | None,
) -> Tick:
    """What one control period does, see `jaxact.simulation.own_ticks.Tick`."""

    def tick(state, inputs):
        number, given = inputs
        wanted = setpoint if given is None else given
        draws = _loop.stage(options, _sensor.draw(options.sensor, key, number, start))
        state, (output, _) = _loop.step(prepared, options, state, wanted, draws)
        passed = period_of(output, reference, number, given, active_ticks)
        return _loop.stage(options, state), passed

    return tick


def run(
    prepared: Prepared,
    options: DriveOptions,
    rollout: RolloutOptions,
    state: LoopState,
    setpoint: Setpoint,
    key: jax.Array | None = None,
    *,
    active_ticks: jax.Array | None = None,
    own_ticks: jax.Array | None = None,
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
        own_ticks: after which the loop is over, a multiple of the number of segments, shape ();
            None: all. Only where `rollout.several`, and of a constant setpoint.
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
    reference = _metrics.reference(start, setpoint.position)
    length = rollout.ticks // SEGMENTS

    steady = active_ticks is None and setpoints is None
    together = stopping.together(length, rollout.unroll)
    span = stopping.stretch(length, together) if rollout.stops else length

    tick = _tick_of(prepared, options, setpoint, key, start, reference, active_ticks)
    if rollout.several:
        return _own_ticks.run(tick, state, start, own_ticks, rollout.unroll)

    def ticks(carry, inputs):
        state, running, envelope = carry
        periods = []
        for place in range(together):
            state, period = tick(state, jax.tree.map(operator.itemgetter(place), inputs))
            periods.append(period)
        running, envelope = _metrics.update(running, envelope, periods, ends=steady)
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
    inputs = firsts, parted(setpoints, SEGMENTS)
    (state, running, _), envelopes = jax.lax.scan(segment, carry, inputs)
    if steady:
        ends = start, prepared.plant.measure(state.plant)[0]
        running = _metrics.trapezoidal(running, reference, *ends)
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
    own_ticks: jax.Array | None = None,
    growth: GrowthOptions | None = None,
    setpoints: Setpoint | None = None,
    rest_amplitude: jax.Array | float = 0.0,
    rubs: jax.Array | bool = False,
    others: Judgement | None = None,
    bases: tuple[Base, ...] = (),
) -> Metrics:
    """Metrics of a step response, verdict and growth rate included.

    Args:
        prepared, options, rollout, state, setpoint, key, active_ticks, own_ticks, setpoints: as for
            `run`.
        rest_amplitude: a motion smaller than this counts as at rest [m or rad], shape (joints,).
        rubs: whether dry friction acts in the robot, shape ().
        others: from `judged`, of other starts of the same loop, shape (starts, joints).
        growth_rate: [1/s] if it is known already (in float64, say), else it is measured here.
        growth: static; how it is measured; None for the usual way.
        bases: static; as for `jaxact.simulation.falling.fall`.
    """
    if growth_rate is None:
        # Whether a policy holds the setpoint is none of the loop's business.
        free = replace(state, drive=replace(state.drive, held=None))
        drive, how = replace(options, held_setpoint=False), growth or GrowthOptions()
        growth_rate = _growth.growth_rate(prepared, drive, free, setpoint, how)
    start, _ = prepared.plant.measure(state.plant)
    end, running, envelopes = run(
        prepared, options, rollout, state, setpoint, key,
        active_ticks=active_ticks, own_ticks=own_ticks, setpoints=setpoints,
    )  # fmt: skip
    reference = _metrics.reference(start, setpoint.position)
    period = prepared.drive.drive.control_period
    ticks = rollout.ticks if own_ticks is None else own_ticks
    if setpoints is None:
        last = prepared.plant.measure(end.plant)
        running = staying(running, reference, period, ticks, last)
    found, _ = _metrics.finish(
        running,
        envelopes,
        reference,
        growth_rate,
        period=period,
        ticks=ticks,
        counted=ticks if active_ticks is None else active_ticks,
        scale=scale_of(prepared, options, rollout.linear_plant, reference, rest_amplitude, rubs),
        others=others,
        fell=fall(bases, state.plant, end.plant, told=setpoints is not None),
        told=setpoints is not None,
    )
    return found


def scale_of(
    prepared: Prepared,
    options: DriveOptions,
    linear_plant: bool,
    reference: Reference,
    rest_amplitude: jax.Array | float,
    rubs: jax.Array | bool,
) -> Scale | None:
    """What the motions of a loop are measured with; None of one that is linear, but for noise."""
    if options.additive and linear_plant:
        return None
    size = jnp.maximum(jnp.abs(reference.start), jnp.abs(reference.target))
    drive, joint = prepared.drive.drive, prepared.joint
    return _scales.scale(
        drive, size, rest_amplitude, linear_plant=linear_plant, rubs=rubs, joint=joint
    )


def judged(
    prepared: Prepared,
    options: DriveOptions,
    rollout: RolloutOptions,
    state: LoopState,
    setpoint: Setpoint,
    key: jax.Array | None = None,
    *,
    growth_rate: jax.Array,
    own_ticks: jax.Array | None = None,
    rest_amplitude: jax.Array | float = 0.0,
    rubs: jax.Array | bool = False,
    bases: tuple[Base, ...] = (),
) -> Judgement:
    """What comes of one start, for `others` of `evaluate`; arguments as there, (joints,)."""
    start, _ = prepared.plant.measure(state.plant)
    loop = prepared, options, rollout, state, setpoint, key
    end, running, envelopes = run(*loop, own_ticks=own_ticks)
    reference = _metrics.reference(start, setpoint.position)
    return _metrics.judge(
        running,
        envelopes,
        reference,
        growth_rate,
        period=prepared.drive.drive.control_period,
        ticks=rollout.ticks if own_ticks is None else own_ticks,
        scale=scale_of(prepared, options, rollout.linear_plant, reference, rest_amplitude, rubs),
        fell=fall(bases, state.plant, end.plant),
    )
