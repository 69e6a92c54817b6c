"""A result of tuning as plain values: its gains, what holds of them, and how they were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.files import plain
from jaxact.parameters import KD, KP, PAYLOAD, base
from jaxact.tuning.result import OfRobot, Tuned

if TYPE_CHECKING:
    from jaxact.tuning.robot.loops import Situation
    from jaxact.tuning.rollouts.validation import Rollouts, Validation

# Metrics that are shown, by the names of `jaxact margins`.
SHOWN = ("sensitivity_peak", "complementary_peak", "gain_margin", "delay_margin", "disk_margin")


def report(
    tuned: Tuned, margins: Mapping[str, Any] | None = None, rollouts: Rollouts | None = None
) -> dict[str, Any]:
    """The result as plain values, for JSON.

    Args:
        margins: of a joint's nominal loop, "before" and "after".
        rollouts: that a robot's gains were held against, None if they were not.
    """
    certificate, robot = tuned.certificate, tuned.robot
    if robot is None:
        own = {KP: tuned.kp, KD: tuned.kd, "units": list(tuned.units[:2])}
        own |= {"margins": margins, "worst": None}
        if len(tuned.members) > 1:
            own["worst"] = {side: rows and rows[""] for side, rows in _sides(tuned).items()}
    else:
        own = _robot_report(tuned, robot, rollouts)
    constraints = [
        {"constraint": c.constraint, "metric": c.metric, "bound": c.bound, "value": c.value,
         "member": c.member, "met": c.met}
        for c in certificate.checks
    ]  # fmt: skip
    return plain({
        **own,
        "objective": tuned.value,
        "objective_name": tuned.goal.objective,
        "objective_before": tuned.value_before,
        "certified": tuned.certified,
        "feasible": tuned.feasible,
        "improved": tuned.improved,
        "verdict": tuned.verdict,
        "interrupted": tuned.interrupted or None,
        "constraints": constraints,
        "binding": list(certificate.binding),
        "members" if robot is None else "loops": certificate.members,
        "corners": certificate.corners,
        "worst_interior_excess": certificate.interior,
        "agreeing_starts": certificate.agreeing,
        "gap_to_brute_force": certificate.gap,
        "notes": list(certificate.notes),
        "iterations": tuned.iterations,
        "evaluations": tuned.evaluations,
        "seconds": tuned.seconds,
    })  # fmt: skip


def _robot_report(tuned: Tuned, robot: OfRobot, rollouts: Rollouts | None) -> dict[str, Any]:
    groups, tracked = robot.case.groups, robot.tracked
    names, kp, kd = np.array(groups.joints), tuned.kp, tuned.kd
    rows = [
        [{"name": n, KP: float(p), KD: float(d)} for n, p, d in zip(*each, strict=True)]
        for each in ((groups.names, kp[groups.first], kd[groups.first]), (names.tolist(), kp, kd))
    ]
    return {
        "situations": [one.name for one in robot.situations],
        "groups": rows[0],
        "joints": rows[1],
        "units": list(tuned.units[:2]),
        "margins": _sides(tuned),
        "assumed": box(robot.situations),
        "rollouts": None if rollouts is None else {
            "duration": rollouts.duration,
            "before": verdicts(rollouts.before) if rollouts.before else None,
            "after": verdicts(rollouts.after),
        },
        "tracking": None if tracked is None else {
            "weight": tracked.weight,
            "derivative": tracked.mode,
            "rms": tracked.rms,
            "rms_by_margins_alone": tracked.aside,
            "rms_before": tracked.before,
        },
    }  # fmt: skip


def verdicts(rollouts: Mapping[str, Validation]) -> dict[str, dict[str, Any]]:
    """How many rollouts of each situation were stable, and the worst one's reason."""
    return {
        name: {
            "stable": int(one.stable.sum()),
            "rollouts": int(one.stable.size),
            "largest_excursion": float(np.nanmax(one.excursion)),
            "worst": one.worst[2],
        }
        for name, one in rollouts.items()
    }


def _sides(tuned: Tuned) -> dict[str, dict[str, dict[str, Any]] | None]:
    """Metrics at their worst, before (None without a start) and after."""
    before = None if tuned.metrics_before is None else worst(tuned, before=True)
    return {"before": before, "after": worst(tuned)}


def worst(tuned: Tuned, *, before: bool = False) -> dict[str, dict[str, Any]]:
    """Metrics at their worst over all members, exact; None where a member is unstable.

    Args:
        before: with the gains of the start.

    Returns:
        Them by the name of the posture, "" of a joint; of a robot with growth rate and number of
        unstable members.
    """
    found: Any = tuned.metrics_before if before else tuned.metrics
    assert found is not None
    rows = {}
    for name, own in _postures(tuned):
        ends = found.worst(own)
        row: dict[str, Any] = {metric: ends[metric] for metric in SHOWN if metric in ends}
        if tuned.robot is not None:
            row["growth_rate"] = float(found.growth_rate[own].max())
            row["unstable_members"] = int((~found.stable[own]).sum())
        rows[name] = row
    return rows


def _postures(tuned: Tuned) -> list[tuple[str, np.ndarray]]:
    """Every posture's name, and which members are its own."""
    if tuned.robot is None:
        return [("", np.ones(len(tuned.members), bool))]
    place = tuned.members.situation  # type: ignore[union-attr]
    return [(one.name, place == i) for i, one in enumerate(tuned.robot.situations)]


def box(situations: Sequence[Situation]) -> dict[str, Any]:
    """What was uncertain: the ends of every parameter by key, over all situations.

    Of a range without a width it is the one value, where situations do not differ in it.

    And, where the body of the robot was, whose setpoint and feedforward are meant.
    """
    from jaxact.tuning.robot.loops import OF_BODY

    found: dict[str, Any] = {}
    for one in situations:
        for key, low, high in zip(one.keys, one.low, one.high, strict=True):
            known = found.get(key, [low, high])
            found[key] = [float(min(low, known[0])), float(max(high, known[1]))]
    for key in situations[0].known:
        values = [one.known[key] for one in situations]
        low, high = min(values), max(values)
        found[key] = low if low == high else [low, high]
    if PAYLOAD in found:
        found["payload_body"] = situations[0].payload_body
    if any(base(key) in OF_BODY for key in found):
        found["setpoint_and_feedforward"] = "of the nominal robot"
    return found
