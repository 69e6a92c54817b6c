"""Where the search for a joint's numbers begins: least squares on its smoothed motion.

J q'' + c q' + F sign(q') + G sin q + offset = f(t - late)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import signal as _signal
from scipy.optimize import lsq_linear

from jaxact.identification import inspection
from jaxact.identification.joint_motion import COMMAND_LIMIT
from jaxact.identification.log import LINKS, Log
from jaxact.identification.model import LONG_DELAYS
from jaxact.parameters import FEEDFORWARD, KD, KP, SETPOINT

if TYPE_CHECKING:
    from jaxact.identification.motion import Context

# Shares of the largest command at which a drive may follow no further, where logs do not say so;
# one by which the forces are explained so much better is begun from.
_LIMITS, _MUCH_BETTER = tuple(0.75**power for power in range(1, 14)), 0.6
# Where the motion leaves less than this share of the forces it tells their sign; where it leaves
# more than the other it contradicts them.
_TOLD, _CONTRADICTS = 0.5, 0.2
# What the motion's columns stand for.
_NAMES = ("inertia", "viscous", "coulomb", "offset", "gravity")
_OF_EITHER_SIGN = ("offset", "gravity")
# Rows by which a drive may be late where the search begins. While the last of them explains the
# motion best, one that is later by this factor is tried too.
_LATE, _LATER = (0, 1, 2, 4, 6, 8, 12), 1.25


def speed(log: Log) -> np.ndarray:
    """The velocity of a log's position, smoothed over some rows, shape (rows,)."""
    return _smooth(log, log["position"], 1)


def _smooth(log: Log, values: np.ndarray, order: int = 0) -> np.ndarray:
    window = min(max(2 * int(0.01 / log.period) + 5, 7), len(log) // 4 * 2 - 1)
    return _signal.savgol_filter(values, window, 3, deriv=order, delta=log.period)


def _motions(log: Log, gravity: bool) -> np.ndarray:
    """What forces follow, shape (rows, forces): acceleration, speed, its sign, 1 and sin q."""
    position = log["position"]
    moving = speed(log)
    columns = [_smooth(log, position, 2), moving, np.sign(moving), np.ones(len(log))]
    return np.stack([*columns, *([np.sin(position)] if gravity else [])], axis=1)


def _needed(log: Log, context: Context, late: int, limit: float = math.inf) -> np.ndarray:
    """The force that arrives at the joint `late` rows after it was asked for, shape (rows,)."""
    told = np.clip(asked(log, context), -limit, limit)
    force = np.append(np.full(late, told[0]), told[: len(told) - late])
    if context.robot:
        force = force - log[LINKS[0]] * _smooth(log, log["position"], 2) - log[LINKS[1]]
    return force


def _explained(
    rows: np.ndarray, logs: Sequence[Log], context: Context, limit: float = math.inf
) -> tuple[tuple[bool, float], dict[str, float]]:
    """How badly the motion follows from what was asked for within a limit, and the numbers.

    The drive is late by some rows: by how many is tried. A motion against the force is the worst.

    Args:
        rows: of all logs, from `_motions`.
        logs, context: as in `guess`.
        limit: of what was asked for [N or N m].
    """

    def late_by(late: int) -> tuple[tuple[bool, float], dict[str, float]]:
        force = np.concatenate([_smooth(log, _needed(log, context, late, limit)) for log in logs])
        found, rest = _least_squares(rows, force, _NAMES)
        left = rest / max(float(np.var(force)), 1e-300)
        return (found["inertia"] <= 0.0, left), found

    tried = [late_by(late) for late in _LATE]
    best = min(tried, key=lambda one: one[0])
    late = _LATE[-1]
    longest = _longest(logs)
    while best is tried[-1] and (late := math.ceil(_LATER * late)) <= longest:
        tried.append(late_by(late))
        best = min(best, tried[-1], key=lambda one: one[0])
    return best


def guess(
    logs: Sequence[Log], context: Context, *, perhaps_limited: bool = False
) -> dict[str, Any]:
    """Where the search begins: least squares on smoothed derivatives, row by row.

    Args:
        logs: of one joint.
        context: what is known of it.
        perhaps_limited: the drive may follow commands up to a limit that no log says.
    """
    gravity = context.structure.gravity
    rows = np.concatenate([_motions(log, gravity) for log in logs])
    (against, left), found = _explained(rows, logs, context)
    largest = max(*(float(np.max(np.abs(asked(log, context)))) for log in logs), 1e-9)
    limit, limited = largest, False
    if perhaps_limited:
        limits = [share * largest for share in _LIMITS]
        tried = [_explained(rows, logs, context, each) for each in limits]
        at = min(range(len(limits)), key=lambda number: tried[number][0])
        limit, limited = limits[at], tried[at][0] < (against, _MUCH_BETTER * left)
        found = tried[at][1] if limited else found
    known = context.known()
    size = max(*(float(np.max(np.abs(_needed(log, context, 0)))) for log in logs), 1e-9)
    fastest = max(float(np.max(np.abs(rows[:, 1]))), 1e-9)
    gain = 1.0
    if gravity and "gravity" in known and found["gravity"] != 0.0:
        gain = abs(known["gravity"] / found["gravity"])
    elif "inertia" in known and found["inertia"] > 0.0:
        gain = known["inertia"] / found["inertia"]
    scaled = {name: gain * value for name, value in found.items()}
    inertia = scaled["inertia"]
    if inertia <= 0.0:
        inertia = gain * size / max(float(np.max(np.abs(rows[:, 0]))), 1e-9)
    if context.robot:
        # Where the motion hardly tells: a rotor, seen through its gear, is like the links.
        least = 0.05 * float(np.mean([np.mean(log[LINKS[0]]) for log in logs]))
        inertia = max(inertia, least)
    heavy = known.get("inertia", 1.0)
    return {
        "inertia": inertia, "viscous": scaled["viscous"], "coulomb": scaled["coulomb"],
        "offset": float(np.clip(scaled["offset"], -0.5 * gain * size, 0.5 * gain * size)),
        "gravity": scaled.get("gravity", 0.0), "gain": gain, "size": gain * size,
        "speed": fastest, "asked": largest, COMMAND_LIMIT: limit,
        "limited": limited, KP: tuple(heavy * kp for kp in (30.0, 300.0, 3000.0)),
        KD: heavy * 20.0,
    }  # fmt: skip


def asked(log: Log, context: Context) -> np.ndarray:
    """The force that a log's command, or its controller, asks for at each row."""
    if not context.structure.closed:
        return log["command"]
    kp, kd = (0.0 if gain is None else gain for gain in log.gains)
    if context.sought_gains:
        heavy = context.known().get("inertia", 1.0)
        kp, kd = heavy * 300.0, heavy * 20.0
    force = kp * (log[SETPOINT] - log["position"]) - kd * inspection.velocity(log)
    if FEEDFORWARD in log:
        force = force + log[FEEDFORWARD]
    limit = command_limit(log)
    return np.clip(force, -limit, limit)


def command_limit(log: Log) -> float:
    """The limit of commands that a log states, or at which they stay; infinite for none."""
    return log.details.get(COMMAND_LIMIT) or inspection.limit_of_command(log) or math.inf


def against_the_command(log: Log) -> bool:
    """Whether a joint moves against its log's command, and no joint could move so with it.

    Both signs are tried, with inertia and friction as they can be and every delay that is looked
    for: what a sine alone does, gravity or a delay of half a turn do as well as another sign.
    """
    rows = _motions(log, gravity=True)
    square, triangle = np.linalg.qr(rows / np.maximum(np.linalg.norm(rows, axis=0), 1e-300))
    least = [-math.inf if name in _OF_EITHER_SIGN else 0.0 for name in _NAMES]

    def left(late: int) -> list[float]:
        command = np.append(np.full(late, log["command"][0]), log["command"][: len(log) - late])
        force = _smooth(log, command)
        own = square.T @ force
        apart = float(force @ force - own @ own)
        bounds, size = (least, np.inf), max(len(log) * float(np.var(force)), 1e-300)
        fits = [lsq_linear(triangle, sign * own, bounds, method="bvls") for sign in (1.0, -1.0)]
        return [(apart + 2.0 * fit.cost) / size for fit in fits]

    tried, longest = list(_LATE), _longest([log])
    while (later := math.ceil(_LATER * tried[-1])) <= longest:
        tried.append(later)
    along, against = np.min([left(late) for late in tried], axis=0)
    return bool(along > _CONTRADICTS and against < min(_TOLD, _MUCH_BETTER * along))


def _longest(logs: Sequence[Log]) -> float:
    """The most rows by which a drive may be late."""
    return min(LONG_DELAYS[-1] / min(log.period for log in logs), 0.5 * min(map(len, logs)))


def _least_squares(
    matrix: np.ndarray, target: np.ndarray, names: Sequence[str]
) -> tuple[dict[str, float], float]:
    """The solution by name, and the mean square that is left."""
    size = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    solved = np.linalg.lstsq(matrix / size, target, rcond=1e-9)[0] / size
    rest = float(np.mean(np.square(target - matrix @ solved)))
    return dict(zip(names[: len(solved)], solved.tolist(), strict=True)), rest
