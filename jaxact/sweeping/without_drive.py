"""The same loop twice: bare, as a simulator without actuators has it, and with its drive."""

from __future__ import annotations

import math

import numpy as np

from jaxact.loops.samples import Samples, explicit
from jaxact.loops.specification import Specification
from jaxact.parameters import INF, base

# An ideal actuator, no delays, perfect sensors and converters. What limits the force is the robot's
# and stays.
PERFECT = {
    "wn": INF, "zeta": 1.0, "delay": 0.0, "setpoint_delay": 0.0, "measurement_delay": 0.0,
    "output_delay": 0.0, "position_resolution": 0.0, "velocity_resolution": 0.0,
    "command_resolution": 0.0, "position_noise": 0.0, "velocity_noise": 0.0, "position_bias": 0.0,
    "velocity_bias": 0.0, "position_bias_walk": 0.0, "velocity_bias_walk": 0.0,
    "velocity_filter": INF, "force_rate_limit": INF, "stall_force": INF, "no_load_speed": INF,
    "policy_rate": INF,
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
