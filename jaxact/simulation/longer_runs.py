"""Samples that run longer than the duration, and what cannot be said of them.

Samples of one kernel all run for the same number of control periods, that of the fastest control
rate among them. The integrals of a slower one stop with the duration; what is largest or last over
the whole rollout (overshoot, rise, settling, peak force) is known where it was over by then.
"""

from __future__ import annotations

import numpy as np

from jaxact.simulation.metrics import SEGMENTS, SETTLED
from jaxact.simulation.rollout import whole_ticks
from jaxact.status import Verdict


def ran_longer(control_rate: np.ndarray, duration: float, ticks: int) -> np.ndarray:
    """Which samples run for more control periods than they would alone.

    Args:
        control_rate: of the samples [Hz], any shape.
        duration: to be simulated [s].
        ticks: control periods that are.
    """
    # No whole number of segments is shorter than that of the rate, rounded up.
    if ticks <= whole_ticks(duration, 1.0 / float(np.min(control_rate))):
        return np.zeros(np.shape(control_rate), bool)
    own = SEGMENTS * np.maximum(np.ceil(duration * control_rate / SEGMENTS - 1e-9), 1.0)
    return np.asarray(own < ticks)


def within(
    rows: dict[str, np.ndarray], longer: np.ndarray, duration: float, *, calm: bool
) -> dict[str, np.ndarray]:
    """Metrics with NaN for what may have happened only after the duration.

    A response that settled in time had risen before, and overshot by more than what counts as
    settled before, too. One that never overshot did not in time either.

    Args:
        rows: metrics by name, shape (n,) each.
        longer: from `ran_longer`, shape (n,).
        duration: [s].
        calm: whether nothing but the step moves the loops: no push, no noise, no motion.
    """
    settled = rows["settling_time"] <= duration
    overshoot = rows["overshoot"]
    known = {
        "settling_time": settled,
        "rise_time": settled,
        "overshoot": (settled & (overshoot > SETTLED)) | (overshoot == 0.0),
        "peak_force": settled & (rows["verdict"] == Verdict.STABLE) & calm,
    }
    parted = {
        name: np.where(longer & ~when, np.nan, rows[name]).astype(rows[name].dtype)
        for name, when in known.items()
    }
    return rows | parted
