"""How much more delay a robot's loop bears before it shakes, and which joints shake then.

Much less than all margins: what is asked first, and often.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jaxact import multiloop as _multiloop
from jaxact import multiloop_limits as _limits
from jaxact.robot_margins import Robot, participation


@dataclass(frozen=True)
class DelayBorne:
    """What a common delay of all commands does to a robot.

    Attributes:
        stable: whether the loop is stable as it is.
        growth_rate: as it is [1/s].
        delay: smallest delay of all commands, on top of what they have, that destabilises [s]; inf
            if there is none, NaN of a loop that is unstable as it is.
        frequency: of the motion that then grows; of an unstable loop, of its fastest growing mode
            [rad/s]; inf if there is none.
        participation: share of each joint in its kinetic energy, shape (joints,); sums to 1.
    """

    stable: bool
    growth_rate: float
    delay: float
    frequency: float
    participation: np.ndarray


def delay_borne(robot: Robot) -> DelayBorne:
    """The delay margin of all joints at once, and the motion in which it is lost.

    Args:
        robot: its loop, as for `jaxact.robot_margins.robot_margins`.
    """
    loop = _multiloop.multiloop(*robot.matrices, robot.period)
    root = complex(loop.roots[np.argmax(np.abs(loop.roots))]) if loop.roots.size else 0j
    growth = math.log(abs(root)) / robot.period if root else -math.inf
    if abs(root) > 1.0 + _limits.MARGINAL:
        angle = float(abs(np.angle(root)))
        return DelayBorne(
            False, growth, math.nan, angle / robot.period, _moving(robot, loop, angle, 0.0)
        )
    grid = _multiloop.grid(loop)
    S = _multiloop.sensitivity(loop, grid)
    S[[0, -1]] = S[[0, -1]].real
    turned = _limits.crossings(grid, _limits.followed(S), lambda s: s.real - 0.5)
    delay, angle = _limits.delay_limit(robot.later_by, robot.period, turned)
    if not math.isfinite(delay):
        even = np.full(len(robot.names), 1.0 / len(robot.names))
        return DelayBorne(True, growth, math.inf, math.inf, even)
    moving = _moving(robot, loop, angle, delay)
    return DelayBorne(True, growth, delay, angle / robot.period, moving)


def _moving(robot: Robot, loop: _multiloop.Multiloop, angle: float, delay: float) -> np.ndarray:
    """Shares of the joints in the motion that is marginal at w T under a delay.

    Its commands are the eigenvector of L = S^-1 - I whose eigenvalue the delay turns nearest to -1.
    """
    values, vectors = np.linalg.eig(_multiloop.sensitivity(loop, np.array([angle]))[0])
    turned = (1.0 - values) / values * np.exp(-1j * angle * delay / robot.period)
    nearest = vectors[:, np.argmin(np.abs(turned + 1.0))]
    return participation(robot, loop, _multiloop.states(loop, angle, nearest))
