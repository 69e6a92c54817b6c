"""How far the gains and the delays of all joints may change together.

A factor g on all commands makes the loop marginal where an eigenvalue s of S(e^(jt)) obeys
g = s / (s - 1); a common delay turns the eigenvalues 1/s - 1 of the loop and makes it marginal
where they have modulus 1, Re s = 1/2. Eigenvalues followed over frequency give all candidates;
which of them bound the stable set is decided by the spectral radius of the loop's matrix.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg

from jaxact.analysis.robot.multiloop import Matrices, Multiloop, joined, reduced, sensitivity
from jaxact.analysis.robot.stability import (
    MARGINAL,
    Counted,
    all_roots,
    beyond,
    excess,
    moving,
    switch,
)

# Factors further from 1 than this are none.
FURTHEST = 1e9
# Halvings of the grid's intervals.
_HALVINGS = 40
# How far beside a crossing stability is looked at, of its distance.
BESIDE = 1e-4
# And before one that destabilises: legs that are alike cross nearly together, and the first counts.
EARLIER = 1e-7
# A root that turns by less than this in a period does not turn [rad].
_STILL = 1e-9
# Imaginary parts below this share are rounding.
ROUNDING = 1e-9
# Periods of delay by which a guess may be wrong; steps of Newton's method at most, how close they
# come, and relative differences.
_NEAR, _NEWTON, _CLOSE, _SMALL = 1.0, 20, 1e-11, 1e-7
# Parts of a period that all delays are tried at, how far before a marginal one, and up to how many
# periods: a delay that is not a whole period changes the loop near the Nyquist frequency by more
# than its phase.
_PARTS, _BEFORE, _END = 4, 1.0 - 1e-9, 4.0


@dataclass(frozen=True)
class Crossing:
    """Where one eigenvalue of S is marginal, between two points of a grid or at one.

    Attributes:
        low, high: w T [rad].
        below, above: the eigenvalue there.
        angle, value: in between, by linear interpolation.
    """

    low: float
    high: float
    below: complex
    above: complex
    angle: float
    value: complex


def followed(S: np.ndarray) -> np.ndarray:
    """Eigenvalues of S over frequency, each in a column of its own; shape (k, m).

    Args:
        S: from 0 to the Nyquist frequency, shape (k, m, m).
    """
    values = sorted_along(np.linalg.eigvals(S))
    for end in (0, -1):
        # S is a real matrix there.
        real = np.abs(values[end].imag) < ROUNDING * np.abs(values[end])
        values[end] = np.where(real, values[end].real, values[end])
    return values


def sorted_along(values: np.ndarray) -> np.ndarray:
    """Eigenvalues in rows, each row in the order that is nearest to the row before; shape (k, m).

    Where the nearest of each is another's too, the sum of all distances decides.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import

    apart = np.abs(values[:-1, :, None] - values[1:, None, :])
    nearest = np.argmin(apart, axis=2)
    alone = (np.sort(nearest, axis=1) == np.arange(values.shape[1])).all(axis=1)
    order = np.arange(values.shape[1])
    ordered = values.copy()
    for row, distance in enumerate(apart):
        order = nearest[row][order] if alone[row] else linear_sum_assignment(distance[order])[1]
        ordered[row + 1] = values[row + 1][order]
    return ordered


def crossings(
    angle: np.ndarray, values: np.ndarray, curve: Callable[[np.ndarray], np.ndarray]
) -> list[Crossing]:
    """Where a real function of the eigenvalues of S passes zero between grid points.

    Args:
        angle: grid of w T [rad], shape (k,).
        values: from `followed`, shape (k, m).
        curve: linear in real and imaginary part.
    """
    real = curve(values)
    rows, columns = np.nonzero(real[:-1] * real[1:] < 0.0)
    found = []
    for row, column in zip(rows, columns, strict=True):
        (low, high), (below, above) = angle[row : row + 2], values[row : row + 2, column]
        share = real[row, column] / (real[row, column] - real[row + 1, column])
        middle, value = low + share * (high - low), below + share * (above - below)
        ends = float(low), float(high), complex(below), complex(above)
        found.append(Crossing(*ends, float(middle), complex(value)))
    return found


def gain_factors(angle: np.ndarray, values: np.ndarray) -> list[Crossing]:
    """Crossings with a real factor on all gains, the ends of the frequency axis included."""
    found = crossings(angle, values, lambda s: s.imag)
    for end in (0, -1):
        real = values[end][values[end].imag == 0.0]
        at = float(angle[end])
        found += [Crossing(at, at, complex(s), complex(s), at, complex(s)) for s in real]
    return [item for item in found if 1.0 / FURTHEST < factor(item) < FURTHEST]


def refined(loop: Multiloop, crossing: Crossing) -> Crossing:
    """The same with a real eigenvalue of S, to rounding."""
    low, high = crossing.low, crossing.high
    below, above = crossing.below, crossing.above
    for _ in range(_HALVINGS if low < high else 0):
        middle = 0.5 * (low + high)
        values = np.linalg.eigvals(sensitivity(loop, np.array([middle]))[0])
        value = values[np.argmin(np.abs(values - 0.5 * (below + above)))]
        if value.imag * below.imag > 0.0:
            low, below = middle, value
        else:
            high, above = middle, value
    return Crossing(low, high, below, above, 0.5 * (low + high), 0.5 * (below + above))


def factor(crossing: Crossing) -> float:
    """The factor on all gains of a crossing; negative or infinite where there is none."""
    s = crossing.value.real
    return s / (s - 1.0) if s != 1.0 else math.inf


def gain_limit(
    loop: Multiloop,
    matrices: Matrices,
    candidates: list[Crossing],
    *,
    up: bool,
    counted: Counted = all_roots,
) -> tuple[float, float]:
    """The nearest factor on all gains at which stability changes, above or below 1.

    Args:
        matrices: M, N, C of the loop.
        candidates: from `gain_factors`.
        counted: of the roots those that stability is asked of.

    Returns:
        The factor (inf above, 0 below if there is none) and its frequency w T [rad] (inf).
    """
    M, N, C = reduced(matrices)
    feedback = N @ C
    sign = 1.0 if up else -1.0

    def matrix(distance: float) -> np.ndarray:
        return M + math.expm1(sign * distance) * feedback

    def growth(distance: float) -> float:
        return excess(matrix(distance), counted)

    def fails(distance: float) -> bool:
        return growth(distance) > 0.0

    ahead = sorted(
        (item for item in candidates if (factor(item) > 1.0) == up),
        key=lambda item: abs(math.log(factor(item))),
    )
    distances = [abs(math.log(factor(item))) for item in ahead]
    between = [0.5 * (near + far) for near, far in pairwise(distances)]
    # Stability may change at a crossing only: it is looked at between them.
    stops = [*between, *(1.5 * last + 0.1 for last in distances[-1:])]
    start, now = 0.0, fails(0.0)
    for item, stop in zip(ahead, stops, strict=True):
        if fails(stop) != now:
            exact = refined(loop, item)
            at = abs(math.log(factor(exact)))
            before = BESIDE if now else EARLIER
            if fails(at - before * at) != now or fails(at + BESIDE * at) == now:
                # Another crossing, between two points of the grid or of a leg that is alike.
                at = switch(growth, start, stop)
                return math.exp(sign * at), angle_of_change(matrix, at)
            return math.exp(sign * at), exact.angle
        start = stop
    return (math.inf if up else 0.0), math.inf


def angle_of_change(matrix: Callable[[float], np.ndarray], at: float) -> float:
    """w T [rad] of the root that leaves the unit circle, or comes back, at a distance."""
    parts = [np.linalg.eigvals(matrix(at + part * at)) for part in (-BESIDE, 0.0, BESIDE)]
    before, here, after = sorted_along(np.array(parts))
    # Of a rigid-body motion rounding decides on which side it is, but it does not move.
    moved = np.abs(np.log(np.abs(after) / np.abs(before)))
    apart = np.abs(np.log(np.abs(here)) - math.log1p(MARGINAL))
    share = np.divide(apart, moved, out=np.full(len(here), np.inf), where=moved > 0.0)
    changed = beyond(before) != beyond(after)
    return abs(float(np.angle(here[np.argmin(np.where(changed, share, np.inf))])))


def later(matrices: Matrices, periods: int) -> np.ndarray:
    """The loop's matrix with all commands delayed by some more whole control periods."""
    M, N, C = reduced(matrices)
    if not periods:
        return M
    size, joints = N.shape
    line = periods * joints
    whole = np.zeros((size + line, size + line))
    whole[:size, :size] = M - N @ C
    whole[:size, -joints:] = N
    whole[size : size + joints, :size] = C
    whole[size + joints :, size:-joints] = np.eye(line - joints)
    return whole


def delay_limit(
    later_by: Callable[[float], Matrices],
    period: float,
    candidates: list[Crossing],
    counted: Counted = moving,
) -> tuple[float, float]:
    """The smallest delay of all commands, on top of what they have, that destabilises [s].

    Args:
        later_by: extra delay of a part of a period [s], in [0, T] -> M, N, C.
        period: T [s].
        candidates: crossings with Re s = 1/2 of the loop as it is.
        counted: the roots that are asked of, see `gain_limit`.

    Returns:
        The delay (inf if there is none) and its frequency w T [rad] (inf).
    """
    # Joints that are alike have the same crossings: only the delays are compared.
    guesses = sorted(
        ((turn(item) / item.angle, item) for item in candidates if item.angle > 0.0),
        key=lambda guess: guess[0],
    )
    best, where = math.inf, math.inf
    for guess, item in guesses:
        if guess > 1.1 * best + 2.0:
            break
        for found in marginal_delays(later_by, period, item.angle, guess, best):
            if found[0] < best:
                best, where = found
    early = early_delay(later_by, period, min(best, _END) * _BEFORE, counted)
    if early is not None:
        best, where = early
    return best * period, where


def turn(crossing: Crossing) -> float:
    """Phase that a delay has to take away [rad], in [0, 2 pi)."""
    s = crossing.value
    return float(np.angle((s - 1.0) / s)) % (2.0 * math.pi)


def marginal_delays(
    later_by: Callable[[float], Matrices], period: float, angle: float, guess: float, best: float
) -> Iterator[tuple[float, float]]:
    """The delays in periods and angles w T near a guess at which the loop is marginal.

    Every eigenvalue that is near 1 at the guess is followed to 1 by Newton's method, by itself:
    joints that are almost alike have some so near to each other that the nearest may be another's.
    Those that arrive beyond the best delay so far [periods] are left out.
    """

    def returned(angle: float, delay: float) -> Returned:
        return feedback(later_by, period, angle, delay)

    first = returned(angle, guess)
    values, vectors = np.linalg.eig(first.commands)
    distance = np.abs(values - 1.0)
    for k in np.flatnonzero(distance <= max(_NEAR * angle, float(distance.min()))):
        point, vector, R = np.array([angle, guess]), vectors[:, k], first
        for _ in range(_NEWTON):
            roots, left, right = scipy.linalg.eig(R.commands, left=True, right=True)
            own = int(np.argmax(np.abs(vector.conj() @ right)))
            value, vector = roots[own], right[:, own]
            if abs(value - 1.0) < _CLOSE:
                yield float(point[1]), float(point[0])
                break
            dual = left[:, own].conj() / (left[:, own].conj() @ vector)
            after = point[1] * (1.0 + _SMALL)
            moved = (returned(point[0], after).commands - R.commands) / (after - point[1])
            slopes = [dual @ R.slope(vector), dual @ moved @ vector]
            jacobian = np.array([np.real(slopes), np.imag(slopes)])
            step = np.linalg.lstsq(jacobian, [1.0 - value.real, -value.imag])[0]
            point = point + step
            inside = 0.0 < point[0] <= math.pi * (1.0 + 1e-12) and point[1] >= 0.0
            # What is left of the way is less than the step before.
            if not inside or point[1] - abs(step[1]) > best:
                break
            R = returned(*point)


@dataclass(frozen=True)
class Returned:
    """What comes back of commands of one frequency under a delay, see `feedback`; n states.

    Attributes:
        kept: places of the states.
        states: these in response to each command, shape (n, m).
        commands: what comes back of each, shape (m, m); marginal where 1 is an eigenvalue.
    """

    kept: np.ndarray
    states: np.ndarray
    commands: np.ndarray
    _angle: float
    _whole: int
    _outputs: np.ndarray
    _factors: tuple[np.ndarray, np.ndarray]

    def slope(self, vector: np.ndarray) -> np.ndarray:
        """How what comes back of these commands changes with w T, shape (m,)."""
        again, _ = scipy.linalg.lapack.zgetrs(*self._factors, self.states @ vector)
        turned = np.exp(1j * self._angle * (1 - self._whole)) * (self._outputs @ again)
        return -1j * (self._whole * (self.commands @ vector) + turned)


def feedback(
    later_by: Callable[[float], Matrices], period: float, angle: float, delay: float
) -> Returned:
    """What comes back of commands of one frequency under a delay:

        R = z^-k C (z I - A)^-1 N,     dR/dt = -j (k R + z^(1-k) C (z I - A)^-2 N),     z = e^(jt)

    of k whole periods, with A = M - N C and N of the part that is left, which changes the loop by
    more than its phase.

    Args:
        angle: w T [rad].
        delay: [periods].
    """
    whole = math.floor(delay)
    matrices = later_by((delay - whole) * period)
    kept = joined(matrices)
    M, N, C = reduced(matrices, kept)
    opened = np.exp(1j * angle) * np.eye(len(M)) - (M - N @ C)
    factors, swaps, _ = scipy.linalg.lapack.zgetrf(opened)
    moved, _ = scipy.linalg.lapack.zgetrs(factors, swaps, N.astype(complex))
    back = np.exp(-1j * angle * whole) * (C @ moved)
    return Returned(kept, moved, back, angle, whole, C, (factors, swaps))


def early_delay(
    later_by: Callable[[float], Matrices],
    period: float,
    last: float,
    counted: Counted,
) -> tuple[float, float] | None:
    """An unstable delay before the last one, by trying [periods]; None if there is none."""

    def matrix(delay: float) -> np.ndarray:
        whole = math.floor(delay)
        return later(later_by((delay - whole) * period), whole)

    def growth(delay: float) -> float:
        return excess(matrix(delay), counted)

    before = 0.0
    # Parts of a period that all loops have alike, so that what they share is computed once.
    parts = np.arange(1, math.ceil(_PARTS * last)) / _PARTS
    for delay in (*(parts if parts.size else [0.5 * last]), last):
        tried = matrix(float(delay))
        # The last one is marginal but for rounding, unless it is where trying ends.
        certain = (delay < last or last >= _END * _BEFORE) and excess(tried) <= 0.0
        if not certain and excess(tried, counted) > 0.0:
            found = switch(growth, before, float(delay))
            values = np.linalg.eigvals(matrix(found))
            # Delay changes nothing that does not turn.
            turning = np.where(np.abs(np.angle(values)) > _STILL, np.abs(values), 0.0)
            return found, float(abs(np.angle(values[np.argmax(turning)])))
        before = float(delay)
    return None
