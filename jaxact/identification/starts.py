"""Where the search for a joint's numbers begins: least squares on its smoothed motion.

J q'' + c q' + F sign(q') + G sin q + offset = f(t - late)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import signal as _signal

from jaxact.identification import inspection
from jaxact.identification.log import LINKS, Log
from jaxact.parameters import FEEDFORWARD, KD, KP, SETPOINT

if TYPE_CHECKING:
    from jaxact.identification.motion import Context

# Rows by which a drive may be late where the search begins.
_LATE = (0, 1, 2, 4, 6, 8, 12)


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


def _needed(log: Log, context: Context, late: int) -> np.ndarray:
    """The force that arrives at the joint `late` rows after it was asked for, shape (rows,)."""
    told = asked(log, context)
    force = np.append(np.full(late, told[0]), told[: len(told) - late])
    if context.robot:
        force = force - log[LINKS[0]] * _smooth(log, log["position"], 2) - log[LINKS[1]]
    return force


def guess(logs: Sequence[Log], context: Context) -> dict[str, Any]:
    """Where the search begins: least squares on smoothed derivatives, row by row.

    The drive is late by a few rows: by how many is tried.
    """
    gravity = context.structure.gravity
    rows = np.concatenate([_motions(log, gravity) for log in logs])
    names = ["inertia", "viscous", "coulomb", "offset", "gravity"][: rows.shape[1]]
    tried = []
    for late in _LATE:
        force = np.concatenate([_smooth(log, _needed(log, context, late)) for log in logs])
        found, rest = _least_squares(rows, force, names)
        tried.append((rest / max(float(np.var(force)), 1e-300), found))
    found = min(tried, key=lambda one: (one[1]["inertia"] <= 0.0, one[0]))[1]
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
    return {
        "inertia": inertia, "viscous": scaled["viscous"], "coulomb": scaled["coulomb"],
        "offset": float(np.clip(scaled["offset"], -0.5 * gain * size, 0.5 * gain * size)),
        "gravity": scaled.get("gravity", 0.0), "gain": gain, "size": gain * size,
        "speed": fastest, KP: (30.0, 300.0, 3000.0), KD: 20.0,
    }  # fmt: skip


def asked(log: Log, context: Context) -> np.ndarray:
    """The force that a log's command, or its controller, asks for at each row."""
    if not context.structure.closed:
        return log["command"]
    kp, kd = (0.0 if gain is None else gain for gain in log.gains)
    if context.sought_gains:
        kp, kd = 300.0, 20.0
    force = kp * (log[SETPOINT] - log["position"]) - kd * inspection.velocity(log)
    if FEEDFORWARD in log:
        force = force + log[FEEDFORWARD]
    limit = log.details.get("command_limit", math.inf)
    return np.clip(force, -limit, limit)


def _least_squares(
    matrix: np.ndarray, target: np.ndarray, names: Sequence[str]
) -> tuple[dict[str, float], float]:
    """The solution by name, and the mean square that is left."""
    size = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    solved = np.linalg.lstsq(matrix / size, target, rcond=1e-9)[0] / size
    rest = float(np.mean(np.square(target - matrix @ solved)))
    return dict(zip(names, solved.tolist(), strict=True)), rest
