"""An identification in pictures: measured and simulated, the ladder, what is left, the response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import signal as _signal
from scipy import stats

from jaxact.plotting import theme, ticks
from jaxact.plotting.page import page

# So many rows of a log can be seen beside each other.
_MOST_ROWS = 1500
_LAGS = 60
# Of a frequency response: incoherent frequencies before it ends, and the fewest to draw.
_MOST_GAPS, _FEWEST_POINTS = 10, 5


@dataclass(frozen=True)
class Compared:
    """One log, and what a model makes of it.

    Attributes:
        title: of the log.
        time: of its rows [s], shape (rows,).
        stimulus, measured, simulated: shape (rows,).
        signal, unit: that was measured.
    """

    title: str
    time: np.ndarray
    stimulus: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    signal: str
    unit: str

    @property
    def rest(self) -> np.ndarray:
        """Measured minus simulated, shape (rows,)."""
        return self.measured - self.simulated


@dataclass(frozen=True)
class Step:
    """One rung of the ladder: name, unknowns, error on unseen logs, whether all is identified."""

    name: str
    size: int
    error: float
    identified: bool
    chosen: bool


@dataclass(frozen=True)
class Profile:
    """The profile likelihood of one unknown.

    Attributes:
        name: of the unknown, with the model where that is not the chosen one.
        unit: of its values.
        value, low, high: the estimate and its 95 % interval.
        values: shape (values,).
        rises: of the sum of squares over that at the interval's ends, shape (values,).
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    values: np.ndarray
    rises: np.ndarray


def sheet(
    compared: Compared,
    steps: Sequence[Step],
    profiles: Sequence[Profile] = (),
    *,
    title: str = "",
    footer: str = "",
) -> Figure:
    """All panels on one page; those of the frequency response where there is one.

    Args:
        compared: a log that the model has not seen.
        steps: the ladder, simplest first.
        profiles: of one or two unknowns.
        title: above.
        footer: below.
    """
    columns = [("ladder", "white")]
    if response(compared) is not None:
        columns.insert(0, ("gain", "phase"))
    if profiles:
        columns.append(("first", "second" if len(profiles) > 1 else "first"))
    with theme.applied():
        paper = page(9.0, 6.6, title=title, footer=footer, entries=3, entry_width=2.6)
        grid = paper.figure.subplot_mosaic(
            [
                ["over"] * len(columns),
                ["rest"] * len(columns),
                *map(list, zip(*columns, strict=True)),
            ],
            height_ratios=(1.5, 0.7, 1.0, 1.0),
        )
        handles = over(grid["over"], compared)
        residual(grid["rest"], compared)
        grid["over"].sharex(grid["rest"])
        grid["over"].tick_params(labelbottom=False)
        if "gain" in grid:
            frequency_response((grid["gain"], grid["phase"]), compared)
        ladder(grid["ladder"], steps, compared.unit)
        autocorrelation(grid["white"], compared)
        for name, drawn in zip(("first", "second"), profiles, strict=False):
            profile_likelihood(grid[name], drawn)
        paper.legend(handles)
    return paper.figure


def joints(each: Sequence[Compared], *, title: str = "", footer: str = "") -> Figure:
    """Measured and simulated of several joints, two beside each other.

    Args:
        each: a log and its simulation.
        title: above.
        footer: below.
    """
    rows = -(-len(each) // 2)
    with theme.applied():
        paper = page(9.0, 1.2 + 1.5 * rows, title=title, footer=footer, entries=2, entry_width=2.6)
        panels = paper.figure.subplots(rows, min(len(each), 2), squeeze=False)
        handles: list = []
        for axes, compared in zip(panels.flat, each, strict=False):
            handles = over(axes, compared)
        for axes in panels.flat[len(each) :]:
            axes.remove()
        for axes in panels[-1]:
            axes.set_xlabel("time [s]")
        paper.legend(handles)
    return paper.figure


def replay(compared: Compared, *, title: str = "", footer: str = "") -> Figure:
    """Measured and simulated where most happens, what is left there, and what is left of it all.

    Args:
        compared: a log and its simulation.
        title: above.
        footer: below.
    """
    with theme.applied():
        paper = page(9.0, 4.6, title=title, footer=footer, entries=2, entry_width=2.6)
        grid = paper.figure.subplot_mosaic(
            [["over"], ["rest"], ["whole"]], height_ratios=(1.6, 0.7, 0.7)
        )
        handles = over(grid["over"], compared)
        residual(grid["rest"], compared)
        grid["rest"].sharex(grid["over"])
        grid["over"].tick_params(labelbottom=False)
        grid["rest"].set_xlabel("")
        grid["whole"].plot(compared.time, compared.rest, color=theme.BLUE, linewidth=0.5)
        grid["whole"].axvspan(
            *compared.time[_busiest(compared)][[0, -1]], color="#E4E4E4", zorder=0
        )
        grid["whole"].set_xlim(compared.time[0], compared.time[-1])
        grid["whole"].set_ylabel(f"all of it [{compared.unit}]")
        grid["whole"].set_xlabel("time [s]; grey: above")
        paper.legend(handles)
    return paper.figure


def over(axes: Axes, compared: Compared) -> list:
    """Measured and simulated over each other.

    Args:
        axes: to draw on.
        compared: a log and its simulation.

    Returns:
        The lines, for a legend.
    """
    part = _busiest(compared)
    time = compared.time[part]
    lines = [
        axes.plot(time, compared.measured[part], color=theme.INK, linewidth=1.4, label="measured"),
        axes.plot(
            time, compared.simulated[part], color=theme.VERMILION, linewidth=1.1,
            linestyle=(0, (4, 1.5)), label="simulated",
        ),
    ]  # fmt: skip
    axes.set_ylabel(f"{compared.signal} [{compared.unit}]")
    axes.set_title(compared.title, loc="left")
    axes.grid(visible=True)
    axes.set_xlim(time[0], time[-1])
    return [line[0] for line in lines]


def residual(axes: Axes, compared: Compared) -> None:
    """Measured minus simulated over time, on the part that `over` shows."""
    part = _busiest(compared)
    axes.plot(compared.time[part], compared.rest[part], color=theme.BLUE, linewidth=0.8)
    axes.axhline(0.0, color=theme.FAINT, linewidth=0.6)
    axes.set_ylabel(f"residual [{compared.unit}]")
    axes.set_xlabel("time [s]")
    axes.grid(visible=True)


def ladder(axes: Axes, steps: Sequence[Step], unit: str) -> None:
    """Error on unseen logs over the number of unknowns; filled where all of them are identified.

    Args:
        axes: to draw on.
        steps: the ladder.
        unit: of the error.
    """
    finite = [step for step in steps if np.isfinite(step.error)]
    for step in finite:
        colour = theme.VERMILION if step.chosen else theme.BLUE
        axes.plot(
            step.size, step.error, "o", markersize=7 if step.chosen else 5, color=colour,
            markerfacecolor=colour if step.identified else "white", zorder=4,
        )  # fmt: skip
    sizes = sorted({step.size for step in finite})
    best = [min(step.error for step in finite if step.size <= size) for size in sizes]
    axes.step(sizes, best, where="post", color=theme.FAINT, linewidth=0.9, zorder=2)
    axes.set_xticks(sizes)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("unknowns (hollow: not all identified)")
    axes.set_ylabel(f"unseen error [{unit}]")
    axes.grid(visible=True)


def autocorrelation(axes: Axes, compared: Compared) -> None:
    """Autocorrelation of the residual, with the 95 % band of white noise."""
    found = correlations(compared)
    band, lags = found["band"], found["lags"]
    axes.axhspan(-band, band, color="#E4E4E4", zorder=0)
    axes.vlines(lags, 0.0, found["values"], color=theme.BLUE, linewidth=1.0)
    axes.axhline(0.0, color=theme.FAINT, linewidth=0.6)
    axes.set_xlabel("lag [rows]")
    axes.set_ylabel("autocorrelation")
    axes.set_ylim(-1.0, 1.0)
    axes.grid(visible=True)


def correlations(compared: Compared) -> dict[str, Any]:
    """Autocorrelation of the residual by lag [rows], and half of the 95 % band of white noise."""
    rest = compared.rest - compared.rest.mean()
    power = max(float(rest @ rest), 1e-300)
    lags = np.arange(1, min(_LAGS, len(rest) - 1))
    each = [float(rest[lag:] @ rest[:-lag]) / power for lag in lags.tolist()]
    return {"lags": lags, "values": np.array(each), "band": 1.96 / np.sqrt(len(rest))}


def profile_likelihood(axes: Axes, drawn: Profile) -> None:
    """Rise of the sum of squares over the values of one unknown, the others fitted anew.

    Args:
        axes: to draw on.
        drawn: the profile.
    """
    axes.axvspan(drawn.low, drawn.high, color="#E4E4E4", zorder=0)
    axes.axhline(1.0, color=theme.FAINT, linewidth=0.8, linestyle=(0, (4, 1.5)))
    axes.plot(drawn.values, drawn.rises, "o-", color=theme.BLUE, markersize=3, linewidth=1.0)
    axes.plot(drawn.value, 0.0, "o", color=theme.VERMILION, markersize=5, zorder=4)
    axes.set_ylim(-0.1, 3.0)
    axes.set_xlabel(f"{drawn.name} [{drawn.unit}]" if drawn.unit else drawn.name)
    axes.set_ylabel("rise (1: 95 %)")
    axes.grid(visible=True)


@dataclass(frozen=True)
class Response:
    """Measured and modelled frequency response, where they are coherent; shape (frequencies,) each.

    Attributes:
        frequency: [Hz].
        gain, phase: measured [-] and [degrees].
        half: half-width of the 95 % band, as a share of the gain and in radians of phase.
        model_gain, model_phase: of the model.
    """

    frequency: np.ndarray
    gain: np.ndarray
    phase: np.ndarray
    half: np.ndarray
    model_gain: np.ndarray
    model_phase: np.ndarray


def response(compared: Compared) -> Response | None:
    """The frequency response from stimulus to signal; None where no band is coherent.

    Args:
        compared: a log and its simulation.

    Source: Bendat, Piersol, "Random Data", 4th ed., section 9.2 (random errors of estimates).
    """
    rate = 1.0 / float(np.median(np.diff(compared.time)))
    length = max(64, min(512, len(compared.time) // 10))
    given = {"fs": rate, "nperseg": length}
    frequency, power = _signal.welch(compared.stimulus, **given)
    _, cross = _signal.csd(compared.stimulus, compared.measured, **given)
    _, model = _signal.csd(compared.stimulus, compared.simulated, **given)
    _, coherence = _signal.coherence(compared.stimulus, compared.measured, **given)
    kept = (coherence > 0.3) & (frequency > 0.0)
    # From the first coherent frequency to where the stimulus no longer says anything.
    kept &= np.cumsum(~kept & (frequency > 0.0)) <= _MOST_GAPS
    if np.count_nonzero(kept) < _FEWEST_POINTS:
        return None
    averages = max(2.0 * len(compared.time) / length - 1.0, 1.0)
    spread = np.sqrt((1.0 - coherence) / np.maximum(coherence, 1e-9) / (2.0 * averages))
    floor = np.maximum(power, 1e-300)[kept]
    turned = np.degrees(np.unwrap(np.angle(cross[kept])))
    modelled = np.degrees(np.unwrap(np.angle(model[kept])))
    return Response(
        frequency=frequency[kept],
        gain=np.abs(cross[kept]) / floor,
        phase=turned + 360.0 * np.round((modelled - turned)[0] / 360.0),
        half=(stats.norm.ppf(0.975) * spread)[kept],
        model_gain=np.abs(model[kept]) / floor,
        model_phase=modelled,
    )


def frequency_response(axes: Sequence[Axes], compared: Compared) -> None:
    """Measured response with its 95 % band where the coherence allows, and the model's.

    Args:
        axes: of gain and phase.
        compared: a log and its simulation.
    """
    gain, phase = axes
    for panel, label in ((gain, "gain"), (phase, "phase [°]")):
        panel.set_xscale("log")
        panel.set_ylabel(label)
        panel.grid(visible=True)
    gain.tick_params(labelbottom=False)
    phase.set_xlabel("frequency [Hz]")
    found = response(compared)
    if found is None:
        gain.text(0.5, 0.5, "no coherent band", transform=gain.transAxes, ha="center", va="center")
        return
    at, half = found.frequency, found.half
    dashed = {"color": theme.VERMILION, "linestyle": (0, (4, 1.5)), "linewidth": 1.1, "zorder": 4}
    bands = (
        (gain, found.gain, found.gain * np.maximum(1.0 - half, 1e-3), found.gain * (1.0 + half)),
        (phase, found.phase, found.phase - np.degrees(half), found.phase + np.degrees(half)),
    )
    for (panel, middle, low, high), own in zip(
        bands, (found.model_gain, found.model_phase), strict=True
    ):
        panel.fill_between(at, low, high, color="#D5D5D5", zorder=1)
        panel.plot(at, middle, color=theme.INK, linewidth=1.2, zorder=3)
        panel.plot(at, own, **dashed)
        ticks.label(panel.xaxis)
    gain.set_yscale("log")
    ticks.label(gain.yaxis)


def _busiest(compared: Compared) -> slice:
    """The rows of a log in which most happens, as many as can be seen."""
    rows = len(compared.time)
    if rows <= _MOST_ROWS:
        return slice(0, rows)
    moved = np.cumsum(np.abs(np.diff(compared.measured, prepend=compared.measured[0])))
    gained = moved[_MOST_ROWS - 1 :] - moved[: rows - _MOST_ROWS + 1]
    first = int(np.argmax(gained))
    return slice(first, first + _MOST_ROWS)
