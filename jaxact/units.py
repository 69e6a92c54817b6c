"""Units of a joint that slides, and of one that turns."""

from __future__ import annotations

from collections.abc import Sequence

# What a joint's position is measured in: it slides, or it turns.
UNITS = ("m", "rad")
# The units of a rotary joint, by how those of one that slides begin.
_TURNED = (
    ("N/m", "N m/rad"), ("N s/m", "N m s/rad"), ("N^2", "(N m)^2"), ("N", "N m"), ("kg", "kg m^2"),
    ("m/s", "rad/s"), ("m", "rad"),
)  # fmt: skip


def turned(units: str) -> str:
    """A unit of a rotary joint, from that of one that slides: `N s/m` is `N m s/rad`."""
    for slide, hinge in _TURNED:
        if units.startswith(slide) and not units.removeprefix(slide)[:1].isalpha():
            return hinge + units.removeprefix(slide)
    return units


def in_unit(units: str, unit: str | None) -> str:
    """A unit as it is written for a joint whose position is in `unit`; None: m."""
    return turned(units) if unit == "rad" else units


def joint_units(units: str, rotary: Sequence[bool]) -> str:
    """A unit that is written for slides, of joints of these kinds.

    Args:
        units: of slides: "N/m", "m s", "N^2 s".
        rotary: of each joint, whether it is measured in rad and N m.

    Returns:
        `units` of slides, that of hinges ("rad s", "(N m)^2 s"), or both of a robot that has both.
    """
    hinge = turned(units)
    if hinge == units or not any(rotary):
        return units
    return hinge if all(rotary) else f"{hinge} or {units}"
