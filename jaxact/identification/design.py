"""Which excitation identifies what, before anyone touches hardware.

With slopes J of what will be measured by the unknowns, and independent noise of standard deviation
sigma, no unbiased estimate has a smaller covariance than

    cov >= sigma^2 (J^T J)^-1                            (the Cramer-Rao bound)

Real residuals hang together, so that real intervals are several times wider; the order of
excitations stays.

Source: Ljung, "System identification", 2nd ed., sections 7.4 and 13.3.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.identification import joint_motion, torque_loop
from jaxact.identification.joint_motion import Structure
from jaxact.identification.recording import Recording
from jaxact.parameters import DELAY, FORCE_LIMIT, KD, KP, MASS, WN, ZETA

PLANTS = ("none", MASS)
_LONGEST = 300_000


@dataclass(frozen=True)
class Bench:
    """What will be measured, and how.

    Attributes:
        plant: "none": force for a commanded force; "mass": position for a setpoint.
        wn: smallest and largest natural frequency that the drive may have [rad/s].
        zeta: smallest and largest damping ratio.
        delay: shortest and longest [s].
        duration: of the excitation [s].
        rate: of the rows [Hz].
        amplitude: largest excitation, [N] or [m] (of rotary joints [N m] or [rad]).
        noise: standard deviation of what is measured, same unit as it.
        mass, kp, kd: of the joint and its controller ("mass" only) [kg, N/m, N s/m].
    """

    plant: str = "none"
    wn: tuple[float, float] = (100.0, 1000.0)
    zeta: tuple[float, float] = (0.7, 0.7)
    delay: tuple[float, float] = (0.0, 5e-3)
    duration: float = 20.0
    rate: float = 1000.0
    amplitude: float = 1.0
    noise: float = 1e-3
    mass: float = 0.7
    kp: float = 400.0
    kd: float = 20.0


@dataclass(frozen=True)
class Promise:
    """What an excitation can identify at best, in the worst corner of the bench's ranges.

    Attributes:
        name: of the excitation.
        wn, zeta: standard deviations as a share of wn [-], and of zeta [-].
        delay: standard deviation [s].
        lag: standard deviation of ``delay + 2 zeta / wn`` [s].
        signal: the excitation, shape (rows,), in the unit of the bench's amplitude.
    """

    name: str
    wn: float
    zeta: float
    delay: float
    lag: float
    signal: np.ndarray


def design(bench: Bench, *, seed: int = 0) -> list[Promise]:
    """Excitations of this amplitude and length, the most telling first.

    Args:
        bench: what will be measured.
        seed: of the pseudo-random ones.

    Returns:
        One promise each, sorted by how well the delay is known.

    Raises:
        UserError: numbers that make no sense.
    """
    _check(bench)
    rows = round(bench.duration * bench.rate)
    time = np.arange(rows) / bench.rate
    corners = list(dict.fromkeys(itertools.product(bench.wn, bench.zeta, _inside(bench))))
    found = []
    with jax.enable_x64(True):
        for name, signal in excitations(bench, time, seed):
            bounds = [_bound(bench, time, signal, corner) for corner in corners]
            worst = np.max(np.array(bounds), axis=0)
            wn, zeta, delay, lag = worst.tolist()
            found.append(Promise(name, wn, zeta, delay, lag, signal))
    return sorted(found, key=lambda one: one.delay)


def _check(bench: Bench) -> None:
    if bench.plant not in PLANTS:
        raise UserError(f"plant = {shown(bench.plant)}; {nearest(bench.plant, PLANTS)}")
    for name in (WN, ZETA, DELAY):
        low, high = getattr(bench, name)
        least = 0.0 if name == DELAY else 1e-6
        if not least <= low <= high < math.inf:
            raise UserError(f"`{name}` = {low:g}..{high:g} is not a range of finite values, rising")
    for name in ("duration", "rate", "amplitude", "noise", MASS, KP):
        if not 0.0 < getattr(bench, name) < math.inf:
            raise UserError(f"`{name}` = {getattr(bench, name):g} must be positive and finite")
    if not 0.0 <= bench.kd < math.inf:
        raise UserError(f"`{KD}` = {bench.kd:g} must be 0 or more, and finite")
    if not 200 <= bench.duration * bench.rate <= _LONGEST:
        raise UserError(
            f"`duration` = {bench.duration:g}: {bench.duration * bench.rate:,.0f} rows at"
            f" {bench.rate:g} Hz; allowed: 200 to {_LONGEST:,}"
        )


def _inside(bench: Bench) -> tuple[float, ...]:
    """The delays that are looked at: between ticks, where a delay has a derivative."""
    quarter = 0.25 / bench.rate
    return tuple(
        delay + quarter if abs(delay * bench.rate - round(delay * bench.rate)) < 1e-3 else delay
        for delay in dict.fromkeys(bench.delay)
    )


def excitations(bench: Bench, time: np.ndarray, seed: int = 0) -> list[tuple[str, np.ndarray]]:
    """Names and signals, shape (rows,) each: PRBS, chirps, a multisine and steps."""
    generator = np.random.default_rng(seed)
    rows, top = len(time), 0.4 * bench.rate
    made: list[tuple[str, np.ndarray]] = []
    for hold in (1e-3, 5e-3, 20e-3, 100e-3):
        each = max(round(hold * bench.rate), 1)
        levels = np.repeat(generator.choice([-1.0, 1.0], rows // each + 1), each)[:rows]
        made.append((f"PRBS of {1e3 * each / bench.rate:g} ms", levels))
    for end in (10.0, 60.0, 200.0):
        if end < top:
            phase = 2.0 * np.pi * (0.1 * time + 0.5 * (end - 0.1) * time**2 / time[-1])
            made.append((f"chirp to {end:g} Hz", np.sin(phase)))
    tones = np.geomspace(1.0, min(150.0, top), 24)
    # Schroeder's phases keep the sum of many tones low.
    each_tone = [
        np.cos(2.0 * np.pi * tone * time - np.pi * number**2 / len(tones))
        for number, tone in enumerate(tones)
    ]
    total = np.sum(each_tone, axis=0)
    made.append((f"multisine to {tones[-1]:g} Hz", total / np.max(np.abs(total))))
    made.append(("steps of 0.5 s", np.where(np.floor(time / 0.5) % 2 == 0, 1.0, -1.0)))
    unique = {name: signal for name, signal in made}
    return [(name, bench.amplitude * signal) for name, signal in unique.items()]


def _bound(
    bench: Bench, time: np.ndarray, signal: np.ndarray, corner: Sequence[float]
) -> tuple[float, float, float, float]:
    """Standard deviations of wn (as a share), zeta, delay and lag at one drive."""
    wn, zeta, delay = corner
    point = jnp.asarray([math.log(wn), zeta, delay, 1.0, 0.0])
    slopes = np.asarray(_slopes_of(bench)(point, jnp.asarray(time), jnp.asarray(signal)))
    size = np.linalg.norm(slopes, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    _, singular, right = np.linalg.svd(slopes / size, full_matrices=False)
    scaled = right.T / np.maximum(singular, 1e-12 * singular[0])
    covariance = bench.noise**2 * scaled @ scaled.T / np.outer(size, size)
    along = np.array([-2.0 * zeta / wn, 2.0 / wn, 1.0, 0.0, 0.0])
    deviations = np.sqrt(np.diag(covariance))
    lag = math.sqrt(max(float(along @ covariance @ along), 0.0))
    return float(deviations[0]), float(deviations[1]), float(deviations[2]), lag


def _slopes_of(bench: Bench) -> Callable[..., jax.Array]:
    """The derivatives of what is measured, compiled."""
    if bench.plant == "none":
        return _force_slopes
    history = math.ceil(bench.delay[1] * bench.rate) + 3
    return partial(_position_slopes, bench.mass, bench.kp, bench.kd, history)


def _drive(point: jax.Array) -> dict[str, jax.Array | float]:
    return {
        WN: jnp.exp(point[0]), ZETA: point[1], DELAY: point[2], "gain": point[3],
        "offset": point[4],
    }  # fmt: skip


@jax.jit
def _force_slopes(point: jax.Array, time: jax.Array, signal: jax.Array) -> jax.Array:
    def measured(at: jax.Array) -> jax.Array:
        own = {FORCE_LIMIT: jnp.inf, "initial_force": 0.0}
        return torque_loop.simulate(time, signal, _drive(at) | own)

    return jax.jacfwd(measured)(point)


@partial(jax.jit, static_argnums=3)
def _position_slopes(
    mass: float, kp: float, kd: float, history: int, point: jax.Array, time: jax.Array,
    signal: jax.Array,
) -> jax.Array:  # fmt: skip
    """As `_force_slopes`, with the inertia in the gain's place: of the two the ratio counts."""
    zero = jnp.zeros_like(time)
    recording = Recording(
        time=time, setpoint=signal, feedforward=zero, command=zero, strength=zero + 1.0,
        controls=jnp.ones(time.shape, bool), row=jnp.arange(time.shape[0]),
        kp=jnp.asarray(kp, time.dtype), kd=jnp.asarray(kd, time.dtype),
        command_limit=jnp.asarray(1e15, time.dtype), position=zero[0], velocity=zero[0],
    )  # fmt: skip
    structure = Structure(closed=True, history=history, difference_ticks=0, gravity=False)

    def measured(at: jax.Array) -> jax.Array:
        own = {
            "inertia": mass, FORCE_LIMIT: 1e15, "viscous": 0.0, "coulomb": 0.0, "gravity": 0.0,
            "zero": 0.0,
        }  # fmt: skip
        return joint_motion.simulate(_drive(at) | own, recording, structure)[0]

    return jax.jacfwd(measured)(point)
