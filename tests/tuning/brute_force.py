"""The tests' own optimum: every gain of a grid tried in NumPy, then the grid refined.

Nothing of jaxact is used: L from its definition on a dense frequency axis, peaks by a parabola
through the largest sample and its neighbours, stability by the winding of 1 + L. Run as a program
it writes tests/data/tuner_random.json.
"""

import json
from pathlib import Path

import numpy as np

_FREQUENCIES = 700


def tables(members, low=2e-4, high=60.0, points=_FREQUENCIES):
    """w and the response per unit of kp, shape (members, points); members: rows of m, wn, zeta, td.

    Frequencies are dense in the logarithm around the lag's own.
    """
    m, wn, zeta, td = (np.asarray(members, float)[:, i : i + 1] for i in range(4))
    w = np.geomspace(low, high, points)[None] / (td + 2.0 * zeta / wn)
    s = 1j * w
    return w, np.exp(-s * td) / (m * s**2 * (1.0 + 2.0 * zeta * s / wn + (s / wn) ** 2))


def parabola_peak(values):
    """Largest value along the last axis, by the parabola through it and its neighbours."""
    index = np.clip(np.argmax(values, axis=-1), 1, values.shape[-1] - 2)
    before, here, after = (
        np.take_along_axis(values, (index + shift)[..., None], axis=-1)[..., 0]
        for shift in (-1, 0, 1)
    )
    bend = before - 2.0 * here + after
    with np.errstate(divide="ignore", invalid="ignore"):
        rise = np.where(bend < 0, -((after - before) ** 2) / (8.0 * bend), 0.0)
    return np.where(here >= np.maximum(before, after), here + rise, np.maximum(before, after))


def log_peaks(members, kp, kd):
    """ln of the largest of Ms and Mt over all members, inf if one is unstable, shape (k,)."""
    worst = np.full(len(kp), -np.inf)
    for w, unit in zip(*tables(members), strict=True):
        plus = 1.0 + (kp[:, None] + 1j * w * kd[:, None]) * unit
        log_plus = 0.5 * np.log(plus.real**2 + plus.imag**2)
        loud = 0.5 * np.log((kp[:, None] ** 2 + (w * kd[:, None]) ** 2) * np.abs(unit) ** 2)
        wound = np.unwrap(np.angle(plus[:, ::2]), axis=1)
        stable = np.abs(wound[:, -1] - wound[:, 0] - np.pi) < 0.7
        peak = np.maximum(parabola_peak(-log_plus), parabola_peak(loud - log_plus))
        worst = np.maximum(worst, np.where(stable, peak, np.inf))
    return worst


def stiffest(members, max_peak, coarse=(64, 64), fine=(33, 33), refinements=6):
    """(kp, kd) of the largest kp with Ms and Mt at most max_peak for all members, and evaluations.

    Every local optimum of the coarse grid within reach of the best one is refined.
    """
    members = np.atleast_2d(np.asarray(members, float))
    lag = np.max(members[:, 3] + 2.0 * members[:, 2] / members[:, 1])
    mass = np.min(members[:, 0])
    box = np.log([[2e-4, 1.5], [2e-2, 1.6]]) + np.log([[mass / lag**2], [mass / lag]])
    number = 0
    centres, width = [box.mean(axis=1)], (box[:, 1] - box[:, 0]) / 2.0
    size = coarse
    for level in range(refinements + 1):
        candidates = []
        for centre in centres:
            axes = [
                np.linspace(c - h, c + h, n) for c, h, n in zip(centre, width, size, strict=True)
            ]
            kp, kd = (a.ravel() for a in np.meshgrid(*axes, indexing="ij"))
            met = log_peaks(members, np.exp(kp), np.exp(kd)) <= np.log(max_peak)
            number += kp.size
            stiffness = np.where(met, kp, -np.inf).reshape(size)
            column = stiffness.max(axis=0)
            rows = stiffness.argmax(axis=0)
            candidates += [
                (column[j], axes[0][rows[j]], axes[1][j])
                for j in range(size[1])
                if np.isfinite(column[j])
            ]
        candidates.sort(reverse=True)
        centres = _apart(candidates, width * 2.5 / np.array(size), 3 if level < 2 else 1)
        if not centres:
            return np.nan, np.nan, number
        width = width * 3.0 / np.array(size)
        size = fine
    return float(np.exp(candidates[0][1])), float(np.exp(candidates[0][2])), number


def _apart(candidates, distance, most):
    """The best candidates that are not neighbours of a better one."""
    kept = []
    for _, kp, kd in candidates:
        here = np.array([kp, kd])
        if all(np.any(np.abs(here - other) > distance) for other in kept):
            kept.append(here)
        if len(kept) == most:
            break
    return kept


def random_members(number, seed):
    """Rows of mass, wn, zeta, delay over the range of real joints."""
    random = np.random.default_rng(seed)
    mass = np.exp(random.uniform(np.log(0.02), np.log(8.0), number))
    wn = np.exp(random.uniform(np.log(40.0), np.log(1200.0), number))
    zeta = random.uniform(0.25, 1.3, number)
    delay = random.uniform(0.0, 12e-3, number)
    peak = random.uniform(1.25, 2.4, number)
    return np.stack([mass, wn, zeta, delay], axis=1), peak


def random_ensembles(number, size, seed):
    """Members (number, size, 4) around random plants, and a peak for each."""
    centres, peaks = random_members(number, seed)
    random = np.random.default_rng(seed + 1)
    spread = random.uniform(-1.0, 1.0, (number, size, 4)) * np.array([0.3, 0.2, 0.2, 0.4])
    return centres[:, None] * (1.0 + spread), peaks


def write(path):
    """All optima that the tests compare with."""
    plants, peaks = random_members(100, 7)
    singles = [stiffest(plant, peak)[:2] for plant, peak in zip(plants, peaks, strict=True)]
    ensembles, ensemble_peaks = random_ensembles(20, 32, 11)
    groups = [
        stiffest(members, peak, coarse=(40, 40), fine=(25, 25))[:2]
        for members, peak in zip(ensembles, ensemble_peaks, strict=True)
    ]
    document = {
        "about": "Brute-force optima of tests/tune/brute_force.py: (kp, kd) of its random plants "
        "and random ensembles, in order.",
        "plants": singles,
        "ensembles": groups,
    }
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write(Path(__file__).parent.parent / "data" / "tuner_random.json")
