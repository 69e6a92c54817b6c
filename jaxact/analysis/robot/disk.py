"""The multi-loop disk margin: how much gain and phase of all loops may change at once.

Each loop is multiplied by its own f_i = (1 + d_i/2) / (1 - d_i/2), |d_i| < a (balanced, sigma = 0).
All are stable for any such factors, of any phase and frequency, up to

    a = 1 / max_w mu(S - I/2),     mu(H) <= min over D of sigma_max(D H D^-1)

with mu the structured singular value for diagonal complex d and D diagonal and positive. The bound
is what is computed: it is mu itself for up to three loops and rarely more than a few per cent above
it, so that the margin is never promised too large.

Sources: Seiler, Packard, Gahinet, "An introduction to disk margins", IEEE Control Systems Magazine
40 (2020); Osborne, "On pre-conditioning of matrices", J. ACM 7 (1960), for a first D; Boyd, El
Ghaoui, "Method of centers for minimizing generalized eigenvalues", Linear Algebra and its
Applications 188 (1993), for the best one.
"""

from __future__ import annotations

import numpy as np

from jaxact.analysis.robot.multiloop import Multiloop, sensitivity

_SWEEPS = 12
_TINY = 1e-150
# Relative accuracy of the bound: where it is reported, and while its peak is looked for.
_ACCURACY, _SEARCH = 1e-9, 1e-4
# Most steps of the method of centres.
CENTRES = 200
NEWTON = 20
# How far a new bound keeps from the one that its scaling has, as a share of the way back.
SHY = 0.2
# Decrement of Newton's method at which a centre is good enough, and above which a step is damped.
CENTRED, DAMPED = 0.3, 0.25


def balanced(H: np.ndarray, settled: float = 1e-9) -> tuple[np.ndarray, np.ndarray]:
    """Osborne's scaling, a few sweeps: D H D^-1 has rows and columns of nearly equal size.

    Args:
        H: complex, shape (k, m, m).
        settled: the last sweep is one that changes D by no more than this share.

    Returns:
        sigma_max(D H D^-1), shape (k,), and the diagonals of D, shape (k, m).
    """
    size = np.abs(H) ** 2
    joints = H.shape[-1]
    diagonal = np.arange(joints)
    size[:, diagonal, diagonal] = 0.0
    scale = np.ones(H.shape[:-1])
    for _ in range(_SWEEPS):
        before = scale.copy()
        for joint in range(joints):
            row = size[:, joint, :].sum(axis=-1)
            column = size[:, :, joint].sum(axis=-1)
            coupled = (row > _TINY) & (column > _TINY)
            ratio = np.where(coupled, column, 1.0) / np.where(coupled, row, 1.0)
            size[:, joint, :] *= np.sqrt(ratio)[:, None]
            size[:, :, joint] /= np.sqrt(ratio)[:, None]
            scale[:, joint] *= ratio**0.25
        if (np.abs(scale - before) <= settled * before).all():
            break
    scaled = H * (scale[:, :, None] / scale[:, None, :])
    return np.linalg.svd(scaled, compute_uv=False)[:, 0], scale


def bound(H: np.ndarray, accuracy: float = _ACCURACY) -> float:
    """min over diagonal D of sigma_max(D H D^-1), by the method of centres.

    With P = D^2 the square of the bound is the smallest b for which b P - H* P H is not indefinite.

    Args:
        H: complex, shape (m, m).
        accuracy: relative; what is returned is never too small.
    """
    return scaled(H, accuracy)[0]


def scaled(H: np.ndarray, accuracy: float = _ACCURACY) -> tuple[float, np.ndarray]:
    """The same, and the diagonal of the best D found, shape (m,)."""
    first, scale = balanced(H[None])
    if len(H) == 1 or first[0] == 0.0:
        return float(first[0]), scale[0]
    unit = H / first[0]
    weights = scale[0] ** 2
    weights *= len(H) / weights.sum()
    best = level = _largest(unit, weights)
    kept = weights
    level *= 1.0 + SHY
    for _ in range(CENTRES):
        weights = _centre(unit, weights, level)
        # Near the best bound F is singular but for rounding, which may lead anywhere: what was
        # found before is a bound all the same.
        if not (np.isfinite(weights).all() and weights.min() > _TINY * weights.max()):
            break
        now = _largest(unit, weights)
        if now < best:
            best, kept = now, weights
        if level - now <= accuracy * now:
            break
        level = now + SHY * (level - now)
    return float(first[0] * np.sqrt(best)), np.sqrt(kept)


def _largest(H: np.ndarray, weights: np.ndarray) -> float:
    """Largest eigenvalue of P^-1 H* P H."""
    root = np.sqrt(weights)
    return float(np.linalg.norm(H * (root[:, None] / root[None]), 2) ** 2)


def _centre(H: np.ndarray, weights: np.ndarray, level: float) -> np.ndarray:
    """Weights p of the same sum near the largest det F, F = level P - H* P H; by Newton."""
    joints = len(H)
    # F = sum of p_i F_i, F_i = level e_i e_i^T - h_i^* h_i with the rows h_i of H; G = F^-1
    # The last row and column keep the sum.
    system = np.ones((joints + 1, joints + 1))
    system[joints, joints] = 0.0
    right = np.zeros(joints + 1)
    for _ in range(NEWTON):
        try:
            G = np.linalg.inv(np.diag(level * weights) - (H.conj().T * weights) @ H)
        except np.linalg.LinAlgError:
            break
        HG = H @ G
        HGH = HG @ H.conj().T
        # tr G F_i, and tr G F_i G F_j
        right[:joints] = (level * np.diag(G) - np.diag(HGH)).real
        mixed = np.abs(HG) ** 2
        curvature = np.abs(level * G) ** 2 - level * (mixed + mixed.T) + np.abs(HGH) ** 2
        system[:joints, :joints] = curvature
        try:
            step = np.linalg.solve(system, right)[:joints]
        except np.linalg.LinAlgError:
            break
        decrement = float(np.sqrt(max(step @ curvature @ step, 0.0)))
        # Damped, so that F stays positive: Newton's step for a self-concordant function.
        weights = weights + step / (1.0 + decrement if decrement > DAMPED else 1.0)
        if decrement < CENTRED:
            break
    return weights


def largest_bound(loop: Multiloop, angle: np.ndarray, S: np.ndarray) -> tuple[float, float]:
    """max over w of the bound of mu(S - I/2), and w T [rad] where it is.

    Args:
        angle: grid of w T [rad], rising, shape (k,).
        S: there, shape (k, m, m).
    """
    joints = S.shape[-1]
    half = 0.5 * np.eye(joints)
    rough, _ = balanced(S - half)
    # The rough bound is above the best one: below what is found already, nothing is to be found.
    found: dict[int, float] = {}
    highest = 0.0
    for place in np.argsort(-rough):
        if rough[place] <= highest:
            break
        found[int(place)] = bound(S[place] - half, _SEARCH)
        highest = max(highest, found[int(place)])
    peak, at = highest, float(angle[max(found, key=lambda place: found[place])])

    def lower(t: float) -> float:
        return -bound(sensitivity(loop, np.array([t]))[0] - half)

    from scipy.optimize import minimize_scalar  # slow to import

    near = sorted(found, key=lambda place: -found[place])
    summits = [p for p in near if _is_summit(p, found)]
    for place in summits[:2]:
        ends = angle[max(place - 1, 0)], angle[min(place + 1, len(angle) - 1)]
        near_enough = {"xatol": 1e-7 * ends[1]}
        refined = minimize_scalar(lower, bounds=ends, method="bounded", options=near_enough)
        if -refined.fun > peak:
            peak, at = -float(refined.fun), float(refined.x)
    return peak, at


def _is_summit(place: int, found: dict[int, float]) -> bool:
    """Whether no neighbour on the grid that was looked at is higher."""
    return all(found.get(other, 0.0) <= found[place] for other in (place - 1, place + 1))
