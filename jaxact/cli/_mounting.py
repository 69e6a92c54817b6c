"""The options that say how a robot is mounted and where its damping acts, for every verb."""

from __future__ import annotations

from typing import Annotated

from tyro.conf import arg

from jaxact.errors import UserError, nearest, shown

BASES = ("free", "fixed", "held")
DAMPINGS = ("joint", "drive")

Base = Annotated[
    str | None,
    arg(
        metavar="free|fixed|held",
        help="Of a robot: its base as the model has it; fixed on a stand, where nothing touches "
        "the robot; or held where the robot stands, in contact.",
        help_behavior_hint="(default: free)",
    ),
]
Damping = Annotated[
    str | None,
    arg(
        metavar="joint|drive",
        help="Of a robot: the joints' viscous damping as the model has it, in the joint; or as "
        "part of the kd that the model brings, sampled and delayed.",
        help_behavior_hint="(default: joint)",
    ),
]


def chosen(base: str | None, damping: str | None, *, robot: bool = True) -> dict[str, str]:
    """The keys of a robot that these options give.

    robot: whether there is one

    Raises UserError for a value that is not known, and without a robot.
    """
    found: dict[str, str] = {}
    for name, value, known in (("base", base, BASES), ("damping", damping, DAMPINGS)):
        if value is None:
            continue
        if not robot:
            raise UserError(f"--{name}: is for a robot; give one with --model")
        if value not in known:
            raise UserError(f"--{name} {shown(value)}; {nearest(value, known)}")
        found[name] = value
    return found
