"""All margins of a robot's linearised, sampled loop: of each joint alone, and of all at once.

A joint alone: the loop L_i = 1/S_ii - 1 that is broken at the command of joint i while all others
stay closed, judged as `jaxact.analysis.sampled.margins` judges a single loop. All at once: the
largest singular values of S and T, the multi-loop disk margin, the common factor on all gains and
the common delay. Everything is exact for the sampled loop, at w in [0, pi/T].

Sources: Skogestad, Postlethwaite, "Multivariable Feedback Control", 2nd ed., sections 4.9 and 8.5;
Seiler, Packard, Gahinet, "An introduction to disk margins" (2020).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxact.analysis.robot import disk as _disk
from jaxact.analysis.robot import limits as _limits
from jaxact.analysis.robot import modes as _modes
from jaxact.analysis.robot import multiloop as _multiloop
from jaxact.analysis.robot.changes import Changes, Limits, changes
from jaxact.analysis.robot.modes import Mode, Robot
from jaxact.analysis.robot.multiloop import Multiloop
from jaxact.analysis.robot.stability import MARGINAL
from jaxact.errors import UserError

_TURN = 2.0 * math.pi
# A factor on gains below this is S = 0, but for the rounding of S: none at all.
_NO_GAIN = 1e-12


@dataclass(frozen=True)
class JointMargins:
    """Margins of the loop of one joint while all others are closed; none of an unstable robot.

    Attributes:
        name: of the joint.
        gain_margin: smallest factor above 1 on its gains that destabilises [-], inf if none.
        gain_reduction_margin: largest factor below 1 that does [-], 0 if none.
        phase_crossover: frequency of `gain_margin` [rad/s], inf if there is none.
        phase_margin: smallest in magnitude over all gain crossovers [rad], inf if there is none.
        gain_crossover: its frequency [rad/s], inf if there is none.
        delay_margin: smallest added delay of its command that destabilises [s], min (phase mod 2
            pi) / w: exact for whole control periods, and of a robot with one joint for any. A part
            of a period also changes |L_i|, by less than 1 % below a sixth of the Nyquist frequency.
        sensitivity_peak, complementary_peak: max |S_ii|, max |1 - S_ii| [-], and their frequencies
            [rad/s].
        modulus_margin: 1 / Ms [-].
        disk_margin: balanced, 1 / max |S_ii - 1/2| [-].
    """

    name: str
    gain_margin: float
    gain_reduction_margin: float
    phase_crossover: float
    phase_margin: float
    gain_crossover: float
    delay_margin: float
    sensitivity_peak: float
    sensitivity_peak_frequency: float
    complementary_peak: float
    complementary_peak_frequency: float
    modulus_margin: float
    disk_margin: float


@dataclass(frozen=True)
class WholeMargins:
    """Margins of all loops at once; none of an unstable robot.

    Attributes:
        gain_margin, gain_reduction_margin: common factor on all gains, as of a joint [-].
        gain_margin_frequency, gain_reduction_frequency: where it is lost [rad/s], inf if it is not.
        delay_margin: common delay added to all commands [s], exact for any delay, inf if none.
        delay_margin_frequency: where it is lost [rad/s].
        sensitivity_peak, complementary_peak: largest singular value of S, of T [-]; frequencies
            [rad/s].
        modulus_margin: 1 / Ms [-].
        disk_margin: of independent changes of all loops at once [-]; at least this much is sure.
        disk_margin_frequency: [rad/s].
        unscaled_disk_margin: 1 / max sigma_max(S - I/2) [-], of changes that may mix the joints.
    """

    gain_margin: float
    gain_margin_frequency: float
    gain_reduction_margin: float
    gain_reduction_frequency: float
    delay_margin: float
    delay_margin_frequency: float
    sensitivity_peak: float
    sensitivity_peak_frequency: float
    complementary_peak: float
    complementary_peak_frequency: float
    modulus_margin: float
    disk_margin: float
    disk_margin_frequency: float
    unscaled_disk_margin: float


@dataclass(frozen=True)
class RobotMargins:
    """How stable a robot is, and how much of it is left.

    Attributes:
        stable: no root outside the unit circle.
        unstable_roots: number of roots outside.
        spectral_radius: largest |root| over a control period [-].
        growth_rate: its logarithm over T [1/s].
        gain_to_boundary: common factor on all gains at the nearest change of stability [-], None if
            there is none.
        log_gain_to_boundary: the magnitude of its logarithm, > 0 if stable (inf if there is none),
            < 0 if unstable (-inf).
        period: control period T [s].
        shaking_rate, toppling_rate: growth rate of the fastest motion that swings, and of the
            fastest one that does not [1/s]; -inf if there is none, see
            `jaxact.analysis.robot.modes`.
        changes: where it begins, or ceases, to shake or to topple.
        whole: margins of all loops at once, None if unstable.
        joints: margins of each joint, in the robot's order; empty if unstable.
        critical: the fastest growing mode that swings of a robot that shakes, else the fastest
            growing one of an unstable robot, the least damped one of a stable robot.
        slowest: the mode that decays last.
        at_peak: the response at the peak of the largest singular value of S, None if unstable.
    """

    stable: bool
    unstable_roots: int
    spectral_radius: float
    growth_rate: float
    gain_to_boundary: float | None
    log_gain_to_boundary: float
    period: float
    shaking_rate: float
    toppling_rate: float
    changes: Changes
    whole: WholeMargins | None
    joints: tuple[JointMargins, ...]
    critical: Mode
    slowest: Mode
    at_peak: Mode | None

    @property
    def verdict(self) -> str:
        """`stable`, `shakes`, `topples`, or `shakes and topples`."""
        return " and ".join(self._faults) or "stable"

    @property
    def _faults(self) -> list[str]:
        words = {"shakes": self.shaking_rate, "topples": self.toppling_rate}
        growing = math.log1p(MARGINAL)  # a period's share of it does not count as growth
        return [word for word, rate in words.items() if rate * self.period > growing]

    @property
    def first_to_shake(self) -> np.ndarray | None:
        """Shares of the joints in what shakes first, shape (m,); None if nothing does.

        Of a robot that shakes, in how it shakes; else in how it would with more delay, or if no
        delay makes it shake, with more gain.
        """
        if "shakes" in self._faults:
            return self.critical.participation
        change = self.changes.more_delay or self.changes.more_gain
        return None if change is None else change.participation

    @property
    def ranking(self) -> list[int]:
        """Numbers of the joints, the one that shakes first at the top; by their shares in that."""
        shares = self.first_to_shake
        if shares is None:
            return sorted(range(len(self.joints)), key=lambda i: self.joints[i].disk_margin)
        return _modes.ranked(shares)


def robot_margins(robot: Robot) -> RobotMargins:
    """All margins of a robot's loop.

    Raises:
        UserError: commands do not move some joints at all, so that no gain matters.
    """
    loop = _multiloop.multiloop(*robot.matrices, robot.period)
    demand_answers(robot.names, _multiloop.sensitivity(loop, np.array([1.0]))[0])
    radius = float(np.max(np.abs(loop.roots), initial=0.0))
    unstable = int(np.sum(_modes.growing(loop.roots)))
    angle = _multiloop.grid(loop)
    S = _multiloop.sensitivity(loop, angle)
    # At the ends of the axis it is real but for rounding.
    S[[0, -1]] = S[[0, -1]].real
    followed = _limits.followed(S)
    gains = _gain_limits(robot, loop, angle, followed)
    factors = [factor for factor, _ in gains if 0.0 < factor < math.inf]
    nearest = min(factors, key=lambda factor: abs(math.log(factor)), default=None)
    distance = math.inf if nearest is None else abs(math.log(nearest))
    whole, at_peak, delay = None, None, None
    joints: tuple[JointMargins, ...] = ()
    if not unstable:
        joints = _of_joints(robot, loop, angle, S)
        turned = _limits.crossings(angle, followed, lambda s: s.real - 0.5)
        delay = _limits.delay_limit(robot.later_by, robot.period, turned)
        if len(joints) == 1:  # its delay is the common one
            joints = (replace(joints[0], delay_margin=delay[0]),)
        whole = _of_all(robot, loop, angle, S, gains, delay)
        at_peak = _modes.response(robot, loop, whole.sensitivity_peak_frequency)
    growth = math.log(radius) / robot.period if radius > 0.0 else -math.inf
    slowest = _modes.mode(robot, loop, int(np.argmax(np.abs(loop.roots))))
    return RobotMargins(
        stable=not unstable,
        unstable_roots=unstable,
        spectral_radius=radius,
        growth_rate=growth,
        gain_to_boundary=nearest,
        log_gain_to_boundary=-distance if unstable else distance,
        shaking_rate=_modes.fastest(loop.roots, robot.period, swing=True),
        toppling_rate=_modes.fastest(loop.roots, robot.period, swing=False),
        period=robot.period,
        changes=changes(robot, loop, angle, followed, Limits(gains, delay)),
        whole=whole,
        joints=joints,
        critical=_critical(robot, loop, slowest),
        slowest=slowest,
        at_peak=at_peak,
    )


def _critical(robot: Robot, loop: Multiloop, slowest: Mode) -> Mode:
    growing = _modes.growing(loop.roots)
    shaking = _modes.largest(loop, growing & _modes.swinging(loop.roots))
    if shaking is not None:
        return _modes.mode(robot, loop, shaking)
    return slowest if growing.any() else _modes.mode(robot, loop, _modes.least_damped(loop))


def _gain_limits(robot: Robot, loop: Multiloop, angle: np.ndarray, followed: np.ndarray):
    """(factor, w T) of the limits above and below the present gains."""
    candidates = _limits.gain_factors(angle, followed)
    up, down = (_limits.gain_limit(loop, robot.matrices, candidates, up=up) for up in (True, False))
    return up, down


def _of_all(
    robot: Robot,
    loop: Multiloop,
    angle: np.ndarray,
    S: np.ndarray,
    gains: tuple[tuple[float, float], tuple[float, float]],
    later: tuple[float, float],
) -> WholeMargins:
    period, unit = robot.period, np.eye(S.shape[-1])
    # S, T = I - S, and the disk margin's (S - T)/2 = S - I/2
    shifted = (0.0 * unit, unit, 0.5 * unit)

    def largest(t: np.ndarray, number: np.ndarray) -> np.ndarray:
        moved = _multiloop.sensitivity(loop, t) - np.stack(shifted)[number]
        return np.linalg.svd(moved, compute_uv=False)[:, 0]

    columns = [np.linalg.svd(S - part, compute_uv=False)[:, 0] for part in shifted]
    peak, where = _multiloop.peaks(angle, np.stack(columns, axis=1), largest)
    disk, disk_at = _disk.largest_bound(loop, angle, S)
    (up, up_at), (down, down_at), (delay, delay_at) = *gains, later
    return WholeMargins(
        gain_margin=up,
        gain_margin_frequency=up_at / period,
        gain_reduction_margin=down,
        gain_reduction_frequency=down_at / period,
        delay_margin=delay,
        delay_margin_frequency=delay_at / period,
        sensitivity_peak=float(peak[0]),
        sensitivity_peak_frequency=float(where[0]) / period,
        complementary_peak=float(peak[1]),
        complementary_peak_frequency=float(where[1]) / period,
        modulus_margin=1.0 / float(peak[0]),
        disk_margin=1.0 / disk,
        disk_margin_frequency=disk_at / period,
        unscaled_disk_margin=1.0 / float(peak[2]),
    )


def _of_joints(
    robot: Robot, loop: Multiloop, angle: np.ndarray, S: np.ndarray
) -> tuple[JointMargins, ...]:
    count = len(robot.names)
    own = S[:, range(count), range(count)]

    def size(t: np.ndarray, number: np.ndarray) -> np.ndarray:
        kind, joint = np.divmod(number, count)
        return np.abs(_multiloop.own_sensitivity(loop, t, joint) - _SHIFTS[kind])

    columns = [np.abs(own - shift) for shift in _SHIFTS]
    peak, where = _multiloop.peaks(angle, np.concatenate(columns, axis=1), size)
    phase = _real_crossings(loop, angle, own)
    gain = _unit_crossings(loop, angle, own)
    return tuple(
        _of_joint(
            name,
            robot.period,
            phase[joint],
            gain[joint],
            peak.reshape(3, count)[:, joint],
            where.reshape(3, count)[:, joint] / robot.period,
        )
        for joint, name in enumerate(robot.names)
    )


# What is taken from S_ii for S, -T, and the disk margin's (S - T)/2.
_SHIFTS = np.array([0.0, 1.0, 0.5])
Crossed = tuple[np.ndarray, np.ndarray]


def _real_crossings(loop: Multiloop, angle: np.ndarray, own: np.ndarray) -> list[Crossed]:
    """Where S_ii of each joint is real: w T and S_ii; the ends of the axis included."""

    def imaginary(t: np.ndarray, joint: np.ndarray) -> np.ndarray:
        return _multiloop.own_sensitivity(loop, t, joint).imag

    at, which = _multiloop.zeros(angle, own.imag, imaginary)
    value = _multiloop.own_sensitivity(loop, at, which).real
    ends = [0, -1]
    return [
        (
            np.concatenate([at[which == joint], angle[ends]]),
            np.concatenate([value[which == joint], own[ends, joint].real]),
        )
        for joint in range(own.shape[1])
    ]


def _unit_crossings(loop: Multiloop, angle: np.ndarray, own: np.ndarray) -> list[Crossed]:
    """Where |L_i| = 1, Re S_ii = 1/2: w T and the phase from -1 [rad], in (-pi, pi]."""

    def real(t: np.ndarray, joint: np.ndarray) -> np.ndarray:
        return _multiloop.own_sensitivity(loop, t, joint).real - 0.5

    at, which = _multiloop.zeros(angle, own.real - 0.5, real)
    value = _multiloop.own_sensitivity(loop, at, which)
    turned = np.angle((value - 1.0) / value)
    return [(at[which == joint], turned[which == joint]) for joint in range(own.shape[1])]


def _of_joint(
    name: str, period: float, phase: Crossed, gain: Crossed, peak: np.ndarray, where: np.ndarray
) -> JointMargins:
    """Margins of one joint from its crossings and peaks."""
    at, value = phase
    with np.errstate(divide="ignore"):
        # -1/L = S / (S - 1) where that is positive
        factor = np.where((value < 0.0) | (value > 1.0), value / (value - 1.0), np.nan)
    up = np.where(factor > 1.0, factor, np.inf)
    down = np.where((factor > _NO_GAIN) & (factor < 1.0), factor, 0.0)
    crossover = at[np.argmin(up)] / period if np.isfinite(up).any() else math.inf
    turned_at, turned = gain
    nearest = int(np.argmin(np.abs(turned))) if turned.size else None
    delays = np.mod(turned, _TURN) / turned_at * period
    return JointMargins(
        name=name,
        gain_margin=float(np.min(up, initial=np.inf)),
        gain_reduction_margin=float(np.max(down, initial=0.0)),
        phase_crossover=float(crossover),
        phase_margin=math.inf if nearest is None else float(turned[nearest]),
        gain_crossover=math.inf if nearest is None else float(turned_at[nearest]) / period,
        delay_margin=float(np.min(delays, initial=np.inf)),
        sensitivity_peak=float(peak[0]),
        sensitivity_peak_frequency=float(where[0]),
        complementary_peak=float(peak[1]),
        complementary_peak_frequency=float(where[1]),
        modulus_margin=1.0 / float(peak[0]),
        disk_margin=1.0 / float(peak[2]),
    )


def still(S: np.ndarray) -> np.ndarray:
    """Numbers of the joints whose commands change nothing: S is I in their columns.

    Args:
        S: at one frequency, shape (m, m).
    """
    return np.flatnonzero((S == np.eye(len(S))).all(axis=0))


def demand_answers(names: Sequence[str], S: np.ndarray) -> None:
    """Refuse joints whose commands change nothing.

    Args:
        names: of all joints.
        S: at one frequency, shape (m, m).

    Raises:
        UserError: there are such.
    """
    unmoved = [names[i] for i in still(S)]
    if unmoved:
        more = f" and {len(unmoved) - 1} more" if len(unmoved) > 1 else ""
        raise UserError(
            f"{unmoved[0]}{more}: the joint's command moves nothing at this posture; its gains are "
            "zero, or contacts or limits hold it"
        )
