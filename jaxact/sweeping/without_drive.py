"""The same loop twice: bare, as a simulator without actuators has it, and with its drive."""

from __future__ import annotations

import math

import numpy as np

from jaxact.loops.samples import Samples, explicit
from jaxact.loops.specification import Specification
from jaxact.parameters import (
    COMMAND_RESOLUTION,
    DELAY,
    FORCE_RATE_LIMIT,
    INF,
    MEASUREMENT_DELAY,
    NO_LOAD_SPEED,
    OUTPUT_DELAY,
    POLICY_RATE,
    POSITION_BIAS,
    POSITION_BIAS_WALK,
    POSITION_NOISE,
    POSITION_RESOLUTION,
    SETPOINT_DELAY,
    STALL_FORCE,
    VELOCITY_BIAS,
    VELOCITY_BIAS_WALK,
    VELOCITY_FILTER,
    VELOCITY_NOISE,
    VELOCITY_RESOLUTION,
    WN,
    ZETA,
    base,
)

# An ideal actuator, no delays, perfect sensors and converters. What limits the force is the robot's
# and stays.
PERFECT = {
    WN: INF, ZETA: 1.0, DELAY: 0.0, SETPOINT_DELAY: 0.0, MEASUREMENT_DELAY: 0.0,
    OUTPUT_DELAY: 0.0, POSITION_RESOLUTION: 0.0, VELOCITY_RESOLUTION: 0.0,
    COMMAND_RESOLUTION: 0.0, POSITION_NOISE: 0.0, VELOCITY_NOISE: 0.0, POSITION_BIAS: 0.0,
    VELOCITY_BIAS: 0.0, POSITION_BIAS_WALK: 0.0, VELOCITY_BIAS_WALK: 0.0,
    VELOCITY_FILTER: INF, FORCE_RATE_LIMIT: INF, STALL_FORCE: INF, NO_LOAD_SPEED: INF,
    POLICY_RATE: INF,
}  # fmt: skip


def pair(specification: Specification) -> Samples:
    """Two loops: the nominal one of a specification without its drive, and the same as it is.

    Args:
        specification: checked; both have its gains, setpoint, push and random numbers.
    """
    columns = {}
    for key, value in specification.nominal.items():
        name, some = base(key), "@" in key
        if name in PERFECT:
            # of some joints only: nothing of their own, so that what holds for all counts
            columns[key] = np.array([math.nan if some else PERFECT[name], value])
    return explicit(specification, columns)
