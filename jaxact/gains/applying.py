"""A robot with the gains of a file in place of those that its model brings."""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxact.errors import GainsWarning
from jaxact.gains import reading
from jaxact.gains.table import FORCE_HIGH, FORCE_LOW, Matched, matched
from jaxact.parameters import FORCE_LIMIT, KD, KP
from jaxact.robots.conversion import IN_JOINT
from jaxact.robots.findings import ASKED, Finding
from jaxact.robots.robot import Joint, Robot


def applied(robot: Robot, file: str) -> Robot:
    """The robot with a file's gains, and its force limits where it has them.

    Args:
        robot: as its model has it; joints that the file does not name stay as they are.
        file: its path, as for `jaxact.gains.reading.read`.

    Returns:
        The robot; what of the file has no counterpart, and what the file has no counterpart of, is
        among its findings.

    Raises:
        UserError: the file cannot be read, or names none of the robot's joints.
    """
    source = reading.read(file)
    found = matched(source, [(joint.name, joint.actuator) for joint in robot.joints])
    warn_of_unmatched(source.path, found)
    joints = tuple(_joint(joint, found) for joint in robot.joints)
    numbers = repr(sorted((name, sorted(own.items())) for name, own in found.parameters.items()))
    digest = hashlib.sha256((robot.digest + numbers).encode()).hexdigest()
    words = "; ".join([said(source.format, found), *_beside(robot, joints)])
    findings = (
        *robot.findings,
        Finding("gains", "file", source.path.name, "knows none", ASKED, words),
    )
    return replace(robot, joints=joints, findings=findings, digest=digest)


def _joint(joint: Joint, found: Matched) -> Joint:
    own = {name: rows.get(joint.name) for name, rows in found.parameters.items()}
    changed: dict[str, Any] = {
        name: value for name in (KP, KD) if (value := own.get(name)) is not None
    }
    limit = own.get(FORCE_LIMIT)
    if limit is not None:
        changed |= {FORCE_LOW: -limit, FORCE_HIGH: limit}
    changed |= {name: own[name] for name in (FORCE_LOW, FORCE_HIGH) if own.get(name) is not None}
    return replace(joint, **changed)


def _beside(robot: Robot, joints: tuple[Joint, ...]) -> list[str]:
    """Damping of joints that stood for the kd which the file now gives."""
    if robot.damping != IN_JOINT:
        return []
    twice = [
        float(robot.model.dof_damping[before.dof])
        for before, after in zip(robot.joints, joints, strict=True)
        if not before.kd > 0.0 and after.kd > 0.0 and robot.model.dof_damping[before.dof] > 0.0
    ]
    if not twice:
        return []
    return [
        f"{len(twice)} joints have damping of their own as well, up to {max(twice):g}, where the"
        " model's actuators had no kd: if it stood for one, give `damping` drive, which takes it"
        " out of the joints"
    ]


def unmatched(found: Matched) -> str:
    """In words, what of a file is for none of the robot's joints."""
    return f"of none of the robot's joints: {', '.join(found.unmatched)}"


def warn_of_unmatched(path: Path, found: Matched) -> None:
    """Warn of names in a file, perhaps misspelt, that are for none of the robot's joints."""
    if found.unmatched:
        warnings.warn(f"{path}: {unmatched(found)}", GainsWarning, stacklevel=2)


def said(kind: str, found: Matched) -> str:
    """In one sentence, what was taken from a file and what was not."""
    limited = any(found.parameters.get(name) for name in (FORCE_LIMIT, FORCE_LOW))
    what = "gains and force limits" if limited else "gains"
    count = len({name for one in (KP, KD) for name in found.parameters.get(one, {})})
    parts = [f"of format {kind}: {what} of {count} joint{'s' if count != 1 else ''}"]
    for parameter, names in found.partly.items():
        if names:
            parts.append(f"no {parameter} of {', '.join(names)}, which stays as the model has it")
    if found.without:
        parts.append(f"none of {', '.join(found.without)}, which stay as the model has them")
    if found.unmatched:
        parts.append(unmatched(found))
    return "; ".join([*parts, *found.notes])
