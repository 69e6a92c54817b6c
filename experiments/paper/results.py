"""Everything that the pictures and the claims are made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import exact_margins as exact
import numpy as np
import pade
import simulated
import study
from study import Cases

# Frequencies of the sensitivity's curves and of its simulated points [rad/s].
_LOW, _HIGH, _CURVE, _MARKS = 3.0, 1000.0, 500, 25
_TRIPLED = 3.0
_STEP_DURATION = 1.0  # [s]
# Actuators faster than any of the study, up to where they nearly are ideal [rad/s].
FASTER = 800.0 * 2.0 ** np.arange(6)
CONTROL_RATES = (250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)  # [Hz]
# The same joint with kp/m and kd/m changed so that it is this many times as fast [-].
SPEEDS = np.geomspace(0.01, 4.0, 53)
INERTIA = 0.02  # of a rotary joint in the mass's place [kg m^2]
PADE_ORDERS = (1, 2)

Margins = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Results:
    """The numbers; indices are z damping ratios, d delays, n natural frequencies, r robots.

    Attributes:
        natural_frequency: of the curves [rad/s], shape (n,).
        marked: which of them are simulated, indices, shape (m,).
        robot_frequency: natural frequencies of the robots' actuators [rad/s], shape (r,).
        curves: margins of the curves, "continuous" and "sampled", each array of shape (z, d, n).
        robots: the same of the robots, shape (r, d).
        boundary: natural frequency at which the nominal loops become stable [rad/s], "continuous"
            and "sampled", shape (z, d); NaN where all of a curve is stable.
        tripled_boundary: the same of the tripled gains.
        simulated_curves: "gain_margin" [-] and "delay_margin" [s] by bisection, shape (z, d, m).
        simulated_robots: the same of the robots, shape (r, d).
        growth_rate: of the robots, simulated at the nominal and at the tripled gains [1/s], (r, d).
        tripled: continuous margins of the robots at the tripled gains, shape (r, d).
        rotary: continuous margins of the robots where `INERTIA` turns, shape (r, d).
        faster: continuous margins over `FASTER`, shape (z, d, natural frequencies).
        rates: sampled gain margins over `CONTROL_RATES`, shape (r, d, rates).
        speeds: frequency of the sensitivity's peak over `SPEEDS` [rad/s], shape (r, d, speeds).
        pade: gain margins by `PADE_ORDERS`, shape (orders, r, d).
        frequency: of the sensitivity [rad/s], shape (k,).
        sensitivity: |S| [-], "continuous" and "sampled", shape (z, d, s, k) with s natural
            frequencies.
        measured_frequency: of the simulated sensitivity [rad/s], shape (j,).
        measured_sensitivity: |S| from simulated step responses [-], shape (z, d, s, j).
        measured_reference: the exact |S| of the sampled loop there [-], shape (z, d, s, j).
        wide_frequency: from where the actuator does not matter up to Nyquist's [rad/s], shape (f,).
        robot_sensitivity: S of the robots, continuous, complex, shape (r, d, f).
        steps: positions after a unit step, simulated [m], over the marked frequencies at the
            nominal delay, shape (z, m, ticks).
        shown_steps: the same over `study.SHOWN`, shape (z, s, ticks).
        robot_steps: the same of the robots, shape (r, d, ticks).
    """

    natural_frequency: np.ndarray
    marked: np.ndarray
    robot_frequency: np.ndarray
    curves: Mapping[str, Margins]
    robots: Mapping[str, Margins]
    boundary: Mapping[str, np.ndarray]
    tripled_boundary: Mapping[str, np.ndarray]
    simulated_curves: Margins
    simulated_robots: Margins
    growth_rate: Mapping[str, np.ndarray]
    tripled: Margins
    rotary: Margins
    faster: Margins
    rates: np.ndarray
    speeds: np.ndarray
    pade: np.ndarray
    frequency: np.ndarray
    sensitivity: Mapping[str, np.ndarray]
    measured_frequency: np.ndarray
    measured_sensitivity: np.ndarray
    measured_reference: np.ndarray
    wide_frequency: np.ndarray
    robot_sensitivity: np.ndarray
    steps: np.ndarray
    shown_steps: np.ndarray
    robot_steps: np.ndarray


def compute() -> Results:
    """All of it, in float64."""
    wn = study.frequencies()
    curves, robots = study.curves(wn), study.robots()
    marked = np.arange(0, len(wn), study.MARKED_EVERY)
    points = study.curves(wn[marked])
    margins = {
        "continuous": _together(exact.continuous_margins, curves, robots),
        "sampled": _together(exact.sampled_margins, curves, robots),
    }
    bisected = {
        "gain_margin": _together(_named(simulated.gain_margins), points, robots),
        "delay_margin": _together(_named(simulated.delay_margins), points, robots),
    }
    of_curves = {kind: found[0] for kind, found in margins.items()}
    return Results(
        natural_frequency=wn,
        marked=marked,
        robot_frequency=np.asarray(robots.natural_frequency)[:, 0],
        curves=of_curves,
        robots={kind: found[1] for kind, found in margins.items()},
        boundary={kind: _reaching(wn, found, 1.0) for kind, found in of_curves.items()},
        tripled_boundary={
            kind: _reaching(wn, found, _TRIPLED) for kind, found in of_curves.items()
        },
        simulated_curves={name: found[0][""] for name, found in bisected.items()},
        simulated_robots={name: found[1][""] for name, found in bisected.items()},
        growth_rate={
            "nominal": simulated.growth_rates(robots),
            "tripled": simulated.growth_rates(robots, factor=_TRIPLED),
        },
        **_other_loops(robots),
        **_sensitivities(robots),
        **_steps(points, robots),
    )


def _other_loops(robots: Cases) -> dict[str, Any]:
    """Margins of loops with other gains, masses, control rates and actuators."""
    ratio = INERTIA / study.MASS
    wide = robots.along(len(SPEEDS))
    many = robots.along(len(CONTROL_RATES))
    speeds = exact.continuous_margins(wide, study.KP * SPEEDS**2, study.KD * SPEEDS)
    return {
        "tripled": exact.continuous_margins(robots, _TRIPLED * study.KP, _TRIPLED * study.KD),
        "rotary": exact.continuous_margins(robots, ratio * study.KP, ratio * study.KD, INERTIA),
        "faster": exact.continuous_margins(study.curves(FASTER)),
        "rates": exact.sampled_margins(many, np.array(CONTROL_RATES))["gain_margin"],
        "speeds": speeds["sensitivity_peak_frequency"],
        "pade": np.stack([pade.gain_margins(robots, order) for order in PADE_ORDERS]),
    }


def _sensitivities(robots: Cases) -> dict[str, Any]:
    shown = study.curves(np.array(study.SHOWN))
    w = np.geomspace(_LOW, _HIGH, _CURVE)
    w_marks = np.geomspace(_LOW, _HIGH, _MARKS)
    wide = np.geomspace(0.1, np.pi * study.CONTROL_RATE, 4000)
    sampled = np.abs(exact.sampled_sensitivity(shown, np.concatenate([w, w_marks])))
    return {
        "frequency": w,
        "sensitivity": {
            "continuous": np.abs(exact.continuous_sensitivity(shown, w)),
            "sampled": sampled[..., :_CURVE],
        },
        "measured_frequency": w_marks,
        "measured_sensitivity": simulated.sensitivity(shown, w_marks),
        "measured_reference": sampled[..., _CURVE:],
        "wide_frequency": wide,
        "robot_sensitivity": exact.continuous_sensitivity(robots, wide),
    }


def _steps(points: Cases, robots: Cases) -> dict[str, np.ndarray]:
    """Positions after a step, simulated."""
    nominal = points.at_delay(study.NOMINAL_DELAY)
    shown = study.curves(np.array(study.SHOWN)).at_delay(study.NOMINAL_DELAY)
    parts = (nominal, shown, robots)
    position = simulated.step_responses(study.joined(*parts), _STEP_DURATION)[0]
    ends = np.cumsum([part.flat().shape[0] for part in parts])[:-1]
    pieces = (
        piece.reshape((*part.shape, -1))
        for part, piece in zip(parts, np.split(position, ends), strict=True)
    )
    return dict(zip(("steps", "shown_steps", "robot_steps"), pieces, strict=True))


def _reaching(wn: np.ndarray, margins: Margins, factor: float) -> np.ndarray:
    """Natural frequency at which the curves reach a gain margin [rad/s], shape (z, d).

    From the signed distance to the boundary, which passes through zero smoothly; NaN where a curve
    never has a smaller margin.
    """
    distance = margins["log_gain_to_boundary"] - np.log(factor)
    found = np.full(distance.shape[:2], np.nan)
    for place in np.ndindex(found.shape):
        row = distance[place]
        below = np.flatnonzero(row <= 0.0)
        if below.size and below[-1] + 1 < len(row):
            last = below[-1]
            pair = slice(last, last + 2)
            found[place] = np.exp(np.interp(0.0, row[pair], np.log(wn[pair])))
    return found


def _named(function: Callable[[Cases], np.ndarray]) -> Callable[[Cases], Margins]:
    return lambda cases: {"": function(cases)}


def _together(
    function: Callable[[Cases], Margins], first: Cases, second: Cases
) -> tuple[Margins, Margins]:
    """One call for two groups of loops, so that it is compiled once."""
    found = function(study.joined(first, second))
    count = first.flat().shape[0]
    return (
        {name: array[:count].reshape(first.shape) for name, array in found.items()},
        {name: array[count:].reshape(second.shape) for name, array in found.items()},
    )
