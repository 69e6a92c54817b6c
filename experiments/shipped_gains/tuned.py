"""Gains tuned for the same robots on the same stand: Ms <= 2 with a delay in the loop."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import models
import numpy as np
from models import Robot

from jaxact.analysis.robot.modes import ranked
from jaxact.robot_margins import whole_robot
from jaxact.tuning.goal import Goal
from jaxact.tuning.groups import Groups
from jaxact.tuning.result import Tuned
from jaxact.tuning.robot import search as _robot
from jaxact.tuning.robot.loops import Situation, situation

DELAY = 5e-3  # in the loop that is tuned [s]
MAX_PEAK = 2.0  # Ms and Mt [-]
FEW = 4  # starts of a search over many kinds of joints, which takes minutes otherwise
# What tells a joint's name from that of its twin on another leg or arm.
_SIDE = re.compile(r"^(left|right|[lr]|[lfhr][lr])_", re.IGNORECASE)


def tuned(robot: Robot, model: Path, rate: float) -> dict[str, Any]:
    """The stiffest gains within the bound, and what they are beside the published ones.

    As many groups of joints share their gains as the publisher has patterns; where no gains within
    the bound are found for these, all joints of a kind (left and right, front and hind) do.

    Args:
        robot: row of the table of facts.
        model: its file.
        rate: of control [Hz].
    """
    one = situation(_loop(robot, model, rate, delay=DELAY), robot.label)
    found, shared = _searched(one, published(robot, one)), "pattern"
    if not found.certified:
        other = _searched(one, kinds(one), FEW)
        if other.certified or _peak(other) < _peak(found):
            found, shared = other, "kind"
    before = found.before
    assert before is not None
    factors = found.kp / before[0]
    own = {joint: (float(found.kp[i]), float(found.kd[i]))
           for i, (joint, _) in enumerate(one.names)}  # fmt: skip
    return {
        "designed_for_delay": DELAY, "max_peak": MAX_PEAK, "certified": found.certified,
        "peak": models.plain(_peak(found)), "shared_by": shared,
        "stiffness": float(np.exp(np.mean(np.log(factors)))),
        "least": float(np.min(factors)), "most": float(np.max(factors)),
        "gains": _by_group(found),
        **_borne(replace(robot, kp=_patterns(own, 0), kd=_patterns(own, 1)), model, rate),
    }  # fmt: skip


def published(robot: Robot, one: Situation) -> Groups:
    """A group for every published pattern; of a model's own gains, for every pair of them."""
    joints = tuple(joint for joint, _ in one.names)
    if robot.kp:
        matching = [next((p for p in robot.kp if any(re.fullmatch(p, name) for name in pair)), "")
                    for pair in one.names]  # fmt: skip
        return _grouped(joints, matching)
    assert one.kp is not None and one.kd is not None
    return _grouped(joints, [f"{kp:g}, {kd:g}" for kp, kd in zip(one.kp, one.kd, strict=True)])


def kinds(one: Situation) -> Groups:
    """A group for every kind of joint: left and right, front and hind share their gains."""
    joints = tuple(joint for joint, _ in one.names)
    return _grouped(joints, [_SIDE.sub("", joint) for joint in joints])


def _grouped(joints: tuple[str, ...], labels: list[str]) -> Groups:
    names = tuple(dict.fromkeys(labels))
    return Groups(names, np.array([names.index(label) for label in labels]), joints)


def _loop(robot: Robot, model: Path, rate: float, **parameters: Any) -> Any:
    return models.specification(
        robot, model, base="fixed", actuator="ideal", control_rate=rate, **parameters
    )


def _searched(one: Situation, groups: Groups, starts: int = _robot.STARTS) -> Tuned:
    assert one.kp is not None and one.kd is not None
    goal = Goal(max_peak=MAX_PEAK)
    return _robot.tune([one], goal, groups, start=(one.kp, one.kd), starts=starts)


def _peak(found: Tuned) -> float:
    """The larger of Ms and Mt of the gains found, inf where they are unstable [-]."""
    if not found.certificate.stable:
        return float("inf")
    checks = found.certificate.checks if found.certified else found.closest
    return float(max(check.value for check in checks))


def _by_group(found: Tuned) -> dict[str, tuple[float, float]]:
    """kp and kd of each group."""
    assert found.robot is not None
    groups = found.robot.case.groups
    return {name: (float(found.kp[first]), float(found.kd[first]))
            for name, first in zip(groups.names, groups.first, strict=True)}  # fmt: skip


def _patterns(own: dict[str, tuple[float, float]], which: int) -> dict[str, float]:
    return {re.escape(joint): gains[which] for joint, gains in own.items()}


def _borne(robot: Robot, model: Path, rate: float) -> dict[str, Any]:
    """All delay in the loop that the robot bears with these gains, like that of the published."""
    (found,) = whole_robot.evaluate(_loop(robot, model, rate))
    known = found.delay_borne
    return {
        "delay": models.plain(known.delay), "frequency": models.plain(known.frequency),
        "joint": found.robot.names[ranked(known.participation)[0]],
    }  # fmt: skip
