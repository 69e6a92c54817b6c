"""Frequency responses of several loops, each with its name and margins, as NumPy arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.compilation.programs import Program
from jaxact.errors import UserError
from jaxact.loops import conversion
from jaxact.parameters import (
    CONTROL_RATE,
    GAIN_SCALE,
    JOINT_DAMPING,
    JOINT_STIFFNESS,
    KD,
    KP,
    MASS,
    OF_JOINT,
    VELOCITY_FILTER,
    WN,
    ZETA,
)
from jaxact.verbs import naming
from jaxact.verbs.margins import of_values
from jaxact.verbs.naming import Loops

if TYPE_CHECKING:
    from jaxact.loops.control_loop import ControlLoop
    from jaxact.plotting.response import LoopResponse

MOST_CURVES = 12
_POINTS = 4000
# Frequencies reach at most this far above the lowest one of a picture.
_DECADES = 1e6


@Program
def _response(loop: Any, w: Any) -> Any:
    from jaxact.analysis.joint.frequency import loop_response, phase

    return loop_response(loop, w), phase(loop, w)


@Program
def _sampled_response(loop: Any, w: Any) -> Any:
    from jaxact.analysis.sampled.search import sampled_response

    return sampled_response(loop, w)


def responses(loop: ControlLoop, *, sampled: bool) -> list[LoopResponse]:
    """Every loop in continuous time and, if asked, as sampled at its control rate.

    Args:
        loop: a joint's, or a batch; at most MOST_CURVES, both kinds together.
        sampled: add the sampled loops.

    Raises:
        UserError: there are more loops than a picture can show.
    """
    loops, velocity = naming.of_pictures(loop), loop.kind.velocity
    groups = _groups(loops)
    count = len(groups) + len(loops) * sampled
    if count > MOST_CURVES:
        raise UserError(
            f"{count} curves are too many for one picture (at most {MOST_CURVES}); "
            "give fewer values"
        )
    found = of_values(loops.values, None)
    at_rate = of_values(loops.values, velocity) if sampled else {}
    drawn = []
    for number, group in enumerate(groups):
        curves = [_continuous(loops, found, group[0], named=sampled)]
        if sampled:
            curves += [_sampled(loops, at_rate, index, velocity) for index in group]
        drawn += [replace(curve, loop=number) for curve in curves]
    return drawn


def _groups(loops: Loops) -> list[list[int]]:
    """Loops that differ in their control rate only, together: one loop in continuous time."""
    names = (KP, KD, GAIN_SCALE, MASS, WN, ZETA, VELOCITY_FILTER, *OF_JOINT)
    rows = zip(
        *(loops.values[name] for name in names), conversion.total_delay(loops.values), strict=True
    )
    groups: dict[tuple[float, ...], list[int]] = {}
    for index, row in enumerate(rows):
        groups.setdefault(tuple(map(float, row)), []).append(index)
    return list(groups.values())


def _label(label: str, kind: str) -> str:
    """A label without the control rate, with what kind of curve it is, "" for nothing to say."""
    words = [word for word in label.split(", ") if word and not word.startswith("control rate")]
    return ", ".join([*words, kind] if kind else words) or "continuous time"


def _frequencies(loops: Loops) -> np.ndarray:
    """The frequencies of all curves of a picture [rad/s], shape (n,)."""
    ends = [_ends(loops.one(index)) for index in range(len(loops))]
    return np.geomspace(min(low for low, _ in ends), max(high for _, high in ends), _POINTS)


def _ends(values: Mapping[str, float]) -> tuple[float, float]:
    """From well below the crossover to well above whatever turns the phase [rad/s]."""
    scale = values[GAIN_SCALE]
    stiffness = abs(scale * values[KP]) + abs(values[JOINT_STIFFNESS])
    stiff = math.sqrt(stiffness / values[MASS])
    damped = abs(scale * values[KD]) / values[MASS]
    delay = conversion.total_delay(values)
    scales = [stiff, damped, 3.0 / delay if delay > 0 else 0.0]
    scales.append(values[WN] if math.isfinite(values[WN]) else 0.0)
    high = 10.0 ** math.ceil(math.log10(3.0 * max(*scales, 1e-6)))
    low = 10.0 ** math.floor(math.log10(0.05 * (stiff or damped or high)))
    return low, min(high, _DECADES * low)


def _continuous(
    loops: Loops, found: dict[str, np.ndarray], index: int, *, named: bool
) -> LoopResponse:
    """The loop in continuous time.

    Args:
        named: say so in its label.
    """
    import jax

    from jaxact.plotting.response import LoopResponse

    values = loops.one(index)
    w = _frequencies(loops)
    with jax.enable_x64(True):
        open_loop, turned = _response(conversion.continuous(values), w)
    return LoopResponse(
        label=_label(loops.labels[index], "continuous time" if named else ""),
        frequency=w,
        open_loop=np.asarray(open_loop),
        phase=np.degrees(np.asarray(turned)) - 180.0,
        margins=_finite(found, index),
        stable=bool(found["stable"][index]),
    )


def _sampled(loops: Loops, found: dict[str, np.ndarray], index: int, velocity: str) -> LoopResponse:
    import jax

    from jaxact.plotting.response import LoopResponse
    from jaxact.plotting.wording import quantity

    values = loops.one(index)
    nyquist = math.pi * values[CONTROL_RATE]
    # One program serves all rates: what is above half of it is computed there, and left out.
    w = np.append(np.minimum(_frequencies(loops), nyquist), nyquist)
    with jax.enable_x64(True):
        found_there = _sampled_response(conversion.sampled(values, velocity), w)
    shown = np.append(w[:-1] < nyquist, True)
    w, open_loop = w[shown], np.asarray(found_there)[shown]
    turned = np.degrees(np.unwrap(np.angle(open_loop)))
    rate = quantity(values[CONTROL_RATE], "Hz")
    return LoopResponse(
        label=_label(loops.labels[index], f"sampled at {rate}"),
        frequency=w,
        open_loop=open_loop,
        phase=turned - 360.0 * round((turned[0] - _beginning(values, w[0])) / 360.0),
        margins=_finite(found, index),
        stable=bool(found["stable"][index]),
        nyquist_frequency=nyquist,
    )


def _beginning(values: Mapping[str, float], w: float) -> float:
    """The phase of the loop in continuous time at a low frequency, but for its lags [deg].

    L(jw) = (kp + kd jw) / (k - m w^2 + c jw)
    """
    lead = math.atan2(values[KD] * w, values[KP])
    own = math.atan2(values[JOINT_DAMPING] * w, values[JOINT_STIFFNESS] - values[MASS] * w * w)
    return math.degrees(lead - own)


def _finite(found: Mapping[str, np.ndarray], index: int) -> dict[str, float]:
    return {name: float(array[index]) for name, array in found.items()}
