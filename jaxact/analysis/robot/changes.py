"""How far gains and delays are from where a robot begins, or ceases, to shake or to topple.

Of a stable robot as of one that topples or shakes: the common factor on all gains, up and down,
and the common delay at which a motion that swings reaches the unit circle, with its frequency and
the joints that move in it; and the factors at which one that does not swing does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from jaxact.analysis.robot import delay as _delay
from jaxact.analysis.robot import limits as _limits
from jaxact.analysis.robot import modes as _modes
from jaxact.analysis.robot.modes import Robot
from jaxact.analysis.robot.multiloop import Matrices, Multiloop, joined, reduced

# Parts of the present delay that are tried for less of it, and halvings of the one where it ends.
_PARTS, _HALVINGS = 16, 30
# A root that turns by less than this in a period does not turn [rad].
_STILL = 1e-9


@dataclass(frozen=True)
class Change:
    """Where a robot begins or ceases to shake, or to topple.

    Attributes:
        value: common factor on all gains [-], or common delay [s].
        frequency: of the motion there [rad/s], 0 of one that topples.
        participation: share of each joint in its kinetic energy, shape (m,).
    """

    value: float
    frequency: float
    participation: np.ndarray


@dataclass(frozen=True)
class Changes:
    """The nearest changes in every direction, None where there is none.

    Attributes:
        more_gain, less_gain: factor on all gains above and below 1 at which shaking begins, or
            ceases if the robot shakes.
        more_delay: extra delay of all commands at which it begins [s]; None of a robot that shakes.
        less_delay: delay taken from all commands at which shaking ceases [s]; None of one that does
            not.
        topple_more_gain, topple_less_gain: factors at which toppling begins, or ceases.
    """

    more_gain: Change | None
    less_gain: Change | None
    more_delay: Change | None
    less_delay: Change | None
    topple_more_gain: Change | None
    topple_less_gain: Change | None


@dataclass(frozen=True)
class Limits:
    """What is known of a loop's stability before it is asked what is lost.

    Attributes:
        gains: (factor, w T) of the nearest change of stability above and below 1, from
            `multiloop_limits.gain_limit`.
        delay: (delay [s], w T) at which a stable loop loses it, None of an unstable one.
    """

    gains: tuple[tuple[float, float], tuple[float, float]]
    delay: tuple[float, float] | None


def changes(
    robot: Robot, loop: Multiloop, angle: np.ndarray, followed: np.ndarray, known: Limits
) -> Changes:
    """All changes of a robot's loop.

    Args:
        angle, followed: a grid of w T [rad] and the eigenvalues of S there, from
            `multiloop_limits`.
        known: limits of stability.
    """
    candidates = _limits.gain_factors(angle, followed)
    now = _modes.growing(loop.roots)
    shaking = bool(np.any(now & _modes.swinging(loop.roots)))

    def gain(*, up: bool, swing: bool) -> Change | None:
        factor, at = known.gains[0 if up else 1]
        if now.any() or (0.0 < factor < math.inf and (at > 0.0) != swing):
            own = [item for item in candidates if (item.angle > 0.0) == swing]
            counted = _modes.shaking if swing else _modes.toppling
            factor, _ = _limits.gain_limit(loop, robot.matrices, own, up=up, counted=counted)
        if not 0.0 < factor < math.inf:
            return None
        M, N, C = robot.matrices
        return _at(robot, (M + (factor - 1.0) * (N @ C), N, C), factor, swing=swing)

    return Changes(
        more_gain=gain(up=True, swing=True),
        less_gain=gain(up=False, swing=True),
        more_delay=None if shaking else _more_delay(robot, angle, followed, known.delay),
        less_delay=_less_delay(robot) if shaking else None,
        topple_more_gain=gain(up=True, swing=False),
        topple_less_gain=gain(up=False, swing=False),
    )


def _at(robot: Robot, matrices: Matrices, value: float, *, swing: bool) -> Change:
    """The motion nearest to the unit circle of a loop that is marginal."""
    kept = joined(matrices)  # other ones than without the change where it is one of the delay
    roots, vectors = scipy.linalg.eig(matrices[0][np.ix_(kept, kept)])
    fitting = (np.abs(np.angle(roots)) > _STILL) == swing
    number = int(np.argmin(np.where(fitting, np.abs(np.abs(roots) - 1.0), np.inf)))
    frequency = float(abs(np.angle(roots[number]))) / robot.period
    moving = vectors[:, _modes.alike(roots, number)]
    shares = _modes.participation(robot, kept, moving, still=not swing)
    return Change(value, frequency, shares)


def _more_delay(
    robot: Robot, grid: np.ndarray, followed: np.ndarray, known: tuple[float, float] | None
) -> Change | None:
    delay, angle = _delay.limit(robot, grid, followed) if known is None else known
    if not math.isfinite(delay):
        return None
    shares = _delay.marginal(robot, angle, delay)
    return Change(delay, angle / robot.period, shares)


def _less_delay(robot: Robot) -> Change | None:
    """How much less delay of all commands ends the shaking, None if none at all does."""

    def shaking(less: float) -> bool:
        return _modes.shakes(reduced(robot.later_by(-less))[0])

    before = 0.0
    for less in np.linspace(0.0, robot.delay, _PARTS + 1)[1:]:
        if not shaking(float(less)):
            low, high = before, float(less)
            for _ in range(_HALVINGS):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if shaking(middle) else (low, middle)
            return _at(robot, robot.later_by(-high), high, swing=True)
        before = float(less)
    return None
