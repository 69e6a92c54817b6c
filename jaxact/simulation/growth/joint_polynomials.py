"""The open loop of a single joint as a short transfer function and a number of whole periods.

Only the sum of a loop's delays matters to its roots, so that the whole control periods in it can be
left out of the simulated step: what remains is a state of a few numbers,

    x' = A x + b u,    (position, velocity) as the controller reads them = C x,

from the derivative of the one step (`jaxact.loops.loop.step`) with shorter delays. Its poles are
those of plant, actuator and velocity filter, which follow from each other, so that each block has
its own factor; the numerators follow from the pulse responses C A^i b.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from jaxact.drive import delay as _delay
from jaxact.drive import step as _drive
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.step import Drive, DriveOptions
from jaxact.loops import loop as _loop
from jaxact.loops.loop import LoopState, Prepared
from jaxact.simulation.growth.delayed_loop import DelayedLoop, denominator


def applies(prepared: Prepared, state: LoopState) -> bool:
    """Whether the plant is a single joint whose position and velocity are its whole state."""
    position, _ = prepared.plant.measure(state.plant)
    numbers = sum(jnp.size(leaf) for leaf in jax.tree.leaves(state.plant))
    return bool(jnp.size(position) == 1 and numbers == 2)


def _whole_periods(drive: Drive, options: DriveOptions) -> tuple[Drive, jax.Array]:
    """The drive without the whole periods of its delays, and how many those are."""
    period, actuator, sensor = jnp.asarray(drive.control_period), drive.actuator, drive.sensor
    whole, rest = _delay.split(jnp.asarray(actuator.delay + drive.output_delay), period)
    short = replace(drive, actuator=replace(actuator, delay=rest), output_delay=0.0 * rest)
    if options.measurement_slots:
        late, rest = _delay.split(jnp.asarray(sensor.delay), period)
        short = replace(short, sensor=replace(sensor, delay=rest))
        whole = whole + late
    controller = replace(drive.controller, setpoint_delay=0.0 * rest)
    return replace(short, controller=controller), whole


def _shorter(prepared: Prepared, options: DriveOptions) -> tuple[Prepared, DriveOptions, jax.Array]:
    """The loop without whole periods of delay, and the periods that were left out."""
    drive, whole = _whole_periods(prepared.drive.drive, options)
    short = replace(
        options.linearised(),
        command_slots=1,
        measurement_slots=min(options.measurement_slots, 1),
        setpoint_slots=0,
        staged=False,
    )
    coefficients = _drive.prepare(drive, short, prepared.plant.shape, prepared.joint)
    return Prepared(prepared.plant, coefficients), short, whole


def _flat(state: LoopState, prepared: Prepared) -> dict[str, jax.Array]:
    """The numbers that a short loop remembers from one period to the next, by name."""
    position, velocity = prepared.plant.measure(state.plant)
    drive = state.drive
    named = {
        "position": position,
        "velocity": velocity,
        "force": drive.force,
        "rate": drive.rate,
        "held": drive.newer,
    }
    if drive.sensor.position is not None:
        named |= {"measured": drive.sensor.position, "estimate": drive.sensor.velocity}
    if drive.measurements is not None:
        late, late_rate = drive.measurements
        assert isinstance(late, tuple) and isinstance(late_rate, tuple)  # one slot each
        named |= {"late": late[0], "late_rate": late_rate[0]}
    return named


def _whole(named: dict[str, jax.Array], like: LoopState, prepared: Prepared) -> LoopState:
    """The state that `_flat` has made these numbers of."""
    drive = replace(like.drive, force=named["force"], rate=named["rate"], newer=named["held"])
    if "measured" in named:
        sensor = replace(drive.sensor, position=named["measured"], velocity=named["estimate"])
        drive = replace(drive, sensor=sensor)
    if "late" in named:
        drive = replace(drive, measurements=((named["late"],), (named["late_rate"],)))
    return LoopState(prepared.plant.init(named["position"], named["velocity"]), drive)


@dataclass(frozen=True)
class _OpenLoop:
    """A short loop opened at its controller; n states.

    Attributes:
        names: of the states.
        A: shape (n, n).
        b: shape (n,).
        C: position and velocity as the controller reads them, shape (2, n).
    """

    names: tuple[str, ...]
    A: jax.Array
    b: jax.Array
    C: jax.Array


def _open_loop(prepared: Prepared, options: DriveOptions) -> _OpenLoop:
    """The derivative of the step, by state and by a force added to the command."""
    rest = jnp.zeros_like(prepared.drive.drive.controller.kp)
    still = _loop.init(prepared, options, rest, rest)
    names = tuple(_flat(still, prepared))

    def advance(x: jax.Array, force: jax.Array, kp: float, kd: float):
        controller = Controller(kp=rest + kp, kd=rest + kd, feedforward=rest)
        drive = replace(prepared.drive.drive, controller=controller)
        driven = replace(prepared, drive=replace(prepared.drive, drive=drive))
        named = {name: x[place] + rest for place, name in enumerate(names)}
        before = _whole(named, still, prepared)
        after, (output, _) = _loop.step(driven, options, before, Setpoint(rest, force=rest + force))
        state = _flat(after, prepared)
        return jnp.stack([state[name].reshape(()) for name in names]), output.command.reshape(())

    start, none = jnp.zeros(len(names), rest.dtype), jnp.zeros((), rest.dtype)
    A, b = jax.jacfwd(lambda x, force: advance(x, force, 0.0, 0.0)[0], argnums=(0, 1))(start, none)
    # With kp = 1 and kd = 0 the command is minus the measured position.
    C = [
        -jax.jacfwd(lambda x, gains=gains: advance(x, none, *gains)[1])(start)
        for gains in ((1.0, 0.0), (0.0, 1.0))
    ]
    return _OpenLoop(names, A, b, jnp.stack(C))


def _factor(block: jax.Array) -> jax.Array:
    """(b, c) of det(w - block) = w^2 + b w + c."""
    trace = block[0, 0] + block[1, 1]
    return jnp.stack([-trace, block[0, 0] * block[1, 1] - block[0, 1] * block[1, 0]])


def delayed_loop(prepared: Prepared, options: DriveOptions) -> DelayedLoop:
    """L(z) of the simulated loop of one joint, without noise, quantisation and limits.

    Args:
        prepared: from `jaxact.loops.loop.prepare`; a plant whose state is one position and one
        velocity.
        options: static.
    """
    short, small, whole = _shorter(prepared, options)
    opened = _open_loop(short, small)
    names, A = opened.names, opened.A
    change = A - jnp.eye(len(names), dtype=A.dtype)

    def block(*of: str) -> jax.Array:
        places = jnp.array([names.index(name) for name in of])
        return change[places[:, None], places]

    factors = [_factor(block("position", "velocity")), _factor(block("force", "rate"))]
    if "estimate" in names:
        # The filter's pole, and one of the poles at 0 that what is merely kept has.
        gain = -change[names.index("estimate"), names.index("estimate")]
        factors.append(jnp.stack([1.0 + gain, gain]))
    controller = short.drive.drive.controller
    gains = jnp.stack([jnp.reshape(controller.kp, ()), jnp.reshape(controller.kd, ())])
    seen, pulse = gains @ opened.C, [opened.b]
    for _ in names[1:]:
        pulse.append(A @ pulse[-1])
    responses = jnp.stack([seen @ state for state in pulse])
    stacked = jnp.stack(factors)
    numerator = jnp.convolve(denominator(stacked), responses)[: len(names)]
    return DelayedLoop(stacked, numerator, whole.reshape(()))
