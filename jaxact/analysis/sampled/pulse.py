"""Frequency response of the sampled loop in closed form, from its pulse-transfer function.

With u = z^{-1} = exp(-j theta), S = 1 - u and theta = w T, the sampled position and velocity are

    Gp(z) = u^{d+1} P(u) / (S^2 Q(S)),    Gv(z) = u^{d+1} V(u) / (S Q(S)),

P and V polynomials of degree 4 and 3 whose coefficients come from the first pulse responses, and
Q = q0 + q1 S + r2 S^2 the servo's denominator written in S, where it does not cancel at low
frequency. A joint with damping or stiffness has such a quadratic of its own for S^2, and V then is
of degree 4. The differenced velocity is Gp S / T (1 - b) / (1 - b u).
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.analysis.sampled.period_map import (
    POSITION,
    VELOCITY,
    SampledLoop,
    filter_pole,
    period_map,
    small_product,
)
from jaxact.analysis.sampled.servo import damped_oscillation, joint_change


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["position", "velocity", "servo", "steps", "pole", "period", "joint"],
    meta_fields=["differenced"],
)
@dataclass(frozen=True)
class PulseTransfer:
    """Coefficients of the sampled plant, from command to what the controller reads.

    Attributes:
        position: P [m/N], shape (..., 5).
        velocity: V [m/s/N], shape (..., 4).
        servo: (q0, q1, r2) [-], shape (..., 3).
        steps: d [-], shape (...).
        pole: b of the velocity filter [-], shape (...).
        period: T [s], shape (...).
        differenced: whether the velocity is the difference of positions.
        joint: as `servo`, of a joint with damping or stiffness of its own; None: S^2.
    """

    position: jax.Array
    velocity: jax.Array
    servo: jax.Array
    steps: jax.Array
    pole: jax.Array
    period: jax.Array
    differenced: bool
    joint: jax.Array | None = None


def pulse_transfer(loop: SampledLoop) -> PulseTransfer:
    """Pulse-transfer function of one loop's plant, servo and delay (the gains do not enter).

    Args:
        loop: fields scalar.
    """
    phi, older, newer, steps = period_map(loop)
    samples = [newer, small_product(phi, newer) + older]
    for _ in range(3):
        samples.append(small_product(phi, samples[-1]))
    pulse = jnp.stack(samples)
    servo = _servo_denominator(loop)
    joint = _joint_denominator(loop, phi) if loop.sprung else None
    double, single = _in_delays(servo, joint)
    zero = jnp.zeros_like(servo[0])
    return PulseTransfer(
        position=_product(double, pulse[:, POSITION])[:5],
        velocity=_product(single, pulse[: len(single), VELOCITY])[: len(single)],
        joint=joint,
        servo=servo,
        steps=steps,
        pole=filter_pole(loop) + zero,
        period=loop.control_period + zero,
        differenced=loop.velocity == "differenced",
    )


def delay_polynomials(transfer: PulseTransfer) -> tuple[jax.Array, jax.Array]:
    """Denominators of position and velocity by rising powers of u, shape (5,) and (4,) or (5,)."""
    return _in_delays(transfer.servo, transfer.joint)


def _in_delays(servo: jax.Array, joint: jax.Array | None) -> tuple[jax.Array, jax.Array]:
    """As `delay_polynomials`, of denominators written in S."""
    one = jnp.ones_like(servo[0])
    of_servo = jnp.stack([one, -(servo[1] + 2.0 * servo[2]), servo[2]])
    if joint is not None:
        of_joint = jnp.stack([one, -(joint[1] + 2.0 * joint[2]), joint[2]])
        both = _product(of_servo, of_joint)
        return both, both
    integrator = jnp.array([1.0, -1.0], dtype=of_servo.dtype)
    single = _product(of_servo, integrator)
    return _product(single, integrator), single


def _product(one: jax.Array, other: jax.Array) -> jax.Array:
    """The product of two polynomials, as sums; coefficients by rising degree."""
    rows = []
    for degree in range(len(one) + len(other) - 1):
        low, high = max(0, degree - len(other) + 1), min(degree, len(one) - 1)
        rows.append(sum(one[i] * other[degree - i] for i in range(low, high + 1)))
    return jnp.stack(rows)


def _joint_denominator(loop: SampledLoop, phi: jax.Array) -> jax.Array:
    """(q0, q1, r2) of det(1 - J u) = q0 + q1 S + r2 S^2, J of position and velocity: (0, 0, 1) of a
    bare mass.
    """
    change = phi[:2, :2] - jnp.eye(2, dtype=phi.dtype)
    if loop.integrator == "exact":  # without taking from 1 what slow joints hardly differ from
        change = joint_change(loop.control_period, loop.mass, *loop.joint)  # type: ignore[misc]
    q0 = change[0, 0] * change[1, 1] - change[0, 1] * change[1, 0]
    # det J - 1 = tr + q0, so that nothing is taken from 1.
    trace = change[0, 0] + change[1, 1]
    return jnp.stack([q0, -trace - 2.0 * q0, 1.0 + trace + q0])


def _servo_denominator(loop: SampledLoop) -> jax.Array:
    """(q0, q1, r2) of 1 - 2 r c u + r^2 u^2 = q0 + q1 S + r2 S^2; (1, 0, 0) if ideal.

    q0 = (1 - r)^2 + 2 r (1 - c) with r = exp(-zeta x), c = cos(sqrt(1 - zeta^2) x), x = wn T.
    """
    ideal = jnp.isinf(loop.natural_frequency)
    zeta = jnp.where(ideal, 1.0, loop.damping_ratio)
    x = jnp.where(ideal, 1.0, loop.natural_frequency) * loop.control_period
    _, half_sine = damped_oscillation(0.5 * x, zeta)
    q0 = jnp.expm1(-zeta * x) ** 2 + 4.0 * (1.0 - zeta) * (1.0 + zeta) * half_sine**2
    r2 = jnp.exp(-2.0 * zeta * x)
    q1 = -jnp.expm1(-2.0 * zeta * x) - q0
    return jnp.where(ideal, jnp.array([1.0, 0.0, 0.0], dtype=q0.dtype), jnp.stack([q0, q1, r2]))


def delays(transfer: PulseTransfer, theta: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """u, S and u^{d+1} on the unit circle, as `plant_response` takes them.

    Args:
        transfer: of one plant.
        theta: w T [rad], any shape.
    """
    half, lag = 0.5 * theta, theta * (transfer.steps + 1.0)
    u = jax.lax.complex(jnp.cos(theta), -jnp.sin(theta))
    s = 2.0 * jnp.sin(half) * jax.lax.complex(jnp.sin(half), jnp.cos(half))
    return u, s, jax.lax.complex(jnp.cos(lag), -jnp.sin(lag))


def plant_response(transfer: PulseTransfer, u: Any, s: Any, hold: Any) -> tuple[Any, Any]:
    """Gp [m/N] and the response of the velocity the controller reads [m/s/N], complex.

    Plain arithmetic, so NumPy arrays stay NumPy.

    Args:
        transfer: of one plant.
        u: exp(-j theta), any shape.
        s: 1 - u, computed without cancellation: 2 j sin(theta / 2) exp(-j theta / 2).
        hold: u^{d+1}.
    """
    servo, rigid, single = denominators(transfer, s)
    position = hold * polynomial(transfer.position, u) / (rigid * servo)
    if not transfer.differenced:
        return position, hold * polynomial(transfer.velocity, u) / (single * servo)
    pole = transfer.pole
    return position, position * s / transfer.period * (1.0 - pole) / (1.0 - pole + pole * s)


def characteristic(transfer: PulseTransfer, kp: Any, kd: Any, z: Any) -> Any:
    """1 + kp Gp(z) + kd Gv(z) times the denominators of both: zero at every closed-loop root z.

    Also at those of a joint of its own, which no gain moves where both are 0.

    Args:
        transfer: of one plant.
        kp: gain [N/m].
        kd: gain [N s/m].
        z: complex, not 0.
    """
    u = 1.0 / z
    s = 1.0 - u
    servo, rigid, single = denominators(transfer, s)
    hold = u ** (transfer.steps + 1.0)
    position = hold * polynomial(transfer.position, u)
    if transfer.differenced:
        pole = transfer.pole
        lowpass = 1.0 - pole + pole * s
        rate = position * s / transfer.period * (1.0 - pole)
        return (rigid * servo + kp * position) * lowpass + kd * rate
    velocity = hold * polynomial(transfer.velocity, u)
    return rigid * servo + kp * position + kd * velocity * (s if transfer.joint is None else 1.0)


def denominators(transfer: PulseTransfer, s: Any) -> tuple[Any, Any, Any]:
    """Of the servo, of the joint's position, and of its velocity."""
    q0, q1, r2 = transfer.servo[0], transfer.servo[1], transfer.servo[2]
    servo = q0 + s * (q1 + s * r2)
    if transfer.joint is None:
        return servo, s * s, s
    own = transfer.joint[0] + s * (transfer.joint[1] + s * transfer.joint[2])
    return servo, own, own


def polynomial(coefficients: Any, u: Any) -> Any:
    """sum_i coefficients[i] u^i, by Horner's rule."""
    total = coefficients[-1] + 0.0 * u
    for i in reversed(range(len(coefficients) - 1)):
        total = total * u + coefficients[i]
    return total
