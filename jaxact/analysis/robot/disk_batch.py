"""The disk margin's bound of many matrices at once; see `jaxact.analysis.robot.disk` for it.

The same method of centres, its steps taken for all matrices that are not done, side by side.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from jaxact.analysis.robot import disk
from jaxact.analysis.robot.summits import summits

# Accuracy of the bound, where it is reported and while its peak is looked for.
_ACCURACY, _SEARCH = 1e-9, 1e-4
_TINY = 1e-150
# Share to which a scaling is settled that is only begun with, or only bounds what is looked at.
_ROUGH = 1e-3
# Grid points that are looked at in one go.
_ROUND = 4

Family = Callable[[np.ndarray, np.ndarray], np.ndarray]


def bounds(H: np.ndarray, accuracy: float = _ACCURACY) -> np.ndarray:
    """min over diagonal D of sigma_max(D H D^-1) of each matrix, never too small; shape (k,).

    Args:
        H: complex, shape (k, m, m).
        accuracy: relative.
    """
    first, scale = disk.balanced(H, _ROUGH)
    joints = H.shape[-1]
    best = np.ones(len(H))
    going = np.flatnonzero(first > 0.0) if joints > 1 else np.zeros(0, int)
    unit = H[going] / first[going, None, None]
    weights = scale[going] ** 2
    weights *= joints / weights.sum(axis=1, keepdims=True)
    level = _largest(unit, weights)
    best[going] = level
    level = level * (1.0 + disk.SHY)
    for _ in range(disk.CENTRES):
        if not going.size:
            break
        try:
            weights = _centres(unit, weights, level)
        except np.linalg.LinAlgError:  # of one of them; each for itself goes on
            best[going] = [disk.bound(one, accuracy) ** 2 for one in unit]
            break
        sound = np.isfinite(weights).all(axis=1) & (
            weights.min(axis=1) > _TINY * weights.max(axis=1)
        )
        going, unit, weights, level = going[sound], unit[sound], weights[sound], level[sound]
        now = _largest(unit, weights)
        best[going] = np.minimum(best[going], now)
        open_ = level - now > accuracy * now
        going, unit, weights = going[open_], unit[open_], weights[open_]
        level = now[open_] + disk.SHY * (level[open_] - now[open_])
    return first * np.sqrt(best)


def _largest(H: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Largest eigenvalue of P^-1 H* P H of each."""
    root = np.sqrt(weights)
    scaled = H * (root[:, :, None] / root[:, None, :])
    return np.linalg.svd(scaled, compute_uv=False)[:, 0] ** 2


def _centres(H: np.ndarray, weights: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Weights of the same sums near the largest det F, F = level P - H* P H; by Newton."""
    weights = weights.copy()
    going = np.arange(len(H))
    for _ in range(disk.NEWTON):
        part, own, at = H[going], weights[going], level[going, None]
        step, decrement = _newton(part, own, at)
        damped = np.where(decrement > disk.DAMPED, 1.0 + decrement, 1.0)
        weights[going] = own + step / damped[:, None]
        going = going[decrement >= disk.CENTRED]
        if not going.size:
            break
    return weights


def _newton(H: np.ndarray, weights: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Newton's step towards the centre, shape (k, m), and its decrement, shape (k,)."""
    count, joints = weights.shape
    back = H.conj().transpose(0, 2, 1)
    diagonal = np.arange(joints)
    F = -(back * weights[:, None, :]) @ H
    F[:, diagonal, diagonal] += level * weights
    G = np.linalg.inv(F)
    HG = H @ G
    HGH = HG @ back
    system = np.ones((count, joints + 1, joints + 1))
    system[:, joints, joints] = 0.0
    right = np.zeros((count, joints + 1))
    right[:, :joints] = (level * G[:, diagonal, diagonal] - HGH[:, diagonal, diagonal]).real
    mixed = _squared(HG)
    scale = level[:, :, None]
    curvature = scale**2 * _squared(G) - scale * (mixed + mixed.transpose(0, 2, 1)) + _squared(HGH)
    system[:, :joints, :joints] = curvature
    step = np.linalg.solve(system, right[..., None])[:, :joints, 0]
    decrement = np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", step, curvature, step), 0.0))
    return step, decrement


def _squared(values: np.ndarray) -> np.ndarray:
    return values.real**2 + values.imag**2


def largest(
    S: list[np.ndarray], grids: list[np.ndarray], above: list[np.ndarray], family: Family
) -> np.ndarray:
    """max over w of the bound of mu(S - I/2) of several loops, and w T [rad] there; (loops, 2).

    Args:
        S: of each loop on its grid, shape (k, m, m) each.
        grids: w T [rad], rising, shape (k,) each.
        above: upper bounds of sigma_max(S - I/2) there, as `singular_bound`, shape (k,) each.
        family: (angles (j,), numbers of loops (j,)) -> S - I/2, shape (j, m, m).
    """
    tops = _highest(S, above)
    brackets = np.array(
        [grid[[max(top - 1, 0), top, min(top + 1, len(grid) - 1)]] for grid, top in
         zip(grids, tops, strict=True)]
    )  # fmt: skip
    numbers = np.arange(len(S))
    return summits(brackets, lambda at, which: bounds(family(at, numbers[which])))


def _highest(S: list[np.ndarray], plain: list[np.ndarray]) -> np.ndarray:
    """The grid point of the largest bound of each loop, but for the accuracy of the search."""
    shifted = [part - 0.5 * np.eye(part.shape[-1]) for part in S]
    tops = [int(np.argmax(size)) for size in plain]
    highest = np.stack([P[top] for P, top in zip(shifted, tops, strict=True)])
    _, scales = disk.balanced(highest, _ROUGH)
    above = [_above(*own) for own in zip(shifted, plain, scales, strict=True)]
    found = np.zeros(len(S))
    best = np.zeros(len(S), int)
    looked = [np.zeros(len(part), bool) for part in shifted]
    rough = [np.zeros(0, bool)] * len(S)
    while True:
        places: list[tuple[int, int]] = []
        for loop, size in enumerate(above):
            ahead = np.flatnonzero((size > found[loop]) & ~looked[loop])
            if ahead.size and found[loop] and not rough[loop].any():
                # Osborne's bound is nearer than one scaling for all.
                nearer, _ = disk.balanced(shifted[loop][ahead], _ROUGH)
                size[ahead] = np.minimum(size[ahead], nearer)
                rough[loop] = np.ones(1, bool)
                ahead = ahead[size[ahead] > found[loop]]
            first = ahead[np.argsort(-size[ahead])[: _ROUND if found[loop] else 1]]
            looked[loop][first] = True
            places += [(loop, int(place)) for place in first]
        if not places:
            return best
        values = bounds(np.stack([shifted[loop][place] for loop, place in places]), _SEARCH)
        for (loop, place), value in zip(places, values, strict=True):
            if value > found[loop]:
                found[loop], best[loop] = value, place


def _above(P: np.ndarray, plain: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Upper bounds of the bound at every frequency: by one scaling D, shape (m,), for all."""
    return np.minimum(plain, singular_bound(P * (scale[:, None] / scale)))


def singular_bound(P: np.ndarray) -> np.ndarray:
    """(tr (P* P)^32)^(1/64) >= sigma_max of each, for a part of the cost; at most m^(1/64) more."""
    size = np.sqrt(np.sum(_squared(P), axis=(1, 2)))
    safe = np.where(size > 0.0, size, 1.0)
    unit = P / safe[:, None, None]
    G = unit.conj().transpose(0, 2, 1) @ unit
    for _ in range(4):
        G = G @ G
    norm = np.sqrt(np.sum(_squared(G), axis=(1, 2)))
    return np.minimum(size, size * norm ** (1.0 / 32.0) * (1.0 + 1e-12))
