"""What logs must have in common for one model to be held against all of them."""

from __future__ import annotations

from collections.abc import Sequence

from jaxact.errors import UserError
from jaxact.identification.joint_motion import COMMAND_LIMIT, Structure
from jaxact.identification.log import LINKS, Log
from jaxact.parameters import FEEDFORWARD, MASS, SETPOINT

_GRAVITY = 9.81


def stated(log: Log, gravity: bool) -> dict[str, float]:
    """Numbers of its joint that a log's details give; `gravity`: of a pendulum."""
    details, found = log.details, {}
    if "inertia" in details:
        found["inertia"] = details["inertia"]
    if gravity and {MASS, "length"} <= set(details):
        found["gravity"] = details[MASS] * _GRAVITY * details["length"]
    return found


def demand_alike(logs: Sequence[Log], structure: Structure, sought_gains: bool) -> None:
    """That logs have what the simulation of the first of them needs, and state as much as it does.

    Args:
        logs: to be fitted, and to try the models on.
        structure: of the simulation of those that are fitted.
        sought_gains: whether the controller's gains are sought.

    Raises:
        UserError: one has not.
    """
    first = logs[0]
    needed = SETPOINT if structure.closed else "command"
    gravity = structure.gravity
    for log in logs:
        if "position" not in log or needed not in log:
            what = "position" if "position" not in log else needed
            raise UserError(f"{log.title}: has no {what}, and {first.title} has; map it in both")
        if structure.closed and not sought_gains and log.gains[0] is None:
            raise UserError(
                f"{log.title}: its gains are not known, and those of other logs are; give kp and kd"
                " in the map"
            )
        other_ticks = log.difference_ticks != structure.difference_ticks
        # Without a command a log does not show that its controller did as the others'.
        if structure.closed and other_ticks and (log.difference_ticks or "command" in log):
            raise UserError(
                f"{log.title}: its controller differences positions over {log.difference_ticks}"
                f" rows, that of {first.title} over {structure.difference_ticks}; state one"
                " difference_ticks of both, or identify them apart"
            )
        if sought_gains and "inertia" not in stated(first, gravity):
            _demand_no_forces(log)
        other = set(stated(first, gravity)) ^ set(stated(log, gravity))
        if other and LINKS[0] not in first:  # a robot's are its model's
            raise UserError(
                f"{log.title} and {first.title}: only one states the {other.pop()} of its joint in"
                " its details; give that of both"
            )


def _demand_no_forces(log: Log) -> None:
    """That a log has no forces, where gains, and all else, are sought per unit of the inertia.

    Raises:
        UserError: it has.
    """
    told = (FEEDFORWARD in log, FEEDFORWARD), (COMMAND_LIMIT in log.details, COMMAND_LIMIT)
    if given := [name for there, name in told if there]:
        raise UserError(
            f"{log.title}: its {given[0]} is a force, and without kp and kd, the command or the"
            " inertia only accelerations are known; give one of them in the map"
        )
