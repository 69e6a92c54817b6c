"""The gains at which a root is marginal (D-partition), and the count of unstable roots beside them.

Continuous, on s = jw, with x = w/wn:

    kp = m w^2 ((1 - x^2) cos(w td) - 2 zeta x sin(w td))
    kd = m w   ((1 - x^2) sin(w td) + 2 zeta x cos(w td)),    and the line kp = 0.

With kp = m w^2 R and kd = m w I without one, a filter 1 / (1 + s tau) of the velocity makes them
m w^2 (R - w tau I) and m w (1 + (w tau)^2) I. Damping c and stiffness k of the joint put m w^2 - k
for m w^2, add c w (I + w tau R) to kp and -c (1 + (w tau)^2) R to kd, and move the line to kp = -k.

Sampled, on z = exp(j w T): the two real unknowns of 1 + kp Gp(z) + kd Gv(z) = 0, and the lines of
z = 1 (kp = -k) and z = -1. NumPy at the edge, float64.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.analysis.boundary.curves import Count, Gains, Range, frequency_grid
from jaxact.analysis.joint.frequency import JointLoop
from jaxact.analysis.joint.roots import count_unstable_roots
from jaxact.analysis.sampled.period_map import SampledLoop, one_period_matrix
from jaxact.analysis.sampled.pulse import plant_response, pulse_transfer
from jaxact.compilation.filling import in_chunks
from jaxact.compilation.programs import Program
from jaxact.parameters import DELAY, JOINT_DAMPING, JOINT_STIFFNESS, MASS, VELOCITY_FILTER

_CHUNK = 128


@dataclass(frozen=True)
class Marginal:
    """The marginal gains of one plant.

    Attributes:
        gains: (kp, kd) of a marginal root at w [rad/s].
        modulus: between what |kp + j w kd| of it is [N/m], whatever the delay, as a function of w;
            None if all frequencies are of interest.
        nyquist: pi/T [rad/s], inf for the continuous loop.
        at_nyquist: Gp(-1), Gv(-1), 0 for the continuous loop.
        lag: longest delay in the phase [s], for the density of the grid.
        count: number of unstable roots at (kp, kd).
        at_rest: kp of the line of roots at rest, -k [N/m].
    """

    gains: Gains
    modulus: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None
    nyquist: float
    at_nyquist: tuple[float, float]
    lag: float
    count: Count
    at_rest: float


def continuous_marginal(
    mass: float,
    wn: float,
    damping_ratio: float,
    delay: float,
    velocity_filter: float = math.inf,
    joint: tuple[float, float] = (0.0, 0.0),
) -> Marginal:
    """Of the continuous loop; mass [kg], wn [rad/s], zeta [-], total delay [s].

    Args:
        velocity_filter: cutoff of the filter of the velocity [rad/s], inf = none.
        joint: its own damping c [N s/m] and stiffness k [N/m].

    Raises:
        ValueError: values out of their domain.
    """
    zeta = 1.0 if math.isinf(wn) else damping_ratio
    c, k = joint
    _check_plant(mass, wn, zeta, delay)
    _check_filter(velocity_filter)

    def servo(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = w / wn
        return (1.0 - x) * (1.0 + x), 2.0 * zeta * x

    def gains(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        real, imaginary = servo(w)
        cosine, sine = np.cos(w * delay), np.sin(w * delay)
        real, imaginary = real * cosine - imaginary * sine, real * sine + imaginary * cosine
        turn = w / velocity_filter
        kp = (mass * w * w - k) * (real - turn * imaginary) + c * w * (imaginary + turn * real)
        kd = (mass * w - k / w) * (1.0 + turn * turn) * imaginary
        return kp, kd - c * (1.0 + turn * turn) * real

    def modulus(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        size = np.hypot(mass * w * w - k, c * w) * np.hypot(*servo(w))
        # The singular values of (R, I) -> (R - w tau I, (1 + (w tau)^2) I).
        turn2 = (w / velocity_filter) ** 2
        determinant, norm2 = 1.0 + turn2, 1.0 + turn2 + (1.0 + turn2) ** 2
        largest = np.sqrt(0.5 * (norm2 + np.sqrt(np.maximum(norm2**2 - 4.0 * determinant**2, 0.0))))
        return size * determinant / largest, size * largest

    def count(kp: np.ndarray, kd: np.ndarray) -> np.ndarray:
        return _count_continuous(kp, kd, (mass, wn, zeta, delay, velocity_filter), joint)

    return Marginal(gains, modulus, math.inf, (0.0, 0.0), delay, count, 0.0 - k)


def sampled_marginal(
    mass: float,
    wn: float,
    damping_ratio: float,
    delay: float,
    control_period: float,
    velocity_filter: float,
    kinds: dict,
    joint: tuple[float, float] = (0.0, 0.0),
) -> Marginal:
    """Of the sampled loop, besides with its control period [s] and velocity filter [rad/s].

    Args:
        kinds: velocity, integrator, substeps of a SampledLoop.
        joint: as for `continuous_marginal`.

    Raises:
        ValueError: values out of their domain.
    """
    zeta = 1.0 if math.isinf(wn) else damping_ratio
    _check_plant(mass, wn, zeta, delay)
    if not 0 < control_period < math.inf:
        raise ValueError("control_period must be positive")
    _check_filter(velocity_filter)
    numbers = (mass, wn, zeta, delay, control_period, velocity_filter)
    with jax.enable_x64(True):
        zero = jnp.asarray(0.0)
        arrays: list = [zero, zero, *(jnp.asarray(float(a)) for a in numbers)]
        own = dict(zip((JOINT_DAMPING, JOINT_STIFFNESS), map(jnp.asarray, joint), strict=True))
        plant = SampledLoop(*arrays, **kinds, **(own if any(joint) else {}))
        transfer = jax.tree.map(np.asarray, _transfer(plant))
        steps = int(transfer.steps)
        # The matrix is affine in the gains.
        base, along_kp, along_kd = (
            np.asarray(
                _period_matrix(replace(plant, kp=zero + kp, kd=zero + kd), max_delay_steps=steps)
            )
            for kp, kd in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
        )

    def plant_at(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u = np.exp(-1j * theta)
        s = 2j * np.sin(0.5 * theta) * np.exp(-0.5j * theta)
        return plant_response(transfer, u, s, np.exp(-1j * theta * (steps + 1)))

    def gains(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        position, rate = plant_at(w * control_period)
        with np.errstate(divide="ignore", invalid="ignore"):
            determinant = position.real * rate.imag - position.imag * rate.real
            return -rate.imag / determinant, position.imag / determinant

    def count(kp: np.ndarray, kd: np.ndarray) -> np.ndarray:
        kp, kd = kp[:, None, None], kd[:, None, None]
        closed = base + kp * (along_kp - base) + kd * (along_kd - base)
        return np.sum(np.abs(np.linalg.eigvals(closed)) > 1.0, axis=1)

    position, rate = plant_at(np.array([math.pi]))
    at_nyquist = (float(position.real[0]), float(rate.real[0]))
    nyquist = math.pi / control_period
    lag = delay + 4.0 * control_period
    return Marginal(gains, None, nyquist, at_nyquist, lag, count, 0.0 - joint[1])


_transfer = Program(pulse_transfer)
_counter = Program(count_unstable_roots)
_period_matrix = Program(one_period_matrix)


def _check_plant(mass: float, wn: float, zeta: float, delay: float) -> None:
    if not (mass > 0 and wn > 0 and zeta > 0):
        raise ValueError("mass, natural_frequency and damping_ratio must be positive")
    if not 0 <= delay < math.inf:
        raise ValueError("the delay must be finite and not negative")


def _check_filter(velocity_filter: float) -> None:
    if not velocity_filter > 0:
        raise ValueError("velocity_filter must be positive")


def window_grid(marginal: Marginal, mass: float, kp_range: Range, kd_range: Range) -> np.ndarray:
    """Frequencies that can lie in the window, dense in their logarithm and in the phase."""
    largest = [max(abs(a), abs(b)) for a, b in (kp_range, kd_range)]
    smallest = [min(abs(a), abs(b)) if a * b > 0 else 0.0 for a, b in (kp_range, kd_range)]
    unit = math.sqrt(max(largest[0], abs(marginal.at_rest)) / mass)
    if marginal.modulus is None:
        low = 1e-3 * math.sqrt(max(smallest[0], 1e-9 * largest[0]) / mass)
        low = min(low, 1e-3 * marginal.nyquist)
        return frequency_grid(low, marginal.nyquist * (1.0 - 1e-9), marginal.lag)
    w = np.geomspace(1e-9 * unit, 1e9 * unit, 20_001)
    least, most = marginal.modulus(w)
    possible = least <= 1.1 * np.hypot(largest[0], w * largest[1])
    possible &= most >= 0.9 * np.hypot(smallest[0], w * smallest[1])
    if not possible.any():
        return np.zeros(0)
    return frequency_grid(w[possible][0], w[possible][-1], marginal.lag)


def kp_on_line(marginal: Marginal, kd: float) -> float:
    """kp [N/m] of 1 + kp Gp(-1) + kd Gv(-1) = 0; NaN where kp does not matter, or continuous."""
    position, rate = marginal.at_nyquist
    negligible = abs(position) * marginal.nyquist <= 1e-12 * abs(rate)
    return math.nan if negligible or _is_continuous(marginal) else -(1.0 + kd * rate) / position


def kd_on_line(marginal: Marginal, kp: float) -> float:
    """kd [N s/m] of 1 + kp Gp(-1) + kd Gv(-1) = 0; NaN where kd does not matter, or continuous."""
    position, rate = marginal.at_nyquist
    negligible = abs(rate) <= 1e-12 * abs(position) * marginal.nyquist
    return math.nan if negligible or _is_continuous(marginal) else -(1.0 + kp * position) / rate


def _is_continuous(marginal: Marginal) -> bool:
    return math.isinf(marginal.nyquist)


def _count_continuous(
    kp: np.ndarray, kd: np.ndarray, plant: tuple[float, ...], joint: tuple[float, float]
) -> np.ndarray:
    """Unstable roots of the continuous loop, in chunks of one compiled shape.

    Args:
        plant: mass, wn, zeta, delay, cutoff of the filter of the velocity.
        joint: its own damping and stiffness.
    """
    names = (MASS, "natural_frequency", "damping_ratio", DELAY, VELOCITY_FILTER)
    own = dict(zip(names, plant, strict=True))
    if math.isinf(own[VELOCITY_FILTER]):
        del own[VELOCITY_FILTER]
    if any(joint):
        own |= dict(zip((JOINT_DAMPING, JOINT_STIFFNESS), joint, strict=True))
    fields = {name: np.full(len(kp), value) for name, value in own.items()}
    loops = JointLoop(kp, kd, **fields)  # type: ignore[arg-type]
    with jax.enable_x64(True):
        return in_chunks(_counter, loops, _CHUNK)
