"""`jaxact.boundary`: the exact stability boundary of a joint's loop in the plane of its gains."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from jaxact.analysis.boundary.boundary import (
    BoundaryCurve,
    continuous_boundary,
    sampled_boundary,
)
from jaxact.errors import UserError, shown
from jaxact.loops import conversion
from jaxact.loops.control_loop import ControlLoop, demand
from jaxact.parameters import (
    CONTROL_RATE,
    GAIN_SCALE,
    KD,
    KP,
    MASS,
    OF_JOINT,
    VELOCITY_FILTER,
    WN,
    ZETA,
)

Window = tuple[float, float]

# The window where none is given: so far around the loop's own gains, to either side.
_AROUND = 100.0


def boundary(
    loop: ControlLoop, *, kp: Window | None = None, kd: Window | None = None, sampled: bool = False
) -> list[BoundaryCurve]:
    """All curves of gains at which a root of the loop is marginal, the D-partition.

        for curve in jaxact.boundary(jaxact.joint(actuator="hyq", delay=1e-3)):
            axes.plot(curve.kp, curve.kd)

    Args:
        loop: a single joint's; what its gains are matters for the default window only.
        kp, kd: (low, high) of the window of gains, without `gain_scale` [N/m], [N s/m]; where
            low > 0 it is sampled evenly in its logarithm. None: a hundredth to a hundred times the
            loop's own.
        sampled: of the loop as its controller samples it, else of the one in continuous time.

    Returns:
        The curves; `separates` of each says whether it bounds the stable region.

    Raises:
        UserError: a batch of loops, a robot, what is not a loop, or an empty window.
    """
    demand(loop)
    if loop.kind.plant is not None:
        raise UserError("the boundary in closed form is that of a joint; sweep a robot's gains")
    conversion.linear_specification(loop)  # what does not fit is said here
    own = conversion.one(loop)
    scale = own[GAIN_SCALE]
    if not scale:
        raise UserError(f"`{GAIN_SCALE}` = 0: no gains arrive at the joint; give another one")
    # The curves are of the gains that arrive at the joint.
    windows = {KP: _window(KP, kp, own[KP]), KD: _window(KD, kd, own[KD])}
    ranges: dict[str, Any] = {
        f"{name}_range": (scale * low, scale * high) for name, (low, high) in windows.items()
    }
    ranges |= {name: own[name] for name in (VELOCITY_FILTER, *OF_JOINT)}
    plant = own[MASS], own[WN], own[ZETA], conversion.total_delay(own)
    if sampled:
        how = {"velocity": loop.kind.velocity, **ranges}
        curves = sampled_boundary(*plant, 1.0 / own[CONTROL_RATE], **how)
    else:
        curves = continuous_boundary(*plant, **ranges)
    return [replace(one, kp=one.kp / scale, kd=one.kd / scale) for one in curves]


def _window(name: str, given: Window | None, own: float) -> Window:
    if given is None:
        if not own > 0.0:
            raise UserError(f"{name} = {own:g}: give the window of {name} as (low, high)")
        return own / _AROUND, own * _AROUND
    try:
        low, high = map(float, given)
    except (TypeError, ValueError):
        low = high = float("nan")
    if not (-float("inf") < low < high < float("inf")):
        raise UserError(
            f"{name} = {shown(given)}: a window is (low, high), both finite, low < high"
        )
    return low, high
