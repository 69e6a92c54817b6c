"""How much more delay a robot's loop bears before it shakes, and which joints shake then.

Much less than all margins: what is asked first, and often.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jaxact.analysis.robot import limits as _limits
from jaxact.analysis.robot import modes as _modes
from jaxact.analysis.robot import multiloop as _multiloop
from jaxact.analysis.robot.modes import Robot


@dataclass(frozen=True)
class DelayBorne:
    """What a common delay of all commands does to a robot.

    Attributes:
        stable: whether the loop is stable as it is.
        shakes, topples: whether a growing motion swings, and whether one does not, as it is.
        growth_rate: as it is [1/s].
        shaking_rate, toppling_rate: of the fastest motion that swings, and of the one that does
            not, as it is [1/s]; -inf where there is none.
        delay: smallest delay of all commands, on top of what they have, at which it begins to shake
            [s]; inf if there is none, NaN of a loop that shakes as it is.
        frequency: of the motion that then grows; of a loop that shakes, of the fastest growing mode
            that swings [rad/s]; inf if there is none.
        participation: share of each joint in its kinetic energy, shape (joints,); sums to 1.
    """

    stable: bool
    shakes: bool
    topples: bool
    growth_rate: float
    shaking_rate: float
    toppling_rate: float
    delay: float
    frequency: float
    participation: np.ndarray


def delay_borne(robot: Robot) -> DelayBorne:
    """The delay margin of all joints at once, and the motion in which it is lost.

    Args:
        robot: its loop, as for `jaxact.analysis.robot.margins.robot_margins`.
    """
    loop = _multiloop.multiloop(*robot.matrices, robot.period)
    growing, swinging = _modes.growing(loop.roots), _modes.swinging(loop.roots)
    topples = bool(np.any(growing & ~swinging))
    radius = float(np.max(np.abs(loop.roots), initial=0.0))
    growth = math.log(radius) / robot.period if radius > 0.0 else -math.inf
    swings = _modes.fastest(loop.roots, robot.period, swing=True)
    rates = growth, swings, _modes.fastest(loop.roots, robot.period, swing=False)
    shaking = _modes.largest(loop, growing & swinging)
    if shaking is not None:
        mode = _modes.mode(robot, loop, shaking)
        shares = mode.participation
        return DelayBorne(False, True, topples, *rates, math.nan, mode.frequency, shares)
    grid = _multiloop.grid(loop)
    S = _multiloop.sensitivity(loop, grid)
    S[[0, -1]] = S[[0, -1]].real
    delay, angle = limit(robot, grid, _limits.followed(S))
    frequency, shares = math.inf, np.full(len(robot.names), 1.0 / len(robot.names))
    if math.isfinite(delay):
        frequency, shares = angle / robot.period, marginal(robot, angle, delay)
    return DelayBorne(not topples, False, topples, *rates, delay, frequency, shares)


def limit(robot: Robot, grid: np.ndarray, followed: np.ndarray) -> tuple[float, float]:
    """The common delay at which a robot that does not shake begins to [s], and w T [rad]; or inf.

    Args:
        robot: its loop.
        grid, followed: w T [rad] and the eigenvalues of S there, from `multiloop_limits.followed`.
    """
    turned = _limits.crossings(grid, followed, lambda s: s.real - 0.5)
    return _limits.delay_limit(robot.later_by, robot.period, turned, _modes.shaking)


def marginal(robot: Robot, angle: float, delay: float) -> np.ndarray:
    """Shares of the joints in the motion that is marginal at w T under a delay [s]; (joints,)."""
    back = _limits.feedback(robot.later_by, robot.period, angle, delay / robot.period)
    values, vectors = np.linalg.eig(back.commands)
    nearest = values[np.argmin(np.abs(values - 1.0))]
    # Those of joints that are alike, of which any mixture is marginal too.
    moving = vectors[:, np.abs(values - nearest) < _modes.ALIKE]
    return _modes.participation(robot, back.kept, back.states @ moving)
