"""Small print of a picture: what was simulated, and how it agrees with exact theory."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

import numpy as np

from jaxact import engines
from jaxact.parameters import (
    CONTROL_RATE,
    FORCE_LIMIT,
    FORCE_RATE_LIMIT,
    GAIN_SCALE,
    KD,
    KP,
    MASS,
    NOISES,
    OF_JOINT,
    RESOLUTIONS,
    STALL_FORCE,
    VELOCITY_FILTER,
    WALKS,
    mass_word,
    of,
)
from jaxact.plotting import wording
from jaxact.status import Verdict
from jaxact.sweeping.store import parameter

if TYPE_CHECKING:
    import xarray as xr

    from jaxact.sweeping.agreement import Agreement

# Where any of these is not at its default the loop is not linear.
_NONLINEAR = (*RESOLUTIONS, *NOISES, *WALKS, FORCE_LIMIT, FORCE_RATE_LIMIT, STALL_FORCE)


def simulated(results: xr.Dataset) -> str:
    """What was simulated: engine, control rate, velocity, duration, precision, number of loops.

    Args:
        results: a sweep store.
    """
    specification = json.loads(results.attrs["specification"])
    engine = _engine(specification["engine"])
    if "plant" in specification:
        engine += f" with {specification['plant']['model']}"
    rates = np.unique(_parameter(results, CONTROL_RATE))
    rate = wording.quantity(rates[0], "Hz") if len(rates) == 1 else f"{len(rates)} rates"
    words = [
        f"Simulated: {engine}",
        f"control at {rate}",
        f"{specification['velocity']} velocity",
        f"{specification['duration']:g} s",
        f"{specification['precision']}",
        f"{results['verdict'].size:,} loops",
    ]
    if "physics_step" in specification:
        words.insert(3, f"physics step {wording.quantity(specification['physics_step'], 's')}")
    if specification.get("integrator_correction") and specification["engine"] != engines.MASS.name:
        words.insert(1, "its integrator corrected")
    return ", ".join(words) + "."


def _engine(name: str) -> str:
    own = engines.named(name)
    return own.title if own else name


def exact(results: xr.Dataset) -> str:
    """What a store of margins is of: the kind of loop, its velocity and filter, how many loops.

    Args:
        results: from `jaxact.sweeping.margins_store`.
    """
    specification = json.loads(results.attrs["specification"])
    words = [f"Exact margins, {results.attrs['margins']}"]
    if "plant" in specification:
        words[0] = f"Exact margins of all joints of {specification['plant']['model']}, linearised"
    if results.attrs["margins"] == "sampled":
        rates = np.unique(_parameter(results, CONTROL_RATE))
        rate = wording.quantity(rates[0], "Hz") if len(rates) == 1 else f"{len(rates)} rates"
        words += [f"control at {rate}", f"{specification['velocity']} velocity"]
    cutoffs = np.unique(_parameter(results, VELOCITY_FILTER))
    if len(cutoffs) == 1 and np.isfinite(cutoffs[0]):
        words.append(f"velocity filtered at {wording.quantity(cutoffs[0], 'rad/s')}")
    return ", ".join([*words, f"{results['verdict'].size:,} loops"]) + "."


def compared(agreement: Agreement) -> str:
    """How many verdicts differ from exact sampled stability, and how near the border they are."""
    whole = agreement.compared == agreement.samples
    of_all = "" if whole else f" of {agreement.compared:,} compared"
    if agreement.disagreements == 0:
        return f"No verdict{of_all} differs from the exact stability of the sampled loop."
    share = agreement.disagreements / agreement.compared
    count = "1 verdict" if agreement.disagreements == 1 else f"{agreement.disagreements:,} verdicts"
    verb = "differs" if agreement.disagreements == 1 else "differ"
    near = (
        f"within {_percent(agreement.furthest)} of the boundary in gain"
        if agreement.furthest < 1.0
        else f"up to a factor {1.0 + agreement.furthest:.3g} from the boundary in gain"
    )
    return (
        f"{count}{of_all} ({_percent(share)}) {verb} from the exact stability of the sampled loop: "
        f"{near}, exact growth rate within ±{agreement.fastest:.2g}/s."
    )


def linear_only(results: xr.Dataset) -> str:
    """A warning where a sweep has quantisation, noise or limits, which exact theory leaves out."""
    active = [name for name in _NONLINEAR if np.any(_parameter(results, name) != of(name).default)]
    if not active:
        return ""
    words = ", ".join(name.replace("_", " ") for name in active)
    return f"The exact boundary is that of the linear loop, without its {words}."


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def _parameter(results: xr.Dataset, name: str) -> np.ndarray:
    return np.asarray(parameter(results, name).values, dtype=float)


def loop(
    values: dict[str, float], results: dict[str, float], static: dict[str, object],
    unit: str = "m", *, joints: int = 1,
) -> str:  # fmt: skip
    """Of one loop: its gains and mass, how it was simulated, and what came out.

    Args:
        values: parameters by short name.
        results: metrics by the names of a sweep's variables.
        static: options of a specification by name.
        unit: of the joint's position.
        joints: how many there are; of several, what came out is that of the worst.
    """
    engine = _engine(str(static["engine"]))
    rate = wording.quantity(values[CONTROL_RATE], "Hz")
    gains = ", ".join(
        f"{words} {values[name]:g} {of(name, unit).unit}"
        for name, words in ((KP, KP), (KD, KD), (MASS, mass_word(unit)))
    )
    for name in OF_JOINT:
        if values.get(name, 0.0) != 0.0:
            gains += f", {name.replace('_', ' ')} {values[name]:g} {of(name, unit).unit}"
    if static.get("plant") is not None:
        gains = f"kp {_own(values[KP], 'N m/rad')}, kd {_own(values[KD], 'N m s/rad')}"
    if values[GAIN_SCALE] != 1.0:
        gains = f"{values[GAIN_SCALE]:g} times {gains}"
    asked = f"{gains}; {engine}, control at {rate}, {static['velocity']} velocity"
    if static["velocity"] == "differenced" and math.isfinite(values[VELOCITY_FILTER]):
        asked += f" filtered at {wording.quantity(values[VELOCITY_FILTER], 'rad/s')}"
    force = "N m" if unit == "rad" else "N"
    for name, own in (("position", unit), ("velocity", f"{unit}/s"), ("command", force)):
        step = values.get(f"{name}_resolution", 0.0)
        if step > 0.0:
            asked += f", {name} resolution {step:.4g} {own}"
    for name in (FORCE_LIMIT, FORCE_RATE_LIMIT):
        if math.isfinite(values.get(name, math.nan)):
            asked += f", {name.replace('_', ' ')} {values[name]:g} {of(name, unit).unit}"
    which = " of the worst joint" if joints > 1 else ""
    return f"{asked}\n{', '.join(_outcome(results, unit, which))}"


def _outcome(results: dict[str, float], unit: str, which: str) -> list[str]:
    """What came out of a loop; overshoot and settling of what is at rest in the end only."""
    verdict = Verdict(int(results["verdict"]))
    found = [verdict.label, f"growth rate {results['growth_rate']:.3g}/s"]
    amplitude = results.get("limit_cycle_amplitude", math.nan)
    if verdict is Verdict.LIMIT_CYCLE and amplitude > 0.0:
        found[0] += f" of {amplitude:.3g} {unit}"
        frequency = results.get("limit_cycle_frequency", math.nan)
        if frequency > 0.0:
            found[0] += f" at {frequency:.3g} rad/s"
        found[1] = f"{found[1]} without quantisation, friction and limits"
    if verdict is not Verdict.STABLE:
        return found
    if math.isfinite(results.get("overshoot", math.nan)):
        found.append(f"overshoot{which} {100.0 * results['overshoot']:.3g} %")
    if math.isfinite(results.get("settling_time", math.nan)):
        all_of = "all joints settled" if which else "settled"
        found.append(f"{all_of} after {wording.quantity(results['settling_time'], 's')}")
    return found


def _own(value: float, unit: str) -> str:
    """A gain of a robot: one number, or what the model or the specification says of each joint."""
    return "as each joint has it" if math.isnan(value) else f"{value:g} {unit}"
