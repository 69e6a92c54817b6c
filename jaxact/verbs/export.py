"""`jaxact.export`: the gains and drives of a robot in the formats of other people's files."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxact import files
from jaxact.environments import environment_drive, gain_formats, torch_export
from jaxact.environments.gain_formats import FORMATS, JointGains
from jaxact.environments.torch_export import FRAMEWORKS, TAKEN, JointDrives
from jaxact.errors import UserError, nearest, shown
from jaxact.gains import reading
from jaxact.gains.table import GainFile, matched
from jaxact.loops import conversion, drives, robots
from jaxact.loops.building import joint, loop_of, robot
from jaxact.loops.control_loop import ControlLoop, demand
from jaxact.parameters import (
    CONTROL_RATE,
    FORCE_LIMIT,
    GAIN_SCALE,
    JOINT_ARMATURE,
    JOINT_DAMPING,
    JOINT_FRICTION,
    KD,
    KP,
    PARAMETERS,
    POLICY_RATE,
    WN,
    ZETA,
    base,
    canonical,
)
from jaxact.tuning.result import Tuned

Source = ControlLoop | Tuned | str | os.PathLike[str]


_ANY = (".*",)  # the joints that the drive of a single one is for
# What of a loop is the joint's, and not its drive's.
_OF_JOINTS = (JOINT_DAMPING, JOINT_FRICTION, JOINT_ARMATURE)
_SECTIONS = ("plant", "parameters", "axes", "loop", "drive")


@dataclass(frozen=True)
class Exported:
    """Gains or drives, written.

    Attributes:
        joints: whose gains they are.
        text: content of the file.
        lost: what the format has no place for, or asks for and is not known here; sentences.
    """

    joints: JointGains
    text: str
    lost: tuple[str, ...]

    def __repr__(self) -> str:
        """The content."""
        return self.text


@dataclass(frozen=True)
class _Found:
    """What a source says: gains, and each joint's drive without ranges."""

    joints: JointGains
    own: Mapping[str, np.ndarray]
    velocity: str = "sampled"
    left_out: tuple[str, ...] = ()


def export(
    source: Source,
    to: str,
    out: str | os.PathLike[str] | None = None,
    *,
    model: str | os.PathLike[str] | None = None,
    parameters: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    **robot_options: Any,
) -> Exported:
    """The gains of a robot, or its whole drives, as somebody else's file.

        jaxact.export("tuned/gains.toml", "deploy-yaml", "deploy.yaml", model="go1.xml")
        jaxact.export("drive.toml", "mjlab", "drive.py", parameters={"delay": (0.002, 0.008)})

    "mjlab" and "isaaclab" write the gains as a configuration, and where there is more between
    setpoint and joint, one self-contained file: the drive's recursion in torch, an actuator class
    of that framework, and the configuration that uses it.

    Args:
        source: a loop, a tuned result, or a file: a drive of `jaxact.identify`, a specification,
            the gains.toml (or the folder) of a tuned result, an MJCF model, or any file of gains
            that `jaxact.robot(gains=...)` reads.
        to: "toml", "mjcf", "deploy-yaml", "rl-gym", "legged-gym", "isaaclab" or "mjlab".
        out: file to write, None for none.
        model: of a file of gains or a drive, the robot's: names and order of the joints, positions
            at rest, force limits, and the gains of joints that the file does not name.
        parameters: of the drive, instead of the source's: a number, an array of shape (joints,), a
            range (low, high), from which every environment draws at its reset, or a table of
            patterns of joints -> number or range.
        overwrite: replace a file that is there.
        robot_options: of that model, as for `jaxact.robot`: keyframe, joints, base, damping, gains.

    Returns:
        The text, what went into it, and what was lost.

    Raises:
        UserError: an unknown format, a source without gains, a file that is there.
    """
    if to not in FORMATS:
        raise UserError(f"`to` = {shown(to)}; {nearest(to, FORMATS)}")
    if out is not None:
        files.check_output(Path(out), overwrite=overwrite)
    given = dict(parameters or {})
    found, name = _found(source, to, given, model, robot_options)
    gains, own = _ranged(found, given)
    text, lost = _written(gains, own, to, name)
    if out is not None:
        with files.output(Path(out)) as partial:
            partial.write_text(text, encoding="utf-8")
    return Exported(gains, text, tuple(lost))


def _ranged(found: _Found, given: Mapping[str, Any]) -> tuple[JointGains, JointDrives]:
    """The gains, and the drives with what was given instead of the source's."""
    names, count = found.joints.names, len(found.joints.names)
    ends = environment_drive.ranges(given, names, found.own)
    low, high = ({n: np.broadcast_to(v, count) for n, v in side.items()} for side in ends)
    for name in (KP, KD, CONTROL_RATE):
        if np.any(low[name] != high[name]):
            advice = "; give gain_scale one" if name != CONTROL_RATE else ""
            raise UserError(f"`{name}`: cannot have a range{advice}")
    for name in low:
        if np.any((low[name] != high[name]) & np.isinf(high[name])):
            raise UserError(f"`{name}`: its range has no end")
    if np.all(low[GAIN_SCALE] == high[GAIN_SCALE]):
        scaled = {name: low[GAIN_SCALE] * low[name] for name in (KP, KD)}
        low, high = ({**side, **scaled, GAIN_SCALE: np.ones(count)} for side in (low, high))
    gains = replace(
        found.joints, kp=tuple(low[KP].tolist()), kd=tuple(low[KD].tolist()),
        force_limit=tuple(high[FORCE_LIMIT].tolist()),
    )  # fmt: skip
    patterns = names if names == _ANY else tuple(map(torch_export.pattern, names))
    return gains, JointDrives(patterns, low, high, found.velocity, found.left_out)


def _written(
    gains: JointGains, own: JointDrives, to: str, name: str
) -> tuple[str, tuple[str, ...]]:
    """The content of the file, and what is lost in it."""
    lost = own.left_out
    if to in FRAMEWORKS and not own.bare:
        comments = [f"The drive of {len(gains.names)} joints, from {name}, written by jaxact"]
        comments[0] = (
            comments[0]
            if gains.names != _ANY
            else (f"The drive of each joint, from {name}, written by jaxact")
        )
        return torch_export.text(own, to, [*comments, *gain_formats.UNITS, *lost]), lost
    if gains.names == _ANY:
        raise UserError(_nameless(to))
    if not own.bare:
        lost = (*lost, "Left out, this format has no place for it: the drive behind the gains")
    return gain_formats.text(gains, to, name, lost), (*lost, *gain_formats.lost(gains, to))


def _found(
    source: Source, to: str, given: Mapping[str, Any], model: str | os.PathLike[str] | None,
    options: dict[str, Any],
) -> tuple[_Found, str]:  # fmt: skip
    """What there is, and what it is from."""

    def of_loop(loop: ControlLoop, more: Any = ()) -> _Found:
        if loop.kind.plant is None and to not in FRAMEWORKS:
            raise UserError(_nameless(to))
        return _of_loop(loop, given, more)

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
            return of_loop(joint(drive=drive), drive.left_out()), path.name
        loop = robot(model, drive=drive, **options)
        return of_loop(loop, drive.left_out(robot=True)), path.name
    if model is not None:
        return of_loop(robot(model, gains=text, **options)), path.name
    if any(section in document for section in _SECTIONS):
        return of_loop(loop_of(path)), path.name
    if path.suffix == ".xml" and _is_model(path):
        return of_loop(robot(path, **options)), path.name
    read = reading.read(text)
    if options:
        raise UserError(f"`{next(iter(options))}`: is for a robot; give its `model`")
    gains = _alone(read)
    own = {name: np.full(len(gains.names), PARAMETERS[name].default) for name in TAKEN}
    own |= {KP: np.array(gains.kp), KD: np.array(gains.kd)}
    return _Found(gains, own | {FORCE_LIMIT: np.array(gains.force_limit)}), path.name


def _nameless(to: str) -> str:
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


def _of_loop(loop: ControlLoop, given: Mapping[str, Any], more: Any = ()) -> _Found:
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
        gains = JointGains(_ANY, (), (), ())
    else:
        along, own, gains = _of_robot(loop, given)
    left = [f"{name} {along[name]:g}" for name in _OF_JOINTS if along.get(name, 0.0)]
    left = [*left, *more]
    said = [f"Left out, as the joint's and not the drive's: {', '.join(left)}"] if left else []
    if plant is not None and plant.damping == "drive":
        said.append("kd has the joints' own damping in it: take that out of the simulated model")
    return _Found(gains, own, loop.kind.velocity, tuple(said))


def _of_robot(
    loop: ControlLoop, instead: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, np.ndarray], JointGains]:
    """All parameters of a robot's loop, those of the drive joint by joint, and its joints.

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
    rate, start = float(along.get(POLICY_RATE, math.inf)), scene.robot.qpos
    position = tuple(float(start[one.qpos]) for one in scene.robot.joints)
    period = 1.0 / rate if math.isfinite(rate) else math.nan
    return along, own, JointGains(scene.labels, (), (), (), position, period)


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
    found = matched(read, [(name, name) for name in names])
    if found.without:
        raise UserError(f"{read.path}: {found.without[0]} has not both of kp and kd")
    limits = found.parameters.get(FORCE_LIMIT, {})
    return JointGains(
        tuple(names),
        tuple(found.parameters[KP][name] for name in names),
        tuple(found.parameters[KD][name] for name in names),
        tuple(limits.get(name, math.inf) for name in names),
    )
