"""`jaxact.export`: the gains and drives of a robot in the formats of other people's files."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxact import files
from jaxact.environments import environment_drive, gain_formats, torch_export
from jaxact.environments.gain_formats import FORMATS, JointGains, Range
from jaxact.environments.torch_export import FRAMEWORKS, NO_RANGES, JointDrives
from jaxact.errors import UserError, nearest, shown
from jaxact.loops.joint_ranges import (
    HIGHEST_FORCE,
    HIGHEST_SETPOINT,
    LOWEST_FORCE,
    LOWEST_SETPOINT,
)
from jaxact.parameters import (
    CONTROL_RATE,
    FORCE_LIMIT,
    GAIN_SCALE,
    KD,
    KP,
    canonical,
)
from jaxact.verbs import export_sources as sources
from jaxact.verbs.export_sources import ANY, Found, Source, nameless


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
    if not isinstance(parameters, Mapping | None):
        raise UserError(
            f"`parameters`: a value of type {type(parameters).__name__}; give a table, e.g. "
            '{"delay": (0.002, 0.008)}'
        )
    given = dict(parameters or {})
    found, name = sources.found(source, to, given, model, robot_options)
    gains, own = _ranged(found, given)
    text, lost = _written(gains, own, to, name)
    if out is not None:
        with files.output(Path(out)) as partial:
            partial.write_text(text, encoding="utf-8")
    return Exported(gains, text, tuple(lost))


def _ranged(found: Found, given: Mapping[str, Any]) -> tuple[JointGains, JointDrives]:
    """The gains, and the drives with what was given instead of the source's."""
    names, count = found.joints.names, len(found.joints.names)
    ends = environment_drive.ranges(given, names, found.own)
    environment_drive.demand_fitting(*ends, found.velocity)
    low, high = ({n: np.broadcast_to(v, count) for n, v in side.items()} for side in ends)
    for name in (KP, KD, CONTROL_RATE):
        if np.any(low[name] != high[name]):
            advice = "; give gain_scale one" if name != CONTROL_RATE else ""
            raise UserError(f"`{name}`: cannot have a range{advice}")
    for name in (KP, KD):
        if np.any(low[name] < 0.0):
            raise UserError(f"`{name}` = {low[name].min():g}: gains in files are not negative")
    # a factor that is fixed is in the gains, of each joint that has one
    fixed = low[GAIN_SCALE] == high[GAIN_SCALE]
    scaled = {name: np.where(fixed, low[GAIN_SCALE], 1.0) * low[name] for name in (KP, KD)}
    low, high = (
        {**side, **scaled, GAIN_SCALE: np.where(fixed, 1.0, side[GAIN_SCALE])}
        for side in (low, high)
    )
    gains = replace(
        found.joints, kp=tuple(low[KP].tolist()), kd=tuple(low[KD].tolist()),
        force_limit=tuple(high[FORCE_LIMIT].tolist()),
        least_limit=tuple(low[FORCE_LIMIT].tolist()),
        force_range=_pairs(found.ranges, LOWEST_FORCE, HIGHEST_FORCE),
        setpoint_range=_pairs(found.ranges, LOWEST_SETPOINT, HIGHEST_SETPOINT),
    )  # fmt: skip
    patterns = names if names == ANY else tuple(map(torch_export.pattern, names))
    bounds = {
        name: found.ranges.get(name, np.full(count, none)) for name, none in NO_RANGES.items()
    }
    rated = found.rated or CONTROL_RATE in map(canonical, given)
    ends = low | bounds, high | bounds
    return gains, JointDrives(patterns, *ends, found.velocity, found.left_out, rated)


def _pairs(ranges: Mapping[str, np.ndarray], low: str, high: str) -> tuple[Range, ...]:
    """Both ends of a range of each joint; none where no joint has one."""
    if low not in ranges:
        return ()
    return tuple(zip(ranges[low].tolist(), ranges[high].tolist(), strict=True))


def _written(
    gains: JointGains, own: JointDrives, to: str, name: str
) -> tuple[str, tuple[str, ...]]:
    """The content of the file, and what is lost in it."""
    lost = own.left_out
    if to in FRAMEWORKS and math.isfinite(gains.period):
        rate = f"policy_rate {1.0 / gains.period:g} Hz"
        lost = (*lost, f"Left out, as the environment's own step holds an action: {rate}")
    if to in FRAMEWORKS and (own.one_sided or gains.limits_drawn or not own.bare):
        comments = [f"The drive of {len(gains.names)} joints, from {name}, written by jaxact"]
        comments[0] = (
            comments[0]
            if gains.names != ANY
            else (f"The drive of each joint, from {name}, written by jaxact")
        )
        return torch_export.text(own, to, [*comments, *gain_formats.UNITS, *lost]), lost
    if gains.names == ANY:
        raise UserError(nameless(to))
    if not own.bare:
        lost = (*lost, "Left out, this format has no place for it: the drive behind the gains")
    return gain_formats.text(gains, to, name, lost), (*lost, *gain_formats.lost(gains, to))
