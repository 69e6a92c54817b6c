"""The loop of a joint in continuous time, in steps that need not resolve its lags.

Over a step h the joint and its servo, x = (q, v h, a h^2, a'/wn h^2), see a command w that changes
linearly, which the exponential of their matrix takes exactly:

    x_{k+1} = Phi x_k + G w_k + H (w_{k+1} - w_k),
    w(t) = kp r(t) - y(t - delay),    y = kp q + kd v

Between steps y is taken to be linear, so that the error shrinks like h^2. A delay shorter than a
step makes y_{k+1} depend on itself; it is a number, and one division finds it.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp

from jaxact.matrix_exponential import exponential_less_one

_STATES = 4


def positions(
    kp: jax.Array,
    kd: jax.Array,
    plant: jax.Array,
    setpoints: jax.Array,
    delay: jax.Array,
    *,
    step: float,
    longest: float,
    cutoff: float = math.inf,
) -> jax.Array:
    """Positions of one loop at 0, h, 2 h, ... [m], shape (ticks,), from rest at the first setpoint.

    Args:
        kp, kd: [N/m], [N s/m].
        plant: m, wn, zeta, an unused number, and of sprung joints damping and stiffness.
        setpoints: as they arrive at the servo [m], shape (ticks,); of a step from 0 all are its
            height, and so is none before them.
        delay: of what is fed back [s].
        step: h [s], static.
        longest: of all delays [s], static.
        cutoff: of the filter of the velocity [rad/s], inf = none.
    """
    return _march(kp, kd, plant, setpoints, delay, setpoints[0], step, longest, cutoff)


def step_positions(
    kp: jax.Array,
    kd: jax.Array,
    plant: jax.Array,
    ticks: int,
    delay: jax.Array,
    *,
    step: float,
    longest: float,
    cutoff: float = math.inf,
) -> jax.Array:
    """As `positions`, from rest at 0 after a setpoint of 1, which arrives at the time 0."""
    ones = jnp.ones((ticks,), jnp.result_type(kp, plant))
    return _march(kp, kd, plant, ones, delay, 0.0 * ones[0], step, longest, cutoff)


def _march(
    kp: jax.Array,
    kd: jax.Array,
    plant: jax.Array,
    setpoints: jax.Array,
    delay: jax.Array,
    start: jax.Array,
    step: float,
    longest: float,
    cutoff: float,
) -> jax.Array:
    grown, held, ramp = _transition(plant, step, cutoff)
    scale = step * step / plant[0]
    stiff, damped = kp * scale, kd * scale / step
    row = jnp.zeros(len(held), held.dtype).at[0].set(stiff)
    row = row.at[1 if math.isinf(cutoff) else _STATES].set(damped)
    late = delay / step
    whole = jax.lax.stop_gradient(jnp.floor(late))
    part = late - whole
    # y(t_{k+1} - delay) from y_k, y_{k-1}, ...; with what of y_{k+1} itself is in it.
    places = jnp.arange(int(longest / step) + 2, dtype=held.dtype)
    share = jnp.where(places == whole - 1.0, 1.0 - part, jnp.where(places == whole, part, 0.0))
    own = jnp.where(whole == 0.0, 1.0 - part, 0.0)
    inward = 1.0 / (1.0 + own * jnp.sum(row * ramp))

    def once(
        carry: tuple[jax.Array, jax.Array, jax.Array], aim: jax.Array
    ) -> tuple[tuple[jax.Array, jax.Array, jax.Array], jax.Array]:
        """One step, to where the setpoint is `aim`."""
        x, command, fed = carry
        back = jnp.sum(share * fed)
        change = jnp.sum(grown * x[None], axis=1) + held * command
        x = x + change + ramp * (stiff * aim - back - command)
        y = inward * jnp.sum(row * x)
        x = x - ramp * (own * y)
        command = stiff * aim - back - own * y
        return (x, command, jnp.concatenate([y[None], fed[:-1]])), x[0]

    x = jnp.zeros(len(held), held.dtype).at[0].set(start)
    fed = jnp.full(places.shape, stiff * start)
    begun = x, stiff * (setpoints[0] - start), fed
    path = jax.lax.scan(once, begun, setpoints[1:])[1]
    return jnp.concatenate([x[:1], path])


def _transition(
    plant: jax.Array, step: float, cutoff: float
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Phi - 1, G and H; the filtered velocity is a state of its own where there is a filter."""
    mass, wn, zeta, _, *joint = plant
    ideal = jnp.isinf(wn)
    x = jnp.where(ideal, 0.0, wn * step)
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    direct = jnp.where(ideal, one, zero)
    damping, stiffness = joint or (zero, zero)
    filtered = not math.isinf(cutoff)
    size = _STATES + filtered
    rate = jnp.zeros((size + 2, size + 2), x.dtype)
    rate = rate.at[0, 1].set(1.0)
    rate = rate.at[1, :3].set(
        jnp.stack([-stiffness * step * step / mass, -damping * step / mass, one - direct])
    )
    rate = rate.at[1, size].set(direct)
    rate = rate.at[2, 3].set(x)
    rate = rate.at[3, 2].set(-x).at[3, 3].set(-2.0 * zeta * x).at[3, size].set(x)
    if filtered:
        rate = rate.at[_STATES, 1].set(cutoff * step).at[_STATES, _STATES].set(-cutoff * step)
    rate = rate.at[size, size + 1].set(1.0)
    grown = exponential_less_one(rate)
    return grown[:size, :size], grown[:size, size], grown[:size, size + 1]
