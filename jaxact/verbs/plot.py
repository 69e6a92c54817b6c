"""`jaxact.plot`: the command line's pictures on the caller's axes.

Every function takes `ax` or `axes`, draws on them in the caller's style, and returns them; without
them it makes a figure with `matplotlib.pyplot`, which a notebook shows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import pyplot
from matplotlib.axes import Axes

from jaxact.errors import UserError
from jaxact.loops.control_loop import ControlLoop, demand
from jaxact.parameters import KD, KP, of
from jaxact.plotting import bode as _bode
from jaxact.plotting import nyquist as _nyquist
from jaxact.plotting import robot as _robot
from jaxact.plotting import sensitivity as _sensitivity
from jaxact.plotting import step as _step
from jaxact.plotting import trajectory as _trajectory
from jaxact.plotting.response import LoopResponse
from jaxact.plotting.wording import quantity
from jaxact.verbs import responses
from jaxact.verbs.boundary import Window
from jaxact.verbs.boundary import boundary as _boundary
from jaxact.verbs.given_axes import on_axes, stacked
from jaxact.verbs.identify import profile_likelihood, residual_autocorrelation
from jaxact.verbs.map_pictures import lines, scatter, stability_map
from jaxact.verbs.margins_of_robot import RobotLoopMargins
from jaxact.verbs.run_tables import SIGNALS
from jaxact.verbs.tuning_pictures import (
    convergence,
    front,
    robot_gains,
    step_band,
    tuned_sensitivity,
    tuning_map,
)

__all__ = [
    "bode", "boundary", "convergence", "front", "lines", "nyquist",
    "profile_likelihood", "residual_autocorrelation", "robot_gains", "robot_margins", "scatter",
    "sensitivity", "stability_map", "step", "step_band", "trajectory",
    "tuned_sensitivity", "tuning_map",
]  # fmt: skip
_SMALL = "small"


def __dir__() -> list[str]:
    """The pictures alone, for completion."""
    return __all__


@on_axes
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


@on_axes
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


@on_axes
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
    axes = pyplot.subplots(2, 1, sharex=True)[1] if axes is None else _several(axes, 2)
    draw(axes, drawn, [response.label for response in drawn])
    if legend:
        axes[0].legend(fontsize=_SMALL)
    return axes


def _several(axes: Any, number: int) -> Sequence[Axes]:
    """The axes that were given, where they are so many."""
    if np.shape(np.array(axes, dtype=object)) != (number,):
        raise UserError(f"axes: this picture has {number} of them; give a list of as many")
    given: Sequence[Axes] = axes
    return given


def _responses(loop: ControlLoop, sampled: bool) -> list[LoopResponse]:
    demand(loop)
    if loop.kind.plant is not None:
        raise UserError(
            "this picture is of a joint's loop; of a robot, see jaxact.plot.robot_margins(...)"
        )
    return responses.responses(loop, sampled=sampled)


@on_axes
def robot_margins(found: RobotLoopMargins, *, axes: Sequence[Axes] | None = None) -> Sequence[Axes]:
    """Largest singular values of S and T of a robot, |S_ii| and |T_ii| of its joints, and motions.

    The bars are the joints' shares in the kinetic energy of the least damped (or fastest growing)
    mode, of what shakes first with more delay, and of the response at the peak of S.

    Args:
        found: from `jaxact.margins`, of a single loop.
        axes: of S, of T and of the shares.
    """
    if not isinstance(found, RobotLoopMargins):
        raise UserError(
            f"found: a value of type {type(found).__name__} has no margins of a robot; give those"
            " of jaxact.margins(jaxact.robot(...))"
        )
    if len(found.details) > 1:
        raise UserError("this picture is of one loop; index the loop first, e.g. loop[0]")
    if axes is None:
        figure = pyplot.figure(figsize=(9.4, 5.6))
        drawn = figure.subplot_mosaic("SB;TB", width_ratios=(2.1, 1.0))
        axes = drawn["S"], drawn["T"], drawn["B"]
    _robot.draw(axes, found.details[0].curves, found.details[0].margins)
    axes[0].legend(fontsize=_SMALL)
    return axes


@on_axes
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
    axes = stacked(_trajectory.HEIGHTS) if axes is None else _several(axes, 3)
    _trajectory.draw(axes, _run(one), units=_units(one))
    return axes


@on_axes
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
    _demand_run(run)
    one = _picked(run, joint)
    many = [dim for dim in one.position.dims if dim != "time"]
    flat = one.stack(number=many, create_index=False) if many else one.expand_dims("number")
    rows = [flat.isel(number=number) for number in range(flat.sizes["number"])]
    labels = [_label(row, many) for row in rows]
    drawn = [
        _step.StepResponse(label, _run(row), stable=int(row.verdict) == 0)
        for label, row in zip(labels, rows, strict=True)
    ]
    axes = stacked(_step.HEIGHTS) if axes is None else _several(axes, 2)
    _step.draw(axes, drawn, labels, units=_units(one))
    if legend:
        axes[0].legend(fontsize=_SMALL)
    return axes


def _demand_run(run: Any) -> None:
    """Raise UserError for what has no trajectories."""
    if not isinstance(run, xr.Dataset) or "position" not in run or "time" not in run.dims:
        raise UserError(
            f"run: a value of type {type(run).__name__} without trajectories; give the dataset of "
            "jaxact.simulate(...)"
        )


def _picked(run: xr.Dataset, joint: str | None) -> xr.Dataset:
    if "joint" not in run.dims:
        if joint is not None:
            raise UserError(f"joint = {joint!r}: the run is of a single joint; leave it out")
        return run
    names = [str(name) for name in run.joint.values]
    if joint is not None and joint not in names:
        raise UserError(f"joint = {joint!r}: the driven joints are {', '.join(names)}")
    return run.sel(joint=names[0] if joint is None else joint)


def _one_joint(run: xr.Dataset, joint: str | None) -> xr.Dataset:
    _demand_run(run)
    one = _picked(run, joint)
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


@on_axes
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
    unit = loop.kind.unit
    ax.set_xlabel(f"kp [{of(KP, unit).unit}]")
    ax.set_ylabel(f"kd [{of(KD, unit).unit}]")
    return ax
