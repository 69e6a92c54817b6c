"""The plants that the gains of a joint are tuned for, from its loop."""

from __future__ import annotations

import numpy as np

from jaxact.errors import UserError
from jaxact.loops import conversion
from jaxact.loops.control_loop import ControlLoop
from jaxact.parameters import (
    CONTROL_RATE,
    GAIN_SCALE,
    MASS,
    MEASUREMENT_DELAY,
    OF_JOINT,
    OUTPUT_DELAY,
    SETPOINT_DELAY,
    VELOCITY_FILTER,
    WN,
    ZETA,
)
from jaxact.tuning.joint.ensemble import Ensemble, Sampling, ensemble
from jaxact.verbs import naming


def nominal_of(loop: ControlLoop, sampled: bool) -> Ensemble:
    """The plant of a joint, as an ensemble of one."""
    own = conversion.one(loop)
    period = 1.0 / own[CONTROL_RATE] if sampled else None
    sampling = Sampling(period, loop.kind.velocity, own[VELOCITY_FILTER])
    label = naming.loop_name(conversion.linear_specification(loop))
    joint = (own[name] for name in OF_JOINT)
    return ensemble(own[MASS], own[WN], own[ZETA], conversion.total_delay(own), *joint,
                    sampling=sampling, names=(label,), output_delay=own[OUTPUT_DELAY],
                    measurement_delay=own[MEASUREMENT_DELAY])  # fmt: skip


def demand_at_once(loops: ControlLoop) -> None:
    """Setpoints that arrive at once, of loops whose time is simulated.

    Raises:
        UserError: otherwise.
    """
    if np.any(loops.parameters[SETPOINT_DELAY]):
        raise UserError(
            "`setpoint_delay`: settling and tracking are of setpoints that arrive at once; leave it"
            " out"
        )


def drawn_of(loops: ControlLoop, loop: ControlLoop, sampling: Sampling, *, timed: bool) -> Ensemble:
    """Other plants for the gains of a loop: one whose gains count more is a lighter one.

    Args:
        loops: of a joint, a batch.
        loop: whose gains are tuned.
        sampling: of the controller of all.
        timed: whether they are simulated.

    Raises:
        UserError: loops of a robot, or that cannot be simulated together.
    """
    if loops.kind.plant is not None:
        raise UserError("`uncertainty`: loops of a robot; give ranges, or an identified drive")
    every = loops.broadcast().parameters
    own = {name: np.ravel(np.asarray(value, float)) for name, value in every.items()}
    if timed:
        demand_at_once(loops)
    _demand_alike(loops, loop, sampling)
    if timed and np.any(own[MEASUREMENT_DELAY] != float(loop.parameters[MEASUREMENT_DELAY])):
        raise UserError(
            "`uncertainty`: loops whose measurement_delay is not that of the loop itself; give all"
            " the same one where the objective is simulated"
        )
    share = own[GAIN_SCALE] / float(loop.parameters[GAIN_SCALE])
    joint = (own[name] / share for name in OF_JOINT)
    number = len(np.broadcast_arrays(*own.values())[0])
    mass = np.broadcast_to(own[MASS] / share, number)
    return ensemble(mass, own[WN], own[ZETA], conversion.total_delay(own), *joint,
                    sampling=sampling, names=tuple(f"draw {i}" for i in range(number)))  # fmt: skip


def _demand_alike(loops: ControlLoop, loop: ControlLoop, sampling: Sampling) -> None:
    """Loops that say how they are sampled are sampled as the loop itself is.

    Raises:
        UserError: otherwise.
    """
    names = [VELOCITY_FILTER, *([] if sampling.control_period is None else [CONTROL_RATE])]
    differ = [
        name
        for name in names
        if name in loops.values and np.any(loops.values[name] != float(loop.parameters[name]))
    ]
    if loops.kind.velocity not in ("sampled", sampling.velocity):
        differ.append("velocity")
    if differ:
        raise UserError(
            f"`uncertainty`: loops whose {differ[0]} is not that of the loop itself; give all the"
            " same one, and tune for each by itself"
        )
