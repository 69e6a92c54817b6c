"""Frequency responses of a sampled loop with several joints, from its matrices over one period.

    x' = M x + N d,     u = C x + d,     S(e^(jt)) = I + C (e^(jt) I - M)^-1 N,     t = w T

One Schur decomposition M = Q U Q^H, those roots last that are gone within few periods. Without
what couples the two parts, the first one is a sum of modes, which S is evaluated from:

    S(z) = I + sum_k c_k b_k^T / (z - z_k) + sum_j H_j z^-j

Where modes are not accurate, of roots that are defective, a triangular system is solved at each
frequency instead. Peaks and crossings
are looked for on a grid that is made of the loop's own roots, and refined to rounding
(Chandrupatla's methods, as `scipy.optimize.elementwise` has them).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

# Rows of a triangular system that are solved one by one before the rest is updated at once.
_BLOCK = 16
# Numbers that one call works on: bounds the memory of many frequencies at once.
_ENTRIES = 2_000_000
# Of the grid: points in a decade, their least relative distance, and places around a root in
# half-widths of its resonance.
PER_DECADE = 24
_APART = 1e-7
_AROUND = (-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0)
# Local maxima of a curve that are refined.
_CANDIDATES = 4
# Distance to a root instead of none.
_ON_ROOT = 1e-16
# Roots below this are no modes of their own: those of delays are defective. So many of their powers
# count at most, and those above this share.
_GONE, _POWERS, _NOTHING = 1e-2, 60, 1e-18
# Share of S by which modes may be wrong, and at how many roots' frequencies that is looked at.
_WRONG, _CHECKED = 1e-10, 24


Matrices = tuple[np.ndarray, np.ndarray, np.ndarray]
Family = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Multiloop:
    """A closed loop over one control period, ready to be evaluated; n states, m joints.

    Attributes:
        roots: eigenvalues of M, shape (n,).
        vectors: Q, scaled back to the states, shape (n, n).
        triangular: U, shape (n, n).
        inputs: Q^-1 N, shape (n, m).
        outputs: C Q, shape (m, n).
        opened: eigenvalues of M - N C, the loop without its controllers, shape (n,).
        kept: places of the n states among those of M.
        period: T [s].
        poles, terms: z_k, shape (p,), and c_k b_k^T followed by H_1, H_2, ..., shape (p + q, m, m);
            None where modes are not accurate.
    """

    roots: np.ndarray
    vectors: np.ndarray
    triangular: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    opened: np.ndarray
    kept: np.ndarray
    period: float
    poles: np.ndarray
    terms: np.ndarray | None


def multiloop(M: np.ndarray, N: np.ndarray, C: np.ndarray, period: float) -> Multiloop:
    """Decompose the matrices of a loop.

    States that nothing moves, or that move nothing, are left out: their roots are 0.

    Args:
        M, N, C: shape (n, n), (n, m), (m, n).
        period: T [s].
    """
    loop = decomposed(M, N, C, period)
    M, N, C = reduced((M, N, C), loop.kept)
    return replace(loop, opened=scipy.linalg.eigvals(M - N @ C))


def decomposed(M: np.ndarray, N: np.ndarray, C: np.ndarray, period: float) -> Multiloop:
    """The same of any outputs, shape (rows, n); without the roots of the opened loop."""
    kept = joined((M, N, C))
    M, N, C = reduced((M, N, C), kept)
    balanced, (scale, _) = scipy.linalg.matrix_balance(M, permute=False, separate=True)
    triangular, vectors, lasting = scipy.linalg.schur(
        balanced.astype(complex), sort=lambda root: abs(root) > _GONE
    )
    loop = Multiloop(
        roots=np.diag(triangular).copy(),
        vectors=scale[:, None] * vectors,
        triangular=triangular,
        inputs=vectors.conj().T @ (N / scale[:, None]),
        outputs=(C * scale) @ vectors,
        opened=np.zeros(0, complex),
        kept=kept,
        period=period,
        poles=np.zeros(0),
        terms=None,
    )
    modal = _modal(loop, lasting)
    nearest = np.argsort(np.abs(np.abs(loop.roots) - 1.0), kind="stable")[:_CHECKED]
    angle = np.abs(np.angle(loop.roots[nearest]))
    exact, found = response(loop, angle), response(modal, angle)
    size = np.abs(exact).max(axis=(1, 2), initial=1.0)
    accurate = np.abs(found - exact).max(axis=(1, 2), initial=0.0) <= _WRONG * size
    return modal if accurate.all() else loop


def _modal(loop: Multiloop, lasting: int) -> Multiloop:
    """The same as a sum of the modes of its first roots and of powers of the others."""
    k, U = lasting, loop.triangular
    apart = np.zeros_like(U[:k, k:])
    if apart.size:
        apart, share, _ = scipy.linalg.lapack.ztrsyl(U[:k, :k], U[k:, k:], -U[:k, k:], isgn=-1)
        apart = apart / share
    with np.errstate(all="ignore"):  # defective ones are found by what comes out
        poles, modes = np.linalg.eig(U[:k, :k])
        fast, outputs = loop.inputs[k:], loop.outputs[:, :k] @ apart + loop.outputs[:, k:]
        try:
            slow = np.linalg.solve(modes, loop.inputs[:k] - apart @ fast)
        except np.linalg.LinAlgError:
            return loop
        terms = (loop.outputs[:, :k] @ modes).T[:, :, None] * slow[:, None]
    powers: list[np.ndarray] = []
    largest = float(np.abs(fast).max(initial=0.0))
    while largest > 0.0 and len(powers) < _POWERS and np.abs(fast).max() > _NOTHING * largest:
        powers.append(outputs @ fast)
        fast = U[k:, k:] @ fast
    return replace(loop, poles=poles, terms=np.concatenate([terms, *(p[None] for p in powers)]))


def _features(loop: Multiloop, z: np.ndarray) -> np.ndarray:
    """What each term of S is multiplied with, shape (k, terms)."""
    assert loop.terms is not None
    apart = z[:, None] - loop.poles
    powers = -1.0 - np.arange(len(loop.terms) - len(loop.poles))
    slow = 1.0 / np.where(apart == 0.0, _ON_ROOT, apart)
    return np.concatenate([slow, z[:, None] ** powers], axis=1)


def joined(matrices: Matrices) -> np.ndarray:
    """Places of the states that something moves, and that move something."""
    M, N, C = matrices
    others = M != 0.0
    own = np.diag(others).copy()
    np.fill_diagonal(others, False)
    pushed, seen = own | np.any(N, axis=1), own | np.any(C, axis=0)
    kept = np.ones(len(M), bool)
    while True:
        moved = others[:, kept].any(axis=1) | pushed
        moving = others[kept].any(axis=0) | seen
        if (moved & moving)[kept].all():
            return np.flatnonzero(kept)
        kept &= moved & moving


def reduced(matrices: Matrices, kept: np.ndarray | None = None) -> Matrices:
    """M, N, C without the states that nothing moves, or that move nothing; `kept` from `joined`."""
    M, N, C = matrices
    kept = joined(matrices) if kept is None else kept
    return M[np.ix_(kept, kept)], N[kept], C[:, kept]


def _solved(loop: Multiloop, z: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(z I - U)^-1 at each z; right and result of shape (n, frequencies, k)."""
    U = loop.triangular
    states = np.array(right, complex)
    shape = states.shape
    for end in range(len(U), 0, -_BLOCK):
        first = max(end - _BLOCK, 0)
        for row in range(end - 1, first - 1, -1):
            apart = z - U[row, row]
            # On a root, which a joint or an object that nothing holds has at z = 1 exactly.
            states[row] /= np.where(apart == 0.0, _ON_ROOT, apart)[:, None]
            for above in range(first, row):
                if U[above, row] != 0.0:
                    states[above] += U[above, row] * states[row]
        if first:
            block = states[first:end].reshape(end - first, -1)
            states[:first] += (U[:first, first:end] @ block).reshape(first, *shape[1:])
    return states


def states(loop: Multiloop, angle: float, force: np.ndarray) -> np.ndarray:
    """States x in response to forces d of one frequency; complex, shape (all states,) of M's kind.

    Args:
        angle: w T [rad].
        force: complex, shape (m,).
    """
    z = np.array([np.exp(1j * angle)])
    found = _solved(loop, z, (loop.inputs @ force)[:, None, None])[:, 0, 0]
    return loop.vectors @ found


def sensitivity(loop: Multiloop, angle: np.ndarray) -> np.ndarray:
    """S at w T = `angle` [rad], shape (k,): complex, shape (k, m, m)."""
    return np.eye(loop.inputs.shape[1]) + response(loop, angle)


def response(loop: Multiloop, angle: np.ndarray) -> np.ndarray:
    """C (z I - M)^-1 N at w T = `angle` [rad], shape (k,): complex, shape (k, rows, m).

    The rows of C may be other than as many as there are inputs.
    """
    z = np.exp(1j * np.asarray(angle, float))
    (size, inputs), rows = loop.inputs.shape, len(loop.outputs)
    if loop.terms is not None:
        moved = _features(loop, z) @ loop.terms.reshape(-1, rows * inputs)
        return moved.reshape(-1, rows, inputs)
    chunk = max(1, _ENTRIES // (size * inputs))
    parts = []
    for part in (z[first : first + chunk] for first in range(0, len(z), chunk)):
        right = np.broadcast_to(loop.inputs[:, None], (size, len(part), inputs))
        solved = _solved(loop, part, right).reshape(size, -1)
        back = (loop.outputs @ solved).reshape(rows, len(part), inputs)
        parts.append(back.transpose(1, 0, 2))
    return np.concatenate(parts) if parts else np.zeros((0, rows, inputs), complex)


def own_sensitivity(loop: Multiloop, angle: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """S_ii of joint `joint` at w T = `angle` [rad]; all of shape (k,)."""
    z = np.exp(1j * np.asarray(angle, float))
    if loop.terms is not None:
        return 1.0 + np.einsum("kf,fk->k", _features(loop, z), loop.terms[:, joint, joint])
    solved = _solved(loop, z, loop.inputs[:, joint][..., None])[..., 0]
    return 1.0 + np.einsum("kn,nk->k", loop.outputs[joint], solved)


def grid(loop: Multiloop) -> np.ndarray:
    """Angles w T [rad] from 0 to pi, both included, dense around every root of the loop."""
    roots = np.concatenate([loop.roots, loop.opened])
    return grid_of(roots, lowest(roots))


def grid_of(roots: np.ndarray, low: float) -> np.ndarray:
    """Angles w T [rad] from 0 to pi, both included, dense around these roots.

    Args:
        roots: shape (n,).
        low: the lowest but 0 [rad].
    """
    decades = math.log10(math.pi / low)
    spread = np.geomspace(low, math.pi, max(2, round(PER_DECADE * decades)))
    points = np.concatenate([around(roots), spread])
    inside = np.unique(points[(points >= low) & (points < math.pi * (1.0 - _APART))])
    return np.concatenate([[0.0], inside[apart(inside)], [math.pi]])


def apart(angle: np.ndarray) -> np.ndarray:
    """Which angles of a rising row to keep: neighbours that differ by rounding make false maxima.

    Ends are kept.
    """
    kept = np.diff(angle, prepend=0.0) > _APART * angle
    return kept | (angle == 0.0) | (angle == math.pi)


def around(roots: np.ndarray) -> np.ndarray:
    """Angles w T [rad] within the resonance of every root, and its corner."""
    rates = _rates(roots)
    corner, turning, width = np.abs(rates), np.abs(rates.imag), np.abs(rates.real)
    beside = turning[:, None] + width[:, None] * np.array(_AROUND)
    return np.concatenate([beside.ravel(), corner, turning])


def lowest(roots: np.ndarray) -> float:
    """Angle w T below which no root has anything [rad]."""
    corner = np.abs(_rates(roots))
    slowest = min(1e-3, float(corner[corner > 0.0].min(initial=1e-3)))
    return max(0.03 * slowest, 1e-9)


def _rates(roots: np.ndarray) -> np.ndarray:
    # What is almost 0 decays within a period and has no frequency of its own.
    return np.log(np.asarray(roots[np.abs(roots) > 1e-4], complex))


def peaks(angle: np.ndarray, values: np.ndarray, family: Family) -> tuple[np.ndarray, np.ndarray]:
    """Largest values of several curves over frequency, refined.

    Args:
        angle: the grid [rad], rising, shape (k,).
        values: of the curves on the grid, shape (k, c); 0 where they are not looked at.
        family: (angles (j,), numbers of curves (j,)) -> values (j,).

    Returns:
        The peaks and their angles [rad], shape (c,) each.
    """
    best = np.argmax(values, axis=0)
    columns = np.arange(values.shape[1])
    peak, where = values[best, columns], angle[best]
    rows, which = _local_maxima(values)
    if rows.size:
        from scipy.optimize import elementwise  # slow to import

        bracket = (angle[rows - 1], angle[rows], angle[rows + 1])
        found = elementwise.find_minimum(
            lambda t, number: -family(t, number.astype(int)), bracket, args=(which,)
        )
        refined = np.where(found.success, -found.f_x, -np.inf)
        for curve, value, at in zip(which, refined, found.x, strict=True):
            if value > peak[curve]:
                peak[curve], where[curve] = value, at
    return peak, where


def _local_maxima(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the largest inner local maxima of each column."""
    inner = values[1:-1]
    top = (inner >= values[:-2]) & (inner >= values[2:])
    rows, columns = [], []
    for column in range(values.shape[1]):
        places = 1 + np.flatnonzero(top[:, column] & (inner[:, column] > 0.0))
        order = np.argsort(-values[places, column])[:_CANDIDATES]
        rows.append(places[order])
        columns.append(np.full(len(order), column))
    return np.concatenate(rows), np.concatenate(columns)


def zeros(angle: np.ndarray, values: np.ndarray, family: Family) -> tuple[np.ndarray, np.ndarray]:
    """Where several real curves pass zero strictly inside the grid.

    Args:
        angle, values, family: as for `peaks`.

    Returns:
        Angles [rad] and numbers of the curves, shape (number of zeros,) each.
    """
    rows, which = np.nonzero(values[:-1] * values[1:] < 0.0)
    if not rows.size:
        return np.zeros(0), np.zeros(0, int)
    from scipy.optimize import elementwise  # slow to import

    found = elementwise.find_root(
        lambda t, number: family(t, number.astype(int)),
        (angle[rows], angle[rows + 1]),
        args=(which,),
    )
    at = np.where(found.success, found.x, 0.5 * (angle[rows] + angle[rows + 1]))
    return at, which


@dataclass(frozen=True)
class Curves:
    """Sensitivities over frequency.

    Attributes:
        frequency: w [rad/s], rising, up to pi/T, shape (k,).
        sensitivity, complementary: largest singular value of S and of T [-], shape (k,) each.
        own_sensitivity, own_complementary: |S_ii| and |1 - S_ii| [-], shape (k, m) each.
        names: of the m joints.
    """

    frequency: np.ndarray
    sensitivity: np.ndarray
    complementary: np.ndarray
    own_sensitivity: np.ndarray
    own_complementary: np.ndarray
    names: tuple[str, ...]


def curves(loop: Multiloop, names: tuple[str, ...]) -> Curves:
    """Sensitivities on the loop's grid."""
    angle = grid(loop)[1:]
    S = sensitivity(loop, angle)
    T = np.eye(len(names)) - S
    own = np.diagonal(S, axis1=1, axis2=2)
    return Curves(
        frequency=angle / loop.period,
        sensitivity=np.linalg.svd(S, compute_uv=False)[:, 0],
        complementary=np.linalg.svd(T, compute_uv=False)[:, 0],
        own_sensitivity=np.abs(own),
        own_complementary=np.abs(1.0 - own),
        names=names,
    )
