"""A joint with friction and gravity behind its drive, on the log's own time stamps.

    J q'' = f - c q' - F(q', f, load) - G sin(q - q0) + offset
    f: the force of the drive, see `jaxact.drive.actuator`, for the command of the controller

Between two instants at which something switches the force is integrated in closed form, and so is
the joint's viscous damping; dry friction brakes until the joint comes to rest, from where it sticks
or turns back. Of second order in the step, exact without friction and gravity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.drive import controller as _controller
from jaxact.drive.actuator import Free
from jaxact.drive.controller import Controller, Setpoint
from jaxact.identification import free_response
from jaxact.identification.recording import Recording
from jaxact.identification.schedule import schedule
from jaxact.parameters import (
    DELAY,
    FEEDFORWARD,
    FORCE_LIMIT,
    INITIAL_POSITION,
    INITIAL_VELOCITY,
    KD,
    KP,
    SETPOINT,
    WN,
    ZETA,
)

INITIAL_FORCE = "initial_force"
"""What the drive gives beyond what holds the joint as a log begins in motion [N or N m]."""
COMMAND_LIMIT = "command_limit"
"""The largest command that the drive follows, in either direction [N or N m]."""
_NO_LIMIT = 1e15
# Intervals are a little longer than nothing [s]: so a joint that stands knows where it would move.
_NO_TIME = 1e-15


@dataclass(frozen=True)
class Structure:
    """What of a joint and its controller is not a number; static where JAX traces.

    Attributes:
        closed: the controller is simulated; otherwise the log's command is given to the drive.
        history: commands that are remembered for the longest delay.
        difference_ticks: periods of the controller over which it differences the position; 0 for
            the speed.
        gravity: the joint carries a pendulum.
    """

    closed: bool
    history: int
    difference_ticks: int
    gravity: bool


@dataclass(frozen=True)
class _Carry:
    position: jax.Array
    velocity: jax.Array
    force: jax.Array
    rate: jax.Array
    commands: jax.Array
    ticks: jax.Array
    seen: tuple[jax.Array, ...]


jax.tree_util.register_dataclass(_Carry)


def simulate(
    values: Mapping[str, Any], recording: Recording, structure: Structure
) -> tuple[jax.Array, jax.Array]:
    """Position and command at each row.

    Args:
        values: inertia [kg or kg m^2] (with links armature, beside theirs), gain, wn [rad/s],
            zeta, delay [s], force_limit and command_limit [N or N m], friction by `_friction`,
            gravity [N m], zero [rad], offset [N or N m], kp and kd where the recording has none,
            initial_position, initial_velocity, initial_force.
        recording: the log.
        structure: static.

    Returns:
        Position [m or rad] and command [N or N m], each of shape (rows,).
    """
    plan = schedule(recording.time, jnp.asarray(values[DELAY], recording.time.dtype))
    wn, zeta = (jnp.asarray(values[name], recording.time.dtype) for name in (WN, ZETA))
    length = plan.length + jnp.where(plan.length == 0.0, _NO_TIME, 0.0)
    known = free_response.coefficients(wn, zeta, length)
    tick = jnp.cumsum(plan.is_row) - 1
    own = {
        SETPOINT: recording.setpoint[tick],
        FEEDFORWARD: recording.feedforward[tick],
        "controls": plan.is_row & recording.controls[tick],
        "is_row": plan.is_row,
        "held": plan.held,
        "command": recording.command[jnp.maximum(plan.held, 0)],
        "strength": recording.strength[jnp.maximum(plan.held, 0)],
        "length": length,
        "links": jax.tree.map(lambda rows: rows[tick], recording.links),
    }
    begin = _begin(values, recording, structure)

    def advance(carry: _Carry, at: tuple[Any, Mapping[str, jax.Array]]) -> tuple[_Carry, Any]:
        known, now = at
        over = free_response.along(known, wn, zeta, now["length"])
        carry, command = _control(values, recording, structure, carry, now)
        held = carry.commands[now["held"] % structure.history] if structure.closed else command
        output = (
            carry.position,
            held if not structure.closed else carry.commands[(carry.ticks - 1) % structure.history],
        )
        return _move(values, structure, carry, over, now, held), output

    _, (position, command) = jax.lax.scan(advance, begin, (known, own))
    at = plan.row[recording.row]
    return position[at], command[at]


def _begin(values: Mapping[str, Any], recording: Recording, structure: Structure) -> _Carry:
    dtype = recording.time.dtype
    position, velocity = (
        jnp.asarray(jnp.where(jnp.isnan(given), measured, given), dtype)
        for given, measured in (
            (values.get(INITIAL_POSITION, math.nan), recording.position),
            (values.get(INITIAL_VELOCITY, math.nan), recording.velocity),
        )
    )
    zero = jnp.zeros((), dtype)
    period, number = recording.control_period, structure.difference_ticks
    seen = tuple(position - velocity * period * (late + 1) for late in range(number))
    # The force that holds the joint where it is, where it stood before the log began.
    force = values["gravity"] * jnp.sin(position - values["zero"]) if structure.gravity else zero
    force = force if recording.links is None else recording.links.force[0]
    force = force + jnp.nan_to_num(values.get(INITIAL_FORCE, 0.0))
    return _Carry(
        position=position,
        velocity=velocity,
        force=jnp.asarray(force - values["offset"], dtype),
        rate=zero,
        commands=jnp.full(structure.history, (force - values["offset"]) / values["gain"], dtype),
        ticks=jnp.zeros((), jnp.int32),
        seen=seen,
    )


def _control(
    values: Mapping[str, Any],
    recording: Recording,
    structure: Structure,
    carry: _Carry,
    now: Mapping[str, jax.Array],
) -> tuple[_Carry, jax.Array]:
    """The controller at a tick; between ticks nothing changes."""
    limit = jnp.minimum(values.get(COMMAND_LIMIT, jnp.inf), recording.command_limit)
    if not structure.closed:
        return carry, jnp.clip(now["command"], -limit, limit)
    kp = values.get(KP, recording.kp)
    kd = values.get(KD, recording.kd)
    speed = carry.velocity
    if structure.difference_ticks:
        over = structure.difference_ticks * recording.control_period
        speed = (carry.position - carry.seen[-1]) / over
    asked = _controller.step(
        Controller(kp=kp, kd=kd),
        Setpoint(now[SETPOINT], force=now[FEEDFORWARD]),
        carry.position,
        speed,
        quantised=False,
    )
    asked = jnp.clip(asked, -limit, limit)
    last = carry.commands[(carry.ticks - 1) % structure.history]
    command = jnp.where(now["controls"], asked, last)
    slot = carry.ticks % structure.history
    commands = jnp.where(now["is_row"], carry.commands.at[slot].set(command), carry.commands)
    seen = (
        tuple(
            jnp.where(now["controls"], new, old)
            for new, old in zip((carry.position, *carry.seen[:-1]), carry.seen, strict=True)
        )
        if carry.seen
        else ()
    )
    ticks = carry.ticks + now["is_row"].astype(jnp.int32)
    return (
        _Carry(carry.position, carry.velocity, carry.force, carry.rate, commands, ticks, seen),
        command,
    )


def _move(
    values: Mapping[str, Any],
    structure: Structure,
    carry: _Carry,
    over: Free,
    now: Mapping[str, Any],
    held: jax.Array,
) -> _Carry:
    """Drive and joint over one interval with a constant input."""
    length = now["length"]
    value = values["gain"] * now["strength"] * held
    e, g = carry.force - value, carry.rate
    impulse = value * length + over.Ic * e + over.Is * g
    moment = 0.5 * value * length * length + over.Jc * e + over.Js * g
    # Finite, as it is multiplied by times that may be zero.
    limit = jnp.minimum(values[FORCE_LIMIT], _NO_LIMIT)
    impulse = _within(impulse, limit * length)
    moment = _within(moment, 0.5 * limit * length**2)
    force = value + over.c * e + over.s * g
    rate = over.rate_e * e + over.rate_g * g
    links = now["links"]
    inertia = values["inertia"] if links is None else values["armature"] + links.inertia
    position, velocity = carry.position, carry.velocity
    pull, slope, bend = _pull(values, structure, links, position + 0.5 * length * velocity)
    load = values["offset"] - pull
    asked = impulse / length
    forwards = jnp.where(velocity == 0.0, asked + load >= 0.0, velocity > 0.0)
    viscous, dry = _braking(values, forwards, velocity, (asked, load, pull), length / inertia)
    decay = viscous * length / inertia
    one, two = _phi(decay)
    most = jnp.where(forwards, one, -one) * length * dry / inertia
    sliding = jnp.exp(-decay) * velocity + one * (impulse + length * load) / inertia - most
    moved = (
        position
        + length * one * velocity
        + 2.0 * two * (moment + 0.5 * length * length * load) / inertia
        - length * two / one * most
    )
    excess = [jnp.where(forwards, f + load, -f - load) - dry for f in (carry.force, asked, force)]
    late, gained, gone = _broken_loose(*excess)
    late = late & (velocity == 0.0) & jnp.isfinite(values[WN])
    sign = jnp.where(forwards, length, -length) / inertia
    sliding = jnp.where(late, sign * gained, sliding)
    moved = jnp.where(late, position + sign * length * gone, moved)
    if structure.gravity or links is not None:
        # What the pull along the way is beyond the one halfway, of third order in the interval.
        more = length**2 * (slope * (sliding - velocity) / 6.0 + bend * length * velocity**2 / 24.0)
        sliding = sliding - more / inertia
        moved = moved + slope * velocity * length**3 / (12.0 * inertia)
    # Once it has come to rest friction points the other way: the joint sticks there or turns back.
    stops = jnp.where(forwards, sliding < 0.0, sliding > 0.0)
    change = jnp.where(stops, sliding - velocity, 1.0)
    rest = jnp.where(stops, length * sliding / change, 0.0)
    _, back = _friction(values, ~forwards, 0.0, asked, pull)
    turned = jnp.minimum(rest * (dry + back) / inertia - jnp.abs(sliding), 0.0)
    after = jnp.where(stops, jnp.where(forwards, turned, -turned), sliding)
    moved = moved + 0.5 * rest * (after - sliding)
    return _Carry(moved, after, force, rate, carry.commands, carry.ticks, carry.seen)


def _braking(
    values: Mapping[str, Any],
    forwards: jax.Array,
    velocity: jax.Array,
    forces: tuple[jax.Array, jax.Array, jax.Array],
    over: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Viscous coefficient and dry friction over an interval, see `_friction`.

    Near rest dry friction changes with the speed: that halfway makes it of second order.

    Args:
        values: of the joint.
        forwards: the direction it moves in, or would.
        velocity: as the interval begins.
        forces: what the drive gives, what load adds to it, and what of it pulls at a gear.
        over: length of the interval over the inertia.
    """
    asked, load, pull = forces
    viscous, dry = _friction(values, forwards, velocity, asked, pull)
    if "stribeck" in values:
        driven = asked + load - viscous * velocity
        driven = jnp.where(forwards, driven, -driven) - dry
        faster = jnp.where(velocity == 0.0, jnp.maximum(driven, 0.0), driven)
        halfway = jnp.maximum(jnp.abs(velocity) + 0.5 * over * faster, 0.0)
        _, dry = _friction(values, forwards, halfway, asked, pull)
    return viscous, dry


def _pull(
    values: Mapping[str, Any], structure: Structure, links: Any, position: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """What weight and links pull back with at a position [N or N m], and its two derivatives."""
    pull = slope = bend = jnp.zeros_like(position)
    if structure.gravity:
        angle = position - values["zero"]
        pull = values["gravity"] * jnp.sin(angle)
        slope, bend = values["gravity"] * jnp.cos(angle), -pull
    if links is not None:
        pull = pull + links.force + links.stiffness * (position - links.position)
        slope = slope + links.stiffness
    return pull, slope, bend


def _broken_loose(
    begin: jax.Array, mean: jax.Array, end: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """A joint at rest that a growing force moves from within an interval on.

    The force beyond friction is below zero as the interval begins, and a line of this mean and end.

    Returns:
        Whether it is so, and the integrals of the force from there on, once and twice, over an
        interval of length 1.
    """
    late = (begin < 0.0) & (end > 0.0)
    steep = jnp.where(late, jnp.maximum(end - mean, 0.5 * end), 1.0)
    share = 0.5 * end / steep  # of the interval, above zero
    gained = 0.5 * end * share
    return late, gained, gained * share / 3.0


def _within(value: jax.Array, limit: jax.Array) -> jax.Array:
    """The value within its limit; with its own derivative where both are zero, unlike `clip`."""
    return jnp.where(jnp.abs(value) > limit, jnp.sign(value) * limit, value)


def _phi(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """``(1 - exp(-x)) / x`` and ``(x - 1 + exp(-x)) / x^2``, also where x is small."""
    small = jnp.abs(x) < 1e-3
    safe = jnp.where(small, 1.0, x)
    one = jnp.where(small, 1.0 - x / 2.0 + x * x / 6.0, -jnp.expm1(-safe) / safe)
    two = jnp.where(small, 0.5 - x / 6.0 + x * x / 24.0, (1.0 - one) / safe)
    return one, two


def _friction(
    values: Mapping[str, Any],
    forwards: jax.Array,
    velocity: jax.Array | float,
    force: jax.Array,
    pull: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Viscous coefficient [N s/m or N m s/rad] and dry friction [N or N m] in this interval.

    ``F = (F0 + loaded max(|f|, |G sin q|)) (1 + stribeck exp(-(v / v_s)^2))``, with factors of
    their own for the two directions where friction is asymmetric: a gear is loaded by the larger of
    what drives it and what it carries, whichever side that comes from.
    """
    viscous = jnp.where(forwards, values["viscous"], values.get("viscous_back", values["viscous"]))
    dry = jnp.where(forwards, values["coulomb"], values.get("coulomb_back", values["coulomb"]))
    if "loaded" in values:
        dry = dry + values["loaded"] * jnp.maximum(jnp.abs(force), jnp.abs(pull))
    if "stribeck" in values:
        slow = jnp.exp(-jnp.square(velocity / values["stribeck_speed"]))
        dry = dry * (1.0 + values["stribeck"] * slow)
    return viscous, dry
