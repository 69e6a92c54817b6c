"""What a user should know of a result that is computed nevertheless: one line on standard error."""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from jaxact.cli import _options
from jaxact.errors import GainsWarning, InexactWarning

if TYPE_CHECKING:
    from jaxact.loops.specification import Plant, Specification


class _GainsAtLength(GainsWarning):
    """All that a command says of a file of gains, of which the library says a part."""


def warn(text: str) -> None:
    """Print one line on standard error; parameters of robots in backquotes as options."""
    print(f"jaxact: warning: {_options.typed(text, 'margins')}", file=sys.stderr)


def posture(specification: Specification) -> None:
    """Warn of a robot whose joints are too weak for its posture, or that creeps; else nothing."""
    plant = specification.plant
    if plant is None:
        return
    gains(plant)
    overload(specification)
    from jaxact.loops import robots
    from jaxact.verbs.robot_tables import RESIDUAL

    found = robots.scene(plant).posture
    if found.settled and found.residual > RESIDUAL:
        warn(
            f"the robot still creeps after settling (accelerations up to {found.residual:.3g}); "
            "small growth rates, and verdicts that follow from their sign, are those of its "
            "creeping"
        )


@contextlib.contextmanager
def as_lines() -> Iterator[None]:
    """What the library warns of, as a line like every other warning; of gains what is not said yet.

    Verbs that compute with gains say more of their file themselves, with `gains`.
    """
    said, told, unsaid = set(), set(), set()
    with warnings.catch_warnings():
        for category in (InexactWarning, GainsWarning):
            warnings.simplefilter("always", category)
        others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any) -> None:
            text = str(message)
            if issubclass(category, GainsWarning) and category is not _GainsAtLength:
                unsaid.add(text)
            elif issubclass(category, InexactWarning | GainsWarning):
                said.add(category)
                if text not in told:  # several computations may be behind one command
                    warn(text)
                told.add(text)
            else:
                others(message, category, *where)

        warnings.showwarning = show  # type: ignore[assignment]
        try:
            yield
        finally:
            for text in sorted(unsaid) if _GainsAtLength not in said else ():
                warn(text)


def gains(plant: Plant | None) -> None:
    """Warn of what a file of gains has no counterpart of, and has that is not taken."""
    if plant is None or plant.gains is None:
        return
    from jaxact.loops import robots

    for found in robots.scene(plant).robot.findings:
        if found.where == "gains" and ";" in found.advice:  # more than what was asked for
            warnings.warn(f"{plant.gains}: {found.advice}", _GainsAtLength, stacklevel=2)


def older(result: str) -> None:
    """Warn of a store in which not all damage would be found."""
    from jaxact.sweeping import integrity, opening

    store = opening.find(result)
    with opening.readable(result):
        found = integrity.description(store)
    if found.older and not found.wrong:
        warn(
            f"{store.name}: was made by an older jaxact, without checksums of its coordinates;"
            " damage there would not be found (`jaxact sweep ... --resume` adds them)"
        )


def overload(specification: Specification) -> None:
    """Warn of a robot's posture that its joints are too weak to hold, or that limits hold or touch.

    Nothing without a robot. Limits are those of the loops, the narrowest of each joint.
    """
    if specification.plant is None:
        return
    from jaxact.loops import edges, robots
    from jaxact.loops.samples import ends
    from jaxact.loops.weak_joints import tell_weak

    scene, along = robots.scene(specification.plant), ends(specification)
    if stopped := robots.at_stops(scene.robot, scene.posture.qpos):
        advice = robots.keyframe_advice(robots.keyframes_within(scene.robot))
        warn(f"{robots.held_by_limits(stopped)}; {advice}")
    for line in edges.said(scene, along):
        warn(line)
    tell_weak(specification.plant, along)
