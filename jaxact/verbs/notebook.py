"""How results look in a notebook: the command line's table, and the picture below it.

Nothing of matplotlib is imported before a result is shown.
"""

from __future__ import annotations

import base64
import contextlib
import html
import io
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from jaxact import reportable
from jaxact.errors import UserError

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

# More loops than this cannot be told apart in one picture.
_MOST_LOOPS = 8
_DPI = 90


def _report(result: Any, out: Any, **options: Any) -> reportable.Report:
    from jaxact.verbs.report import report  # of results too, which it imports

    return report(result, out, **options)


# How results look is not their own layer's to know.
reportable.written_by(_report)


def shown(text: str, picture: Callable[[], Figure] | None = None, *, words: str = "") -> str:
    """A table and a picture as HTML.

    Args:
        text: the table.
        picture: makes the figure; what it refuses is not shown.
        words: what the picture shows, for those who cannot see it.
    """
    found = f'<pre style="overflow-x: auto">{html.escape(text)}</pre>'
    if picture is None:
        return found
    from jaxact.plotting import theme

    with contextlib.suppress(UserError), theme.applied():
        image = io.BytesIO()
        picture().savefig(image, format="png", dpi=_DPI, facecolor="white")
        data = base64.b64encode(image.getvalue()).decode()
        # No wider than what it stands in, on a narrow screen.
        style = "max-width: 100%; height: auto; background: white"
        found += (
            f'<img alt="{html.escape(words)}" style="{style}" src="data:image/png;base64,{data}">'
        )
    return found


def _figure(width: float, height: float) -> Figure:
    """A figure of its own, which no window or cell shows by itself."""
    from matplotlib.figure import Figure

    return Figure((width, height), layout="constrained")


def margins(found: Any, *, sampled: bool) -> str:
    """Margins of a joint's loops: the table, Nyquist plot and sensitivities.

    Args:
        found: by `jaxact.margins`.
        sampled: draw the loops as their controllers sample them as well.
    """
    from jaxact.verbs import plot

    def picture() -> Figure:
        figure = _figure(9.0, 4.0)
        axes = figure.subplot_mosaic([["nyquist", "S"], ["nyquist", "T"]])
        plot.nyquist(found.loop, sampled=sampled, ax=axes["nyquist"])
        plot.sensitivity(found.loop, sampled=sampled, axes=[axes["S"], axes["T"]], legend=False)
        return figure

    few = math.prod(found.loop.shape) <= _MOST_LOOPS
    return shown(repr(found), picture if few else None, words="Nyquist plot and sensitivities")


def robot_margins(found: Any) -> str:
    """Margins of a robot: the tables, and of a single loop the singular values."""
    from jaxact.verbs import plot

    def picture() -> Figure:
        # Every joint has a row of its own beside the two curves.
        figure = _figure(9.0, max(4.5, 1.0 + 0.2 * len(found.joints)))
        places = [["S", "shares"], ["T", "shares"]]
        axes = figure.subplot_mosaic(places, width_ratios=(2.0, 1.0))
        plot.robot_margins(found, axes=[axes[name] for name in ("S", "T", "shares")])
        return figure

    return shown(repr(found), picture, words="Largest singular values of S and T, and shares")


def tuned(best: Any) -> str:
    """Tuned gains: the verdict, and sensitivities or the gains of groups before and after."""
    from jaxact.verbs import tuning_pictures

    def picture() -> Figure:
        figure = _figure(9.0, 4.5)
        if best.robot is not None:
            tuning_pictures.robot_gains(best, axes=figure.subplots(2, 1, sharex=True))
            return figure
        columns = figure.subplots(2, 2 if best.front else 1, squeeze=False)
        tuning_pictures.tuned_sensitivity(best, axes=columns[:, 0])
        if best.front:
            tuning_pictures.front(best, axes=columns[:, 1], legend=False)
        return figure

    what = "gains of the groups" if best.robot is not None else "sensitivities"
    return shown(repr(best), picture, words=f"{what} before and after")


def identified(found: Any) -> str:
    """An identified drive: its report, an unseen log over its simulation, and the ladder."""
    from jaxact.plotting import identification as pictures
    from jaxact.verbs import identify

    def picture() -> Figure:
        figure = _figure(9.0, 5.0)
        axes = figure.subplot_mosaic(
            [["over", "over"], ["rest", "ladder"]], height_ratios=(1.4, 1.0)
        )
        log = identify.compared(found)
        axes["over"].legend(handles=pictures.over(axes["over"], log))
        pictures.residual(axes["rest"], log)
        pictures.ladder(axes["ladder"], identify.steps(found), log.unit)
        return figure

    return shown(str(found), picture, words="measured and simulated, residual and ladder")


def identified_robot(found: Any) -> str:
    """The drives of a robot: their report, and every joint measured and simulated."""
    from jaxact.verbs.identify import robot_sheet

    return shown(str(found), lambda: robot_sheet(found), words="measured and simulated by joint")


def simulated(run: xr.Dataset) -> Figure:
    """A simulated loop over time, or the loops of a batch; of a robot the joint that errs most."""
    from jaxact.verbs import plot

    joint = None
    if "joint" in run.dims:
        off = abs(run.position - run.setpoint).max([d for d in run.position.dims if d != "joint"])
        joint = str(run.joint.values[int(off.fillna(0.0).values.argmax())])
    figure = _figure(9.0, 5.0)
    if run.verdict.ndim:
        axes = figure.subplots(2, 1, sharex=True)
        plot.step(run, joint=joint, axes=axes, legend=run.verdict.size <= _MOST_LOOPS)
    else:
        axes = figure.subplots(3, 1, sharex=True)
        plot.trajectory(run, joint=joint, axes=axes)
    if joint is not None:
        axes[0].set_title(joint)
    return figure
