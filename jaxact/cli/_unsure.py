"""What `jaxact tune` takes as not known: ranges, or what an identified drive leaves open."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from jaxact.cli._arguments import UNSET_NUMBER
from jaxact.errors import UserError, nearest, shown
from jaxact.loops.drives import DRIVE

if TYPE_CHECKING:
    from jaxact.cli.tune import Search
    from jaxact.loops.control_loop import ControlLoop
    from jaxact.loops.drives import IdentifiedDrive

# What an identified drive says of what is not known.
INTERVALS, SAMPLES, NONE = "intervals", "samples", "none"
DRAWN = 32


def uncertainty(
    search: Search, drive: IdentifiedDrive | None, loop: ControlLoop, given: dict[str, Any]
) -> str | ControlLoop:
    """What is not known: as it is written, or by the identified drive.

    Raises:
        UserError: it is what only a drive says, and there is none.
    """
    words = search.uncertainty or ("" if drive is None else INTERVALS)
    first, _, rest = words.partition(",")
    if first not in (INTERVALS, SAMPLES, NONE):
        if drive is not None and "=" not in first:
            what = nearest(first, (INTERVALS, SAMPLES, NONE, "NAME=LOW..HIGH"))
            raise UserError(f"--uncertainty {shown(first)}; {what}")
        return words
    if drive is None:
        raise UserError(f"--uncertainty {first}: is of an identified drive; give one with --drive")
    if first == INTERVALS:
        from jaxact.verbs.tune import intervals

        return intervals(drive, loop, rest)
    if first == NONE and not rest:
        return ""
    robot = loop.kind.plant is not None
    if robot or rest:
        why = f"of a robot give {INTERVALS}" if robot else "leave the ranges behind it out"
        raise UserError(f"--uncertainty {first}: {why}")
    from jaxact.loops.building import joint

    number = DRAWN if search.ensemble == UNSET_NUMBER else search.ensemble
    velocity: Any = loop.kind.velocity
    return joint(**given | {DRIVE: drive}, samples=number, seed=search.seed, velocity=velocity)
