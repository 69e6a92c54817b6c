"""Margins of any number of loops, straight from the margins, by one compiled program."""

import jax
import numpy as np

from jaxact.analysis.joint.frequency import JointLoop
from jaxact.analysis.joint.margins import margins
from jaxact.tuning.joint.ensemble import PARAMETERS

_MARGINS = jax.jit(margins)
_SIZE = 512


def margins_of(members, kp, kd):
    """Of all members, NumPy; gains that broadcast with them."""
    plant = (getattr(members, name) for name in PARAMETERS)
    rows = np.broadcast_arrays(np.float64(kp), np.float64(kd), *plant)
    number = rows[0].size
    whole = _SIZE * -(-number // _SIZE)
    padded = [np.pad(row, (0, whole - number), mode="edge") for row in rows]
    with jax.enable_x64(True):
        parts = [_MARGINS(JointLoop(*(row[i : i + _SIZE] for row in padded)))
                 for i in range(0, whole, _SIZE)]  # fmt: skip
    return jax.tree.map(lambda *a: np.concatenate(a)[:number], *parts)


def largest_peaks(members, kp, kd):
    """max(Ms, Mt) of each member, all of which are stable."""
    found = margins_of(members, kp, kd)
    assert np.all(found.stable)
    return np.maximum(found.sensitivity_peak, found.complementary_peak)
