"""The plane of a joint's gains: its worst peaks, bounds and boundaries, before and after tuning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter
from scipy.ndimage import distance_transform_edt

from jaxact.analysis.boundary.curves import BoundaryCurve
from jaxact.parameters import KD, KP
from jaxact.plotting import theme, ticks, wording
from jaxact.plotting.page import page
from jaxact.plotting.tuning import BEFORE, star

_HIGHEST = 10.0
# Dark pink: found neither in the colours of the peaks nor in the marks.
_BOUND: dict[str, Any] = {"color": "#A3195B", "linewidth": 1.8}
# Share of the plane that a region needs to be named in it.
_ENOUGH = 0.04


@dataclass(frozen=True)
class Boundary:
    """Where one loop changes stability.

    Attributes:
        name: of the loop.
        curves: its marginal gains.
    """

    name: str
    curves: Sequence[BoundaryCurve]


@dataclass(frozen=True)
class Plane:
    """The larger of Ms and Mt over the plane of the gains, for the worst member.

    Attributes:
        kp: [N/m], shape (n,);  kd: [N s/m], shape (m,).
        peak: [-], shape (m, n), NaN where a member is unstable.
        boundaries: exact stability boundaries, of the members shown.
        units: of the gains.
    """

    kp: np.ndarray
    kd: np.ndarray
    peak: np.ndarray
    boundaries: Sequence[Boundary]
    units: tuple[str, str] = ("N/m", "N s/m")


def tuning_map(
    plane: Plane,
    before: tuple[float, float] | None,
    after: tuple[float, float],
    *,
    max_peak: float,
    reached: bool = True,
    title: str = "",
    footer: str = "",
) -> Figure:
    """The worst peak over the gains, the bound as a line, and both pairs of gains.

    Args:
        before, after: (kp, kd); None for no pair to start from.
        max_peak: the bound that is drawn, inf for none.
        reached: whether the gains meet every bound.
        title, footer: above and below.
    """
    with theme.applied():
        handles = _handles(plane, before, after, _shown(plane, max_peak), reached=reached)
        paper = page(6.4, 4.9, title=title, footer=footer, entries=len(handles), entry_width=3.2)
        axes = paper.figure.subplots()
        draw(axes, plane, before, after, max_peak=max_peak, reached=reached)
        paper.legend(handles)
    return paper.figure


def draw(
    axes: Axes,
    plane: Plane,
    before: tuple[float, float] | None,
    after: tuple[float, float],
    *,
    max_peak: float,
    reached: bool = True,
    colorbar: bool = True,
) -> list[Artist]:
    """As `tuning_map`, on given axes. Returns a legend."""
    finite, bound = plane.peak[np.isfinite(plane.peak)], _shown(plane, max_peak)
    mesh = _peaks(axes, plane)
    if np.isfinite(bound):
        axes.contour(
            plane.kp, plane.kd, plane.peak, levels=[bound], colors=_BOUND["color"],
            linewidths=_BOUND["linewidth"],
        )  # fmt: skip
    elif np.isfinite(max_peak) and not (finite < max_peak).any():
        above = f"max(Ms, Mt) above {max_peak:g}" if finite.size else "unstable"
        axes.set_title(f"{above} everywhere here", color=theme.VERMILION)
    for index, boundary in enumerate(plane.boundaries):
        for curve in boundary.curves:
            if curve.separates:
                axes.plot(curve.kp, curve.kd, **_line(index), scalex=False, scaley=False)
    if before is not None:
        axes.plot(*before, marker="X", color=BEFORE, markersize=9, markeredgecolor="white")
        axes.annotate("", after, before, arrowprops={"arrowstyle": "->", "color": theme.INK})
    axes.plot(*after, marker="*", color=theme.YELLOW, markersize=14, markeredgecolor="black")
    _dress(axes, plane)
    if colorbar:
        several = ", worst of the members named" if len(plane.boundaries) > 1 else ""
        bar = axes.figure.colorbar(mesh, ax=axes, extend="max")
        bar.set_label(f"max(Ms, Mt){several}")
        bar.ax.yaxis.set_major_locator(FixedLocator([1, 1.5, 2, 3, 5, 10]))
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.yaxis.set_minor_formatter(NullFormatter())
    return _handles(plane, before, after, bound, reached=reached)


def _shown(plane: Plane, max_peak: float) -> float:
    """The bound where a part of the plane meets it and another does not, else inf."""
    finite = plane.peak[np.isfinite(plane.peak)]
    return max_peak if finite.size and finite.min() < max_peak < finite.max() else np.inf


def _peaks(axes: Axes, plane: Plane) -> QuadMesh:
    """The coloured plane, and a word where a member is unstable."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_facecolor("#F1E4D8")
    unstable = ~np.isfinite(plane.peak)
    if _ENOUGH < unstable.mean() < 1.0:
        row, column = _deepest(unstable)
        axes.text(
            plane.kp[column], plane.kd[row], "unstable", ha="center", va="center",
            color="#7A4A22", fontsize=9, zorder=2,
        )  # fmt: skip
    return axes.pcolormesh(
        plane.kp, plane.kd, np.ma.masked_invalid(plane.peak), cmap=theme.sequential(),
        norm=LogNorm(1.0, _HIGHEST), shading="nearest", rasterized=True,
    )  # fmt: skip


def _deepest(mask: np.ndarray) -> tuple[int, int]:
    """Where the cells of a region are furthest from its border and that of the picture."""
    depth = distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    row, column = np.unravel_index(int(np.argmax(depth)), mask.shape)
    return int(row), int(column)


def _dress(axes: Axes, plane: Plane) -> None:
    axes.set_xlim(plane.kp[0], plane.kp[-1])
    axes.set_ylim(plane.kd[0], plane.kd[-1])
    axes.set_xlabel(wording.axis_label(KP, plane.units[0], "stiffness"))
    axes.set_ylabel(wording.axis_label(KD, plane.units[1], "damping"))
    ticks.label(axes.xaxis)
    ticks.label(axes.yaxis)


def _line(index: int) -> dict[str, Any]:
    """Of the index-th boundary: black, each with a dash of its own."""
    return {
        "color": "black",
        "linewidth": 1.4,
        "linestyle": theme.DASHES[index % len(theme.DASHES)],
    }


def _handles(
    plane: Plane,
    before: tuple[float, float] | None,
    after: tuple[float, float],
    bound: float,
    *,
    reached: bool,
) -> list[Artist]:
    def words(gains: tuple[float, float]) -> str:
        kp, kd = plane.units
        return f"kp {gains[0]:.4g} {kp}, kd {gains[1]:.4g} {kd}"

    handles: list[Artist] = [star(f"{'after' if reached else 'nearest found'}: {words(after)}")]
    if before is not None:
        handles.append(Line2D([], [], marker="X", color=BEFORE, ls="none", markersize=8,
                              label=f"before: {words(before)}"))  # fmt: skip
    if np.isfinite(bound):
        handles.append(Line2D([], [], **_BOUND, label=f"max(Ms, Mt) = {bound:g}"))
    for index, boundary in enumerate(plane.boundaries):
        if any(curve.separates for curve in boundary.curves):
            label = f"exact boundary: {boundary.name}"
            handles.append(Line2D([], [], **_line(index), label=label))
    return handles
