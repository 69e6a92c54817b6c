"""The drives of a robot's joints from logs of the robot in the air, or on a test bench.

Each joint is simulated by itself behind its drive, with what the links do to it along the motion
that was measured (`jaxact.identification.links`): the ladder is that of a single joint, of which
armature, friction, delay and dynamics are sought and the links are known. Joints of a group share
their numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax

from jaxact.errors import UserError
from jaxact.identification import knowledge
from jaxact.identification.identify import Source, identify
from jaxact.identification.knowledge import Estimate
from jaxact.identification.links import constant_forces, joint_of, levelled, with_links
from jaxact.identification.log import Log
from jaxact.identification.reading import ColumnMap, Columns, read
from jaxact.identification.report import estimate
from jaxact.identification.result import Identified
from jaxact.identification.verdict import MOST_CORRELATED, Level
from jaxact.loops import drives
from jaxact.loops.drives import ROBOT, IdentifiedDrive
from jaxact.loops.unmodelled import OFFSET
from jaxact.parameters import (
    CONTROL_RATE,
    DELAY,
    FORCE_LIMIT,
    GAIN_SCALE,
    JOINT_ARMATURE,
    JOINT_DAMPING,
    JOINT_FRICTION,
    KD,
    KP,
    POSITION_RESOLUTION,
    WN,
    ZETA,
)
from jaxact.reportable import Reportable
from jaxact.robots import model as _models
from jaxact.robots.mounting import FIXED
from jaxact.robots.robot import Joint, Robot
from jaxact.tuning.groups import group

SUFFIXES = (".xml", ".mjcf", ".urdf")
"""Of files that are robots."""

# Numbers of a joint that its model has too -> the parameter that is added to the model's.
_ADDED = {"armature": JOINT_ARMATURE, "viscous": JOINT_DAMPING, "coulomb": JOINT_FRICTION}
# Models whose error on unseen logs is within this factor are about as good.
_ABOUT_AS_GOOD = 1.5
_OF_DRIVE = (KP, KD, WN, ZETA, DELAY, FORCE_LIMIT, POSITION_RESOLUTION)


@dataclass(frozen=True)
class Part:
    """The drive of one joint, or of several that share it.

    Attributes:
        name: of the joint, or of the group.
        joints: of the robot.
        found: what was identified.
        delay: its interval, where the chosen model has none that of the same with a delay.
    """

    name: str
    joints: tuple[Joint, ...]
    found: Identified
    delay: Estimate

    @property
    def pattern(self) -> str:
        """Regular expression of the joints' names."""
        return "|".join(re.escape(joint.name) for joint in self.joints)


@dataclass(frozen=True)
class IdentifiedRobot(Reportable):
    """The identified drives of a robot's joints; printed, they are what was found.

    Attributes:
        robot: on which they were identified, its base fixed.
        parts: a drive each.
    """

    robot: Robot
    parts: tuple[Part, ...]

    @property
    def drive(self) -> IdentifiedDrive:
        """The drives as their file has them, for `jaxact.robot` and `jaxact.tune`."""
        return drives.of_document("identified", self.document())

    @property
    def sentence(self) -> str:
        """The verdict on the worst of the drives."""
        order = list(Level)
        worst = max(self.parts, key=lambda part: order.index(part.found.verdict.level))
        return f"{worst.name}: {worst.found.verdict.sentence}"

    def document(self) -> dict[str, Any]:
        """Everything as plain numbers and words, for TOML and JSON."""
        values, unsure, less = self._parameters()
        each = [part.found.document() for part in self.parts]
        ticks = max(one.get(drives.DIFFERENCE_TICKS, 0) for one in each)
        levels = [part.found.verdict.level for part in self.parts]
        return {
            "plant": ROBOT,
            "model": self.robot.path.name,
            "unit": "rad",
            "verdict": {
                "level": max(levels, key=list(Level).index).value, "sentence": self.sentence,
            },
            ROBOT: values,
            **({drives.DIFFERENCE_TICKS: ticks} if ticks else {}),
            "uncertainty": unsure,
            "left_out": less,
            "estimates": {},
            "joints": {
                part.name: {
                    **document, "joints": [joint.name for joint in part.joints],
                    DELAY: {"value": part.delay.value, "low": part.delay.low,
                              "high": part.delay.high, "identified": part.delay.identified},
                }
                for part, document in zip(self.parts, each, strict=True)
            },
        }  # fmt: skip

    def _parameters(self) -> tuple[dict[str, float], dict[str, list[float]], list[str]]:
        """Parameters of a loop of the robot, their 95 % intervals, and what cannot be said so."""
        values, less = self._shared()
        unsure: dict[str, list[float]] = {}
        for part in self.parts:
            drive = part.found.drive
            values |= {
                f"{name}@{part.pattern}": drive.joint[name]
                for name in _OF_DRIVE
                if name in drive.joint
            }
            unsure[f"{DELAY}@{part.pattern}"] = [part.delay.low, part.delay.high]
            for name in (WN, ZETA):
                if name in drive.uncertainty:
                    unsure[f"{name}@{part.pattern}"] = list(map(float, drive.uncertainty[name]))
            more, fewer = self._added(part)
            values |= more
            less += fewer
            less += [f"{words} of {part.name}" for words in drive.beyond_a_loop
                     if words != OFFSET]  # fmt: skip
            less += [f"{words}, {part.name}" for words in drive.document.get("left_out", ())]
        return values, unsure, less

    def _shared(self) -> tuple[dict[str, float], list[str]]:
        """Gain and control rate, of which a robot has one each, and what of them cannot be said."""
        values: dict[str, float] = {}
        less: list[str] = []
        rates = {part.name: part.found.drive.joint[CONTROL_RATE] for part in self.parts}
        if len(set(rates.values())) == 1:
            values[CONTROL_RATE] = next(iter(rates.values()))
        else:
            each = ", ".join(f"{rate:g} Hz of {name}" for name, rate in rates.items())
            less.append(f"control rates ({each}), of which a robot has one: give that")
        gains = {part.name: part.found.drive.joint.get(GAIN_SCALE, 1.0) for part in self.parts}
        number = sum(len(part.joints) for part in self.parts)
        if len(set(gains.values())) == 1 and number == len(self.robot.joints):
            gain = next(iter(gains.values()))
            values |= {GAIN_SCALE: gain} if gain != 1.0 else {}
        else:
            less += [
                f"the gain {gain:.4g} of {name}: multiply its kp and kd by that"
                for name, gain in gains.items()
                if gain != 1.0
            ]
        return values, less

    def _added(self, part: Part) -> tuple[dict[str, float], list[str]]:
        """What is added to the model's own armature, damping and friction, and where it has more.

        Joints of a part share the sum, and may differ in what their model has of it.
        """
        values: dict[str, float] = {}
        less: list[str] = []
        for name, parameter in _ADDED.items():
            whole = part.found.drive.numbers.get(name, 0.0)
            owns = [self._own(parameter, joint) for joint in part.joints]
            for own in dict.fromkeys(owns):
                names = [j.name for j, one in zip(part.joints, owns, strict=True) if one == own]
                if whole > own:
                    values[f"{parameter}@{'|'.join(map(re.escape, names))}"] = whole - own
                elif own > whole:
                    word = {"armature": "armature", "viscous": "damping"}.get(name, "frictionloss")
                    who = part.name if len(names) == len(owns) else ", ".join(names)
                    less.append(
                        f"{word} of {who}, which is {whole:.3g} and not the {own:.3g} of"
                        f" {self.robot.path.name}"
                    )
        return values, less

    def _own(self, parameter: str, joint: Joint) -> float:
        """What the model itself has of a number of a joint."""
        model = self.robot.model
        rows = {
            JOINT_ARMATURE: model.dof_armature, JOINT_DAMPING: model.dof_damping,
            JOINT_FRICTION: model.dof_frictionloss,
        }[parameter]  # fmt: skip
        return float(rows[joint.dof])

    def __str__(self) -> str:
        """What was found, as text."""
        lines = []
        for part in self.parts:
            chosen, verdict = part.found.chosen, part.found.verdict
            who = ", ".join(joint.name for joint in part.joints)
            lines.append(f"{part.name}: {chosen.rung.name}; {min(chosen.scores):.1f} % of unseen")
            lines += [f"  joints {who}"] if who != part.name else []
            lines += [f"  {estimate(one)}" for one in chosen.knowledge.estimates
                      if one.name != DELAY]  # fmt: skip
            lines.append(f"  {estimate(part.delay)}")
            lines.append(f"  verdict: {verdict.sentence}")
        vague = [part.name for part in self.parts if not part.delay.identified]
        if vague:
            lines += ["", f"the delay is not identifiable from these logs: {', '.join(vague)}"]
        return "\n".join(lines)


def identify_robot(
    logs: Source | Sequence[Source],
    model: str | Path,
    *,
    validate: Source | Sequence[Source] = (),
    columns: ColumnMap | Mapping[str, Columns] | None = None,
    joint: str = "",
    groups: Sequence[str] = (),
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> IdentifiedRobot:
    """Find the drives of a robot's joints.

    Args:
        logs: files that record the joints together, to be fitted.
        model: MJCF or URDF file; its base is fixed, and nothing touches the robot.
        validate: files to try the models on.
        columns: what the columns are for each joint, by its name or its actuator's.
        joint: the only one to identify; the others still say what moves.
        groups: patterns found in the names of joints or actuators: the joints of one share a drive.
        progress: is told what is being fitted.
        options: as for `jaxact.identify`.

    Raises:
        UserError: a joint that the model does not have, and as `jaxact.identify`.
    """
    robot = _models.read(model, base=FIXED)
    fitted, held = (_together(each, columns, robot) for each in (logs, validate))
    if not fitted:
        raise UserError("`logs` is empty; give at least one log")
    named = {log.joint: joint_of(robot, log.joint) for log in fitted}
    if joint:
        chosen, recorded = joint_of(robot, joint), ", ".join(named)
        named = {name: own for name, own in named.items() if own == chosen}
        if not named:
            raise UserError(f"joint {joint} was not recorded; the map has {recorded}")
    shared = group(tuple(groups), [(own.name, own.actuator) for own in named.values()])
    parts = []
    for number, name in enumerate(shared.names):
        own = [key for key, place in zip(named, shared.members, strict=True) if place == number]
        title = name if groups else own[0]

        def say(words: str, title: str = title) -> None:
            if progress is not None:
                progress(f"{title}: {words}")

        ours, others = ([log for log in each if log.joint in own] for each in (fitted, held))
        if len(own) > 1:
            constant = constant_forces(ours)
            ours, others = levelled(ours, constant), levelled(others, constant)
        found = identify(ours, "mass", validate=others, progress=say, **options)
        parts.append(Part(title, tuple(named[key] for key in own), found, _delay(found)))
    return IdentifiedRobot(robot, tuple(parts))


def _together(
    given: Source | Sequence[Source],
    columns: ColumnMap | Mapping[str, Columns] | None,
    robot: Robot,
) -> list[Log]:
    """The logs of all joints in these files, with what the links do to each."""
    each = [given] if isinstance(given, str | Path) else list(given)  # type: ignore[arg-type]
    if any(isinstance(one, Log) for one in each):
        raise UserError("logs: of a robot, give files, which record its joints together")
    found: list[Log] = []
    for one in each:
        found += with_links(read(Path(one), columns), robot)  # type: ignore[arg-type]
    return found


def _delay(found: Identified) -> Estimate:
    """The delay's interval in the chosen model, or in the same one with a delay.

    It contains what models predict that assume another friction and are about as good. Where the
    error that is left follows the stimulus, as that of a wrong delay would, no delay is identified.
    """
    chosen = found.chosen
    own = _own_delay(found)
    period = found.ladder.fitted[0].period
    others = [
        one.numbers[DELAY]
        for one in found.ladder.candidates
        if one.rung.dynamics == DELAY and one.error <= _ABOUT_AS_GOOD * chosen.error
    ]
    low, high = min(own.low, *others, own.value), max(own.high, *others, own.value)
    reason = own.reason
    if not reason and high - low > max(period, own.high - own.low):
        reason = "it depends on the friction that is assumed"
    if found.verdict.correlated > MOST_CORRELATED:
        high = max(high, low + period)
        reason = reason or "the error that is left follows the stimulus, as a delay's would"
    return replace(own, low=low, high=high, identified=not reason, reason=reason)


def _own_delay(found: Identified) -> Estimate:
    """The delay's estimate in the chosen model, or in the same one with a delay."""
    chosen = found.chosen
    if DELAY in chosen.rung.free:
        return chosen.knowledge[DELAY]
    names = (f"{chosen.rung.dynamics} with delay", DELAY)
    beside = [
        one
        for name in names
        for one in found.ladder.candidates
        if one.rung.dynamics == name and one.rung.friction == chosen.rung.friction
    ]
    with jax.enable_x64(True):
        return knowledge.of_fit(beside[0].fit)[DELAY]
