"""What a user should know of a result that is computed nevertheless: one line on standard error."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxact.sweep.specification import Specification


def warn(text: str) -> None:
    """Print one line on standard error."""
    print(f"jaxact: warning: {text}", file=sys.stderr)


# Accelerations of a posture at rest are smaller [rad/s^2 or m/s^2].
RESIDUAL = 1e-2


def posture(specification: Specification) -> None:
    """Warn of a robot whose joints are too weak for its posture, or that creeps; else nothing."""
    if specification.plant is None:
        return
    overload(specification)
    from jaxact.sweep import robots

    found = robots.scene(specification.plant).posture
    if found.settled and found.residual > RESIDUAL:
        warn(
            f"the robot still creeps after settling (accelerations up to {found.residual:.3g}); "
            "small growth rates, and verdicts that follow from their sign, are those of its "
            "creeping"
        )


def older(result: str) -> None:
    """Warn of a store in which not all damage would be found."""
    from jaxact.sweep import integrity, opening

    store = opening.find(result)
    with opening.readable(result):
        found = integrity.description(store)
    if found.older and not found.wrong:
        warn(
            f"{store.name}: was made by an older jaxact, without checksums of its coordinates;"
            " damage there would not be found (`jaxact sweep ... --resume` adds them)"
        )


def overload(specification: Specification) -> None:
    """Warn of a robot's posture that its joints are too weak to hold, or that limits hold.

    Nothing without a robot.
    """
    if specification.plant is None:
        return
    from jaxact.sweep import robots

    scene = robots.scene(specification.plant)
    if stopped := robots.at_stops(scene.robot, scene.posture.qpos):
        advice = robots.keyframe_advice(robots.keyframes_within(scene.robot))
        warn(f"{robots.held_by_limits(stopped)}; {advice}")
    weak = robots.overloaded(scene)
    if weak:
        warn(
            f"{', '.join(weak)}: more than the model's joints can exert; linear figures are those "
            "of joints that could, simulations saturate"
        )
