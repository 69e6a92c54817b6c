"""The force loop alone: what a drive makes of the commands in a log.

    f'' + 2 zeta wn f' + wn^2 f = wn^2 gain u(t - delay),      measured: f + offset, within limits

on the log's own time stamps, with the closed form of `jaxact.drive.actuator`. Of the time before a
log three numbers are left: the force and its rate at the first row, and the command that was held
before, which acts until the first one arrives.
"""

from __future__ import annotations

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from jaxact.identification import free_response
from jaxact.identification.schedule import schedule
from jaxact.parameters import DELAY, FORCE_LIMIT, WN, ZETA

INITIAL_FORCE, INITIAL_RATE, EARLIER = "initial_force", "initial_rate", "earlier_command"


def simulate(
    time: jax.Array, command: jax.Array, values: Mapping[str, jax.Array | float]
) -> jax.Array:
    """The force at each row.

    Args:
        time: of the rows [s], shape (rows,).
        command: held from each row on [N or N m], shape (rows,).
        values: `gain` [-], `offset` [N or N m], `wn` [rad/s] (may be infinite), `zeta`, `delay`
            [s], `force_limit` [N or N m] (may be infinite); `initial_force` without the offset
            [N or N m], `initial_rate` of it [N/s or N m/s], 0 where it is not there, and
            `earlier_command` [N or N m], the first one where it is not there.

    Returns:
        [N or N m], shape (rows,). An ideal drive's force at a row is the one just after a command
        that arrives at that instant.
    """
    plan = schedule(time, jnp.asarray(values[DELAY], time.dtype))
    wn, zeta = (jnp.asarray(values[name], time.dtype) for name in (WN, ZETA))
    held = jnp.where(
        plan.held < 0, values.get(EARLIER, command[0]), command[jnp.maximum(plan.held, 0)]
    )
    inputs = values["gain"] * held
    known = free_response.coefficients(wn, zeta, plan.length)

    def advance(carry, at):
        force, rate = carry
        known, length, value = at
        over = free_response.along(known, wn, zeta, length)
        offset = force - value
        after = (
            value + over.c * offset + over.s * rate,
            over.rate_e * offset + over.rate_g * rate,
        )
        return after, force

    begun = values[INITIAL_FORCE], values.get(INITIAL_RATE, 0.0)
    start = tuple(jnp.asarray(value, time.dtype) for value in begun)
    _, forces = jax.lax.scan(advance, start, (known, plan.length, inputs))
    followed = jnp.where(jnp.isinf(wn), inputs[_last_of_instant(plan)], forces[plan.row])
    limit = values[FORCE_LIMIT]
    return jnp.clip(followed, -limit, limit) + values["offset"]


def _last_of_instant(plan):
    """The interval that begins at each row once everything of that instant has happened."""
    after = plan.row + 1
    at_once = (plan.length[plan.row] == 0.0) & ~plan.is_row[
        jnp.minimum(after, plan.is_row.size - 1)
    ]
    return jnp.where(at_once, jnp.minimum(after, plan.is_row.size - 1), plan.row)
