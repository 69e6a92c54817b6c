"""The pictures of a tuning: gain plane, convergence and step responses of its result."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.plotting.wording import quantity

if TYPE_CHECKING:
    from jaxact.loops.control_loop import ControlLoop
    from jaxact.plotting.convergence import UnmetBound
    from jaxact.plotting.tuning_map import Boundary
    from jaxact.tuning.joint.ensemble import Ensemble
    from jaxact.tuning.result import OfRobot, Tuned

_GRID = 110
_FIELDS = ("mass", "natural_frequency", "damping_ratio", "delay")
# Step responses last this many times the slower one's time constant; that of the start counts up
# to some multiple of the result's.
_CONSTANTS, _SLOWER = 6.0, 5.0


def of_joint(tuned: Tuned, loop: ControlLoop) -> dict[str, Any]:
    """Pictures of one joint's tuning by name.

    loop: the nominal one
    """
    from jaxact.plotting.tuning_map import tuning_map

    after = tuned.kp, tuned.kd
    return {
        "stability_map": tuning_map(
            _plane(tuned),
            tuned.before,
            after,
            max_peak=tuned.goal.max_peak,
            reached=tuned.certified,
            footer=tuned.verdict,
        ),  # fmt: skip
        "convergence": _convergence(tuned, given=tuned.before is not None),
        "step": _steps(tuned, loop),
    }


def of_robot(tuned: Tuned, robot: OfRobot) -> dict[str, Any]:
    """Pictures of a robot's tuning by name."""
    from jaxact.plotting import robot_tuning as pictures
    from jaxact.plotting.robot_gains import gains

    groups, pair = robot.case.groups, (tuned.kp, tuned.kd)
    with np.errstate(over="ignore"):
        ends = np.exp(np.asarray(tuned.paths.gains, float)).reshape(-1, 2, len(groups))
    after, before = (
        None if k is None else tuple(np.exp(groups.log_gains(*k)).reshape(2, -1))
        for k in (pair, tuned.before)
    )
    bands = [] if tuned.before is None else _bands(robot, tuned.before)
    return {
        "sensitivity": pictures.sensitivities(
            bands, _bands(robot, pair), max_peak=tuned.goal.max_peak, footer=tuned.verdict
        ),
        "convergence": _convergence(tuned, given=False),
        "gains": gains(groups.names, before, after, ends, units=tuned.units[:2]),
    }


def _bands(robot: OfRobot, gains: tuple[np.ndarray, np.ndarray]) -> list[Any]:
    """Singular values of every situation's loops with gains of the joints."""
    from jaxact.plotting.robot_tuning import Band
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
        bands.append(Band(one.name, angle / one.period, *rows))
    return bands


def missed(tuned: Tuned) -> UnmetBound | None:
    """What a tuning did not reach, None where it reached everything."""
    from jaxact.plotting.convergence import UnmetBound

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
    from jaxact.tuning.joint.ensemble import chosen

    named = {tuned.members.name(i): i for i in range(len(tuned.members))}
    index = [named[name] for name in tuned.certificate.binding if name in named][:4]
    return chosen(tuned.members, np.array(index or [0]))


def _plane(tuned: Tuned) -> Any:
    from jaxact.plotting.tuning_map import Plane
    from jaxact.tuning.joint import metrics

    members = _binding(tuned)
    pairs = np.array([pair for pair in (tuned.before, (tuned.kp, tuned.kd)) if pair is not None])
    low, high = pairs.min(axis=0) / np.array([8.0, 4.0]), pairs.max(axis=0) * np.array([8.0, 4.0])
    kp, kd = (np.geomspace(a, b, _GRID) for a, b in zip(low, high, strict=True))
    sampling = tuned.members.sampling
    grid = _GRID if sampling.control_period is None else _GRID // 3
    kp, kd = kp[:: _GRID // grid], kd[:: _GRID // grid]
    log_kp, log_kd = np.meshgrid(np.log(kp), np.log(kd))
    shaped = {name: getattr(members, name)[:, None, None] for name in _FIELDS}
    found = metrics.evaluate(log_kp[None], log_kd[None], shaped, sampling)
    peak = np.maximum(found.log["sensitivity_peak"], found.log["complementary_peak"])
    worst = np.where(found.stable, peak, np.inf).max(axis=0)
    ranges = {"kp_range": (low[0], high[0]), "kd_range": (low[1], high[1])}
    boundaries = [_boundary(members, index, ranges) for index in range(len(members))]
    return Plane(kp, kd, np.where(np.isfinite(worst), np.exp(worst), np.nan), boundaries)


def _boundary(members: Ensemble, index: int, ranges: dict[str, Any]) -> Boundary:
    """Where a member changes stability: sampled as it is controlled, or in continuous time."""
    from jaxact.analysis.boundary.boundary import continuous_boundary, sampled_boundary
    from jaxact.plotting.tuning_map import Boundary

    plant = [float(getattr(members, name)[index]) for name in _FIELDS]
    name = members.name(index) if len(members) > 1 else ""
    period, cutoff = members.sampling.control_period, members.sampling.velocity_filter
    if period is None:
        curves = continuous_boundary(*plant, velocity_filter=cutoff, **ranges)
        return Boundary(name or "continuous time", curves)
    curves = sampled_boundary(
        *plant, period, velocity=members.sampling.velocity, velocity_filter=cutoff, **ranges
    )
    return Boundary(name or f"sampled at {quantity(1.0 / period, 'Hz')}", curves)


def _convergence(tuned: Tuned, *, given: bool) -> Any:
    from jaxact.plotting.convergence import convergence

    goal, paths = tuned.goal, tuned.paths
    unit = tuned.units[2]
    label = goal.objective if unit == "1" else f"{goal.objective} [{unit}]"
    with np.errstate(over="ignore"):
        values = np.exp(goal.sense * paths.path_value)
        ratio = np.exp(paths.path_violation)
    return convergence(
        values, ratio, label=label, given=given,
        stable=np.isfinite(paths.violation), missed=missed(tuned),
    )  # fmt: skip


def _steps(tuned: Tuned, loop: ControlLoop) -> Any:
    from jaxact.plotting.step_band import Responses, step_band
    from jaxact.tuning.joint.ensemble import joined
    from jaxact.tuning.joint.response import step_responses

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
    return step_band(time, before, after)


def _nominal(loop: ControlLoop, tuned: Tuned) -> Ensemble:
    """The plant that was named, as an ensemble of one."""
    from jaxact.loops import conversion
    from jaxact.tuning.joint.ensemble import ensemble

    own = conversion.one(loop)
    delay = conversion.total_delay(own)
    return ensemble(own["mass"], own["wn"], own["zeta"], delay, sampling=tuned.members.sampling)
