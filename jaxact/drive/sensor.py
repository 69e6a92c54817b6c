"""Sensing at the control rate: bias, noise, encoder counts, and the velocity estimate.

    q_m = round((q + bias + noise) / resolution) * resolution,  bias' = bias + walk sqrt(T) N(0, 1)
    v_m = the sampled velocity, with its own bias, noise and resolution, or, as drives really do it,
    v_m' = v_m + (1 - exp(-w_f T)) ((q_m' - q_m) / T - v_m)

The measurement delay is not here: the drive samples the plant as it was that long ago.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import jax
import jax.numpy as jnp

from jaxact.drive import threefry


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sensor:
    """Parameters of the sensing; every field a float or an array of shape (joints,).

    Attributes:
        delay: measurement delay [s].
        position_resolution: one encoder count [m or rad]; 0 for none.
        velocity_resolution: one count of a sampled velocity [m/s or rad/s]; 0 for none.
        position_noise: standard deviation of each sample [m or rad].
        velocity_noise: standard deviation of each sampled velocity [m/s or rad/s].
        position_bias: constant offset [m or rad].
        velocity_bias: constant offset of a sampled velocity [m/s or rad/s].
        position_bias_walk: random walk of the offset [m/sqrt(s) or rad/sqrt(s)].
        velocity_bias_walk: random walk of the velocity offset [m/s/sqrt(s) or rad/s/sqrt(s)].
        velocity_filter: cutoff w_f of the differenced velocity [rad/s]; inf for no filter.
    """

    delay: jax.Array | float = 0.0
    position_resolution: jax.Array | float = 0.0
    velocity_resolution: jax.Array | float = 0.0
    position_noise: jax.Array | float = 0.0
    velocity_noise: jax.Array | float = 0.0
    position_bias: jax.Array | float = 0.0
    velocity_bias: jax.Array | float = 0.0
    position_bias_walk: jax.Array | float = 0.0
    velocity_bias_walk: jax.Array | float = 0.0
    velocity_filter: jax.Array | float = inf


@dataclass(frozen=True)
class SensorOptions:
    """Which parts of the sensor exist: static, so that what is off costs nothing.

    Attributes:
        differenced: the velocity is the filtered difference of measured positions.
        noise: either noise is on.
        walk: either bias walks.
        quantise: either resolution is on.
    """

    differenced: bool = False
    noise: bool = False
    walk: bool = False
    quantise: bool = False


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SensorState:
    """What the sensor remembers, each of shape (joints,), or None where it does not exist.

    Attributes:
        position: previous measured position [m or rad] (differenced velocity only).
        velocity: previous velocity estimate [m/s or rad/s] (differenced velocity only).
        walked: how far the two biases have walked, a pair.
    """

    position: jax.Array | None
    velocity: jax.Array | None
    walked: tuple[jax.Array, jax.Array] | None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SensorCoefficients:
    """What follows from the parameters and the period and does not change during a rollout.

    Attributes:
        parameters: the sensor itself.
        rate: 1 / T [Hz].
        root_period: sqrt(T) [sqrt(s)].
        filter_gain: 1 - exp(-w_f T) [-], shape (joints,).
    """

    parameters: Sensor
    rate: jax.Array
    root_period: jax.Array
    filter_gain: jax.Array


def quantise(value: jax.Array, resolution: jax.Array) -> jax.Array:
    """The nearest multiple of `resolution`, or the value itself where the resolution is 0.

    Args:
        value: any unit, shape (joints,).
        resolution: same unit, broadcastable, >= 0.

    Returns:
        same unit and shape. The derivative is 0 (1 where the resolution is 0).
    """
    on = resolution > 0.0
    count = jnp.where(on, resolution, 1.0)
    # Not value / count: a compiler may or may not make this of it, and round otherwise.
    per_count = 1.0 / count
    return jnp.where(on, jnp.round(value * per_count) * count, value)


def prepare(sensor: Sensor, period: jax.Array) -> SensorCoefficients:
    """Coefficients for a control period T [s]; see `SensorCoefficients`."""
    unfiltered = jnp.isinf(sensor.velocity_filter)
    cutoff = jnp.where(unfiltered, 1.0, sensor.velocity_filter)
    return SensorCoefficients(
        parameters=sensor,
        rate=1.0 / period,
        root_period=jnp.sqrt(period),
        filter_gain=jnp.where(unfiltered, 1.0, -jnp.expm1(-cutoff * period)),
    )


def init(
    sensor: Sensor,
    options: SensorOptions,
    position: jax.Array,
    velocity: jax.Array,
    period: jax.Array,
) -> SensorState:
    """State of a sensor that has watched a plant come to x0 at the constant v0, up to time 0.

    The sample before the first is x0 - v0 (T + delay), biased and in counts. The estimate of the
    velocity is v0, what a filter makes of counts too on average; neither has noise.

    Args:
        sensor: the parameters.
        options: static.
        position: x0 [m or rad], shape (joints,).
        velocity: v0 [m/s or rad/s], shape (joints,).
        period: T [s].
    """
    zero = jnp.zeros_like(position)
    before = position - velocity * (period + sensor.delay)
    measured = before + sensor.position_bias
    if options.quantise:
        measured = quantise(measured, jnp.asarray(sensor.position_resolution))
    return SensorState(
        position=measured if options.differenced else None,
        velocity=velocity if options.differenced else None,
        walked=(zero, zero) if options.walk else None,
    )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Draws:
    """Standard normal numbers of one tick: pairs for position and velocity, shape (joints,) each.

    Attributes:
        noise: of the samples; None without noise.
        walk: of the biases; None where none walks.
    """

    noise: tuple[jax.Array, jax.Array] | None = None
    walk: tuple[jax.Array, jax.Array] | None = None


def _standard_normal(words: jax.Array, dtype: jax.typing.DTypeLike) -> jax.Array:
    """Normal numbers from random 32-bit words, by the inverse of the distribution; same shape."""
    # The 24 highest bits and a half fit a float32 exactly, so that neither -1 nor 1 occurs.
    whole = jax.lax.bitcast_convert_type(words, jnp.int32) >> 8
    uniform = (whole.astype(dtype) + 0.5) / 2.0**23
    return jnp.sqrt(jnp.asarray(2.0, dtype)) * jax.lax.erf_inv(uniform)


def draw(
    options: SensorOptions, key: jax.Array | None, number: jax.Array, like: jax.Array
) -> Draws:
    """Random numbers of one tick; noise and walk have streams of their own.

    Each joint and tick is one count of a counter-based generator, whose two words are the numbers
    for position and velocity.

    Args:
        options: static.
        key: random key of this sample; needed only with noise or a walking bias.
        number: of the tick, whole, shape ().
        like: any joint quantity, shape (joints,).

    Raises:
        ValueError: there is no key, and one is needed.
    """
    if not (options.noise or options.walk):
        return Draws()
    if key is None:
        raise ValueError("a drive with noise needs a random key")
    size = max(1, like.size)
    counts = jnp.asarray(number, jnp.uint32) * size + jnp.arange(size, dtype=jnp.uint32)

    words = jax.random.key_data(key)

    def normal(source: int) -> tuple[jax.Array, jax.Array]:
        stream = threefry.folded(words, source)
        first, second = threefry.words(stream, counts.reshape(like.shape))
        return _standard_normal(first, like.dtype), _standard_normal(second, like.dtype)

    return Draws(normal(0) if options.noise else None, normal(1) if options.walk else None)


def step(
    coefficients: SensorCoefficients,
    options: SensorOptions,
    state: SensorState,
    position: jax.Array,
    velocity: jax.Array,
    draws: Draws,
) -> tuple[SensorState, tuple[jax.Array, jax.Array]]:
    """One sample of the sensor; see the module for the equations.

    Args:
        coefficients: from `prepare`.
        options: static.
        state: from `init` or the previous step.
        position: true position at the sampling instant [m or rad], shape (joints,).
        velocity: true velocity at the sampling instant [m/s or rad/s], shape (joints,).
        draws: random numbers of this tick, from `draw`.

    Returns:
        The next state, and (measured position, measured velocity).
    """
    sensor, walked = coefficients.parameters, state.walked
    position = position + sensor.position_bias
    velocity = velocity + sensor.velocity_bias
    if walked is not None:
        first, second = draws.walk[0], draws.walk[1]
        root = coefficients.root_period
        walked = (
            walked[0] + sensor.position_bias_walk * root * first,
            walked[1] + sensor.velocity_bias_walk * root * second,
        )
        position, velocity = position + walked[0], velocity + walked[1]
    if options.noise:
        position = position + sensor.position_noise * draws.noise[0]
        velocity = velocity + sensor.velocity_noise * draws.noise[1]
    if options.quantise:
        position = quantise(position, jnp.asarray(sensor.position_resolution))
    if options.differenced:
        difference = (position - state.position) * coefficients.rate
        velocity = state.velocity + coefficients.filter_gain * (difference - state.velocity)
        return SensorState(position, velocity, walked), (position, velocity)
    if options.quantise:
        velocity = quantise(velocity, jnp.asarray(sensor.velocity_resolution))
    return SensorState(None, None, walked), (position, velocity)
