"""What a loop, a tuned result or a file says of joints' gains and drives, for `jaxact.export`."""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxact.environments.gain_formats import JointGains
from jaxact.environments.torch_export import FRAMEWORKS, TAKEN
from jaxact.errors import UserError, shown
from jaxact.gains import reading
from jaxact.gains.table import FORCE_HIGH, FORCE_LOW, GainFile, matched
from jaxact.loops import conversion, drives, robots
from jaxact.loops.building import joint, loop_of, robot
from jaxact.loops.control_loop import ControlLoop, demand
from jaxact.loops.joint_ranges import (
    HIGHEST_FORCE,
    HIGHEST_SETPOINT,
    LOWEST_FORCE,
    LOWEST_SETPOINT,
)
from jaxact.parameters import (
    CONTROL_RATE,
    FORCE_LIMIT,
    JOINT_ARMATURE,
    JOINT_DAMPING,
    JOINT_FRICTION,
    JOINT_STIFFNESS,
    KD,
    KP,
    PARAMETERS,
    POLICY_RATE,
    WN,
    ZETA,
    base,
    canonical,
)
from jaxact.robots.findings import ASKED, HARMLESS
from jaxact.robots.robot import Robot
from jaxact.tuning.result import Tuned

Source = ControlLoop | Tuned | str | os.PathLike[str]

ANY = (".*",)  # the joints that the drive of a single one is for
# What of a loop is the joint's, and not its drive's.
_OF_JOINTS = (JOINT_DAMPING, JOINT_STIFFNESS, JOINT_FRICTION, JOINT_ARMATURE)
# What patterns of joints' names have, and names seldom.
_PATTERN = re.compile(r"[][(){}.*+?|^$\\]")
_SECTIONS = ("plant", "parameters", "axes", "loop", "drive")


@dataclass(frozen=True)
class Found:
    """What a source says: gains, and each joint's drive.

    Attributes:
        joints: whose gains they are; without gains and limits, which are in `own`.
        own: parameters of `TAKEN`, shape (joints,).
        ranges: of force and setpoint, by the names of `NO_RANGES`, where a joint has one.
        velocity: that the controllers see.
        left_out: what is not the drive's, sentences.
        rated: the source gives a control rate.
    """

    joints: JointGains
    own: Mapping[str, np.ndarray]
    ranges: Mapping[str, np.ndarray] = field(default_factory=dict)
    velocity: str = "sampled"
    left_out: tuple[str, ...] = ()
    rated: bool = False


def found(
    source: Source, to: str, given: Mapping[str, Any], model: str | os.PathLike[str] | None,
    options: dict[str, Any],
) -> tuple[Found, str]:  # fmt: skip
    """What there is, and what it is from."""

    def of_loop(loop: ControlLoop, more: Any = ()) -> Found:
        if loop.kind.plant is None and to not in FRAMEWORKS:
            raise UserError(nameless(to))
        return _of_loop(loop, given, more)

    if isinstance(source, Tuned | ControlLoop):
        _demand_none({"model": model, **options}, "a file, and this is a loop; leave it out")
    if isinstance(source, Tuned):
        if source.loop is None:
            raise UserError("source: a result without its loop; tune a loop with jaxact.tune")
        return of_loop(source.loop), "a tuned result"
    if isinstance(source, ControlLoop):
        demand(source, "source")
        return of_loop(source), "a loop"
    if not isinstance(source, str | os.PathLike):
        raise UserError(
            f"source: a value of type {type(source).__name__} has no gains; give a loop, what "
            "jaxact.tune found, or a file of gains, a drive or a model"
        )
    text = os.fspath(source)
    path = Path(text) / "gains.toml" if Path(text).is_dir() else Path(text)
    text = str(path) if Path(text).is_dir() else text
    document = _toml(path)
    if "estimates" in document:
        drive = drives.load_drive(path)
        if model is None:
            return of_loop(*_of_drive(drive, given)), path.name
        _demand_one(options, "drive", "a drive")
        loop = robot(model, **options | {"drive": drive})
        return of_loop(loop, drive.left_out(robot=True)), path.name
    if model is not None:
        _demand_one(options, "gains", "a file of gains")
        placed = of_loop(robot(model, **options | {"gains": text}))
        return replace(
            placed, left_out=(*placed.left_out, *_said(path, reading.read(text)))
        ), path.name
    if any(section in document for section in _SECTIONS):
        _demand_none(options, f"a model, and {path.name} is a specification: write it there")
        return of_loop(loop_of(path)), path.name
    if path.suffix == ".xml" and _is_model(path):
        return of_loop(robot(path, **options)), path.name
    read = reading.read(text)
    if options:
        raise UserError(f"`{next(iter(options))}`: is for a robot; give its `model`")
    gains = _alone(read)
    own = {name: np.full(len(gains.names), PARAMETERS[name].default) for name in TAKEN}
    own |= {KP: np.array(gains.kp), KD: np.array(gains.kd)}
    forces = np.array(gains.force_range).T
    ranges = dict(zip((LOWEST_FORCE, HIGHEST_FORCE), forces, strict=False))
    own |= {FORCE_LIMIT: np.array(gains.force_limit)}
    return Found(gains, own, ranges, left_out=_said(path, read)), path.name


def _of_drive(
    drive: drives.IdentifiedDrive, given: Mapping[str, Any]
) -> tuple[ControlLoop, list[str]]:
    """The loop of the drive of a single joint, and what is left out of it.

    Raises:
        UserError: its gains are per unit of an inertia, and none are given instead.
    """
    if not drive.per_inertia:
        return joint(drive=drive), drive.left_out()
    if not {KP, KD} <= {canonical(name) for name in given}:
        raise UserError(
            f"{drive.name}: its gains are per unit of an inertia that is not known; give `kp` and"
            " `kd`"
        )
    kept = drive.parameters(robot=True)  # what is no force
    seen: Any = drive.velocity
    return joint(velocity=seen, **kept), drive.left_out(robot=True)


def _demand_none(options: Mapping[str, Any], what: str) -> None:
    """None of these options is given, which are for something else, in words."""
    for name, value in options.items():
        if value is not None:
            raise UserError(f"`{name}`: is for {what}")


def _demand_one(options: Mapping[str, Any], name: str, what: str) -> None:
    """Raise UserError where an option gives another of what the source is, in words."""
    if options.get(name) is not None:
        raise UserError(f"`{name}`: the source is {what} already; leave one of them out")


def _said(path: Path, read: GainFile) -> tuple[str, ...]:
    """What a file of gains says besides, and gains do not carry."""
    return tuple(f"Of {path.name}: {note}" for note in read.notes)


def nameless(to: str) -> str:
    """What a format lacks that names the joints."""
    return (
        f"`to` = {shown(to)}: names the joints of a robot; export a loop of jaxact.robot(model, "
        "...), or give the `model` beside a file, and `kp` and `kd` where neither has them"
    )


def _toml(path: Path) -> dict[str, Any]:
    """What a TOML file says; nothing of any other, which is judged where it is read."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig")) if path.suffix == ".toml" else {}
    except (OSError, ValueError, RecursionError):
        return {}


def _is_model(path: Path) -> bool:
    try:
        return "<worldbody" in path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False


def _of_loop(loop: ControlLoop, given: Mapping[str, Any], more: Any = ()) -> Found:
    """What a loop says of its drives, joint by joint.

    Args:
        loop: of a robot, or of a joint, whose drive is then that of any.
        given: parameters that count instead.
        more: what was left out already.

    Raises:
        UserError: several loops, or one without gains.
    """
    if loop.shape == (1,):
        loop = loop[0]
    # what varies and is given counts as given
    instead = {canonical(name) for name in given} | ({WN, ZETA} if "actuator" in given else set())
    kept = {n: v for n, v in loop.values.items() if not np.ndim(v) or n not in instead}
    loop = replace(loop, values=kept)
    if loop.shape:
        varied = ", ".join(name for name, value in kept.items() if np.ndim(value))
        raise UserError(f"several loops, of which one is exported: give one {varied}")
    plant = loop.kind.plant
    if plant is None:
        along: Mapping[str, Any] = conversion.one(loop)
        lacking = [f"`{n}`" for n in (KP, KD) if n not in loop.values and n not in given]
        if lacking:
            raise UserError(f"{' and '.join(lacking)}: not in the source; give them")
        own = {name: np.array([along[name]]) for name in TAKEN}
        gains = JointGains(ANY, (), (), (), period=_period(along))
        ranges: Mapping[str, np.ndarray] = {}
    else:
        along, own, ranges, gains = _of_robot(loop, given)
    left = [f"{name} {along[name]:g}" for name in _OF_JOINTS if along.get(name, 0.0)]
    left += [
        f"{base(key)} of {key.partition('@')[2]} {value:g}"
        for key, value in along.items()
        if "@" in key and base(key) in _OF_JOINTS and value
    ]
    left = [*left, *more]
    said = [f"Left out, as the joint's and not the drive's: {', '.join(left)}"] if left else []
    if plant is not None:
        said += _of_model(robots.scene(plant).robot)
    rated = CONTROL_RATE in loop.values
    return Found(gains, own, ranges, loop.kind.velocity, tuple(said), rated)


def _of_model(robot: Robot) -> list[str]:
    """What of a robot's model the gains stand for, or lack, in sentences."""
    said = []
    if any(one.action == ASKED and one.field == "damping" for one in robot.findings):
        words = "kd stands for the joints' own damping as well"
        said.append(f"{words}: take that out of the simulated model")
    smoothed = [one for one in robot.findings if one.action == HARMLESS and one.field == "dyntype"]
    if smoothed:
        more = f" and of {len(smoothed) - 1} more" if smoothed[1:] else ""
        said.append(f"Left out: what smooths the setpoint of {smoothed[0].where}{more}")
    return said


def _of_robot(
    loop: ControlLoop, instead: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, np.ndarray], dict[str, np.ndarray], JointGains]:
    """All parameters of a robot's loop, those of the drive joint by joint, ranges, and its joints.

    Raises:
        UserError: a joint of the robot has no gains.
    """
    scene = robots.scene(loop.kind.plant)
    along = {name: rows.reshape(-1)[0] for name, rows in conversion.samples(loop).along.items()}
    given = {name for name in along if "@" not in name and not np.isnan(along[name])}
    keys = [name for name in along if "@" in name]
    for name, value in instead.items():
        if isinstance(value, Mapping):
            keys += [f"{canonical(name)}@{pattern}" for pattern in value]
        else:
            given.add(canonical(name))
    robots.check(scene, keys, given)
    masks = {key: robots.matched(scene, key) for key in along if "@" in key}
    asked = {key: value for key, value in along.items() if base(key) in TAKEN}
    with jax.enable_x64(True):
        found = robots.each_joint(asked, robots.brought(scene), masks)
    count = len(scene.labels)
    own = {name: np.broadcast_to(np.asarray(found[name], float), count) for name in TAKEN}
    start = scene.robot.qpos
    position = tuple(float(start[one.qpos]) for one in scene.robot.joints)
    gains = JointGains(scene.labels, (), (), (), position=position, period=_period(along))
    return along, own, _ranges(scene.robot, found), gains


def _period(along: Mapping[str, Any]) -> float:
    """Of the setpoints [s]; nan where nothing holds them."""
    rate = float(along.get(POLICY_RATE, math.inf))
    return 1.0 / rate if math.isfinite(rate) else math.nan


def _ranges(robot: Robot, found: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """A robot's ranges of force and of setpoint, where it has any.

    Those of setpoints are its servos' own, which do not depend on a posture.
    """
    names = (LOWEST_FORCE, HIGHEST_FORCE)
    own = {name: np.asarray(found[name], float) for name in names if name in found}
    ends = np.array([(one.setpoint_low, one.setpoint_high) for one in robot.joints], float)
    if np.isfinite(ends).any():
        own[LOWEST_SETPOINT], own[HIGHEST_SETPOINT] = ends.T
    return own


def _alone(read: GainFile) -> JointGains:
    """The gains of a file that names every joint.

    Raises:
        UserError: it does not.
    """
    names = list(dict.fromkeys(str(one.key) for one in read.entries))
    patterns = read.keys == "pattern" and read.format != "toml"
    if read.keys in ("place", "motor", "part") or patterns:
        raise UserError(
            f"{read.path}: does not name every joint of the robot; give its `model` as well"
        )
    wide = [name for name in names if read.keys == "pattern" and _PATTERN.search(name)]
    if wide:
        raise UserError(
            f"{read.path}: {shown(wide[0])} is a pattern, and does not name every joint of the"
            " robot; give its `model` as well"
        )
    found = matched(read, [(name, name) for name in names])
    lacking = [name for one in found.partly.values() for name in one] + [*found.without]
    if lacking:
        raise UserError(f"{read.path}: {lacking[0]} has not both of kp and kd")
    none = (FORCE_LIMIT, math.inf), (FORCE_LOW, -math.inf), (FORCE_HIGH, math.inf)
    rows = {
        name: tuple(found.parameters.get(name, {}).get(joint, default) for joint in names)
        for name, default in ((KP, math.nan), (KD, math.nan), *none)
    }
    ranges = tuple(zip(rows[FORCE_LOW], rows[FORCE_HIGH], strict=True))
    own = ranges if FORCE_LOW in found.parameters else ()
    return JointGains(tuple(names), rows[KP], rows[KD], rows[FORCE_LIMIT], force_range=own)
