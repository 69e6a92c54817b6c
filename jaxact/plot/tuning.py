"""Pictures of a tuning: gain plane before and after, convergence, step responses, front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from jaxact.lobes import BoundaryCurve
from jaxact.plot import look, wording
from jaxact.plot.sheet import sheet

BEFORE, AFTER = look.VERMILION, look.BLUE
_HIGHEST = 10.0
# Green comes here in the cycle of line styles, and blue is the objective's.
_FIRST = look.CYCLE.index(look.GREEN)


@dataclass(frozen=True)
class Plane:
    """The larger of Ms and Mt over the plane of the gains, for the worst member.

    kp: [N/m], shape (n,);  kd: [N s/m], shape (m,)
    peak: [-], shape (m, n), NaN where unstable
    boundaries: exact stability boundaries, of the members shown
    """

    kp: np.ndarray
    kd: np.ndarray
    peak: np.ndarray
    boundaries: Sequence[BoundaryCurve]


def tuning_map(
    plane: Plane,
    before: tuple[float, float] | None,
    after: tuple[float, float],
    *,
    max_peak: float,
    title: str = "",
    footer: str = "",
) -> Figure:
    """The worst peak over the gains, the bound as a line, and both pairs of gains.

    before, after: (kp, kd); None for no pair to start from
    max_peak: the bound that is drawn, inf for none
    title, footer: above and below
    """
    with look.look():
        handles = _handles(before, after, max_peak)
        paper = sheet(6.4, 4.9, title=title, footer=footer, entries=len(handles), entry_width=3.2)
        axes = paper.figure.subplots()
        axes.set_xscale("log")
        axes.set_yscale("log")
        shown = np.ma.masked_invalid(plane.peak)
        axes.set_facecolor("#F1E4D8")
        mesh = axes.pcolormesh(
            plane.kp, plane.kd, shown, cmap=look.sequential(), norm=LogNorm(1.0, _HIGHEST),
            shading="nearest", rasterized=True,
        )  # fmt: skip
        if np.isfinite(max_peak) and np.nanmin(plane.peak) < max_peak < np.nanmax(plane.peak):
            axes.contour(plane.kp, plane.kd, plane.peak, levels=[max_peak], colors="white",
                         linewidths=1.6)  # fmt: skip
        for curve in plane.boundaries:
            if curve.separates:
                axes.plot(curve.kp, curve.kd, color="black", linewidth=1.4, scalex=False,
                          scaley=False)  # fmt: skip
        if before is not None:
            axes.plot(*before, marker="X", color=BEFORE, markersize=9, markeredgecolor="white")
            axes.annotate("", after, before, arrowprops={"arrowstyle": "->", "color": look.INK})
        axes.plot(*after, marker="*", color=look.YELLOW, markersize=14, markeredgecolor="black")
        axes.set_xlim(plane.kp[0], plane.kp[-1])
        axes.set_ylim(plane.kd[0], plane.kd[-1])
        axes.set_xlabel(wording.axis_label("kp", "N/m", "stiffness"))
        axes.set_ylabel(wording.axis_label("kd", "N s/m", "damping"))
        bar = paper.figure.colorbar(mesh, ax=axes, extend="max")
        bar.set_label("max(Ms, Mt) of the worst member")
        bar.ax.yaxis.set_major_locator(FixedLocator([1, 1.5, 2, 3, 5, 10]))
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.yaxis.set_minor_formatter(NullFormatter())
        paper.legend(handles)
    return paper.figure


def _handles(
    before: tuple[float, float] | None, after: tuple[float, float], max_peak: float
) -> list[Artist]:
    def words(gains: tuple[float, float]) -> str:
        return f"kp {gains[0]:.4g} N/m, kd {gains[1]:.4g} N s/m"

    handles: list[Artist] = [_star(f"after: {words(after)}")]
    if before is not None:
        handles.append(Line2D([], [], marker="X", color=BEFORE, ls="none", markersize=8,
                              label=f"before: {words(before)}"))  # fmt: skip
    handles.append(Line2D([], [], color="black", lw=1.4, label="exact stability boundary"))
    if np.isfinite(max_peak):
        handles.append(
            Line2D([], [], color=look.FAINT, lw=1.6, label=f"max(Ms, Mt) = {max_peak:g}")
        )
    return handles


def _star(label: str) -> Artist:
    return Line2D(
        [], [], marker="*", color=look.YELLOW, markersize=12, markeredgecolor="black", ls="none",
        label=label,
    )  # fmt: skip


def convergence(
    values: np.ndarray,
    violations: np.ndarray,
    *,
    label: str,
    given: bool,
    title: str = "",
    footer: str = "",
) -> Figure:
    """The objective of every start along the descent, and by how much its constraints are missed.

    values: of the objective in its unit, shape (starts, steps)
    violations: largest ratio of a figure to its bound [-], 1 where it is met, same shape
    label: of the objective, with unit
    given: the last start is the user's own
    title, footer: above and below
    """
    with look.look():
        paper = sheet(6.8, 4.8, title=title, footer=footer, entries=2 if given else 1)
        upper, lower = paper.figure.subplots(
            2, 1, sharex=True, gridspec_kw={"height_ratios": (1.5, 1)}
        )
        steps = np.arange(values.shape[1])
        for index in range(len(values)):
            own = given and index == len(values) - 1
            line = {"color": BEFORE if own else AFTER, "linewidth": 1.6 if own else 1.0,
                    "alpha": 1.0 if own else 0.75}  # fmt: skip
            upper.plot(steps, values[index], **line)
            lower.plot(steps, violations[index], **line)
        if np.all(values > 0):
            upper.set_yscale("log")
        upper.set_ylabel(label)
        lower.set_ylabel("figure / bound")
        finite = violations[np.isfinite(violations)]
        if finite.size:
            lower.set_ylim(0.9 * min(finite.min(), 1.0), min(1.1 * max(finite.max(), 1.0), 4.0))
        lower.axhline(1.0, color=look.INK, linewidth=0.9)
        lower.set_xlabel("step")
        for axes in (upper, lower):
            axes.grid(visible=True)
        paper.figure.align_ylabels()
        handles = [Line2D([], [], color=AFTER, label="default starts")]
        if given:
            handles.append(Line2D([], [], color=BEFORE, label="the given start"))
        paper.legend(handles)
    return paper.figure


def step_band(
    time: np.ndarray,
    before: np.ndarray | None,
    after: np.ndarray,
    *,
    title: str = "",
    footer: str = "",
) -> Figure:
    """Step responses of all members, with the gains before and after.

    time: [s], shape (ticks,)
    before, after: position relative to the step, shape (members, ticks); None for no start
    title, footer: above and below
    """
    with look.look():
        paper = sheet(7.0, 4.0, title=title, footer=footer, entries=2)
        axes = paper.figure.subplots()
        scale, unit = (1e3, "ms") if time[-1] < 0.5 else (1.0, "s")
        handles: list[Artist] = []
        for rows, color, name in ((before, BEFORE, "before"), (after, AFTER, "after")):
            if rows is not None:
                _members(axes, time * scale, rows, color)
                handles.append(Line2D([], [], color=color, label=name))
        axes.axhline(1.0, color=look.INK, linewidth=0.9, linestyle="--", zorder=1)
        axes.axhspan(0.98, 1.02, color="#E4E4E4", zorder=0)
        highest = float(np.nanmax(after))
        axes.set_ylim(-0.1, max(1.3, min(1.1 * highest, 2.2)))
        axes.set_xlim(0.0, time[-1] * scale)
        axes.set_xlabel(f"time [{unit}]")
        axes.set_ylabel("position / step")
        axes.grid(visible=True)
        paper.legend(handles)
    return paper.figure


def _members(axes: Axes, time: np.ndarray, rows: np.ndarray, color: str) -> None:
    thin = 1.6 if len(rows) == 1 else 0.6
    for row in rows:
        axes.plot(time, row, color=color, linewidth=thin, alpha=1.0 if len(rows) == 1 else 0.5)


def front(
    peaks: np.ndarray,
    values: np.ndarray,
    kd: np.ndarray,
    *,
    label: str,
    kd_unit: str = "N s/m",
    groups: Sequence[str] = ("",),
    marked: tuple[float, float] | None = None,
    title: str = "",
    footer: str = "",
) -> Figure:
    """What robustness costs: the objective against the largest peak allowed, and kd below.

    peaks: largest Ms and Mt allowed [-], rising, shape (points,)
    values: of the objective in its unit, NaN where infeasible, shape (points,)
    kd: of the groups of joints, shape (points, groups), or (points,) of a single joint
    label: of the objective, with unit
    kd_unit: of kd
    groups: names of the groups; one without a name is not named
    marked: a point (peak, value) to mark
    title, footer: above and below
    """
    with look.look():
        rows = np.reshape(kd, (len(peaks), -1)).T
        named = [name for name in groups if name]
        entries = len(named) + (1 if marked else 0)
        paper = sheet(6.4, 4.8, title=title, footer=footer, entries=entries)
        upper, lower = paper.figure.subplots(
            2, 1, sharex=True, gridspec_kw={"height_ratios": (1.6, 1)}
        )
        upper.plot(peaks, values, marker="o", markersize=4, color=AFTER)
        handles: list[Artist] = []
        for index, (row, name) in enumerate(zip(rows, groups, strict=True)):
            color = look.CYCLE[(_FIRST + index) % len(look.CYCLE)]
            style = {"marker": look.MARKERS[index // len(look.CYCLE)], "markersize": 4,
                     "color": color}  # fmt: skip
            lower.plot(peaks, row, **style)
            if name:
                handles.append(Line2D([], [], **style, label=f"kd of {name}"))
        if marked is not None:
            upper.plot(*marked, marker="*", markersize=13, color=look.YELLOW,
                       markeredgecolor="black", zorder=5)  # fmt: skip
            handles.append(_star("the bound asked for"))
        upper.set_yscale("log")
        upper.set_ylabel(label)
        if len(rows) > 1:
            lower.set_yscale("log")
        lower.set_ylabel(f"kd [{kd_unit}]")
        lower.set_xlabel("largest Ms and Mt allowed")
        for axes in (upper, lower):
            axes.grid(visible=True)
        paper.figure.align_ylabels()
        paper.legend(handles)
    return paper.figure
