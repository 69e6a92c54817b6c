"""Whether a response that is within the band at the end of a rollout stays in it.

One that swings through the band just then is in it, too. It stays if

    e^2 + (v / w)^2 <= b^2   or   it has been in the band for 3.1 t

with the error e and the velocity v at the end and the half-width b of the band. The frequency w of
the swing is taken from the rise time t, which of a second-order response with damping ratio z is
(1.02 + 2.34 z^2) / w within 7 %; z from the overshoot exp(-pi z / sqrt(1 - z^2)). Without damping
the first is the amplitude of the swing, and 3.1 t half its period, in which it leaves the band.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp

from jaxact.simulation.metrics import SETTLED, Reference, Running

_HALF_SWING = 3.1  # pi / 1.02, rise times
_LEAST = 1e-9  # overshoot; less is as good as none


def staying(
    running: Running,
    aim: Reference,
    period: jax.Array,
    ticks: int | jax.Array,
    end: tuple[jax.Array, jax.Array],
) -> Running:
    """The accumulators of a response that has not settled, unless it stays in the band.

    Args:
        running: of all periods.
        aim: of the step, constant.
        period: control period [s].
        ticks: number of them.
        end: position [m or rad] and velocity then, shape (joints,).
    """
    position, velocity = end
    error = (position - aim.target) * aim.per_span
    rise = running.high - running.low
    rise = jnp.where(jnp.isfinite(rise), rise, 0.0)
    fall = jnp.square(jnp.log(jnp.clip(running.highest - 1.0, _LEAST, 1.0)))
    damping = fall / (jnp.pi**2 + fall)  # z^2
    swing = velocity * aim.per_span * rise * period / (1.02 + 2.34 * damping)
    stays = jnp.square(error) + jnp.square(swing) <= SETTLED**2
    stays |= ticks - running.unsettled >= _HALF_SWING * rise
    return replace(running, unsettled=jnp.where(stays, running.unsettled, jnp.inf))
