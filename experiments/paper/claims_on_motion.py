"""Claims on the model (section 2), on step responses (3) and on the sensitivity (3.3)."""

from __future__ import annotations

import numpy as np
import study
from claim import (
    KINDS,
    Claim,
    by_actuator,
    by_damping,
    number,
    of_actuators,
    percent,
    reaching,
)  # fmt: skip

from results import INERTIA, SPEEDS, Results

# What counts as a small difference: of the step's height, of a motion's length, of |S| [-].
_SMALL_STEP, _SMALL_MOTION, _SMALL = 0.1, 0.05, 0.05
_MOTION = 0.5  # duration of the planned motion [s]
_PEAK, _NEAR = 40.0, 0.3  # the study's frequency [rad/s], and what counts as near it [-]
_LOW, _HIGH = 10.0, 1000.0  # what counts as low and as high frequencies [rad/s]
_NOISE = 0.1  # what counts as similar noise [-]


def on_model(results: Results) -> list[Claim]:
    """Section 2."""
    same = []
    for name in ("gain_margin", "phase_margin", "delay_margin", "sensitivity_peak"):
        linear, rotary = results.robots["continuous"][name], results.rotary[name]
        same.append(np.isclose(rotary, linear, rtol=1e-9, atol=0.0))
    ratio = INERTIA / study.MASS
    return [
        Claim(
            "2.1",
            "both closed-loop dynamics can be coarsely approximated by a second order system with "
            "delay",
            unjudged="it needs the measured responses of both actuators, which the study cites",
        ),
        Claim(
            "2.1",
            "the findings below also qualitatively translate to rotary joints",
            "gains in proportion to the inertia",
            of_actuators(np.all(same, axis=0)),
            (
                f"{INERTIA:g} kg m² with {ratio * study.KP:.3g} N m/rad and {ratio * study.KD:.3g} "
                "N m s/rad have the margins and the sensitivity peak of the study's joint, to "
                "rounding.",
            ),
        ),
    ]


def on_steps(results: Results) -> list[Claim]:
    """Section 3, figure 2."""
    wn = results.natural_frequency
    rise = np.array([[rise_time(float(w), zeta) for w in wn] for zeta in study.DAMPING_RATIOS])
    bare = results.robot_steps[0, 0]
    off = np.max(np.abs(results.robot_steps - bare), axis=-1)
    of_curves = np.max(np.abs(results.steps - bare), axis=-1)
    marked = wn[results.marked]
    planned = np.array([[_planned(step) for step in one] for one in results.robot_steps])
    apart = np.max(np.abs(planned - planned[0, 0]), axis=-1)
    limits = [[reaching(marked, one, _SMALL_STEP)] for one in of_curves]
    return [
        Claim(
            "3",
            "the force response significantly varies in terms of rise times",
            "by more than a factor of two over the range",
            tuple(
                (f"ζ {zeta:g}", "", bool(one.max() > 2.0 * one.min()))
                for zeta, one in zip(study.DAMPING_RATIOS, rise, strict=True)
            ),
            (
                by_damping(
                    f"rise time of the force, 10 to 90 %, at {wn[0]:g} / {wn[-1]:g} rad/s",
                    1e3 * rise[:, [0, -1]], "ms",
                ),
            ),
        ),
        Claim(
            "3",
            "the differences between various actuator dynamics become small unless they are very "
            "slow",
            f"the joint is never further than {percent(_SMALL_STEP)} of the step from where it "
            "would be without actuator dynamics",
            of_actuators(off < _SMALL_STEP),
            (
                by_actuator("largest difference", 100.0 * off, "% of the step"),
                by_damping("small from these natural frequencies on, at 1 ms", limits, "rad/s"),
            ),
        ),
        Claim(
            "3",
            "if we are only interested in ... evaluating kinematic plans, neglecting the actuator "
            "dynamics seems acceptable",
            f"a minimum-jerk motion of {_MOTION:g} s: the paths differ by less than "
            f"{percent(_SMALL_MOTION)} of its length",
            of_actuators(apart < _SMALL_MOTION),
            (by_actuator("largest difference", 100.0 * apart, "% of the length"),),
        ),
    ]  # fmt: skip


def on_sensitivity(results: Results) -> list[Claim]:
    """Section 3.3, figure 4."""
    return [
        _attenuates(results), _passes(results), _noise(results), _between(results),
        _near_40(results), _slower_is_higher(results),
    ]  # fmt: skip


def _attenuates(results: Results) -> Claim:
    w, S = results.wide_frequency, np.abs(results.robot_sensitivity)
    off = np.abs(S / S[0, 0] - 1.0)
    low = w <= _LOW
    until = np.where(np.any(off > _SMALL, axis=-1), w[np.argmax(off > _SMALL, axis=-1)], np.inf)
    return Claim(
        "3.3",
        "attenuates disturbances ... in the lower extreme of the frequency spectrum ... not "
        "influenced by the actuator model",
        f"up to {_LOW:g} rad/s |S| stays below 1 and within {percent(_SMALL)} of that without "
        "actuator dynamics",
        of_actuators(np.all((S < 1.0) & (off < _SMALL), axis=-1, where=low)),
        (
            by_actuator(f"|S| at {_LOW:g} rad/s", _at(w, S, _LOW)),
            by_actuator("within that up to", until, "rad/s"),
        ),
    )


def _passes(results: Results) -> Claim:
    w, S = results.wide_frequency, np.abs(results.robot_sensitivity)
    return Claim(
        "3.3",
        "At the higher extreme, any disturbance is passed through ... also with no dependency on "
        "the model",
        f"from {_HIGH:g} rad/s on |S| is within {percent(_SMALL)} of 1",
        of_actuators(np.all(np.abs(S - 1.0) < _SMALL, axis=-1, where=w >= _HIGH)),
        (by_actuator(f"|S| at {_HIGH:g} rad/s", _at(w, S, _HIGH)),),
    )


def _noise(results: Results) -> Claim:
    w, T = results.wide_frequency, 1.0 - results.robot_sensitivity
    rms = np.sqrt(np.trapezoid(np.abs(T) ** 2, w, axis=-1))
    more = rms / rms[0, 0] - 1.0
    return Claim(
        "3.3",
        "we assume that noise rejection behaves similar with or without an actuator model",
        f"white noise of the measurement moves the joint by within {percent(_NOISE)} as much "
        "(rms); noise reaches the joint through T = 1 - S, not through S",
        of_actuators(np.abs(more) < _NOISE),
        (
            by_actuator("more motion than without actuator dynamics", 100.0 * more, "%"),
            by_actuator(f"|T| at {_HIGH:g} rad/s", _at(w, np.abs(T), _HIGH)),
        ),
    )


def _between(results: Results) -> Claim:
    nominal = results.speeds[1:, study.NOMINAL_DELAY]
    spans = [f"{number(np.nanmin(one))} to {number(np.nanmax(one))}" for one in nominal]
    ratio = study.KP / study.MASS * SPEEDS[[0, -1]] ** 2
    return Claim(
        "3.3",
        "Depending on the rigid body mass and the position control parameters, the frequency ... "
        "varies between around 1 to 100 rad/s",
        unjudged="it names no masses and no gains",
        numbers=(
            f"With kp/m from {number(ratio[0])} to {number(ratio[1])} 1/s² and kd in proportion to "
            f"√kp, as far as the loops are stable at 1 ms: HyQ {spans[0]}, StarLETH {spans[1]} "
            "rad/s.",
        ),
    )


def _near_40(results: Results) -> Claim:
    found = {kind: results.robots[kind]["sensitivity_peak_frequency"] for kind in KINDS}
    cases = list(of_actuators(np.all([_near(found[kind]) for kind in KINDS], axis=0)))
    spans: dict[str, list[list[float]]] = {kind: [] for kind in KINDS}
    shares = []
    for z, zeta in enumerate(study.DAMPING_RATIOS):
        curves = {k: results.curves[k]["sensitivity_peak_frequency"][z] for k in KINDS}
        good = [bool(np.all(_near(one) | np.isnan(one))) for one in curves.values()]
        cases.append((f"ζ {zeta:g} over the whole range", "", all(good)))
        every = np.concatenate([one[~np.isnan(one)] for one in curves.values()])
        shares.append([100.0 * np.mean(_near(every))])
        for kind, one in curves.items():
            spans[kind].append([np.nanmin(one), np.nanmax(one)])
    return Claim(
        "3.3",
        "For the given parameters we find a sensitivity peak at a frequency around 40 rad/s",
        f"within {percent(_NEAR)}, in continuous time and sampled",
        tuple(cases),
        (
            *(by_actuator(f"peak ({kind})", found[kind], "rad/s") for kind in KINDS),
            *(
                by_damping(f"lowest / highest of all stable loops ({kind})", spans[kind], "rad/s")
                for kind in KINDS
            ),
            by_damping("near it, of all stable loops", shares, "%"),
        ),
    )


def _slower_is_higher(results: Results) -> Claim:
    cases = []
    for kind in KINDS:
        peaks = results.curves[kind]["sensitivity_peak"].reshape(
            (-1, len(results.natural_frequency))
        )
        falling = [bool(np.all(np.diff(one[np.isfinite(one)]) < 0.0)) for one in peaks]
        cases.append((kind, "", all(falling)))
    found = results.robots["continuous"]["sensitivity_peak"]
    return Claim(
        "3.3",
        "Slower actuator dynamics lead to a higher peak sensitivity",
        "along each curve of figure 4",
        tuple(cases),
        (by_actuator("Ms", found),),
    )


def rise_time(wn: float, zeta: float) -> float:
    """10 to 90 % of the actuator's response to a step of its command [s].

    f(t) = 1 - exp(-zeta wn t) (cos wd t + zeta wn/wd sin wd t), wd = wn sqrt(1 - zeta^2).
    """
    t = np.linspace(0.0, 10.0 / wn, 20001)
    force = actuator_step(wn, zeta, t)
    low, high = (t[np.argmax(force > level)] for level in (0.1, 0.9))
    return float(high - low)


def actuator_step(wn: float, zeta: float, t: np.ndarray) -> np.ndarray:
    """f(t) of `rise_time` [-]; t: [s], any shape; 0 before t = 0."""
    wd = wn * np.sqrt(1.0 - zeta**2)
    t = np.maximum(t, 0.0)
    return 1.0 - np.exp(-zeta * wn * t) * (np.cos(wd * t) + zeta * wn / wd * np.sin(wd * t))


def _planned(step: np.ndarray) -> np.ndarray:
    """Where the linear loop is along a minimum-jerk motion, from its response to a unit step."""
    x = np.minimum(np.arange(len(step)) / (study.CONTROL_RATE * _MOTION), 1.0)
    setpoint = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return np.convolve(np.diff(setpoint, prepend=0.0), step)[: len(step)]


def _near(frequency: np.ndarray) -> np.ndarray:
    return np.abs(frequency - _PEAK) <= _NEAR * _PEAK


def _at(w: np.ndarray, values: np.ndarray, frequency: float) -> np.ndarray:
    return values[..., np.argmin(np.abs(w - frequency))]
