"""A robot's closed loop over one control period, and its motions: what shakes, and what topples.

A root z of the loop is the motion e^(s t) with s = ln(z)/T. A growing one topples the robot if it
grows faster than it turns, Re s >= |Im s|: the robot has fallen before it has swung once, as an
upright one does whose joints are stiff but that nobody balances. Else it shakes it, and so does a
growing one that turns by more than a quarter in one period, however fast it grows: |Im s| ends at
pi/T, and a motion that goes there and back from tick to tick is no fall.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxact.analysis.robot import multiloop as _multiloop
from jaxact.analysis.robot.multiloop import Matrices, Multiloop
from jaxact.analysis.robot.stability import beyond, drifting, excess, neutral

# A root that turns by less than this in a period does not turn [rad].
_STILL = 1e-9
# Joints whose velocities are less than this share of all states of a motion have no part in it.
_UNMOVED = 1e-12
ALIKE = 1e-9
"""Roots, or sizes beside the largest, that differ by less are equal but for rounding."""


@dataclass(frozen=True)
class Robot:
    """A closed loop; n states, m joints.

    Attributes:
        matrices: M, N, C over one control period, see `jaxact.analysis.robot.multiloop`.
        positions, velocities: of the joints at the ticks, rows of shape (m, n) each.
        inertias: that forces on the joints feel [kg or kg m^2], shape (m,).
        names: of the joints.
        period: control period T [s].
        later_by: extra delay of all commands [s], from -delay to T -> M, N, C.
        delay: smallest command delay of a joint [s].
    """

    matrices: Matrices
    positions: np.ndarray
    velocities: np.ndarray
    inertias: np.ndarray
    names: tuple[str, ...]
    period: float
    later_by: Callable[[float], Matrices]
    delay: float = 0.0


@dataclass(frozen=True)
class Mode:
    """A motion of the closed loop, or its response to the force that it amplifies most.

    Attributes:
        growth_rate: [1/s], negative if it decays; 0 of a response.
        frequency: [rad/s].
        damping_ratio: [-], 1 where it does not oscillate; 0 of a response.
        participation: share of each joint in the kinetic energy of the joints, shape (m,); sums to
            1, or all 0 of a motion in which none of them moves.
    """

    growth_rate: float
    frequency: float
    damping_ratio: float
    participation: np.ndarray


def growing(roots: np.ndarray) -> np.ndarray:
    """Which roots are of growing motions, beyond rounding; what is not a number is.

    Of a base that drifts, several roots are 1, which rounding parts: none of them grows.
    """
    return beyond(roots) & ~neutral(roots)


def swinging(roots: np.ndarray) -> np.ndarray:
    """Which roots turn faster than they grow or decay, or grow there and back."""
    roots = np.asarray(roots, complex)
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.log(roots)
        back = (roots.real < 0.0) & (rates.real > 0.0)
    return back | (np.abs(rates.imag) > np.abs(rates.real))


def shaking(roots: np.ndarray) -> np.ndarray:
    """Which roots shake a robot if they grow: those that swing."""
    return swinging(roots) & ~drifting(roots)


def toppling(roots: np.ndarray) -> np.ndarray:
    """Which roots topple a robot if they grow: those that do not swing."""
    return ~swinging(roots)


def shakes(M: np.ndarray) -> bool:
    """Whether a loop with this matrix has a growing motion that swings."""
    return excess(M, shaking) > 0.0


def fastest(roots: np.ndarray, period: float, *, swing: bool) -> float:
    """Growth rate of the roots that swing, or of those that do not [1/s]; -inf if there is none."""
    sizes = np.abs(roots[(swinging(roots) == swing) & ~neutral(roots)])
    largest = float(sizes.max(initial=0.0))
    return float(np.log(largest)) / period if largest > 0.0 else -np.inf


def largest(loop: Multiloop, which: np.ndarray) -> int | None:
    """Number of the largest root among these, None if there is none."""
    places = np.flatnonzero(which)
    return int(places[np.argmax(np.abs(loop.roots[places]))]) if places.size else None


def least_damped(loop: Multiloop) -> int:
    """Number of the root with the smallest damping ratio."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.log(loop.roots)
        damping = -rates.real / np.abs(rates)
    return int(np.argmin(np.where(np.isfinite(damping), damping, np.inf)))


def mode(robot: Robot, loop: Multiloop, number: int) -> Mode:
    """The motion that belongs to one root."""
    rate = np.log(loop.roots[number]) / robot.period
    equal = alike(loop.roots, number)
    # Of equal roots the smallest vector, or it is the one of the root before.
    least = ALIKE if equal.size > 1 else None
    vectors = [_eigenvector(loop.triangular, place, least) for place in equal]
    return Mode(
        growth_rate=float(rate.real),
        frequency=float(abs(rate.imag)) if abs(rate.imag) > _STILL / robot.period else 0.0,
        damping_ratio=float(-rate.real / (abs(rate) or 1.0)),
        participation=participation(
            robot,
            loop.kept,
            loop.vectors @ np.stack(vectors, -1),
            still=abs(rate) * robot.period < _STILL,
        ),
    )


def _eigenvector(U: np.ndarray, number: int, least: float | None) -> np.ndarray:
    """Of a triangular matrix: the rows below its root are zero.

    Args:
        least: singular values below this share of the largest are zero, None: below rounding.
    """
    vector = np.zeros(len(U), complex)
    vector[number] = 1.0
    shifted = U[:number, :number] - U[number, number] * np.eye(number)
    vector[:number] = np.linalg.lstsq(shifted, -U[:number, number], rcond=least)[0]
    return vector


def alike(roots: np.ndarray, number: int) -> np.ndarray:
    """Numbers of the roots that only rounding tells from this one, as those of legs on a stand.

    Of their motions any mixture is one too, and which are found is chance. Of a motion that does
    not swing it is the root alone: a base that drifts has many at 1.
    """
    if not swinging(roots[number]):
        return np.array([number])
    return np.flatnonzero(np.abs(roots - roots[number]) < ALIKE)


def response(robot: Robot, loop: Multiloop, frequency: float) -> Mode:
    """What the joints do under the forces that S amplifies most, at one frequency [rad/s]."""
    angle = frequency * robot.period
    _, sizes, rows = np.linalg.svd(_multiloop.sensitivity(loop, np.array([angle]))[0])
    forces = rows[sizes > (1.0 - ALIKE) * sizes[0]].conj()  # of legs that are alike all
    moved = np.stack([_multiloop.states(loop, angle, one) for one in forces], axis=-1)
    return Mode(0.0, frequency, 0.0, participation(robot, loop.kept, moved))


def ranked(shares: np.ndarray) -> list[int]:
    """Numbers of the joints by their shares in a motion, the largest first.

    Legs that are alike have shares that are alike but for rounding: as the model has them.
    """
    return np.argsort(-np.round(shares, 6), kind="stable").tolist()


def participation(
    robot: Robot, kept: np.ndarray, states: np.ndarray, *, still: bool = False
) -> np.ndarray:
    """Share of each joint in I |v|^2; 0 of a motion in which no joint moves but for rounding, as
    that of something beside a robot, and equal shares where that cannot be told.

    Of several motions it is the mean over those that are orthogonal in I v: of any mixture of
    theirs the same.

    Args:
        kept: places of the states among those of M, shape (k,).
        states: of the motion, complex, shape (k,), or of several, shape (k, n).
        still: its root is 1, where velocities are nothing but rounding: shares in I |q|^2, to which
            those in I |v|^2 tend there.
    """
    # A joint that no force moves feels an infinite inertia.
    inertias = np.where(np.isfinite(robot.inertias), robot.inertias, 0.0)
    rows = robot.positions if still else robot.velocities
    joints = (rows[:, kept] @ states).reshape(len(inertias), -1)
    if np.linalg.norm(joints) <= _UNMOVED * np.linalg.norm(states):
        return np.zeros(len(inertias))
    moved = np.sqrt(inertias)[:, None] * joints
    if not moved.any() or not np.isfinite(moved).all():
        return np.full(len(inertias), 1.0 / len(inertias))
    motions, sizes, _ = np.linalg.svd(moved, full_matrices=False)
    motions = motions[:, sizes > ALIKE * sizes[0]]
    return np.mean(np.abs(motions) ** 2, axis=1)
