"""Colour of a result variable: its map, its normalisation, its label."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, LogNorm, Normalize, SymLogNorm
from matplotlib.ticker import FixedLocator, FuncFormatter, Locator, NullLocator

from jaxact.errors import UserError, nearest
from jaxact.plotting import theme, ticks
from jaxact.status import Verdict

# Symmetric-log colours: linear within this fraction of the largest growth rate shown.
LINEAR_FRACTION = 1e-3
_LONG = {
    "growth_rate": "growth rate",
    "shaking_rate": "shaking rate",
    "rise_time": "rise time",
    "settling_time": "settling time",
    "integrated_absolute_error": "integrated absolute error",
    "integrated_squared_error": "integrated squared error",
    "control_effort": "control effort",
    "peak_force": "peak force",
    "rms_force": "rms force",
    "limit_cycle_amplitude": "limit cycle amplitude",
    "limit_cycle_frequency": "limit cycle frequency",
}


# Rates of small perturbations, drawn with their sign, of every loop.
RATES = ("growth_rate", "shaking_rate")
# What only a limit cycle has; of a loop that settles its amplitude is none, not small.
OF_LIMIT_CYCLES = ("limit_cycle_amplitude", "limit_cycle_frequency")


@dataclass(frozen=True)
class Field:
    """How one variable is coloured.

    Attributes:
        variable: its name in the store.
        label: text of the colour bar, with unit.
        colors: colour map.
        norm: value -> [0, 1].
        ticks: colour-bar ticks, None for matplotlib's own.
        extend: arrows of the colour bar where values lie beyond it.
    """

    variable: str
    label: str
    colors: Colormap
    norm: Normalize
    ticks: Locator | None
    extend: str


def variables(dataset: xr.Dataset) -> list[str]:
    """Names that can be drawn: every result but the verdict, which is drawn always."""
    return [str(name) for name in dataset.data_vars if name != "verdict"]


def usual(dataset: xr.Dataset) -> str:
    """What is coloured unless something else is asked for: a rate.

    Where robots topple, whose growth rates are those of falling, the shaking rate: what gains and
    delays change.
    """
    topples = "shaking_rate" in dataset and np.any(dataset["verdict"].values == Verdict.TOPPLES)
    return "shaking_rate" if topples else "growth_rate"


def field(dataset: xr.Dataset, variable: str) -> Field:
    """Colours of a variable over the whole sweep, so that all panels share them.

    Raises:
        UserError: a name that is not in the store, and one without a finite value.
    """
    known = variables(dataset)
    if variable not in known:
        raise UserError(f"unknown variable '{variable}'; {nearest(variable, known)}")
    array = dataset[variable]
    # an unstable loop's overshoot or settling time is a number about the explosion, not a response
    shown = array.values if variable in RATES else settled(dataset, variable)
    finite = shown[np.isfinite(shown)].astype(float)
    if finite.size == 0 and variable in OF_LIMIT_CYCLES:
        raise UserError(f"variable '{variable}': no loop of this sweep is a limit cycle")
    if finite.size == 0:
        raise UserError(f"variable '{variable}' has no finite value in this sweep; choose another")
    label = variable_label(array)
    if variable in RATES:
        return _signed(variable, label, finite)
    low, high = (float(v) for v in np.percentile(finite, [0.5, 99.5]))
    extend = _extend(finite, low, high)
    colors = theme.sequential()
    if variable == OF_LIMIT_CYCLES[0] and low == high:
        low, high = low / 2.0, high * 2.0
    # Of a peak what matters is between 1 and 3, and loops beside the boundary have any.
    if low > 0 and (high / low > (5 if variable.endswith("_peak") else 30)
                    or variable == OF_LIMIT_CYCLES[0]):  # fmt: skip
        return Field(variable, label, colors, LogNorm(low, high), None, extend)
    if low == high:
        low, high, extend = low - 0.5, high + 0.5, "neither"
    return Field(variable, label, colors, Normalize(low, high), None, extend)


def settled(dataset: xr.Dataset, variable: str) -> np.ndarray:
    """Values of a variable where the verdict is stable or limit cycle, NaN elsewhere.

    What only limit cycles have is NaN where the loop settles.
    """
    verdict, values = dataset["verdict"].values, dataset[variable].values.astype(float)
    if variable in OF_LIMIT_CYCLES:
        return np.where((verdict == Verdict.LIMIT_CYCLE) & (values > 0.0), values, np.nan)
    keep = (verdict == Verdict.STABLE) | (verdict == Verdict.LIMIT_CYCLE)
    return np.where(keep, values, np.nan)


def variable_label(array: xr.DataArray) -> str:
    """`settling time [s]`."""
    name = str(array.name)
    words = str(array.attrs.get("long_name", _LONG.get(name, name.replace("_", " "))))
    units = str(array.attrs.get("units", ""))
    return f"{words} [{units}]" if units not in ("", "1") else words


def signed_scale(values: np.ndarray) -> tuple[float, float]:
    """(limit, linear range) of a symmetric-log scale that shows these signed values."""
    largest = float(np.percentile(np.abs(values), 99.0)) if values.size else 1.0
    limit = 10.0 ** math.ceil(math.log10(max(largest, 1e-9)) - 0.05)
    return limit, limit * LINEAR_FRACTION


def signed_ticks(limit: float, linear: float) -> tuple[Locator, FuncFormatter]:
    """Decades from -limit to limit with zero, each written out."""
    decades = np.arange(round(math.log10(linear)), round(math.log10(limit)) + 1)
    positive = 10.0**decades
    ticks = np.concatenate([-positive[::-1], [0.0], positive])
    return FixedLocator(ticks), FuncFormatter(lambda v, _: f"{v:g}".replace("-", "\u2212"))


def _signed(variable: str, label: str, finite: np.ndarray) -> Field:
    limit, linear = signed_scale(finite)
    norm = SymLogNorm(linthresh=linear, linscale=0.6, vmin=-limit, vmax=limit)
    ticks, _ = signed_ticks(limit, linear)
    return Field(variable, label, theme.diverging(), norm, ticks, _extend(finite, -limit, limit))


def _extend(finite: np.ndarray, low: float, high: float) -> str:
    below, above = bool(finite.min() < low), bool(finite.max() > high)
    return {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[below, above]


def dress_colorbar(bar: Colorbar, shown: Field) -> None:
    """Label and ticks of a colour bar."""
    bar.set_label(shown.label)
    bar.outline.set_linewidth(0.6)  # type: ignore[operator]
    if shown.ticks is not None and isinstance(shown.norm, SymLogNorm):
        _, formatter = signed_ticks(float(shown.norm.vmax or 1.0), shown.norm.linthresh)
        bar.ax.yaxis.set_major_locator(shown.ticks)
        bar.ax.yaxis.set_minor_locator(NullLocator())
        bar.ax.yaxis.set_major_formatter(formatter)
    elif isinstance(shown.norm, LogNorm):
        ticks.label(bar.ax.yaxis)
