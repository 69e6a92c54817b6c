"""A second-order force servo under a held command, integrated exactly up to position.

    f'' + 2 zeta wn f' + wn^2 f = wn^2 u,    m v' = f,    q' = v

with `u` constant. Everything follows from the normalised integrals b_k(x), x = wn t, of the
solution b_0 of b'' + 2 zeta b' + b = 0, b(0) = 0, b'(0) = 1:

    b_{-1} = b_0',    b_{k+1} = integral of b_k from 0 to x.

They are smooth in zeta through 1 and accurate for small x, where the closed forms cancel. A joint
with damping c and stiffness k, m v' = f - c v - k q, shares no such chain; its response is the
exponential of the whole matrix.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.compilation.once import together
from jaxact.matrix_exponential import exponential_less_one

_SERIES_REACH = 2.0
_SERIES_TERMS = 26
# 1 / (n + 3)! and 1 / (n + 4)!, from the last n.
_SHARES = [
    [1.0 / math.factorial(n + 3), 1.0 / math.factorial(n + 4)]
    for n in reversed(range(_SERIES_TERMS))
]


def servo_integrals(x: jax.Array, damping_ratio: jax.Array) -> tuple[jax.Array, ...]:
    """(b_{-1}, b_0, b_1, b_2, b_3) of the servo with natural frequency 1, at time x.

    For x < 2 / max(1, 2 zeta) the power series, otherwise the exact recurrence
    b_{k+1} = x^k / k! - 2 zeta b_k - b_{k-1}; both to a few units of rounding.

    Args:
        x: time times natural frequency [-], any shape, >= 0.
        damping_ratio: zeta [-], broadcastable, > 0.
    """
    zeta = damping_ratio
    near = x * jnp.maximum(1.0, 2.0 * zeta) < _SERIES_REACH
    # Each branch sees only arguments where it is finite, so that derivatives are too.
    x_near = jnp.where(near, x, 0.0)
    series = _servo_integrals_by_series(x_near, zeta)
    closed = _servo_integrals_by_recurrence(jnp.where(near, _SERIES_REACH, x), zeta)
    return together(*(jnp.where(near, a, b) for a, b in zip(series, closed, strict=True)))


def _servo_integrals_by_series(x: jax.Array, zeta: jax.Array) -> tuple[jax.Array, ...]:
    """b_k = x^{k+1} sum_n c_n x^n / (n + k + 1)!, c_0 = 1, c_n = -2 zeta c_{n-1} - c_{n-2}.

    For k = 2 and 3, summed from the last term as Clenshaw does; the recurrence, downwards, gives
    the others without cancelling.
    """
    of_next, of_second = (-2.0 * zeta * x)[None], (-x * x)[None]

    def add(sums: tuple[jax.Array, jax.Array], share: jax.Array) -> tuple[Any, None]:
        total, after = sums
        return (share + of_next * total + of_second * after, total), None

    ones = (1,) * (of_next.ndim - 1)
    shares = jnp.asarray(_SHARES, of_next.dtype).reshape(_SERIES_TERMS, 2, *ones)
    none = jnp.zeros((2, *of_next.shape[1:]), of_next.dtype)
    (sums, _), _ = jax.lax.scan(add, (none, none), shares)
    b_2, b_3 = x**3 * sums[0], x**4 * sums[1]
    b_1 = 0.5 * x * x - 2.0 * zeta * b_2 - b_3
    b_0 = x - 2.0 * zeta * b_1 - b_2
    return 1.0 - 2.0 * zeta * b_0 - b_1, b_0, b_1, b_2, b_3


def _servo_integrals_by_recurrence(x: jax.Array, zeta: jax.Array) -> tuple[jax.Array, ...]:
    cosine, sine = damped_oscillation(x, zeta)
    derivative = cosine - zeta * sine
    b_0 = sine
    b_1 = 1.0 - 2.0 * zeta * b_0 - derivative
    b_2 = x - 2.0 * zeta * b_1 - b_0
    b_3 = 0.5 * x * x - 2.0 * zeta * b_2 - b_1
    return derivative, b_0, b_1, b_2, b_3


def damped_oscillation(x: jax.Array, damping_ratio: jax.Array) -> tuple[jax.Array, jax.Array]:
    """exp(-zeta x) cos(r x) and exp(-zeta x) sin(r x) / r, r = sqrt(1 - zeta^2), for all zeta > 0.

    Args:
        x: time times natural frequency [-], any shape, >= 0.
        damping_ratio: zeta [-], broadcastable, > 0; at and above 1 the hyperbolic continuation.
    """
    zeta = damping_ratio
    square = (1.0 - zeta) * (1.0 + zeta)
    small = jnp.abs(square) * x * x < 0.25
    under = (square > 0) & ~small
    over = (square <= 0) & ~small

    power = jnp.where(small, -square * x * x, 0.0)
    decay = jnp.exp(-zeta * x)
    cosine = _sum_series(power, 0)
    sine = x * _sum_series(power, 1)
    near_critical = (decay * cosine, decay * sine)

    root = jnp.sqrt(jnp.where(under, square, 1.0))
    oscillating = (decay * jnp.cos(root * x), decay * jnp.sin(root * x) / root)

    root = jnp.sqrt(jnp.where(over, -square, 1.0))
    slow = jnp.exp(-x / (zeta + root))
    fast_over_slow = jnp.expm1(-2.0 * root * x)
    creeping = (slow * (1.0 + 0.5 * fast_over_slow), -0.5 * slow * fast_over_slow / root)

    cosine, sine = together(
        *(
            jnp.where(small, a, jnp.where(under, b, c))
            for a, b, c in zip(near_critical, oscillating, creeping, strict=True)
        )
    )
    return cosine, sine


def _sum_series(power: jax.Array, odd: int) -> jax.Array:
    """sum_n power^n / (2 n + odd)!: cos or sin(y)/y of y^2 = -power, |power| <= 1/4."""
    total = jnp.zeros_like(power)
    for n in reversed(range(8)):
        total = total * power + 1.0 / math.factorial(2 * n + odd)
    return total


def held_transition(
    time: jax.Array, mass: jax.Array, natural_frequency: jax.Array, damping_ratio: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Phi (4, 4) and Gamma (4,) of x(t) = Phi x(0) + Gamma u for x = (q, v, f, f'/wn).

    f'/wn instead of f' keeps the matrix well scaled and the ideal servo finite.

    Args:
        time: t [s], scalar, >= 0.
        mass: m [kg], scalar.
        natural_frequency: wn [rad/s], scalar, inf = ideal (f = u, no state).
        damping_ratio: zeta [-], scalar, ignored for the ideal servo.
    """
    ideal = jnp.isinf(natural_frequency)
    wn = jnp.where(ideal, 1.0, natural_frequency)
    x = wn * time
    derivative, b_0, b_1, b_2, b_3 = servo_integrals(x, jnp.where(ideal, 1.0, damping_ratio))
    zero, one = jnp.zeros_like(x), jnp.ones_like(x)
    servo = jnp.stack(
        [
            jnp.stack([one, time + zero, (0.5 * x * x - b_3) / wn**2 / mass, b_2 / wn**2 / mass]),
            jnp.stack([zero, one, (x - b_2) / wn / mass, b_1 / wn / mass]),
            jnp.stack([zero, zero, 1.0 - b_1, b_0]),
            jnp.stack([zero, zero, -b_0, derivative]),
        ]
    )
    drive = jnp.stack([b_3 / wn**2 / mass, b_2 / wn / mass, b_1, b_0])
    servo_ideal = jnp.stack(
        [
            jnp.stack([one, time + zero, zero, zero]),
            jnp.stack([zero, one, zero, zero]),
            jnp.zeros_like(servo[2]),
            jnp.zeros_like(servo[3]),
        ]
    )
    drive_ideal = jnp.stack([0.5 * time**2 / mass + zero, time / mass + zero, one, zero])
    return jnp.where(ideal, servo_ideal, servo), jnp.where(ideal, drive_ideal, drive)


def sprung_transition(
    time: jax.Array,
    mass: jax.Array,
    natural_frequency: jax.Array,
    damping_ratio: jax.Array,
    joint_damping: jax.Array | float,
    joint_stiffness: jax.Array | float,
) -> tuple[jax.Array, jax.Array]:
    """As `held_transition`, of a joint with damping c [N s/m] and stiffness k [N/m] of its own.

    With the time as unit, and the acceleration f/m for the force:

        (q, v t, a t^2, a'/wn t^2)' = (v, a - (c t/m) v - (k t^2/m) q, x a'/wn,
                                       x (u - a) - 2 zeta x a'/wn),     x = wn t
    """
    ideal = jnp.isinf(natural_frequency)
    x = jnp.where(ideal, 0.0, natural_frequency * time)
    damped = joint_damping * time / mass
    stiff = joint_stiffness * time * time / mass
    zero, one = jnp.zeros_like(x + damped + stiff), jnp.ones_like(x + damped + stiff)
    direct = jnp.where(ideal, one, zero)
    rate = [
        [zero, one, zero, zero, zero],
        [-stiff, -damped, 1.0 - direct, zero, direct],
        [zero, zero, zero, x, zero],
        [zero, zero, -x, -2.0 * damping_ratio * x, x],
        [zero] * 5,
    ]
    grown = exponential_less_one(jnp.stack([jnp.stack([a + zero for a in row]) for row in rate]))
    # Back to units; the velocity after a displacement follows without dividing by the time.
    of_q = jnp.stack([1.0 + grown[0, 0], -joint_stiffness / mass * time * grown[0, 1]])
    of_v = jnp.stack([time * grown[0, 1], 1.0 + grown[1, 1]])
    push = jnp.stack([time * time, time]) / mass
    top = jnp.stack([of_q, of_v, push * grown[:2, 2], push * grown[:2, 3]], axis=1)
    servo = jnp.concatenate([jnp.zeros((2, 2), top.dtype), grown[2:4, 2:4]], axis=1)
    servo = jnp.where(ideal, 0.0, servo + jnp.eye(4, dtype=top.dtype)[2:])
    held = jnp.where(ideal, jnp.stack([one, zero]), grown[2:4, 4])
    return jnp.concatenate([top, servo]), jnp.concatenate([push * grown[:2, 4], held])


def joint_change(
    time: jax.Array, mass: jax.Array, joint_damping: jax.Array, joint_stiffness: jax.Array
) -> jax.Array:
    """J - 1 (2, 2) of (q, v t) of the joint alone, to the last digits however slow it is.

    Args:
        time, mass, joint_damping, joint_stiffness: as for `sprung_transition`.
    """
    rates = -joint_stiffness * time * time / mass, -joint_damping * time / mass
    zero = jnp.zeros_like(rates[0] + rates[1])
    top = jnp.stack([zero, zero + 1.0])
    return exponential_less_one(jnp.stack([top, jnp.stack([rate + zero for rate in rates])]))
