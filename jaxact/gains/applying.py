"""A robot with the gains of a file in place of those that its model brings."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import Any

from jaxact.gains import reading
from jaxact.gains.table import Matched, matched
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
        changed |= {"force_low": -limit, "force_high": limit}
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


def said(kind: str, found: Matched) -> str:
    """In one sentence, what was taken from a file and what was not."""
    what = "gains and force limits" if found.parameters.get(FORCE_LIMIT) else "gains"
    parts = [f"of format {kind}: {what} of {len(found.parameters[KP])} joints"]
    if found.without:
        parts.append(f"none of {', '.join(found.without)}, which stay as the model has them")
    if found.unmatched:
        parts.append(f"of none of the robot's joints: {', '.join(found.unmatched)}")
    return "; ".join([*parts, *found.notes])
