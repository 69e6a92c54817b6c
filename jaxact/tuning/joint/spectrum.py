"""Smooth stand-ins for the margins, cheap enough for thousands of gradient steps.

L(jw) = kp Gp(jw) + kd Gv(jw) is linear in the gains, so Gp and Gv of every member are tabulated
once, on frequencies normalised by the member's lag, delay + 2 zeta/wn. A peak is then a maximum
over the table, smoothed: softmax_s(x) = ln(sum exp(s x)) / s, which is exact as s grows. Crossings
are interpolated. What comes out steers the descent; nothing is certified with it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.analysis.joint.frequency import JointLoop, servo_denominator
from jaxact.analysis.sampled.period_map import SampledLoop
from jaxact.analysis.sampled.pulse import delays, plant_response, pulse_transfer
from jaxact.compilation.programs import Program
from jaxact.tuning.joint.ensemble import DEFAULT_PERIOD, PARAMETERS, PLANT, Ensemble, Sampling
from jaxact.tuning.joint.noise import counted_rate, force_response
from jaxact.tuning.objective import softmax

POINTS = 144
# From well below the corner kp/kd of the softest feasible loops to beyond any crossover.
_LOW, _HIGH = 1e-3, 40.0
_TINY = 1e-30
# How much a bandwidth that there is not counts for what is missing to one [-].
_MISSING = 3.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Spectrum:
    """Responses of one member to its command; members and cases go in front.

    Attributes:
        frequency: w [rad/s], ascending, shape (..., points).
        position: Gp as real and imaginary part [m/N], shape (..., 2, points).
        velocity: Gv as the controller sees it, likewise [m/s/N].
        force: size of the force by command [-], shape (..., points).
        rate: noise of the velocity by that of the position, likewise [1/s], (..., 2, points).
        period: between readings of the encoder [s], shape (...).
        stiffness: of the joint itself [N/m], shape (...).
    """

    frequency: jax.Array
    position: jax.Array
    velocity: jax.Array
    force: jax.Array
    rate: jax.Array
    period: jax.Array
    stiffness: jax.Array


def tabulate(members: Ensemble, scale: np.ndarray, points: int = POINTS) -> Spectrum:
    """Spectra of all members, float64 NumPy arrays with the members in front.

    Args:
        scale: time that normalises the frequencies of each [s], shape (n,).
    """
    x = np.geomspace(_LOW, _HIGH, points)
    w = x / scale[:, None]
    period = members.sampling.control_period
    if period is None:
        position, force = _continuous(members, w)
        rate = 1j * w / (1.0 + 1j * w / members.sampling.velocity_filter)
        velocity, period = rate * position, DEFAULT_PERIOD
    else:
        w = np.minimum(w, np.pi / period)
        position, velocity, force, rate = _sampled(members, w)
    position, velocity, rate = (
        np.stack([g.real, g.imag], axis=1) for g in (position, velocity, rate)
    )
    periods: Any = np.full(len(members), period)
    own: Any = members.joint_stiffness
    return Spectrum(w, position, velocity, np.abs(force), rate, periods, own)


def _continuous(members: Ensemble, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gp, and the force by command but for the delay."""
    column = [getattr(members, name)[:, None] for name in PLANT]
    with jax.enable_x64(True):
        real, imaginary = servo_denominator(JointLoop(0.0, 0.0, *column[:4]), w)  # type: ignore[arg-type]
    servo = np.asarray(real) + 1j * np.asarray(imaginary)
    mass, *_, delay, damping, stiffness = column
    plant = mass * w * w - stiffness - 1j * w * damping
    return -np.exp(-1j * w * delay) / (plant * servo), 1.0 / servo


def _sampled(members: Ensemble, w: np.ndarray) -> list[np.ndarray]:
    with jax.enable_x64(True):
        bare = not (members.joint_damping.any() or members.joint_stiffness.any())
        names = PARAMETERS if bare else PLANT
        plants = tuple(jnp.asarray(getattr(members, name)) for name in names)
        found = _pulse_responses(plants, jnp.asarray(w), sampling=members.sampling)
    return [np.asarray(each) for each in found]


@Program
def _pulse_responses(plants: tuple[jax.Array, ...], w: jax.Array, *, sampling: Sampling) -> tuple:
    """From parameters of plants, (n,) each, and frequencies: Gp, Gv, the force by command and the
    velocity's noise, shape (n, points).
    """

    def one(plant: tuple[jax.Array, ...], w: jax.Array) -> tuple[jax.Array, ...]:
        """The same of one plant at its own frequencies."""
        period = jnp.asarray(sampling.control_period, w.dtype)
        cutoff = jnp.asarray(sampling.velocity_filter, w.dtype)
        zero = jnp.zeros((), w.dtype)
        own = dict(zip(PLANT, plant, strict=False))
        loop = SampledLoop(
            zero, zero, control_period=period, velocity_filter=cutoff, velocity=sampling.velocity,
            **own,  # type: ignore[arg-type]
        )  # fmt: skip
        transfer = pulse_transfer(loop)
        u, s, hold = delays(transfer, w * period)
        both = plant_response(transfer, u, s, hold)
        return *both, force_response(loop, u), counted_rate(transfer, s)

    return jax.vmap(one)(plants, w)


def single_precision(spectrum: Spectrum) -> Spectrum:
    """The same in float32, for the descent."""
    return Spectrum(*(jnp.asarray(getattr(spectrum, f.name), jnp.float32)
                      for f in fields(Spectrum)))  # fmt: skip


def open_loop(spectrum: Spectrum, kp: jax.Array, kd: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Real and imaginary part of L on the table of one member, shape (points,)."""
    response = kp * spectrum.position + kd * spectrum.velocity
    return response[0], response[1]


def is_stable(
    real: jax.Array, imaginary: jax.Array, stiffness: jax.Array | float = 0.0
) -> jax.Array:
    """Whether L, as tabulated, winds around -1 no time: no unstable root.

    The double pole at the origin starts the curve at -180 degrees: above it the loop is stable
    for small gains. Every passage of the real axis left of -1 counts, upwards against downwards. A
    joint's own `stiffness` k [N/m] starts it at kp/k instead: above the axis counts only left of
    -1, where it must start if k < 0.
    """
    above = imaginary > 0.0
    changed = above[1:] != above[:-1]
    real_there = _on_axis(real, imaginary)
    beyond = changed & (real_there < -1.0)
    passages = jnp.where(beyond, jnp.where(above[1:], 1, -1), 0)
    at_end = real[-1] < -1.0
    begun = above[0] & ((stiffness == 0.0) | (real[0] < -1.0))
    held = (stiffness >= 0.0) | (real[0] < -1.0)
    return (begun.astype(passages.dtype) + jnp.sum(passages) == 0) & ~at_end & held


def _on_axis(real: jax.Array, imaginary: jax.Array) -> jax.Array:
    """Re L where Im L passes zero between neighbours, linear in between."""
    step = imaginary[:-1] - imaginary[1:]
    part = imaginary[:-1] / jnp.where(step == 0.0, 1.0, step)
    return real[:-1] + part * (real[1:] - real[:-1])


def log_metrics(
    spectrum: Spectrum, kp: jax.Array, kd: jax.Array, names: tuple[str, ...], sharpness: jax.Array
) -> tuple[dict[str, jax.Array], jax.Array]:
    """Smooth ln of the metrics of one member, and whether its loop is stable.

    Args:
        kp, kd: [N/m], [N s/m], scalars.
        names: static, of the metrics wanted.
        sharpness: s of the smooth maximum.
    """
    real, imaginary = open_loop(spectrum, kp, kd)
    gain = real**2 + imaginary**2
    plus = (1.0 + real) ** 2 + imaginary**2
    found: dict[str, jax.Array] = {}
    if "sensitivity_peak" in names:
        found["sensitivity_peak"] = softmax(-0.5 * jnp.log(plus + _TINY), sharpness)
    if "complementary_peak" in names:
        ratio = 0.5 * (jnp.log(gain + _TINY) - jnp.log(plus + _TINY))
        found["complementary_peak"] = softmax(ratio, sharpness)
    if "disk_margin" in names:
        minus = (1.0 - real) ** 2 + imaginary**2
        ratio = 0.5 * (jnp.log(0.25 * minus + _TINY) - jnp.log(plus + _TINY))
        found["disk_margin"] = -softmax(ratio, sharpness)
    if "gain_margin" in names:
        found["gain_margin"] = _log_gain_margin(real, imaginary)
    if "delay_margin" in names:
        found["delay_margin"] = _log_delay_margin(spectrum.frequency, real, imaginary, gain)
    if "noise_gain" in names:
        found["noise_gain"] = _log_noise_gain(spectrum, kp, kd, plus)
    if "bandwidth" in names:
        found["bandwidth"] = _log_bandwidth(spectrum, kp, plus)
    return found, is_stable(real, imaginary, spectrum.stiffness)


def _log_gain_margin(real: jax.Array, imaginary: jax.Array) -> jax.Array:
    """-ln of the largest |L| < 1 on the negative real axis; large where there is none."""
    there = _on_axis(real, imaginary)
    passes = ((imaginary[1:] > 0.0) != (imaginary[:-1] > 0.0)) & (there < 0.0) & (there > -1.0)
    logs = jnp.where(passes, jnp.log(jnp.where(passes, -there, 1.0)), -20.0)
    return -jnp.max(logs)


def _log_delay_margin(
    w: jax.Array, real: jax.Array, imaginary: jax.Array, gain: jax.Array
) -> jax.Array:
    """ln of the smallest (phase mod 2 pi) / w over the gain crossovers."""
    level = 0.5 * jnp.log(gain + _TINY)
    passes = (level[1:] > 0.0) != (level[:-1] > 0.0)
    step = level[:-1] - level[1:]
    part = jnp.where(passes, level[:-1] / jnp.where(passes, step, 1.0), 0.5)

    def between(values: jax.Array) -> jax.Array:
        return values[:-1] + part * (values[1:] - values[:-1])

    angle = jnp.arctan2(-between(imaginary), -between(real))
    phase = jnp.where(angle < 0.0, angle + 2.0 * jnp.pi, angle)
    delays = jnp.log(phase + _TINY) - between(jnp.log(w))
    return jnp.min(jnp.where(passes, delays, 20.0))


def _log_noise_gain(spectrum: Spectrum, kp: jax.Array, kd: jax.Array, plus: jax.Array) -> jax.Array:
    """ln of `jaxact.tuning.joint.noise.noise_gain` from |1 + L|^2 on the table."""
    w = spectrum.frequency
    top = jnp.pi / spectrum.period
    control = (kp + kd * spectrum.rate[0]) ** 2 + (kd * spectrum.rate[1]) ** 2
    force = spectrum.force**2 * control / (plus + _TINY)
    inside = jnp.clip((jnp.minimum(w[1:], top) - w[:-1]) / jnp.maximum(w[1:] - w[:-1], _TINY), 0, 1)
    area = jnp.sum(0.5 * (force[1:] + force[:-1]) * (w[1:] - w[:-1]) * inside)
    return 0.5 * jnp.log(spectrum.period / (12.0 * jnp.pi) * area + _TINY)


def _log_bandwidth(spectrum: Spectrum, kp: jax.Array, plus: jax.Array) -> jax.Array:
    """ln of the first frequency with |kp Gp / (1 + L)| < 1/sqrt(2), interpolated.

    Where a spring keeps it below that from the beginning it falls with what is missing, so that
    the descent leads to where there is a bandwidth.
    """
    size = jnp.sum(spectrum.position**2, axis=0)
    excess = jnp.log(kp) + 0.5 * (jnp.log(size + _TINY) - jnp.log(plus + _TINY) + jnp.log(2.0))
    below = excess < 0.0
    first = jnp.clip(jnp.argmax(below), 1, below.shape[0] - 1)
    before, after = excess[first - 1], excess[first]
    part = before / jnp.where(before == after, 1.0, before - after)
    logs = jnp.log(spectrum.frequency)
    found = logs[first - 1] + jnp.clip(part, 0.0, 1.0) * (logs[first] - logs[first - 1])
    found = jnp.where(jnp.any(below), found, logs[-1])
    return jnp.where(excess[0] > 0.0, found, logs[0] + _MISSING * excess[0])
