"""What `jaxact.check` says of the loop that the model's own gains make: first, and in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from jaxact.errors import UserError
from jaxact.files import plain
from jaxact.loops.drives import DRIVE
from jaxact.parameters import CONTROL_RATE

# Share of a joint in a motion from which on the motion is its own, and from which on it is named
# beside others; and how many are.
_ALONE, _PART, _MOST_NAMED = 0.8, 0.1, 3

if TYPE_CHECKING:
    from jaxact.loops.specification import Plant
    from jaxact.robot_margins.on_stand import Loop, OnStand
    from jaxact.robots.robot import Robot


def found(plant: Plant, robot: Robot, drive: Mapping[str, float], velocity: str) -> OnStand | str:
    """What the gains bear, or why that is not known; "" where the model brings none.

    Args:
        plant: the robot.
        robot: the same, read.
        drive: parameters of the drives beside the gains, the control rate among them.
        velocity: that the controllers see, "sampled" or "differenced".
    """
    import mujoco
    import numpy as np

    from jaxact.robot_margins import on_stand
    from jaxact.robots.findings import MUJOCO

    if not on_stand.brings_gains(robot) or any(MUJOCO in item.engines for item in robot.findings):
        return ""
    try:
        return on_stand.on_stand(plant, robot, drive, velocity)
    except (UserError, mujoco.FatalError, np.linalg.LinAlgError) as error:
        return str(error)


def as_json(known: OnStand | str) -> dict[str, Any] | None:
    """The same as plain values; null where it is not known."""
    if isinstance(known, str):
        return None
    loops = {name: getattr(known, name) for name in ("as_it_is", "in_drive", "stuck", "free")}
    return {
        CONTROL_RATE: known.control_rate,
        DRIVE: {name: value for name, value in known.drive.items() if name != CONTROL_RATE},
        **{name: None if loop is None else _loop(loop) for name, loop in loops.items()},
        "outside": list(known.outside),
        "edges": list(known.edges),
        "overloaded": list(known.weak),
        "hidden_gains": [joint.name for joint in known.hidden],
        "friction": known.friction,
        "falls": known.falls or None,
    }


def _loop(loop: Loop) -> dict[str, Any]:
    borne = {key: value for key, value in asdict(loop.borne).items() if key != "participation"}
    shares = loop.shares
    begins = {"joint": next(iter(shares)), "participation": shares}
    return begins | plain(borne)


def as_text(known: OnStand | str) -> list[str]:
    """The same as paragraphs."""
    if isinstance(known, str):
        return [f"How much delay the gains bear is not known: {known}"] if known else []
    behind = ", behind these drives" if len(known.drive) > 1 else ""
    at = f"On a stand, at {known.control_rate:g} Hz{behind},"
    first = f"{at} the gains {_bears(known.as_it_is)}."
    if known.in_drive is not None:
        # The answer that counts for a robot comes first.
        first = f"{at} with the joints' damping in the drives, the gains {_bears(known.in_drive)}."
    return [*_of_limits(known), first, *_of_damping(known), *_of_friction(known), *_of_base(known)]


def _bears(loop: Loop, *, would: bool = False) -> str:
    from jaxact.plotting.wording import quantity

    borne = loop.borne
    leaves = f"do not stop what leaves the posture, by {borne.toppling_rate:.3g} 1/s"
    if borne.shakes:
        return f"{_shake(loop)}, and {leaves}" if borne.topples else _shake(loop)
    where = f" at {quantity(borne.frequency, 'rad/s')}"
    who, several = _who(loop)
    shakes = "would shake" if would else "shake" if several else "shakes"
    then = ", when" if would else "; then"
    bears = f"bear {quantity(borne.delay, 's')} of delay{then} {who} {shakes}{where}"
    if math.isinf(borne.delay):
        bears = "bear any delay"
    if borne.topples:
        return f"{leaves}; they {bears}"
    return bears


def _shake(loop: Loop) -> str:
    from jaxact.plotting.wording import quantity

    borne = loop.borne
    return (
        f"shake even without more delay: {_who(loop)[0]} at "
        f"{quantity(borne.frequency, 'rad/s')}, growing by {borne.shaking_rate:.3g} 1/s"
    )


def _who(loop: Loop) -> tuple[str, bool]:
    """The joints that move most, with their shares where no single one does it; and if several."""
    shares = list(loop.shares.items())
    if not shares[0][1]:
        return "no driven joint", False
    if len(shares) == 1 or shares[0][1] >= _ALONE:
        return shares[0][0], False
    named = [f"{name} ({100.0 * share:.0f} %)" for name, share in shares[:_MOST_NAMED]]
    named = [text for text, (_, share) in zip(named, shares, strict=False) if share >= _PART]
    if len(named) < 2:
        return shares[0][0], False
    return f"{', '.join(named[:-1])} and {named[-1]}", True


def _of_limits(known: OnStand) -> list[str]:
    from jaxact.loops import robots, strength

    found = [f"{line}." for line in known.edges]
    if known.weak:
        found.append(f"{strength.too_weak(known.weak)}.")
    if known.outside:
        found.insert(0, f"{robots.held_by_limits(known.outside)}; {robots.keyframe_advice(())}.")
    return found


def _of_damping(known: OnStand) -> list[str]:
    if known.in_drive is None:
        return []
    count, of = len(known.hidden), len(known.as_it_is.names)
    return [
        f"{count} of {of} driven joints have kp, no kd, and damping of their own: most likely a "
        'drive\'s D gain, which `damping="drive"` has sampled and delayed. As the model has it, in '
        f"the joint and at once, the gains would {_bears(known.as_it_is, would=True)}."
    ]


def _of_friction(known: OnStand) -> list[str]:
    if known.stuck is None:
        return []
    return [
        f"{_left_out(known.friction, known.friction_unit)}; as MuJoCo linearises it at rest the "
        f"gains would {_bears(known.stuck, would=True)}."
    ]


def friction_alone(robot: Robot) -> list[str]:
    """What is said of dry friction where the model brings no gains."""
    from jaxact.robot_margins.on_stand import friction_unit
    from jaxact.robots import friction

    if not friction.rubs(robot.model):
        return []
    most = friction.largest(robot.model)
    return [
        f'{_left_out(most, friction_unit(robot.model))}; margins with `friction="stuck"` have it.'
    ]


def _left_out(most: float, unit: str) -> str:
    return f"Dry friction of up to {most:.3g} {unit} is left out, as it damps no joint that moves"


def _of_base(known: OnStand) -> list[str]:
    if known.falls:
        return [f"With its base free there is no posture to look at: {known.falls}"]
    if known.free is None:
        return []
    borne = known.free.borne
    if borne.stable:
        return [f"With its base free, at this posture, the gains {_bears(known.free)}."]
    if not borne.topples:
        return [f"With its base free the gains {_bears(known.free)}."]
    topples = (
        f"With its base free the robot topples, by {borne.toppling_rate:.3g} 1/s, because it has "
        'no balance controller, whatever the drives do in time: `base="fixed"` leaves only its '
        "joints and drives."
    )
    return [f"{topples} The gains {_shake(known.free)}." if borne.shakes else topples]
