"""What `jaxact check` says of the loop that the model's own gains make: first, and in sentences."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from jaxact.errors import UserError

if TYPE_CHECKING:
    from jaxact.loops.specification import Plant
    from jaxact.robot_margins.on_stand import Loop, OnStand
    from jaxact.robots.robot import Robot


def found(plant: Plant, robot: Robot) -> OnStand | str:
    """What the gains bear, or why that is not known; "" where the model brings none."""
    import mujoco
    import numpy as np

    from jaxact.robot_margins import on_stand

    if not on_stand.brings_gains(robot) or any("mujoco" in item.engines for item in robot.findings):
        return ""
    try:
        return on_stand.on_stand(plant, robot)
    except (UserError, mujoco.FatalError, np.linalg.LinAlgError) as error:
        return str(error)


def as_json(known: OnStand | str) -> dict[str, Any] | None:
    """The same as plain values; null where it is not known."""
    if isinstance(known, str):
        return None
    loops = {name: getattr(known, name) for name in ("as_it_is", "in_drive", "stuck", "free")}
    return {
        "control_rate": known.control_rate,
        **{name: None if loop is None else _loop(loop) for name, loop in loops.items()},
        "hidden_gains": [joint.name for joint in known.hidden],
        "friction": known.friction,
        "falls": known.falls or None,
    }


def _loop(loop: Loop) -> dict[str, Any]:
    borne = {key: value for key, value in asdict(loop.borne).items() if key != "participation"}
    return {"joint": loop.joint} | {key: _plain(value) for key, value in borne.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf" if value > 0.0 else "-inf"
    return value


def as_text(known: OnStand | str) -> list[str]:
    """The same as paragraphs."""
    if isinstance(known, str):
        return [f"How much delay the gains bear is not known: {known}"] if known else []
    said = [
        f"On a stand, at {known.control_rate:g} Hz, the gains {_bears(known.as_it_is)}.",
        *_of_damping(known),
        *_of_friction(known),
        *_of_base(known),
    ]
    return said


def _bears(loop: Loop) -> str:
    from jaxact.plotting.wording import quantity

    borne = loop.borne
    where = f" at {quantity(borne.frequency, 'rad/s')}"
    if borne.shakes:
        return (
            f"shake even without more delay: {loop.joint}{where}, growing by "
            f"{borne.growth_rate:.3g} 1/s"
        )
    bears = f"bear {quantity(borne.delay, 's')} of delay; then {loop.joint} shakes{where}"
    if math.isinf(borne.delay):
        bears = "bear any delay"
    if borne.topples:
        return (
            f"do not hold the posture, which is left by {borne.growth_rate:.3g} 1/s; they {bears}"
        )
    return bears


def _of_damping(known: OnStand) -> list[str]:
    if known.in_drive is None:
        return []
    count, of = len(known.hidden), len(known.as_it_is.names)
    return [
        f"{count} of {of} driven joints have kp, no kd, and damping of their own: most likely a "
        "drive's D gain, which acts at once here. Computed in the drive, with --damping drive, "
        f"the gains {_bears(known.in_drive)}."
    ]


def _of_friction(known: OnStand) -> list[str]:
    if known.stuck is None:
        return []
    return [
        f"Dry friction of up to {known.friction:.3g} N m (N) is left out, as it damps no joint "
        f"that moves; as MuJoCo linearises it at rest the gains would {_would(known.stuck)}."
    ]


def _would(loop: Loop) -> str:
    return _bears(loop).replace("; then", ", when").replace(" shakes", " would shake")


def _of_base(known: OnStand) -> list[str]:
    if known.falls:
        return [f"With its base free there is no posture to look at: {known.falls}"]
    if known.free is None:
        return []
    borne = known.free.borne
    if borne.stable:
        return [f"With its base free, standing, the gains {_bears(known.free)}."]
    if not borne.topples:
        return [f"With its base free the gains {_bears(known.free)}."]
    return [
        f"With its base free the robot topples, by {borne.growth_rate:.3g} 1/s, for want of a "
        "balance controller, whatever the drives do in time: --base fixed leaves only its joints "
        "and drives."
    ]
