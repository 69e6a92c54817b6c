"""The exact boundary of stability over any two parameters of a joint's loop.

In the plane of the gains it is the D-partition curve of `jaxact.analysis.boundary.boundary`;
elsewhere it is traced: the sampled loop by the spectral radius of its one-period matrix, the one in
continuous time by the argument principle, both bisected to a millionth of a cell.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.compilation import filling
from jaxact.compilation.programs import Program
from jaxact.loops import conversion
from jaxact.parameters import CONTROL_RATE, GAIN_SCALE, KD, KP
from jaxact.sweeping import agreement, store
from jaxact.sweeping.tracing import Curve, trace

if TYPE_CHECKING:
    import xarray as xr

_CHUNK = 2048
# Seconds of eigenvalues that the boundary of one panel may take on one core.
_PATIENCE = 4.0
_GRIDS = (97, 65, 49, 33, 25)
NAMES = (*agreement.LINEAR_PARAMETERS, GAIN_SCALE)


@dataclass(frozen=True)
class Window:
    """The stretch of one parameter that a panel shows.

    Attributes:
        name: of the parameter.
        low, high: its ends, in the parameter's unit.
        logarithmic: whether the axis is, so that both ends are positive.
    """

    name: str
    low: float
    high: float
    logarithmic: bool

    def values(self, share: np.ndarray) -> np.ndarray:
        """Of the parameter, from shares of the axis between 0 and 1."""
        if self.logarithmic:
            return self.low * (self.high / self.low) ** share
        return self.low + share * (self.high - self.low)


@dataclass(frozen=True)
class ExactLines:
    """Lines between stable and unstable, as points (x, y) each.

    Attributes:
        continuous: of the loop in continuous time.
        sampled: of the loop at its control rate.
    """

    continuous: tuple[Curve, ...]
    sampled: tuple[Curve, ...]


def exact_lines(part: xr.Dataset, x: Window, y: Window) -> ExactLines | None:
    """The exact boundary in a window of two parameters of a slice of a sweep.

    None where another parameter that matters varies, where neither of the two does, and for a
    model of one's own, whose inertia is not known here.

    Args:
        part: of a sweep store.
        x, y: what the panel shows.
    """
    if not agreement.is_plain_mass(part) or not {x.name, y.name} & set(NAMES):
        return None
    if {x.name, y.name} == {KP, KD}:
        found = _gain_plane(part, x, y)
        if found is not None:
            return found
    fixed = {}
    for name in NAMES:
        values = np.unique(store.parameter(part, name).values)
        if name not in (x.name, y.name):
            if len(values) != 1:
                return None
            fixed[name] = float(values[0])
    return _traced(fixed, x, y, agreement.velocity_of(part))


def _gain_plane(part: xr.Dataset, x: Window, y: Window) -> ExactLines | None:
    windows = {window.name: (window.low, window.high) for window in (x, y)}
    found = agreement.exact_boundary(part, windows[KP], windows[KD])
    if found is None:
        return None
    return ExactLines(*(
        tuple((getattr(c, x.name), getattr(c, y.name)) for c in curves if c.separates)
        for curves in (found.continuous, found.sampled)
    ))  # fmt: skip


def _traced(fixed: Mapping[str, float], x: Window, y: Window, velocity: str) -> ExactLines:
    def values(first: np.ndarray, second: np.ndarray) -> dict[str, np.ndarray]:
        loops = {name: np.full(len(first), value) for name, value in fixed.items()}
        loops |= {x.name: x.values(first), y.name: y.values(second)}
        scale = loops.pop(GAIN_SCALE)
        return loops | {name: scale * loops[name] for name in (KP, KD)}

    def sampled(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        loops = {name: values(first, second)[name] for name in agreement.LINEAR_PARAMETERS}
        return agreement.spectral_radii(loops, velocity=velocity) < 1.0

    def continuous(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return stable_in_continuous_time(values(first, second))

    ends = values(np.array([0.0, 0.0, 1.0, 1.0]), np.array([0.0, 1.0, 0.0, 1.0]))
    fine = np.linspace(0.0, 1.0, _GRIDS[0])
    grid = np.linspace(0.0, 1.0, _affordable(ends))
    curves = trace(continuous, fine, fine), trace(sampled, grid, grid)
    return ExactLines(*(tuple((x.values(a), y.values(b)) for a, b in part) for part in curves))


def _affordable(ends: Mapping[str, np.ndarray]) -> int:
    """Points of a grid's side whose eigenvalues take no longer than a picture may cost."""
    steps = conversion.total_delay(ends) * ends[CONTROL_RATE]
    seconds = 1e-5 + 2e-8 * (8.0 + float(steps.max())) ** 3
    for points in _GRIDS:
        if (points**2 + 100 * points) * seconds <= _PATIENCE:
            return points
    return _GRIDS[-1]


def stable_in_continuous_time(values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Whether loops are stable, by the argument principle, in float64; shape (n,).

    Args:
        values: parameters of the linear loops by short name, shape (n,) each.
    """
    import jax

    from jaxact.loops import conversion

    with jax.enable_x64(True):
        loops = conversion.continuous(dict(values) | {GAIN_SCALE: 1.0})
        return filling.in_chunks(_unstable_roots, loops, _CHUNK) == 0


@Program
def _unstable_roots(loop: Any) -> Any:
    from jaxact.analysis.joint.roots import count_unstable_roots

    return count_unstable_roots(loop)
