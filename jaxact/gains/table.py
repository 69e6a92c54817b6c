"""What a file says of gains, and which joints it means."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from jaxact.errors import InexactWarning, UserError, shown
from jaxact.parameters import FORCE_LIMIT, KD, KP

Keys = Literal["name", "part", "pattern", "place", "motor"]
"""What the keys of a file are: names of joints, parts of names (legged_gym: the last that is part
of a joint's name counts), regular expressions that match a name in full, places among the driven
joints from 0, which must be as many, or numbers of motors, which are the first such places."""

_PLAIN = re.compile(r"[\w-]+")  # a name, and no pattern of several
# The drive's parameters that such files have.
READ = (KP, KD, FORCE_LIMIT)
# Ends of a joint's range of force where it differs by direction; called as in `robots.robot.Joint`.
FORCE_LOW, FORCE_HIGH = "force_low", "force_high"


@dataclass(frozen=True)
class Entry:
    """A number, and the joints that it is for.

    Attributes:
        parameter: kp [N m/rad], kd [N m s/rad], force_limit, force_low or force_high [N m]; of
            slides N and m.
        key: as `Keys` says.
        value: of the parameter.
        within: patterns; only joints that one of them matches are meant.
        robot: that the file has it for, where it may have several; else "".
    """

    parameter: str
    key: str | int
    value: float
    within: tuple[str, ...] = (".*",)
    robot: str = ""


@dataclass(frozen=True)
class GainFile:
    """What a file says.

    Attributes:
        path: of the file.
        format: of `jaxact.gains.reading.FORMATS`.
        entries: its numbers.
        keys: what their keys are.
        notes: what else it says, which gains do not carry, and what had to be assumed.
        later_wins: where several entries are for one joint, the last counts; else, and where keys
            are names, it is a mistake.
    """

    path: Path
    format: str
    entries: tuple[Entry, ...]
    keys: Keys
    notes: tuple[str, ...] = ()
    later_wins: bool = True

    def __post_init__(self) -> None:
        for one in self.entries:
            if one.parameter in (FORCE_LOW, FORCE_HIGH):
                continue
            if not math.isfinite(one.value) and one.parameter != FORCE_LIMIT or one.value < 0.0:
                raise UserError(
                    f"{self.path}: {one.parameter} of {shown(one.key)} is {one.value:g}; give a"
                    " number that is not negative"
                )


def tell_shadowed(parameter: str, patterns: Iterable[str]) -> None:
    """Warn of patterns of a table that change nothing, as a later one has all of their joints.

    That is known without the joints of a name, and of whatever comes before `.*`.

    Args:
        parameter: that the table is of.
        patterns: its keys in their order, of which the last that matches a joint counts.
    """
    listed = list(map(str, patterns))
    for place, first in enumerate(listed):
        for later in listed[place + 1 :]:
            if later == ".*" or (_PLAIN.fullmatch(first) and _has(later, first)):
                warnings.warn(
                    f"{parameter}: {shown(first)} changes nothing, since {shown(later)} comes later"
                    " and has its joints as well; exchange them",
                    InexactWarning, stacklevel=4,
                )  # fmt: skip
                break


def _has(pattern: str, name: str) -> bool:
    """Whether a pattern matches a name; one that is none is refused elsewhere."""
    try:
        return re.fullmatch(pattern, name) is not None
    except re.error:
        return False


@dataclass(frozen=True)
class Matched:
    """The numbers of a file, joint by joint.

    Attributes:
        parameters: name of the parameter -> name of the joint -> its value.
        unmatched: keys of the file that are for none of the joints.
        without: driven joints that the file gives no gains.
        partly: kp and kd -> the driven joints that it gives only the other one.
        notes: of the file, and of how names were matched.
    """

    parameters: Mapping[str, Mapping[str, float]]
    unmatched: tuple[str, ...]
    without: tuple[str, ...]
    partly: Mapping[str, tuple[str, ...]]
    notes: tuple[str, ...]


_NAME = re.compile(r"[\w-]+([./][\w-]+)*")  # of a configuration, or of one of rl_sar's robots


def split(file: str | Path) -> tuple[Path, str | None]:
    """The path of a file, and the name behind a colon where the whole is not a file."""
    text = str(file)
    before, colon, after = text.rpartition(":")
    if not colon or not _NAME.fullmatch(after) or Path(text).exists():
        return Path(text), None
    if "/" in after and Path(before).suffix not in (".yaml", ".yml"):  # a folder's name, rather
        return Path(text), None
    return Path(before), after


def matched(file: GainFile, joints: Sequence[tuple[str, str]]) -> Matched:
    """Which joint gets which numbers.

    Args:
        file: as it was read.
        joints: of each driven joint its name and its actuator's, in the order of the actuators.

    Raises:
        UserError: no joint is meant, the number of gains is not that of the joints where the file
            has no names, its motors cannot be the joints in their order, or several entries are
            for one joint and none of them counts more.
    """
    if file.keys == "place":
        _check_places(file, len(joints))
    if file.keys == "motor":
        _check_motors(file, len(joints))
    meant = {_id(one): _joints_of(file, one, joints) for one in file.entries}
    notes = list(file.notes)
    if file.keys == "name" and not any(meant.values()):
        meant = {_id(one): _alike(one, joints) for one in file.entries}
        if any(meant.values()):
            notes.append("its names have no, or another, ending `_joint` than the model's")
    exclusive = file.keys == "name" or not file.later_wins
    found: dict[str, dict[str, float]] = {}
    by: dict[tuple[str, str], Entry] = {}
    for one in file.entries:
        for name in meant[_id(one)]:
            before = by.get((one.parameter, name))
            if before is not None and exclusive and before.value != one.value:
                raise UserError(_conflict(file, name, before, one))
            by[one.parameter, name] = one
            found.setdefault(one.parameter, {})[name] = one.value
    names = [name for name, _ in joints]
    if not any(found.get(one) for one in (KP, KD)):
        given = list(dict.fromkeys(str(one.key) for one in file.entries))
        raise UserError(
            f"{file.path}: none of its joints ({_few(given)}) is one of the robot's ({_few(names)})"
        )
    unmatched = dict.fromkeys(str(one.key) for one in file.entries if not meant[_id(one)])
    lacking = {one: [name for name in names if name not in found.get(one, {})] for one in (KP, KD)}
    without = [name for name in names if all(name in own for own in lacking.values())]
    partly = {
        one: tuple(name for name in own if name not in without) for one, own in lacking.items()
    }
    return Matched(found, tuple(unmatched), tuple(without), partly, tuple(notes))


def _conflict(file: GainFile, joint: str, first: Entry, second: Entry) -> str:
    path = file.path
    if first.robot != second.robot:
        return (
            f"{path}: has several robots, {first.robot} and {second.robot}, that both give"
            f" {first.parameter} of {joint}; name one: {path}:{first.robot}"
        )
    named = file.keys == "name"  # of the joint itself, and of its actuator
    remedy = "leave one of them out" if named else "make the patterns exclude each other"
    return (
        f"{path}: {shown(first.key)} and {shown(second.key)} both give {first.parameter} of"
        f" {joint}; {remedy}"
    )


def _id(entry: Entry) -> tuple[object, ...]:
    return entry.parameter, entry.key, entry.within


def _joints_of(file: GainFile, entry: Entry, joints: Sequence[tuple[str, str]]) -> list[str]:
    """Names of the joints that an entry is for."""
    if isinstance(entry.key, int):
        return [joints[entry.key][0]] if entry.key < len(joints) else []
    if file.keys == "name":
        exact = [pair[0] for pair in joints if pair[0] == entry.key]
        return exact or [pair[0] for pair in joints if pair[1] == entry.key]
    found = []
    for name, actuator in joints:
        if file.keys == "part":
            fits = entry.key in name
        else:
            fits = any(
                _full(file, entry.key, one) and any(_full(file, p, one) for p in entry.within)
                for one in (name, actuator)
            )
        found += [name] if fits else []
    return found


def _full(file: GainFile, pattern: str, name: str) -> bool:
    try:
        return pattern == name or re.fullmatch(pattern, name) is not None
    except re.error as error:
        raise UserError(
            f"{file.path}: {shown(pattern)} is not a regular expression: {error}"
        ) from None


def _alike(entry: Entry, joints: Iterable[tuple[str, str]]) -> list[str]:
    """As `_joints_of`, of names that differ in case, or in whether they end in `_joint`."""
    key = _plain(str(entry.key))
    found = [name for name, actuator in joints if key in (_plain(name), _plain(actuator))]
    return found if len(found) == 1 else []


def _plain(name: str) -> str:
    return name.casefold().removesuffix("_joint")


def _check_places(file: GainFile, joints: int) -> None:
    places = {one.key for one in file.entries}
    if len(places) != joints:
        raise UserError(
            f"{file.path}: has gains for {len(places)} joints without their names, and the robot"
            f" has {joints} driven joints; choose as many with `joints`"
        )


def _check_motors(file: GainFile, joints: int) -> None:
    """Raise UserError where motor i cannot be driven joint i: a motor is left out, or beyond."""
    motors = sorted({int(one.key) for one in file.entries})
    unused = sorted(set(range(motors[-1])) - set(motors))
    why = f"none of motor {unused[0]}" if unused else f"the robot has {joints} driven joints"
    if unused or motors[-1] >= joints:
        raise UserError(
            f"{file.path}: has gains of motor {motors[-1]}, and {why}, so its motors are not the"
            " driven joints in their order; give a TOML file with [kp] and [kd] of joint = number"
        )


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f", ... {len(names)} in all" if len(names) > 3 else "")
