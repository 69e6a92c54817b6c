"""Motors for models that have no actuators: every URDF, and an MJCF that only describes a body."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import mujoco

from jaxact.robots.findings import EMULATED, Finding

_SINGLE = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


def add(spec: mujoco.MjSpec, path: Path, patterns: Sequence[str]) -> tuple[Finding, ...]:
    """Give each hinge and slide joint a motor, if there are no actuators at all.

    Args:
        spec: of the model; changed.
        path: the file it was read from.
        patterns: of the joints that are driven; those that none matches get no motor. All do where
            this leaves none, so that it can be said which there are.

    Returns:
        What is said of it: nothing where the model has actuators.
    """
    joints = [joint for joint in spec.joints if joint.type in _SINGLE]
    if spec.actuators or not joints:
        return ()
    name_joints(spec)
    for joint in [one for one in joints if _matches(one.name, patterns)] or joints:
        motor = spec.add_actuator(name=joint.name, target=joint.name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.set_to_motor()
    kind = "a URDF" if is_urdf(path) else "the model"
    return (
        Finding(
            "model", "actuator", f"none in {kind}", "has nothing to drive", EMULATED,
            "every hinge and slide joint gets a motor, within the joint's effort limit; where some "
            "are passive, name the driven ones with `joints = [...]`",
        ),
    )  # fmt: skip


def _matches(name: str, patterns: Sequence[str]) -> bool:
    try:
        return any(re.fullmatch(pattern, name) for pattern in patterns)
    except re.error:
        return True  # what is wrong with it is said where all patterns are read


def is_urdf(path: Path) -> bool:
    """Whether the first element of the file is a URDF's."""
    text = re.sub(rb"<!--.*?-->", b"", path.read_bytes(), flags=re.DOTALL)
    root = re.search(rb"<([A-Za-z][\w.:-]*)", text)
    return root is not None and root[1] == b"robot"


def name_joints(spec: mujoco.MjSpec) -> None:
    """Call joints that have no name by their number, as messages do."""
    taken = {joint.name for joint in spec.joints}
    for number, joint in enumerate(spec.joints):
        if not joint.name:
            joint.name = free_name(f"joint {number}", taken)


def free_name(wish: str, taken: set[str]) -> str:
    """The name, made longer until it is not among those taken."""
    while wish in taken:
        wish += "_"
    return wish
