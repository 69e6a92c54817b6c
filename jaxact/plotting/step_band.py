"""Step responses of an ensemble: the range of all members, with two of them drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxact.plotting import theme
from jaxact.plotting.page import page
from jaxact.plotting.tuning import AFTER, BEFORE

# Responses are drawn up to here; an unstable one goes on without end.
_HIGHEST, _BEYOND = 2.2, 10.0


@dataclass(frozen=True)
class Responses:
    """Responses with one pair of gains.

    Attributes:
        rows: position relative to the step, shape (members, ticks).
        names: of the members, in their order; none where there is one.
        nominal: response of the nominal plant, shape (ticks,); None where it is the only member.
    """

    rows: np.ndarray
    names: Sequence[str] = ()
    nominal: np.ndarray | None = None


def step_band(
    time: np.ndarray,
    before: Responses | None,
    after: Responses,
    *,
    title: str = "",
    footer: str = "",
) -> Figure:
    """Step responses with the gains before and after: the range of all members as a band.

    In it, solid the nominal plant, and dashed the member that overshoots most.

    Args:
        time: [s], shape (ticks,).
        before, after: None for no start.
        title, footer: above and below.
    """
    with theme.applied():
        sides = [(before, BEFORE, "before"), (after, AFTER, "after")]
        handles = [handle for side in sides if side[0] for handle in _handles(*side)]
        paper = page(
            7.0, 4.0, title=title, footer=footer, entries=len(handles),
            entry_width=3.4 if len(after.rows) > 1 else 1.5,
        )  # fmt: skip
        draw(paper.figure.subplots(), time, before, after)
        paper.legend(handles)
    return paper.figure


def draw(axes: Axes, time: np.ndarray, before: Responses | None, after: Responses) -> list[Artist]:
    """As `step_band`, on given axes. Returns a legend."""
    sides = [(before, BEFORE, "before"), (after, AFTER, "after")]
    scale, unit = (1e3, "ms") if time[-1] < 0.5 else (1.0, "s")
    for responses, color, _ in sides:
        if responses is not None:
            _draw(axes, time * scale, responses, color)
    axes.axhline(1.0, color=theme.INK, linewidth=0.9, linestyle=":", zorder=1)
    axes.axhspan(0.98, 1.02, color="#E4E4E4", zorder=0)
    peaks = [np.nanmax(side.rows) for side, *_ in sides if side is not None]
    axes.set_ylim(-0.1, max(1.3, min(1.1 * float(max(peaks)), _HIGHEST)))
    axes.set_xlim(0.0, time[-1] * scale)
    axes.set_xlabel(f"time [{unit}]")
    axes.set_ylabel("position / step")
    axes.grid(visible=True)
    return [handle for side, color, name in sides if side for handle in _handles(side, color, name)]


def worst(rows: np.ndarray) -> int:
    """The member that goes furthest beyond the step."""
    return int(np.argmax(np.where(np.isnan(rows), np.inf, rows).max(axis=1)))


def _draw(axes: Axes, time: np.ndarray, responses: Responses, color: str) -> None:
    rows = np.clip(np.nan_to_num(responses.rows, nan=_BEYOND), -_BEYOND, _BEYOND)
    if len(rows) == 1:
        axes.plot(time, rows[0], color=color, linewidth=1.6)
        return
    axes.fill_between(
        time, rows.min(axis=0), rows.max(axis=0), color=color, alpha=0.22, linewidth=0.0
    )
    axes.plot(time, rows[worst(rows)], color=color, linewidth=1.2, linestyle=(0, (5, 1.5)))
    if responses.nominal is not None:
        axes.plot(time, responses.nominal, color=theme.shade(color, -0.25), linewidth=1.8)


def _handles(responses: Responses, color: str, name: str) -> list[Artist]:
    """Legend entries of one side: one of a single loop, else of the band and what is in it."""
    if len(responses.rows) == 1:
        return [Line2D([], [], color=color, linewidth=1.6, label=name)]
    number = worst(responses.rows)
    member = responses.names[number] if responses.names else f"member {number}"
    handles: list[Artist] = [
        Patch(color=color, alpha=0.22, label=f"{name}: all {len(responses.rows)} members")
    ]
    if responses.nominal is not None:
        dark = theme.shade(color, -0.25)
        handles.append(Line2D([], [], color=dark, linewidth=1.8, label="nominal"))
    dash = {"color": color, "linewidth": 1.2, "linestyle": (0, (5, 1.5))}
    handles.append(Line2D([], [], **dash, label=f"overshoots most: {member}"))  # type: ignore[arg-type]
    return handles
