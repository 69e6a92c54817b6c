"""The joints of a robot that end with their force at a limit, away from where they should be."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxact.simulation.single import Single

# Over this last part of a run the force is less than the command, by this share of it at least, and
# changes by less: behind a command that grows a drive lags, without a limit.
_LAST, _LESS = 0.25, 0.01
_MOST_NAMED = 3


def joints(run: Single) -> list[int]:
    """The places of the joints whose limits hold from the last quarter of a run to its end.

    Args:
        run: of one loop.

    Returns:
        None of a single joint, whose verdict has its limits in it.
    """
    if run.trajectory.configuration is None:
        return []
    asked, given = (np.abs(_last(one)) for one in (run.trajectory.command, run.trajectory.force))
    less = np.all(asked - given > _LESS * asked, axis=0)
    return np.flatnonzero(less & (np.ptp(given, axis=0) < _LESS * given.max(axis=0))).tolist()


def lines(run: Single) -> list[str]:
    """Where such joints are then, in words; nothing where there are none."""
    from jaxact.plotting.wording import quantity

    found = joints(run)
    if not found:
        return []
    away = np.abs(_last(run.trajectory.position) - _last(run.trajectory.setpoint)).max(axis=0)
    force = np.abs(_last(run.trajectory.force)).max(axis=0)
    parts = []
    for place in found[:_MOST_NAMED]:
        length, unit = ("rad", "N m") if run.joints[place].rotary else ("m", "N")
        far = quantity(float(f"{away[place]:.3g}"), length)
        most = quantity(float(f"{force[place]:.3g}"), unit)
        parts.append(f"{run.joints[place].name} is up to {far} from its setpoint with {most}")
    more = f" (and {len(found) - len(parts)} more)" if len(found) > len(parts) else ""
    return [f"In the last quarter {', '.join(parts)}, the most that it can exert{more}."]


def _last(signal: np.ndarray) -> np.ndarray:
    """The last quarter of a signal, shape (steps, joints)."""
    rows = np.asarray(signal)
    return rows[len(rows) - max(1, int(_LAST * len(rows))) :]
