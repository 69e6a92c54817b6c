"""Margins and frequency responses of loops given on the command line, as NumPy arrays."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.cli._loops import Loops
from jaxact.errors import UserError

if TYPE_CHECKING:
    from jaxact.plot.response import LoopResponse
    from jaxact.programs import Program

MOST_CURVES = 12
_POINTS = 4000
# Frequencies reach at most this far above the lowest one of a picture.
_DECADES = 1e6
# Numbers of loops and delays in control periods are rounded up to multiples of these: a program
# that is kept then serves the next command too, and computing takes far less than compiling.
_FEW, _MANY = 16, 64
_STEPS = 16


def margins(loops: Loops) -> dict[str, np.ndarray]:
    """All margins of every loop in continuous time, phase margins in degrees; shape (n,) each.

    With `spectral_abscissa`, the real part of the rightmost root [1/s].
    """
    import jax

    with jax.enable_x64(True):
        found, root = _compiled()(_joint_loop(_filled_up(loops.values, len(loops))))
        arrays = _arrays(found, len(loops))
        arrays["spectral_abscissa"] = np.asarray(root).real[: len(loops)]
    return _in_degrees(arrays)


def sampled_margins(loops: Loops, velocity: str) -> dict[str, np.ndarray]:
    """The same of every loop as sampled at its control rate.

    velocity: "sampled" or "differenced"

    `spectral_abscissa` is log(spectral radius) / T, to be compared with the continuous one.
    """
    import jax

    from jaxact.sampled import delay_steps

    values = loops.values
    steps = delay_steps(_total_delay(values), 1.0 / values["control_rate"])
    # Long delays take long to compute, so that one loop is not to wait for others.
    filled = _filled_up(values, len(loops)) if steps <= _STEPS else values
    with jax.enable_x64(True):
        found = _compiled_sampled(_rounded_up(steps, _STEPS))(_sampled_loop(filled, velocity))
        arrays = _arrays(found, len(loops))
    with np.errstate(divide="ignore"):
        arrays["spectral_abscissa"] = np.log(arrays["spectral_radius"]) * values["control_rate"]
    return _in_degrees(arrays)


def _rounded_up(number: int, unit: int) -> int:
    """To a multiple of the unit, which is at least 1 unit."""
    return unit * max(1, -(-number // unit))


def _filled_up(values: Mapping[str, np.ndarray], number: int) -> dict[str, np.ndarray]:
    """Parameters of the loops, the last of which is repeated up to a round number of loops."""
    more = _rounded_up(number, _FEW if number <= _FEW else _MANY) - number
    return {name: np.pad(array, (0, more), "edge") for name, array in values.items()}


def _arrays(found: Any, number: int) -> dict[str, np.ndarray]:
    """The figures of the first loops, by name; shape (number,) each."""
    return {one.name: np.asarray(getattr(found, one.name))[:number] for one in fields(found)}


@functools.cache
def _compiled() -> Program:
    from jaxact.margins import margins as margins_of
    from jaxact.programs import Program
    from jaxact.roots import rightmost_root

    return Program(lambda: lambda loop: (margins_of(loop), rightmost_root(loop)), "margins, root")


@functools.cache
def _compiled_sampled(steps: int) -> Program:
    from jaxact.programs import Program
    from jaxact.sampled_margins import sampled_margins as margins_of

    function = functools.partial(margins_of, max_delay_steps=steps)
    return Program(lambda: function, ("sampled margins", steps))


@functools.cache
def _compiled_response() -> Program:
    from jaxact.frequency import loop_response, phase
    from jaxact.programs import Program

    return Program(lambda: lambda loop, w: (loop_response(loop, w), phase(loop, w)), "response")


@functools.cache
def _compiled_sampled_response() -> Program:
    from jaxact.programs import Program
    from jaxact.sampled_search import sampled_response

    return Program(lambda: sampled_response, "sampled response")


def responses(loops: Loops, *, sampled: bool, velocity: str) -> list[LoopResponse]:
    """Every loop in continuous time and, if asked, as sampled at its control rate.

    loops: at most MOST_CURVES, both kinds together
    sampled: add the sampled loops
    velocity: "sampled" or "differenced", of the sampled loops

    Raises UserError where there are more loops than a picture can show.
    """
    groups = _groups(loops)
    count = len(groups) + len(loops) * sampled
    if count > MOST_CURVES:
        raise UserError(
            f"{count} curves are too many for one picture (at most {MOST_CURVES}); "
            "give fewer values"
        )
    found = margins(loops)
    at_rate = sampled_margins(loops, velocity) if sampled else {}
    drawn = []
    for number, group in enumerate(groups):
        curves = [_continuous(loops, found, group[0], named=sampled)]
        if sampled:
            curves += [_sampled(loops, at_rate, index, velocity) for index in group]
        drawn += [replace(curve, loop=number) for curve in curves]
    return drawn


def _groups(loops: Loops) -> list[list[int]]:
    """Loops that differ in their control rate only, together: one loop in continuous time."""
    names = ("kp", "kd", "mass", "wn", "zeta", "velocity_filter")
    rows = zip(*(loops.values[name] for name in names), _total_delay(loops.values), strict=True)
    groups: dict[tuple[float, ...], list[int]] = {}
    for index, row in enumerate(rows):
        groups.setdefault(tuple(map(float, row)), []).append(index)
    return list(groups.values())


def _label(label: str, kind: str) -> str:
    """A label without the control rate, with what kind of curve it is, "" for nothing to say."""
    words = [word for word in label.split(", ") if word and not word.startswith("control rate")]
    return ", ".join([*words, kind] if kind else words) or "continuous time"


def _in_degrees(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return arrays | {"phase_margin": np.degrees(arrays["phase_margin"])}


def _total_delay(values: Mapping[str, Any]) -> Any:
    return values["delay"] + values["measurement_delay"] + values["output_delay"]


def _joint_loop(values: Mapping[str, Any]) -> Any:
    """The linear loops in continuous time; to be called where float64 is on."""
    import jax.numpy as jnp

    from jaxact.frequency import JointLoop

    names = ("kp", "kd", "mass", "wn", "zeta")
    cutoff = values["velocity_filter"]
    return JointLoop(
        *(jnp.asarray(values[name]) for name in names),
        jnp.asarray(_total_delay(values)),
        velocity_filter=jnp.asarray(cutoff) if np.isfinite(cutoff).any() else None,
    )


def _sampled_loop(values: Mapping[str, Any], velocity: str) -> Any:
    """The linear sampled loops; to be called where float64 is on."""
    import jax.numpy as jnp

    from jaxact.sampled import SampledLoop

    names = ("kp", "kd", "mass", "wn", "zeta")
    return SampledLoop(
        *(jnp.asarray(values[name]) for name in names),
        delay=jnp.asarray(_total_delay(values)),
        control_period=jnp.asarray(1.0 / values["control_rate"]),
        velocity_filter=jnp.asarray(values["velocity_filter"]),
        velocity=velocity,
    )


def _frequencies(loops: Loops) -> np.ndarray:
    """The frequencies of all curves of a picture [rad/s], shape (n,)."""
    ends = [_ends(loops.one(index)) for index in range(len(loops))]
    return np.geomspace(min(low for low, _ in ends), max(high for _, high in ends), _POINTS)


def _ends(values: Mapping[str, float]) -> tuple[float, float]:
    """From well below the crossover to well above whatever turns the phase [rad/s]."""
    stiff = math.sqrt(abs(values["kp"]) / values["mass"])
    damped = abs(values["kd"]) / values["mass"]
    delay = _total_delay(values)
    scales = [stiff, damped, 3.0 / delay if delay > 0 else 0.0]
    scales.append(values["wn"] if math.isfinite(values["wn"]) else 0.0)
    high = 10.0 ** math.ceil(math.log10(3.0 * max(*scales, 1e-6)))
    low = 10.0 ** math.floor(math.log10(0.05 * (stiff or damped or high)))
    return low, min(high, _DECADES * low)


def _continuous(
    loops: Loops, found: dict[str, np.ndarray], index: int, *, named: bool
) -> LoopResponse:
    """The loop in continuous time.

    named: say so in its label
    """
    import jax

    from jaxact.plot.response import LoopResponse

    values = loops.one(index)
    w = _frequencies(loops)
    with jax.enable_x64(True):
        open_loop, turned = _compiled_response()(_joint_loop(values), w)
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

    from jaxact.plot.response import LoopResponse
    from jaxact.plot.wording import quantity

    values = loops.one(index)
    nyquist = math.pi * values["control_rate"]
    # One program serves all rates: what is above half of it is computed there, and left out.
    w = np.append(np.minimum(_frequencies(loops), nyquist), nyquist)
    with jax.enable_x64(True):
        found_there = _compiled_sampled_response()(_sampled_loop(values, velocity), w)
    shown = np.append(w[:-1] < nyquist, True)
    w, open_loop = w[shown], np.asarray(found_there)[shown]
    turned = np.degrees(np.unwrap(np.angle(open_loop)))
    rate = quantity(values["control_rate"], "Hz")
    return LoopResponse(
        label=_label(loops.labels[index], f"sampled at {rate}"),
        frequency=w,
        open_loop=open_loop,
        phase=turned - 360.0 * round((turned[0] + 180.0) / 360.0),
        margins=_finite(found, index),
        stable=bool(found["stable"][index]),
        nyquist_frequency=nyquist,
    )


def _finite(found: Mapping[str, np.ndarray], index: int) -> dict[str, float]:
    return {name: float(array[index]) for name, array in found.items()}
