"""A sweep held against exact theory: the border of stability, and the verdicts that differ from it.

A loop is exactly stable when the spectral radius rho of its one-period matrix is below 1. A sample
disagrees when its verdict says otherwise. How near it is to the border is the smallest factor on
kp, on kd, or on both, up or down, at which rho crosses 1; and its growth rate log(rho)/T. The
matrix is of the linear loop: quantisation, noise and limits are not in it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.compilation import filling
from jaxact.compilation.programs import Program
from jaxact.loops import conversion
from jaxact.parameters import (
    CONTROL_RATE,
    GAIN_SCALE,
    KD,
    KP,
    LINEAR,
    MASS,
    OF_JOINT,
    VELOCITY_FILTER,
    WN,
    ZETA,
)
from jaxact.status import Verdict
from jaxact.sweeping import store

if TYPE_CHECKING:
    import xarray as xr

    from jaxact.analysis.boundary.boundary import BoundaryCurve
# What the stability of the linear loop depends on; the gains first.
LINEAR_PARAMETERS = (*LINEAR, CONTROL_RATE)
# |rho - 1| within rounding of the eigenvalues: on the boundary, neither side is wrong there.
ON_BOUNDARY = 1e-9
# Factors tried on the gains, above and below 1, when the border is looked for.
_LADDER = 1.0 + np.geomspace(1e-5, 1e3, 84)
_DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1))
# Loops (of matrices up to 32 x 32) whose matrices are built at once.
_CHUNK = 2048
# Loops, taken evenly, that those which are compared are among: all parameters of all need memory.
_LOOKED_AT = 4_000_000
# Seconds of eigenvalues that a picture may cost; beyond them every n-th sample is compared.
_PATIENCE = 20.0


@dataclass(frozen=True)
class Agreement:
    """Simulation against exact theory.

    Attributes:
        samples: loops in the sweep.
        compared: loops whose verdict was compared (valid ones, or every n-th of very many).
        optimistic: simulated stable, exactly unstable.
        pessimistic: simulated not stable, exactly stable.
        furthest: largest distance of a disagreeing sample to the border, as factor - 1 on a gain
            [-]; 0 without disagreements, inf where no factor up to 1000 reaches it.
        fastest: largest |exact growth rate| of a disagreeing sample [1/s]; 0 without disagreements.
    """

    samples: int
    compared: int
    optimistic: int
    pessimistic: int
    furthest: float
    fastest: float

    @property
    def disagreements(self) -> int:
        """Samples whose verdict differs from the exact one."""
        return self.optimistic + self.pessimistic


@dataclass(frozen=True)
class ExactBoundary:
    """The border between stable and unstable gains of one slice of a sweep.

    Attributes:
        continuous: curves of the loop in continuous time, see `jaxact.analysis.boundary.boundary`.
        sampled: curves of the loop at its control rate.
    """

    continuous: tuple[BoundaryCurve, ...]
    sampled: tuple[BoundaryCurve, ...]


def exact_boundary(
    part: xr.Dataset, kp_range: tuple[float, float], kd_range: tuple[float, float]
) -> ExactBoundary | None:
    """The exact border in the (kp, kd) plane of a slice that varies nothing else that matters.

    None where another parameter of the linear loop varies or the gains are scaled, and for a model
    of one's own, whose inertia is not known here.

    Args:
        part: of a sweep store.
        kp_range, kd_range: of the window [N/m], [N s/m].
    """
    from jaxact.analysis.boundary.boundary import continuous_boundary, sampled_boundary

    if not is_plain_mass(part) or np.any(store.parameter(part, GAIN_SCALE).values != 1.0):
        return None
    values = {}
    for name in LINEAR_PARAMETERS[2:]:
        found = np.unique(store.parameter(part, name).values)
        if len(found) != 1:
            return None
        values[name] = float(found[0])
    servo = values[MASS], values[WN], values[ZETA]
    delay = conversion.total_delay(values)
    window: dict[str, Any] = {"kp_range": kp_range, "kd_range": kd_range}
    window |= {name: values[name] for name in (VELOCITY_FILTER, *OF_JOINT)}
    continuous = continuous_boundary(*servo, delay, **window)
    sampled = sampled_boundary(
        *servo, delay, 1.0 / values[CONTROL_RATE], velocity=velocity_of(part), **window
    )
    return ExactBoundary(tuple(continuous), tuple(sampled))


def sweep_agreement(results: xr.Dataset) -> Agreement | None:
    """Compare every verdict of a sweep store; None for a model whose inertia is not known here."""
    if not is_plain_mass(results):
        return None
    verdict = results["verdict"]
    numbers = np.arange(0, verdict.size, -(-verdict.size // _LOOKED_AT))
    places = dict(zip(verdict.dims, np.unravel_index(numbers, verdict.shape), strict=True))
    values = {}
    for name in (*LINEAR_PARAMETERS, GAIN_SCALE):
        own = store.parameter(results, name)
        along = own.values[tuple(places[dim] for dim in own.dims)]
        values[name] = np.broadcast_to(along, numbers.shape)
    scale = values.pop(GAIN_SCALE)
    values |= {name: scale * values[name] for name in (KP, KD)}
    found = agreement(values, verdict.values.ravel()[numbers], velocity=velocity_of(results))
    return replace(found, samples=verdict.size)


def is_plain_mass(results: xr.Dataset) -> bool:
    """Whether the plant is the mass itself, or the built-in model of it."""
    return "plant" not in json.loads(results.attrs["specification"])


def velocity_of(results: xr.Dataset) -> str:
    """ "sampled" or "differenced", as the sweep was specified."""
    return str(json.loads(results.attrs["specification"])["velocity"])


def agreement(
    values: Mapping[str, np.ndarray], verdict: np.ndarray, *, velocity: str = "sampled"
) -> Agreement:
    """Compare the verdict of every loop with its exact spectral radius.

    Args:
        values: every parameter of every loop, shape (samples,) each, by short name.
        verdict: codes of `jaxact.status.Verdict`, shape (samples,).
        velocity: "sampled" or "differenced".
    """
    verdict = np.asarray(verdict).ravel()
    chosen = np.flatnonzero(verdict != Verdict.INVALID)
    chosen = chosen[:: _stride(values, chosen)]
    loops = {name: np.asarray(array, dtype=float).ravel()[chosen] for name, array in values.items()}
    radius = spectral_radii(loops, velocity=velocity)
    decided = np.abs(radius - 1.0) > ON_BOUNDARY
    simulated, exact = verdict[chosen] == Verdict.STABLE, radius < 1.0
    # A quantised loop may cycle whether small perturbations of the linear one decay or grow.
    wrong = decided & (simulated != exact) & (verdict[chosen] != Verdict.LIMIT_CYCLE)
    furthest = fastest = 0.0
    if wrong.any():
        rates = np.log(radius[wrong]) * loops[CONTROL_RATE][wrong]
        fastest = float(np.abs(rates).max())
        distances = gain_distances(_take(loops, wrong), exact[wrong], velocity=velocity)
        furthest = float(distances.max())
    return Agreement(
        samples=len(verdict),
        compared=len(chosen),
        optimistic=int(np.sum(wrong & simulated)),
        pessimistic=int(np.sum(wrong & exact)),
        furthest=furthest,
        fastest=fastest,
    )


def spectral_radii(values: Mapping[str, np.ndarray], *, velocity: str = "sampled") -> np.ndarray:
    """Spectral radius of every loop's one-period matrix, in float64; shape (samples,).

    Args:
        values: parameters by short name, shape (samples,) each.
        velocity: "sampled" or "differenced".
    """
    steps = _whole_steps(values)
    most = int(steps.max(initial=0))
    radii = np.empty(len(steps))
    chunk = int(np.clip(_CHUNK * 32**2 // (most + 7) ** 2, 16, _CHUNK))
    order = np.argsort(steps, kind="stable")
    for start in range(0, len(order), chunk):
        part = order[start : start + chunk]
        matrices = _matrices(_take(values, part), velocity, most, chunk)
        for held in np.unique(steps[part]):
            same = steps[part] == held
            radii[part[same]] = _radii(_cut(matrices[same], int(held), most))
    return radii


def gain_distances(
    values: Mapping[str, np.ndarray], stable: np.ndarray, *, velocity: str = "sampled"
) -> np.ndarray:
    """Smallest factor - 1 on kp, kd or both, up or down, that changes each loop's stability.

    Args:
        values: parameters by short name, shape (samples,) each.
        stable: whether each loop is exactly stable as it is, shape (samples,).
        velocity: "sampled" or "differenced".

    Returns:
        Shape (samples,). The border is at most that far, and hardly less than 0.8 times as far.
    """
    distance = np.full(len(stable), np.inf)
    open_ = np.arange(len(stable))
    for factor in _LADDER:
        if open_.size == 0:
            break
        part = _take(values, open_)
        crossed = np.zeros(open_.size, dtype=bool)
        for on_kp, on_kd in _DIRECTIONS:
            moved = part | {
                KP: part[KP] * factor**on_kp,
                KD: part[KD] * factor**on_kd,
            }
            radius = spectral_radii(moved, velocity=velocity)
            crossed |= (radius < 1.0) != stable[open_]
        distance[open_[crossed]] = factor - 1.0
        open_ = open_[~crossed]
    return distance


def _whole_steps(values: Mapping[str, np.ndarray]) -> np.ndarray:
    return np.ceil(conversion.total_delay(values) * values[CONTROL_RATE] - 1e-9).astype(int)


def _stride(values: Mapping[str, np.ndarray], chosen: np.ndarray) -> int:
    """Stride of the loops that can be compared within `_PATIENCE` on one core."""
    size = 7.0 + _whole_steps(values).ravel()[chosen]
    seconds = np.sum(1e-5 + 2e-8 * size**3)
    return max(1, int(np.ceil(seconds / _PATIENCE)))


def _take(values: Mapping[str, np.ndarray], part: np.ndarray) -> dict[str, np.ndarray]:
    return {name: array[part] for name, array in values.items()}


def _matrices(values: Mapping[str, np.ndarray], velocity: str, most: int, chunk: int) -> np.ndarray:
    """One-period matrices with room for `most` delayed commands, shape (samples, size, size)."""
    import jax

    from jaxact.loops import conversion

    # Padded to one of two sizes: compiling takes longer than computing.
    count = len(values[KP])
    own = {name: values[name] for name in LINEAR_PARAMETERS if name in values}
    own = filling.filled(own, min(256, chunk) if count <= 256 else chunk)
    with jax.enable_x64(True):
        loop = conversion.sampled(own | {GAIN_SCALE: 1.0}, velocity)
        return np.asarray(_matrices_of(loop, most=most))[:count]


@Program
def _matrices_of(loops: Any, *, most: int) -> Any:
    import jax

    from jaxact.analysis.sampled.period_map import one_period_matrix

    return jax.vmap(lambda loop: one_period_matrix(loop, most))(loops)


def _cut(matrices: np.ndarray, held: int, most: int) -> np.ndarray:
    """The matrices without commands older than `held` + 1 periods, which nothing reads there."""
    size = matrices.shape[-1]
    kept = np.r_[: 4 + held + 1, 4 + most + 1 : size]
    return matrices[:, kept[:, None], kept]


def _radii(matrices: np.ndarray) -> np.ndarray:
    """Largest |eigenvalue| of each, inf where an element is not finite; shape (samples,)."""
    radii = np.full(len(matrices), np.inf)
    finite = np.isfinite(matrices).all(axis=(1, 2))
    if finite.any():
        radii[finite] = np.abs(np.linalg.eigvals(matrices[finite])).max(axis=1)
    return radii
