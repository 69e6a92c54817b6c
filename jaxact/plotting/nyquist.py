"""Nyquist plot of loops: unit circle, critical point, and the disk to stay out of."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke

from jaxact.plotting import theme
from jaxact.plotting.page import column, lines, page
from jaxact.plotting.response import LoopResponse, curve_styles, number

# Disks of more curves than this are drawn as circles only: their colours would mix to mud.
_MOST_FILLED = 3
_MARKS = "Circle: disk margin, L stays outside. On L: ○ phase crossover, □ gain crossover."


def nyquist(
    responses: Sequence[LoopResponse],
    *,
    title: str = "",
    footer: str = "",
    reach: float = 2.6,
) -> Figure:
    """L(jw) in the complex plane near the critical point -1.

    The shaded disk of a stable loop has its diameter from -(2 + a)/(2 - a) to -(2 - a)/(2 + a),
    with a the balanced disk margin: L stays outside and touches it (Seiler, Packard and Gahinet,
    "An introduction to disk margins", 2020).

    Args:
        responses: at least one loop.
        title, footer: above and below.
        reach: how far the picture extends to the left of the origin [-].
    """
    with theme.applied():
        labels = column([_described(response) for response in responses], 6.6)
        small_print = "\n".join(part for part in (footer, _MARKS) if part)
        paper = page(
            6.6, 6.2, title=title, footer=small_print, entries=lines(labels), entry_width=6.6
        )
        axes = paper.figure.subplots()
        draw(axes, responses, labels, reach=reach)
        paper.legend(axes.get_legend_handles_labels()[0])
    return paper.figure


def draw(
    axes: Axes, responses: Sequence[LoopResponse], labels: Sequence[str], *, reach: float = 2.6
) -> None:
    """The same on given axes, without a legend.

    Args:
        axes: of the complex plane.
        responses: at least one loop.
        labels: what each is called in a legend.
        reach: as for `nyquist`.
    """
    circle = Circle((0.0, 0.0), 1.0, fill=False, edgecolor=theme.FAINT, linewidth=0.9, zorder=1)
    axes.add_patch(circle)
    drawn = list(zip(responses, labels, curve_styles(responses), strict=True))
    filled = len(responses) <= _MOST_FILLED
    for response, label, line in drawn:
        _disk(axes, response, line["color"], filled=filled)
        curve = response.open_loop
        axes.plot(curve.real, curve.imag, label=label, **line)
        _arrow(axes, curve, line["color"], reach)
        _margins(axes, response, line["color"])
    _critical_point(axes)
    axes.axhline(0.0, color=theme.GRID, linewidth=0.7, zorder=0)
    axes.axvline(0.0, color=theme.GRID, linewidth=0.7, zorder=0)
    axes.set_aspect("equal")
    axes.set_xlim(-reach, 1.25)
    axes.set_ylim(-0.5 * (reach + 1.25), 0.5 * (reach + 1.25))
    axes.set_xlabel("Re L(jω)")
    axes.set_ylabel("Im L(jω)")


def disk(disk_margin: float) -> tuple[float, float]:
    """(centre, radius) on the real axis of the disk L stays out of, for a margin below 2."""
    square = disk_margin * disk_margin
    return -(4.0 + square) / (4.0 - square), 4.0 * disk_margin / (4.0 - square)


def _described(response: LoopResponse) -> str:
    """`HyQ, 1 ms: disk margin 0.47, gains ×0.62 to ×1.61, phase ±26°`."""
    margin = response.margin("disk_margin")
    if not response.stable:
        return f"{response.label}: unstable"
    if margin is None:
        return response.label
    if margin >= 2.0:
        return f"{response.label}: disk margin {number(margin)}"
    low, high = (2.0 - margin) / (2.0 + margin), (2.0 + margin) / (2.0 - margin)
    phase = 2.0 * math.degrees(math.atan(0.5 * margin))
    return (
        f"{response.label}: disk margin {number(margin)}, "
        f"gains ×{number(low)} to ×{number(high)}, phase ±{phase:.0f}°"
    )


def _critical_point(axes: Axes) -> None:
    """-1, above all that is drawn there."""
    halo = [withStroke(linewidth=3.0, foreground="white")]
    axes.plot(
        -1.0, 0.0, marker="+", color="black", markersize=11, markeredgewidth=1.8, zorder=9,
        path_effects=halo,
    )  # fmt: skip
    axes.annotate(
        "−1", (-1.0, 0.0), (-7.0, 6.0), textcoords="offset points", ha="right", fontsize=10,
        fontweight="bold", zorder=10, path_effects=halo,
    )  # fmt: skip


def _disk(axes: Axes, response: LoopResponse, color: object, *, filled: bool) -> None:
    margin = response.margin("disk_margin")
    if margin is None or not 0.0 < margin < 2.0:
        return
    centre, radius = disk(margin)
    if filled:
        axes.add_patch(
            Circle((centre, 0.0), radius, facecolor=color, alpha=0.10, edgecolor="none", zorder=0.5)  # type: ignore[arg-type]
        )
    axes.add_patch(
        Circle((centre, 0.0), radius, fill=False, edgecolor=color, linewidth=0.8, zorder=1)  # type: ignore[arg-type]
    )


def _arrow(axes: Axes, curve: np.ndarray, color: object, reach: float) -> None:
    """The direction of rising frequency, where the curve is well inside the picture."""
    inside = np.flatnonzero((np.abs(curve) < 0.55 * reach) & (np.abs(curve) > 0.5))
    if inside.size < 3:
        return
    at = int(inside[0])
    start, end = curve[at], curve[at + 1]
    if not np.isfinite([start.real, start.imag, end.real, end.imag]).all() or start == end:
        return
    axes.annotate(
        "", (end.real, end.imag), (start.real, start.imag), zorder=4,
        arrowprops={"arrowstyle": "-|>", "color": color, "mutation_scale": 13},
    )  # fmt: skip


def _margins(axes: Axes, response: LoopResponse, color: object) -> None:
    """The phase crossover on the real axis and the gain crossover on the unit circle."""
    gain, phase = response.margin("gain_margin"), response.margin("phase_margin")
    dot = {"markersize": 5.0, "markerfacecolor": "white", "color": color, "zorder": 5}
    if gain:
        axes.plot(-1.0 / gain, 0.0, marker="o", **dot)  # type: ignore[arg-type]
    if phase is not None:
        angle = math.radians(phase - 180.0)
        axes.plot(math.cos(angle), math.sin(angle), marker="s", **dot)  # type: ignore[arg-type]
