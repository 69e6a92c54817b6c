"""The options of every verb that say how a robot is mounted, how it is damped and how it rubs."""

from __future__ import annotations

from typing import Annotated

from tyro.conf import arg

from jaxact.errors import UserError, nearest, shown

BASES = ("free", "fixed", "held")
DAMPINGS = ("joint", "drive")
FRICTIONS = ("moving", "stuck")

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
Friction = Annotated[
    str | None,
    arg(
        metavar="moving|stuck",
        help="Of a robot: margins and growth rates of joints that move, which dry friction does "
        "not damp; or as MuJoCo linearises it at rest, as very strong damping.",
        help_behavior_hint="(default: moving)",
    ),
]


def chosen(
    base: str | None, damping: str | None, friction: str | None = None, *, robot: bool = True
) -> dict[str, str]:
    """The keys of a robot that these options give.

    robot: whether there is one

    Raises UserError for a value that is not known, and without a robot.
    """
    found: dict[str, str] = {}
    options = (
        ("base", base, BASES),
        ("damping", damping, DAMPINGS),
        ("friction", friction, FRICTIONS),
    )
    for name, value, known in options:
        if value is None:
            continue
        if not robot:
            raise UserError(f"--{name}: is for a robot; give one with --model")
        if value not in known:
            raise UserError(f"--{name} {shown(value)}; {nearest(value, known)}")
        found[name] = value
    return found
