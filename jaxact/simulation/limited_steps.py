"""How fine the physics steps of a single joint are by default, so that limits come out right.

Without limits the joint is exact by steps of any length. A limit that acts within a step is of
second order in it, beside what else changes in a step: the force behind an actuator with dynamics,
the force-speed line of a joint that speeds up, its damping and its spring. Each of these has a
rate, and a step is to be a fraction of the time that belongs to it.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np

from jaxact.errors import InexactWarning
from jaxact.parameters import (
    CONTROL_RATE,
    FORCE_LIMIT,
    FORCE_RATE_LIMIT,
    JOINT_DAMPING,
    JOINT_STIFFNESS,
    MASS,
    NO_LOAD_SPEED,
    STALL_FORCE,
    WN,
)

MOST = 64
"""Most steps that a step without limits is cut into."""
# Longest step by the time constants of what happens in it: behind a force limit alone the
# actuator's; with a rate limit or a line the actuator's and the spring's; the line's. Measured:
# trajectories are right to about 0.3 % then.
_BEHIND_A_FORCE_LIMIT, _OF_MOTION, _OF_A_LINE = 0.5, 0.2, 0.06
# With steps this long by the line's time constant a line is said to be coarse.
_COARSE = 0.25


def finer(along: Mapping[str, np.ndarray], steps: np.ndarray) -> np.ndarray:
    """Into how many parts the physics steps of single joints are cut for their limits.

    Args:
        along: parameters of all samples by name, arrays that broadcast.
        steps: physics step without limits for each control rate [s], shape (n,).

    Returns:
        Powers of two up to `MOST`, the finest that a sample of that rate needs, shape (n,); 1
        without limits.
    """
    limits = [np.isfinite(along[name]) for name in (FORCE_LIMIT, FORCE_RATE_LIMIT, STALL_FORCE)]
    if not any(np.any(limit) for limit in limits):
        return np.ones(len(steps), int)
    needed, slope = _rates(along, *limits)
    needed, slope = (_by_control_rate(rates, along[CONTROL_RATE]) for rates in (needed, slope))
    wanted = np.ceil(np.log2(np.maximum(needed * steps, 1.0)) - 1e-9)
    parts = np.minimum(2.0**wanted, MOST).astype(int)
    coarse = slope * steps / parts
    if np.any(coarse > _COARSE):
        warnings.warn(
            f"the torque-speed line is as fast as {coarse.max():.2g} times a physics step of 1/"
            f"{MOST} of a control period; give a shorter `physics_step` to see it in full",
            InexactWarning,
            stacklevel=2,
        )
    return parts


def _rates(along: Mapping[str, np.ndarray], force, rate, line) -> tuple[np.ndarray, np.ndarray]:
    """Steps per second that each sample needs, and the rate of its line [1/s]."""
    mass, wn = along[MASS], along[WN]
    wn = np.where(np.isfinite(wn), wn, 0.0)
    damped = np.abs(along[JOINT_DAMPING]) / mass
    sprung = np.sqrt(np.abs(along[JOINT_STIFFNESS]) / mass)
    falls = np.where(line, np.where(line, along[STALL_FORCE], 0.0) / along[NO_LOAD_SPEED], 0.0)
    slope = falls / mass
    moving = np.maximum(np.maximum(wn, damped), sprung) / _OF_MOTION
    needed = np.where(rate | line, np.maximum(moving, slope / _OF_A_LINE), 0.0)
    return np.maximum(needed, np.where(force, wn / _BEHIND_A_FORCE_LIMIT, 0.0)), slope


def _by_control_rate(values: np.ndarray, control_rate: np.ndarray) -> np.ndarray:
    """The largest of the values that occur with each control rate, shape (n,)."""
    flat = control_rate.ravel()
    if flat.size == 1:
        return np.full(1, np.max(values))
    every, rates = (array.ravel() for array in np.broadcast_arrays(values, control_rate))
    found, where = np.unique(rates, return_inverse=True)
    largest = np.zeros(found.size)
    np.maximum.at(largest, where, every)
    return largest[np.searchsorted(found, flat)]
