"""Independent figures for the tests of the analysis: other methods, NumPy and SciPy only."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import scipy.linalg

from jaxact.analysis.joint.frequency import JointLoop

ORACLE = json.loads((Path(__file__).parent / "data" / "paper_loop.json").read_text())
NAMES = ("kp", "kd", "mass", "natural_frequency", "damping_ratio", "delay")
CONTINUOUS = ORACLE["paper_cases"] + ORACLE["frequency_sweep"]


def plant_values(cases, name):
    missing = {"natural_frequency": np.inf, "damping_ratio": 1.0}
    return np.array([missing[name] if c[name] is None else c[name] for c in cases], dtype=float)


def joint_loop(values, dtype=None):
    """A JointLoop from an array (6, ...) in the order of NAMES."""
    return JointLoop(*(jnp.asarray(v, dtype=dtype) for v in values))


def figures(cases, name):
    """An oracle column: null becomes NaN, "inf" infinity."""
    return np.array([np.nan if c[name] is None else float(c[name]) for c in cases])


def response(values, w):
    """L(jw) straight from its definition; values (6, ...), w broadcastable."""
    kp, kd, mass, wn, zeta, delay = values
    s = 1j * w
    servo = 1.0 if np.all(np.isinf(wn)) else 1.0 / (1.0 + 2.0 * zeta * s / wn + (s / wn) ** 2)
    return (kp + kd * s) / (mass * s**2) * servo * np.exp(-s * delay)


def random_loops(number, seed):
    """Loops over the whole range: gains over six decades, a third of them lightly damped."""
    random = np.random.default_rng(seed)
    light = random.random(number) < 1.0 / 3.0
    zeta = np.where(
        light, 10 ** random.uniform(-2.0, -1.0, number), random.uniform(0.1, 2.0, number)
    )
    wn = 10 ** random.uniform(np.log10(20.0), np.log10(2000.0), number)
    wn[random.random(number) < 0.05] = np.inf
    delay = random.uniform(0.0, 0.02, number) * (random.random(number) > 0.05)
    mass = 10 ** random.uniform(-1.5, 1.0, number)
    kp, kd = 10 ** random.uniform(-1.0, 5.0, number), 10 ** random.uniform(-3.0, 3.0, number)
    # Without the next line three quarters are unstable: too stiff for their damping.
    kp = np.where(random.random(number) < 0.45, np.clip(kd * 8, 0.1, None) * kp**0.2, kp)
    return np.array([kp, kd, mass, wn, zeta, delay])


def collocation_roots(values, nodes):
    """Approximate closed-loop roots, (n, 4 + nodes): the command's history on Chebyshev points."""
    kp, kd, mass, wn, zeta, delay = values
    ideal = np.isinf(wn)
    wn = np.where(ideal, 1.0, wn)
    k = np.arange(nodes + 1)
    x = np.cos(np.pi * k / nodes)
    c = np.where((k == 0) | (k == nodes), 2.0, 1.0) * (-1.0) ** k
    difference = np.outer(c, 1.0 / c) / (x[:, None] - x + np.eye(nodes + 1))
    difference -= np.diag(difference.sum(axis=1))
    matrix = np.zeros((len(kp), 4 + nodes, 4 + nodes))
    matrix[:, 0, 1], matrix[:, 1, 2], matrix[:, 2, 3] = 1.0, 1.0 / mass, wn
    matrix[:, 3, 2], matrix[:, 3, 3] = -wn, -2.0 * zeta * wn
    late = delay > 0
    speed = 2.0 / np.where(late, delay, 1.0)
    history = speed[:, None, None] * difference[1:, 1:]
    matrix[:, 4:, 4:] = np.where(late[:, None, None], history, -np.eye(nodes))
    inflow = np.where(late, speed, 0.0)[:, None] * difference[1:, 0]
    matrix[:, 4:, 0], matrix[:, 4:, 1] = -inflow * kp[:, None], -inflow * kd[:, None]
    # The delayed command drives the force servo, or the mass itself if there is none.
    for row, strength in ((3, np.where(ideal, 0.0, wn)), (1, np.where(ideal, 1.0 / mass, 0.0))):
        matrix[:, row, -1] += np.where(late, strength, 0.0)
        matrix[:, row, 0] -= np.where(late, 0.0, strength * kp)
        matrix[:, row, 1] -= np.where(late, 0.0, strength * kd)
    matrix[ideal, 1, 2] = 0.0
    return np.linalg.eigvals(matrix)


def largest_crossover(values):
    """An upper bound of |s| of any unstable root [rad/s]: where |kp| + |kd| w = m w^2 |D| last."""
    kp, kd, mass, wn, zeta, _ = values
    w = np.geomspace(1e-4, 1e7, 2201)[:, None]
    x = w / wn
    servo = np.hypot(1.0 - x**2, 2.0 * zeta * x)
    louder = np.hypot(kp, kd * w) > mass * w**2 * servo
    return w[len(w) - 1 - np.argmax(louder[::-1], axis=0), 0]


def collocation_count(values):
    """Number of roots in the right half plane, with enough nodes for the loop's fastest root."""
    need = largest_crossover(values) * values[5]
    generous = 100 * np.ceil(np.minimum(need, 900.0) / 50)
    nodes = np.select([need < 6, need < 25, need < 70], [20, 40, 90], generous).astype(int)
    count = np.zeros(values.shape[1], dtype=int)
    for size in np.unique(nodes):
        members = np.flatnonzero(nodes == size)
        for part in np.array_split(members, max(1, len(members) // 500)):
            count[part] = np.sum(collocation_roots(values[:, part], size).real > 0, axis=1)
    return count


def sampled_matrix(values, period, *, differenced=False, cutoff=np.inf):
    """One control period by scipy's matrix exponential on the continuous system with its input.

    State (q, v, f, f', held commands, previous position, previous estimate).
    """
    kp, kd, mass, wn, zeta, delay = (float(v) for v in values)
    steps = int(np.floor(delay / period + 1e-12))
    remainder = max(delay - steps * period, 0.0)
    ideal = np.isinf(wn)
    flow = np.zeros((5, 5))
    flow[0, 1] = 1.0
    if ideal:
        flow[1, 4] = 1.0 / mass
    else:
        flow[1, 2], flow[2, 3] = 1.0 / mass, 1.0
        flow[3, 2], flow[3, 3], flow[3, 4] = -(wn**2), -2.0 * zeta * wn, wn**2
    early, late = (
        scipy.linalg.expm(flow * remainder),
        scipy.linalg.expm(flow * (period - remainder)),
    )
    held = steps + 1
    size = 4 + held + 2
    rows = np.eye(size)
    pole = np.exp(-cutoff * period) if differenced else 0.0
    difference = (rows[0] - rows[-2]) / period
    estimate = pole * rows[-1] + (1.0 - pole) * difference if differenced else rows[1]
    command = -(kp * rows[0] + kd * estimate)
    commands = np.vstack([command, rows[4 : 4 + held]])
    middle = early[:4, :4] @ rows[:4] + np.outer(early[:4, 4], commands[steps + 1])
    end = late[:4, :4] @ middle + np.outer(late[:4, 4], commands[steps])
    end[2:] *= not ideal
    return np.vstack([end, commands[:held], rows[0], estimate])
