"""Pictures of a tuning: the plane of the gains, convergence, responses, what robustness costs.

Each on given axes, and as a page of the folder that the command line writes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import pyplot
from matplotlib.artist import Artist
from matplotlib.axes import Axes

from jaxact.analysis.boundary.boundary import continuous_boundary, sampled_boundary
from jaxact.errors import UserError
from jaxact.loops import conversion
from jaxact.parameters import DELAY, MASS, OF_JOINT, WN, ZETA
from jaxact.plotting import convergence as _convergence
from jaxact.plotting import robot_gains as _gains
from jaxact.plotting import robot_tuning as _bands
from jaxact.plotting import sensitivity as _sensitivity
from jaxact.plotting import step_band as _band
from jaxact.plotting import tuning as _front
from jaxact.plotting import tuning_map as _map
from jaxact.plotting.convergence import UnmetBound
from jaxact.plotting.step_band import Responses
from jaxact.plotting.tuning_map import Boundary, Plane
from jaxact.plotting.wording import quantity
from jaxact.tuning.joint import metrics
from jaxact.tuning.joint.ensemble import chosen, ensemble, joined
from jaxact.tuning.joint.response import step_responses
from jaxact.tuning.result import Tuned
from jaxact.verbs import responses as _responses
from jaxact.verbs.given_axes import on_axes, stacked
from jaxact.verbs.tuning_front import Front
from jaxact.verbs.tuning_front import front as _points
from jaxact.verbs.tuning_tables import with_gains

if TYPE_CHECKING:
    from jaxact.loops.control_loop import ControlLoop
    from jaxact.plotting.response import LoopResponse
    from jaxact.tuning.joint.ensemble import Ensemble
    from jaxact.tuning.result import OfRobot

_GRID = 110
_FIELDS = (MASS, "natural_frequency", "damping_ratio", DELAY)
# Step responses last this many times the slower one's time constant; that of the start counts up
# to some multiple of the result's.
_CONSTANTS, _SLOWER = 6.0, 5.0
_SMALL = "small"


@on_axes
def tuning_map(
    best: Tuned, *, ax: Axes | None = None, colorbar: bool = True, legend: bool = True
) -> Axes:
    """The plane of a joint's gains: worst peaks, the bound, exact boundaries, and both pairs.

    Args:
        best: from `jaxact.tune`, of a joint.
        ax: of the plane (kp, kd), made logarithmic.
        colorbar, legend: add them.
    """
    _demand(best, robot=False)
    ax = pyplot.subplots()[1] if ax is None else ax
    handles = _map.draw(ax, *_plane_of(best), colorbar=colorbar, **_bounds(best))
    return _with_legend(ax, handles, legend)


@on_axes
def convergence(
    best: Tuned, *, axes: Sequence[Axes] | None = None, legend: bool = True
) -> Sequence[Axes]:
    """The objective of every start along the descent, and by how much its bounds are missed.

    Args:
        best: from `jaxact.tune`.
        axes: of the objective and of the bounds.
        legend: name the curves.
    """
    _demand(best)
    axes = stacked(_convergence.HEIGHTS) if axes is None else axes
    _with_legend(axes[0], _convergence.draw(axes, *_paths(best)[0], **_paths(best)[1]), legend)
    return axes


@on_axes
def step_band(best: Tuned, *, ax: Axes | None = None, legend: bool = True) -> Axes:
    """Step responses of a joint before and after: the range of all members as a band.

    In it, solid the nominal plant, and dashed the member that overshoots most.

    Args:
        best: from `jaxact.tune`, of a joint.
        ax: of position over time.
        legend: name the curves.
    """
    _demand(best, robot=False)
    assert best.loop is not None
    ax = pyplot.subplots()[1] if ax is None else ax
    return _with_legend(ax, _band.draw(ax, *_steps(best, best.loop)), legend)


@on_axes
def front(
    best: Tuned, *, axes: Sequence[Axes] | None = None, legend: bool = True
) -> Sequence[Axes]:
    """What robustness costs: the objective against the largest peak allowed, and kd below.

    Args:
        best: from `jaxact.tune`, with a front.
        axes: of the objective and of kd.
        legend: name the curves.

    Raises:
        UserError: no front was asked for.
    """
    _demand(best)
    if not best.front:
        raise UserError("there is no front; ask for one, e.g. jaxact.tune(loop, front=10)")
    axes = stacked(_front.HEIGHTS) if axes is None else axes
    found, marked = _points(best.front), best.goal.max_peak
    drawn, words = drawn_front(found, marked)
    _with_legend(axes[0], _front.draw_front(axes, *drawn, **words), legend)
    return axes


@on_axes
def robot_gains(
    best: Tuned, *, axes: Sequence[Axes] | None = None, legend: bool = True
) -> Sequence[Axes]:
    """kp and kd of every group of a robot's joints before and after, and where starts ended.

    Args:
        best: from `jaxact.tune`, of a robot.
        axes: of kp and of kd.
        legend: name the marks.
    """
    robot = _demand(best, robot=True)
    assert robot is not None
    axes = pyplot.subplots(2, 1, sharex=True)[1] if axes is None else axes
    drawn = _of_groups(best, robot)
    _with_legend(axes[0], _gains.draw(axes, *drawn, units=best.units[:2]), legend)
    return axes


@on_axes
def tuned_sensitivity(best: Tuned, *, axes: Any = None, legend: bool = True) -> Any:
    """Sensitivities before and after.

    Args:
        best: from `jaxact.tune`.
        axes: of |S| and of |T|; of a robot of the largest singular values, shape (2, postures).
        legend: name the curves.
    """
    _demand(best)
    if best.robot is None:
        assert best.loop is not None
        axes = pyplot.subplots(2, 1, sharex=True)[1] if axes is None else axes
        drawn = before_and_after(best, best.loop)
        _sensitivity.draw(axes, drawn, [response.label for response in drawn])
        if legend:
            axes[0].legend(fontsize=_SMALL)
        return axes
    number = len(best.robot.situations)
    if axes is None:
        axes = pyplot.subplots(2, number, sharex="col", sharey=True, squeeze=False)[1]
    grid = np.reshape(np.array(axes, dtype=object), (2, number))
    handles = _bands.draw(grid, *_sides(best, best.robot), max_peak=best.goal.max_peak)
    _with_legend(grid[0, 0], handles, legend)
    return axes


def of_joint(tuned: Tuned, loop: ControlLoop) -> dict[str, Any]:
    """Pages of one joint's tuning by name.

    Args:
        tuned: the result.
        loop: the nominal one.
    """
    values, options = _paths(tuned)
    return {
        "stability_map": _map.tuning_map(*_plane_of(tuned), **_bounds(tuned), footer=tuned.verdict),
        "convergence": _convergence.convergence(*values, **options),
        "step": _band.step_band(*_steps(tuned, loop)),
        "sensitivity": _sensitivity.sensitivity(
            before_and_after(tuned, loop), footer=tuned.verdict
        ),
    }


def of_robot(tuned: Tuned, robot: OfRobot) -> dict[str, Any]:
    """Pages of a robot's tuning by name."""
    values, options = _paths(tuned)
    return {
        "sensitivity": _bands.sensitivities(
            *_sides(tuned, robot), max_peak=tuned.goal.max_peak, footer=tuned.verdict
        ),
        "convergence": _convergence.convergence(*values, **options),
        "gains": _gains.gains(*_of_groups(tuned, robot), units=tuned.units[:2]),
    }


def _with_legend(ax: Axes, handles: list[Artist], legend: bool) -> Axes:
    if legend and handles:
        ax.legend(handles=handles, fontsize=_SMALL)
    return ax


def _demand(best: Any, *, robot: bool | None = None) -> OfRobot | None:
    if not isinstance(best, Tuned):
        kind = type(best).__name__
        raise UserError(f"best: a value of type {kind} has no tuned gains; give jaxact.tune(...)'s")
    if robot is not None and (best.robot is not None) != robot:
        raise UserError(f"this picture is of {'a robot' if robot else 'a joint'}'s tuned gains")
    return best.robot


def before_and_after(tuned: Tuned, loop: ControlLoop) -> list[LoopResponse]:
    """Frequency responses of a joint with both pairs of gains; blue, as everywhere, is after."""
    drawn = _responses.responses(with_gains(tuned, loop), sampled=not tuned.continuous)
    return sorted(drawn, key=lambda response: -(response.loop or 0))


def drawn_front(found: Front, marked: float) -> tuple[tuple[np.ndarray, ...], dict[str, Any]]:
    """What `jaxact.plotting.tuning.draw_front` takes of a front; marked: the peak asked for."""
    values = np.where(found.certified, found.values, np.nan)
    known = np.isfinite(values)
    inside = known.sum() > 1 and found.peaks[known][0] <= marked <= found.peaks[known][-1]
    at = float(np.interp(marked, found.peaks[known], values[known])) if inside else None
    return (found.peaks, values, np.where(known[:, None], found.kd, np.nan)), {
        "label": f"{found.objective} [{found.units[2]}]",
        "kd_unit": found.units[1],
        "groups": found.groups,
        "marked": None if at is None else (marked, at),
    }


def _of_groups(tuned: Tuned, robot: OfRobot) -> tuple[Any, ...]:
    """Names of the groups, their gains before and after, and where the starts ended."""
    groups = robot.case.groups
    with np.errstate(over="ignore"):
        ends = np.exp(np.asarray(tuned.paths.gains, float)).reshape(-1, 2, len(groups))
    before, after = (
        None if k is None else tuple(np.exp(groups.log_gains(*k)).reshape(2, -1))
        for k in (tuned.before, (tuned.kp, tuned.kd))
    )
    return groups.names, before, after, ends


def _sides(tuned: Tuned, robot: OfRobot) -> tuple[list[Any], list[Any]]:
    """Bands of the sensitivities before, [] without a start, and after."""
    before = [] if tuned.before is None else _singular_values(robot, tuned.before)
    return before, _singular_values(robot, (tuned.kp, tuned.kd))


def _singular_values(robot: OfRobot, gains: tuple[np.ndarray, np.ndarray]) -> list[Any]:
    """Singular values of every situation's loops with gains of the joints."""
    from jaxact.tuning.robot.peaks import sensitivity

    bands, table = [], robot.case.table
    for place, one in enumerate(robot.situations):
        own = table.take(np.flatnonzero(table.loops.situation == place))
        S = sensitivity(own.response, *gains)
        T = np.eye(S.shape[-1]) - S
        # Loops have frequencies of their own: on those of the first.
        angle = own.angle[0]
        size = [np.linalg.svd(X, compute_uv=False)[..., 0] for X in (S, T)]
        rows = [
            np.stack([np.interp(angle, a, v) for a, v in zip(own.angle, values, strict=True)])
            for values in size
        ]
        bands.append(_bands.Band(one.name, angle / one.period, *rows))
    return bands


def missed(tuned: Tuned) -> UnmetBound | None:
    """What a tuning did not reach, None where it reached everything."""
    if tuned.feasible:
        return None
    checks = [check for check in tuned.closest if not check.met]
    if not tuned.certificate.stable:
        return UnmetBound("not reached: no gains found that make every member stable", math.inf)
    if not checks:
        return UnmetBound(
            "not reached: no gains found that meet the constraints together", math.inf
        )
    worst = max(checks, key=lambda check: check.excess)
    sign = "≤" if worst.constraint.startswith("max") else "≥"
    metric = worst.metric.replace("_", " ")
    words = f"not reached: {metric} {worst.value:.4g} at best, asked for {sign} {worst.bound:g}"
    return UnmetBound(words, math.exp(worst.excess))


def _binding(tuned: Tuned) -> Ensemble:
    """A few members that say where the bounds are: those that bind, else the first."""
    named = {tuned.members.name(i): i for i in range(len(tuned.members))}
    index = [named[name] for name in tuned.certificate.binding if name in named][:4]
    return chosen(tuned.members, np.array(index or [0]))


def _plane(tuned: Tuned) -> Any:
    members = _binding(tuned)
    pairs = np.array([pair for pair in (tuned.before, (tuned.kp, tuned.kd)) if pair is not None])
    low, high = pairs.min(axis=0) / np.array([8.0, 4.0]), pairs.max(axis=0) * np.array([8.0, 4.0])
    kp, kd = (np.geomspace(a, b, _GRID) for a, b in zip(low, high, strict=True))
    sampling = tuned.members.sampling
    grid = _GRID if sampling.control_period is None else _GRID // 3
    kp, kd = kp[:: _GRID // grid], kd[:: _GRID // grid]
    log_kp, log_kd = np.meshgrid(np.log(kp), np.log(kd))
    shaped = {name: getattr(members, name)[:, None, None] for name in (*_FIELDS, *OF_JOINT)}
    found = metrics.evaluate(log_kp[None], log_kd[None], shaped, sampling)
    peak = np.maximum(found.log["sensitivity_peak"], found.log["complementary_peak"])
    worst = np.where(found.stable, peak, np.inf).max(axis=0)
    ranges = {"kp_range": (low[0], high[0]), "kd_range": (low[1], high[1])}
    boundaries = [_boundary(members, index, ranges) for index in range(len(members))]
    peaks = np.where(np.isfinite(worst), np.exp(worst), np.nan)
    return Plane(kp, kd, peaks, boundaries, tuned.units[:2])


def _boundary(members: Ensemble, index: int, ranges: dict[str, Any]) -> Boundary:
    """Where a member changes stability: sampled as it is controlled, or in continuous time."""
    plant = [float(getattr(members, name)[index]) for name in _FIELDS]
    ranges = ranges | {name: float(getattr(members, name)[index]) for name in OF_JOINT}
    name = members.name(index) if len(members) > 1 else ""
    period, cutoff = members.sampling.control_period, members.sampling.velocity_filter
    if period is None:
        curves = continuous_boundary(*plant, velocity_filter=cutoff, **ranges)
        return Boundary(name or "continuous time", curves)
    curves = sampled_boundary(
        *plant, period, velocity=members.sampling.velocity, velocity_filter=cutoff, **ranges
    )
    return Boundary(name or f"sampled at {quantity(1.0 / period, 'Hz')}", curves)


def _paths(tuned: Tuned) -> tuple[tuple[np.ndarray, np.ndarray], dict[str, Any]]:
    """What `jaxact.plotting.convergence.draw` takes."""
    goal, paths, unit = tuned.goal, tuned.paths, tuned.units[2]
    with np.errstate(over="ignore"):
        values = np.exp(goal.sense * paths.path_value)
        ratio = np.exp(paths.path_violation)
    return (values, ratio), {
        "label": goal.objective if unit == "1" else f"{goal.objective} [{unit}]",
        "given": tuned.robot is None and tuned.before is not None,
        "stable": np.isfinite(paths.violation),
        "missed": missed(tuned),
    }


def _plane_of(tuned: Tuned) -> tuple[Plane, Any, tuple[float, float]]:
    return _plane(tuned), tuned.before, (tuned.kp, tuned.kd)


def _bounds(tuned: Tuned) -> dict[str, Any]:
    return {"max_peak": tuned.goal.max_peak, "reached": tuned.certified}


def _steps(tuned: Tuned, loop: ControlLoop) -> tuple[np.ndarray, Responses | None, Responses]:
    """Times [s], and the step responses before (None without a start) and after."""
    members = tuned.members
    several = len(members) > 1
    simulated = joined(members, _nominal(loop, tuned)) if several else members
    heaviest = float(members.mass.max())
    slow = [
        max(kd / kp, math.sqrt(heaviest / kp))
        for kp, kd in (tuned.before or (tuned.kp, tuned.kd), (tuned.kp, tuned.kd))
    ]
    duration = _CONSTANTS * min(max(slow), _SLOWER * slow[-1])
    names = [members.name(index) for index in range(len(members))]

    def responses(gains: tuple[float, float]) -> tuple[np.ndarray, Responses]:
        time, rows = step_responses(simulated, *gains, duration)
        return time, Responses(rows[:-1], names, rows[-1]) if several else Responses(rows)

    time, after = responses((tuned.kp, tuned.kd))
    before = None if tuned.before is None else responses(tuned.before)[1]
    return time, before, after


def _nominal(loop: ControlLoop, tuned: Tuned) -> Ensemble:
    """The plant that was named, as an ensemble of one."""
    own = conversion.one(loop)
    delay = conversion.total_delay(own)
    joint = (own[name] for name in OF_JOINT)
    sampling = tuned.members.sampling
    return ensemble(own[MASS], own[WN], own[ZETA], delay, *joint, sampling=sampling)
