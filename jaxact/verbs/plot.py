"""`jaxact.plot`: the command line's pictures on the caller's axes.

Every function takes `ax` or `axes`, draws on them in the caller's style, and returns them; without
them it makes a figure with `matplotlib.pyplot`, which a notebook shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable

from jaxact.errors import UserError
from jaxact.loops.control_loop import ControlLoop
from jaxact.plotting import bode as _bode
from jaxact.plotting import even_grid
from jaxact.plotting import field as _field
from jaxact.plotting import nyquist as _nyquist
from jaxact.plotting import panels as _panels
from jaxact.plotting import sensitivity as _sensitivity
from jaxact.plotting import stability_map as _map
from jaxact.plotting import step as _step
from jaxact.plotting import trajectory as _trajectory
from jaxact.plotting.response import LoopResponse
from jaxact.plotting.wording import quantity
from jaxact.plotting.zero_line import zero_line
from jaxact.status import Verdict
from jaxact.sweeping import agreement
from jaxact.verbs import map_lines, responses
from jaxact.verbs.boundary import Window
from jaxact.verbs.boundary import boundary as _boundary
from jaxact.verbs.run_tables import SIGNALS

if TYPE_CHECKING:
    from jaxact.simulation.single import Single

_SMALL = "small"


def bode(
    loop: ControlLoop, *, sampled: bool = False, axes: Sequence[Axes] | None = None,
    legend: bool = True,
) -> Sequence[Axes]:  # fmt: skip
    """Magnitude and phase of the open loop L, with its margins.

    Args:
        loop: of a joint, one or a few.
        sampled: add the loops as their controllers sample them.
        axes: of the magnitude and of the phase.
        legend: name the loops.
    """
    return _curves(loop, sampled, axes, legend, _bode.draw)


def sensitivity(
    loop: ControlLoop, *, sampled: bool = False, axes: Sequence[Axes] | None = None,
    legend: bool = True,
) -> Sequence[Axes]:  # fmt: skip
    """Sensitivity |S| and complementary sensitivity |T|, with their peaks.

    Args:
        loop, sampled, legend: as for `bode`.
        axes: of |S| and of |T|.
    """
    return _curves(loop, sampled, axes, legend, _sensitivity.draw)


def nyquist(
    loop: ControlLoop, *, sampled: bool = False, ax: Axes | None = None, legend: bool = True
) -> Axes:
    """The open loop L in the complex plane near -1, with the disk that it stays out of.

    Args:
        loop, sampled, legend: as for `bode`.
        ax: of the complex plane.
    """
    drawn = _responses(loop, sampled)
    ax = pyplot.subplots()[1] if ax is None else ax
    _nyquist.draw(ax, drawn, [response.label for response in drawn])
    if legend:
        ax.legend(fontsize=_SMALL)
    return ax


def _curves(
    loop: ControlLoop,
    sampled: bool,
    axes: Sequence[Axes] | None,
    legend: bool,
    draw: Callable[..., None],
) -> Sequence[Axes]:
    drawn = _responses(loop, sampled)
    axes = pyplot.subplots(2, 1, sharex=True)[1] if axes is None else axes
    draw(axes, drawn, [response.label for response in drawn])
    if legend:
        axes[0].legend(fontsize=_SMALL)
    return axes


def _responses(loop: ControlLoop, sampled: bool) -> list[LoopResponse]:
    if loop.kind.plant is not None:
        raise UserError("this picture is of a joint's loop; of a robot, see jaxact.margins(...)")
    return responses.responses(loop, sampled=sampled)


def trajectory(
    run: xr.Dataset, *, joint: str | None = None, axes: Sequence[Axes] | None = None
) -> Sequence[Axes]:
    """Position, velocity and force of one simulated loop over time.

    Args:
        run: from `jaxact.simulate`, of one loop.
        joint: of a robot, None for the first.
        axes: of position, velocity and force.
    """
    one = _one_joint(run, joint)
    if axes is None:
        heights = {"height_ratios": _trajectory.HEIGHTS}
        axes = pyplot.subplots(3, 1, sharex=True, gridspec_kw=heights)[1]
    _trajectory.draw(axes, _run(one), units=_units(one))
    return axes


def step(
    run: xr.Dataset, *, joint: str | None = None, axes: Sequence[Axes] | None = None,
    legend: bool = True,
) -> Sequence[Axes]:  # fmt: skip
    """Step responses of one simulated loop or of a batch over each other, with their forces.

    Args:
        run: from `jaxact.simulate`.
        joint: of a robot, None for the first.
        axes: of position and force.
        legend: name the loops.
    """
    one = run if "joint" not in run.dims else _picked(run, joint)
    many = [dim for dim in one.position.dims if dim != "time"]
    flat = one.stack(number=many, create_index=False) if many else one.expand_dims("number")
    rows = [flat.isel(number=number) for number in range(flat.sizes["number"])]
    labels = [_label(row, many) for row in rows]
    drawn = [
        _step.StepResponse(label, _run(row), stable=int(row.verdict) == 0)
        for label, row in zip(labels, rows, strict=True)
    ]
    if axes is None:
        heights = {"height_ratios": _step.HEIGHTS}
        axes = pyplot.subplots(2, 1, sharex=True, gridspec_kw=heights)[1]
    _step.draw(axes, drawn, labels, units=_units(one))
    if legend:
        axes[0].legend(fontsize=_SMALL)
    return axes


def signals(run: Single, joint: int = 0) -> _trajectory.Joint:
    """The signals of one joint of a simulated loop."""
    rows = {name: getattr(run.trajectory, name)[:, joint] for name in SIGNALS}
    return _trajectory.Joint(time=run.trajectory.time, **rows)


def step_response(run: Single, label: str) -> _step.StepResponse:
    """A simulated loop as a step response, its legend with overshoot, rise and settling time.

    Args:
        run: of one loop.
        label: what it is called.
    """
    verdict, results = Verdict(int(run.results["verdict"])), run.results
    words = [] if verdict is Verdict.STABLE else [verdict.label]
    if verdict is not Verdict.UNSTABLE and math.isfinite(results["overshoot"]):
        words.append(f"overshoot {100.0 * results['overshoot']:.3g} %")
    for name in ("rise_time", "settling_time"):
        if math.isfinite(results[name]):
            words.append(f"{name.replace('_', ' ')} {quantity(results[name], 's')}")
    label = f"{label}: {', '.join(words)}" if words else label
    stable = verdict in (Verdict.STABLE, Verdict.LIMIT_CYCLE)
    return _step.StepResponse(label, signals(run), stable)


def _picked(run: xr.Dataset, joint: str | None) -> xr.Dataset:
    names = [str(name) for name in run.joint.values]
    if joint is not None and joint not in names:
        raise UserError(f"joint = {joint!r}: the driven joints are {', '.join(names)}")
    return run.sel(joint=names[0] if joint is None else joint)


def _one_joint(run: xr.Dataset, joint: str | None) -> xr.Dataset:
    one = _picked(run, joint) if "joint" in run.dims else run
    if one.position.dims != ("time",):
        raise UserError("this picture is of one loop; pick one, e.g. run.isel(delay=0)")
    return one


def _run(one: xr.Dataset) -> _trajectory.Joint:
    return _trajectory.Joint(*(np.asarray(one[name].values) for name in ("time", *SIGNALS)))


def _units(one: xr.Dataset) -> tuple[str, str]:
    return one.position.attrs["units"], one.force.attrs["units"]


def _label(row: xr.Dataset, dims: Sequence[Any]) -> str:
    words = []
    for dim in dims:
        value, units = row[dim].values[()], str(row[dim].attrs.get("units", ""))
        words.append(f"{str(dim).replace('_', ' ')} {quantity(value, units)}")
    return ", ".join(words) or "response"


def stability_map(
    maps: xr.Dataset,
    *,
    variable: str | None = None,
    x: str | None = None,
    y: str | None = None,
    select: Mapping[str, float | str] | None = None,
    ax: Axes | None = None,
    axes: Sequence[Axes] | None = None,
    exact: bool = True,
    nominal: bool = True,
    colorbar: bool = True,
    legend: bool = True,
) -> Axes | np.ndarray:
    """A variable of a sweep over two parameters, verdicts hatched, the exact boundary on top.

    Args:
        maps: from `jaxact.sweep` or `jaxact.load_result`.
        variable: coloured; None for the growth rate.
        x, y: parameters across the map; None for kp and kd where they were swept.
        select: parameter -> value, of which the nearest is kept.
        ax: for a single map.
        axes: for as many maps as what is left over has values.
        exact: draw the exact boundary; of robots, where the linearised rate is zero.
        nominal: mark the specification's own parameters.
        colorbar, legend: add them.

    Returns:
        The axes, as they were given; an array of them where there are several maps.

    Raises:
        UserError: parameters that were not swept, or another number of axes than of maps.
    """
    maps = even_grid.resampled(maps) if even_grid.refined(maps) else maps
    picked = {name: str(value) for name, value in (select or {}).items()}
    arrangement = _panels.arrange(maps, kind="map", x=x, y=y, select=picked)
    variable = _field.usual(maps) if variable is None else variable
    shown, count = _field.field(maps, variable), len(arrangement.panels)
    given = [ax] if ax is not None else None if axes is None else list(np.ravel(np.array(axes)))
    if given is None:
        grid = pyplot.subplots(arrangement.rows, arrangement.columns, sharex=True, sharey=True,
                               squeeze=False, layout="constrained")[1]  # fmt: skip
        given = [grid[panel.row, panel.column] for panel in arrangement.panels]
    own = ax is None and axes is None
    if len(given) != count:
        raise UserError(
            f"there are {count} maps, and {len(given)} axes; give as many, or select, e.g. "
            "select={'delay': 0.001}"
        )
    _draw_maps(given, maps, arrangement, shown, exact=exact, marked=nominal)
    for one in given if own else ():
        one.label_outer()
    if colorbar:
        mappable = ScalarMappable(norm=shown.norm, cmap=shown.colors)
        bar = given[0].figure.colorbar(mappable, ax=given, extend=shown.extend)
        _field.dress_colorbar(bar, shown)
    if legend:
        handles = _map.verdict_handles({int(v) for v in np.unique(maps["verdict"])})
        if handles:
            given[0].legend(handles=handles, fontsize=_SMALL)
    return given[0] if count == 1 else np.array(given, dtype=object)


def _draw_maps(
    axes: Sequence[Axes], maps: xr.Dataset, arrangement: _panels.Arrangement,
    shown: _field.Field, *, exact: bool, marked: bool,
) -> None:  # fmt: skip
    plain = agreement.is_plain_mass(maps)
    known = map_lines.boundaries(arrangement) if exact and plain else [None] * len(axes)
    rate = shown.variable if shown.variable in _field.RATES else _field.usual(maps)
    point = map_lines.nominal(maps, arrangement) if marked else None
    for one, panel, boundary_of_it in zip(axes, arrangement.panels, known, strict=True):
        _map.dress_axis(one, "x", arrangement.x)
        _map.dress_axis(one, "y", arrangement.y)
        one.set_xlabel(arrangement.x.label)
        one.set_ylabel(arrangement.y.label)
        words = ", ".join(word for word in (panel.caption, panel.row_caption) if word)
        if words:
            one.set_title(words)
        zero = zero_line(arrangement, panel, rate) if exact and not plain else ()
        _map.draw(one, arrangement, panel, shown, exact=boundary_of_it, zero=zero, nominal=point)


def boundary(
    loop: ControlLoop, *, kp: Window | None = None, kd: Window | None = None,
    sampled: bool = False, ax: Axes | None = None, **line: Any,
) -> Axes:  # fmt: skip
    """The exact stability boundary in the plane of the gains, and the loop's own gains.

    Args:
        loop, kp, kd, sampled: as for `jaxact.boundary`.
        ax: of the plane (kp, kd); its scales are left as they are, logarithmic on a new figure.
        line: of the curves, as for `Axes.plot`.
    """
    curves = _boundary(loop, kp=kp, kd=kd, sampled=sampled)
    if ax is None:
        ax = pyplot.subplots()[1]
        ax.set_xscale("log")
        ax.set_yscale("log")
    for curve in curves:
        if curve.separates:
            ax.plot(curve.kp, curve.kd, **{"color": "black", **line})
    ax.plot(loop.kp, loop.kd, marker="*", color="black", linestyle="none")
    ax.set_xlabel("kp [N/m]")
    ax.set_ylabel("kd [N s/m]")
    return ax
