"""The way of a setpoint to the controller: held at the policy's rate, then delayed.

A policy, or a planner, gives setpoints at a rate of its own, an n-th of the control rate:

    r_k = r(t_j),   j = n floor(k / n),     n = control rate / policy rate,

and what reaches the controller at tick k is that signal as it was the setpoint delay ago, linear
between the ticks: of a step, a part arrives a tick before the whole of it does. Nothing of it lies
inside the loop, so that stability and margins do not depend on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.drive import delay as _delay
from jaxact.drive.controller import Setpoint

Lines = tuple[_delay.Line, _delay.Line, _delay.Line]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Held:
    """A setpoint between two ticks of the policy.

    Attributes:
        setpoint: as it was sampled, leaves of shape (joints,).
        age: control ticks since then [-], shape (joints,).
    """

    setpoint: Setpoint
    age: jax.Array


def ticks_of_policy(policy_period: jax.Array, control_period: jax.Array) -> jax.Array:
    """n, the control ticks in a period of the policy [-]; 1 for a period of 0."""
    return jnp.maximum(jnp.round(policy_period / control_period), 1.0)


def begin(position: jax.Array, every: jax.Array) -> Held:
    """Before the first tick, which is one of the policy's.

    Args:
        position: of the plant [m or rad], shape (joints,); nothing reads it.
        every: n, see the module; shape (joints,).
    """
    zero = jnp.zeros_like(position)
    return Held(Setpoint(position, zero, zero), zero + (every - 1.0))


def hold(held: Held, setpoint: Setpoint, every: jax.Array) -> Held:
    """The setpoint of this control tick: a new one where the policy ticks, else the one before.

    Args:
        held: of the tick before.
        setpoint: given now, leaves broadcastable to (joints,).
        every: n, see the module; shape (joints,).
    """
    age = held.age + 1.0
    new = age > every - 0.5
    values = jax.tree.map(lambda now, old: jnp.where(new, now, old), setpoint, held.setpoint)
    return Held(values, jnp.where(new, 0.0, age))


def late(
    lines: Lines, setpoint: Setpoint, at: tuple[Any, Any], share: jax.Array, like: jax.Array
) -> tuple[Lines, Setpoint]:
    """Push a setpoint and read it as it was, linear between the ticks around that time.

    Args:
        lines: of positions, velocities and forces.
        setpoint: of this tick.
        at: selectors of the newer and the older entry.
        share: of the older entry [-].
        like: any joint quantity, shape (joints,).
    """
    values = (setpoint.position, setpoint.velocity, setpoint.force)
    pushed = tuple(
        _delay.push(line, value + jnp.zeros_like(like))
        for line, value in zip(lines, values, strict=True)
    )
    newer_at, older_at = at
    read = (
        (1.0 - share) * _delay.read(line, newer_at) + share * _delay.read(line, older_at)
        for line in pushed
    )
    return (pushed[0], pushed[1], pushed[2]), Setpoint(*read)
