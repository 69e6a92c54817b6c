"""`jaxact.export`: the gains of a robot in the formats of other people's files."""

from __future__ import annotations

import math
import os
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxact import files
from jaxact.environments import gain_formats
from jaxact.environments.gain_formats import FORMATS, JointGains
from jaxact.errors import UserError, nearest, shown
from jaxact.gains import reading
from jaxact.gains.table import GainFile, matched
from jaxact.loops import conversion, robots
from jaxact.loops.building import loop_of, robot
from jaxact.loops.control_loop import ControlLoop
from jaxact.parameters import FORCE_LIMIT, GAIN_SCALE, KD, KP, POLICY_RATE, base
from jaxact.tuning.result import Tuned

Source = ControlLoop | Tuned | str | os.PathLike[str]


@dataclass(frozen=True)
class Exported:
    """Gains, written.

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


def export(
    source: Source,
    to: str,
    out: str | os.PathLike[str] | None = None,
    *,
    model: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    **robot_options: Any,
) -> Exported:
    """The gains of a robot as somebody else's file.

        jaxact.export("tuned/gains.toml", "deploy-yaml", "deploy.yaml", model="go1.xml")

    Args:
        source: a robot's loop, a tuned result, or a file: a specification with a [plant], the
            gains.toml (or the folder) of a tuned result, an MJCF model, or any file of gains that
            `jaxact.robot(gains=...)` reads.
        to: "toml", "mjcf", "deploy-yaml", "rl-gym", "legged-gym", "isaaclab" or "mjlab".
        out: file to write, None for none.
        model: of a file of gains, the robot's: names and order of the joints, positions at rest,
            force limits, and the gains of joints that the file does not name.
        overwrite: replace a file that is there.
        robot_options: of that model, as for `jaxact.robot`: keyframe, joints, base, damping.

    Returns:
        The text, what went into it, and what was lost.

    Raises:
        UserError: an unknown format, a source without a robot's gains, a file that is there.
    """
    if to not in FORMATS:
        raise UserError(f"`to` = {shown(to)}; {nearest(to, FORMATS)}")
    if out is not None:
        files.check_output(Path(out), overwrite=overwrite)
    joints, name = _found(source, model, robot_options)
    text = gain_formats.text(joints, to, name)
    if out is not None:
        with files.output(Path(out)) as partial:
            partial.write_text(text, encoding="utf-8")
    return Exported(joints, text, tuple(gain_formats.lost(joints, to)))


def _found(
    source: Source, model: str | os.PathLike[str] | None, options: dict[str, Any]
) -> tuple[JointGains, str]:
    """The gains, and what they are from."""
    if isinstance(source, Tuned):
        if source.loop is None:
            raise UserError("source: a result without its loop; tune a robot with jaxact.tune")
        return of_loop(source.loop), "a tuned result"
    if isinstance(source, ControlLoop):
        return of_loop(source), "a loop"
    text = os.fspath(source)
    path = Path(text) / "gains.toml" if Path(text).is_dir() else Path(text)
    if model is not None:
        return of_loop(robot(model, gains=str(path) if Path(text).is_dir() else text, **options)), (
            path.name
        )
    if path.suffix == ".toml" and _is_specification(path):
        return of_loop(loop_of(path)), path.name
    read = reading.read(str(path) if Path(text).is_dir() else text)
    if read.format == "mjcf" and _is_model(path):
        return of_loop(robot(path, **options)), path.name
    if options:
        raise UserError(f"`{next(iter(options))}`: is for a robot; give its `model`")
    return _alone(read), path.name


def _is_specification(path: Path) -> bool:
    try:
        return "plant" in tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False  # what is wrong with it is said where it is read


def _is_model(path: Path) -> bool:
    return "<worldbody" in path.read_text(encoding="utf-8", errors="replace")


def of_loop(loop: ControlLoop) -> JointGains:
    """The gains of a robot's loop, joint by joint.

    Raises:
        UserError: a joint, several loops, or a joint of the robot without gains.
    """
    plant = loop.kind.plant
    if plant is None or loop.shape:
        raise UserError("gains are exported of a single loop of a robot, not of a joint or a batch")
    scene = robots.scene(plant)
    along = {name: rows.reshape(-1)[0] for name, rows in conversion.samples(loop).along.items()}
    given = {name for name in along if "@" not in name and not np.isnan(along[name])}
    robots.check(scene, [name for name in along if "@" in name], given)
    masks = {key: robots.matched(scene, key) for key in along if "@" in key}
    asked = {key: value for key, value in along.items() if base(key) in _USED}
    with jax.enable_x64(True):
        found = robots.each_joint(asked, robots.brought(scene), masks)
    count = len(scene.labels)
    own = {name: np.broadcast_to(np.asarray(found[name], float), count) for name in _EACH}
    scale = np.broadcast_to(np.asarray(found.get(GAIN_SCALE, 1.0), float), count)
    rate = float(along.get(POLICY_RATE, math.inf))
    start = scene.robot.qpos
    return JointGains(
        scene.labels,
        tuple((scale * own[KP]).tolist()),
        tuple((scale * own[KD]).tolist()),
        tuple(own[FORCE_LIMIT].tolist()),
        tuple(float(start[joint.qpos]) for joint in scene.robot.joints),
        1.0 / rate if math.isfinite(rate) else math.nan,
    )


_EACH = (KP, KD, FORCE_LIMIT)
_USED = (*_EACH, GAIN_SCALE)


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
