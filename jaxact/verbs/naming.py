"""What loops are called: by their actuator and their delay, or by what tells them apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.parameters import PRESETS, of
from jaxact.plotting.wording import quantity

DELAYS = ("delay", "measurement_delay", "output_delay")
"""Delays within the loop: only their sum counts."""


def labels(samples: Samples) -> tuple[str, ...]:
    """What tells the loops apart, with units: `HyQ, delay 1 ms`; () where nothing does."""
    columns = []
    for name, place in samples.coords.items():
        hidden = (
            name in ("sample", "loop", "feedforward")
            or name.startswith("loop_")
            or (name in ("wn", "zeta") and "actuator" in samples.coords)
        )
        if hidden and not (name == "feedforward" and len(place.values) > 1):
            continue
        sizes = [
            n if dim in place.dims else 1
            for dim, n in zip(samples.dims, samples.shape, strict=True)
        ]
        spread = np.broadcast_to(place.values.reshape(sizes), samples.shape)
        columns.append([_word(name, value) for value in spread.ravel()])
    return tuple(", ".join(words) for words in zip(*columns, strict=True))


def _word(name: str, value: Any) -> str:
    if name == "actuator":
        return quantity(str(value))
    return f"{name.replace('_', ' ')} {quantity(value, of(name).unit)}"


def common_words(values: Mapping[str, float]) -> list[str]:
    """The actuator and the delay, where several loops have them in common.

    values: that they have in common, by short name
    """
    words = []
    if "wn" in values and ("zeta" in values or np.isinf(values["wn"])):
        words.append(_actuator_name(values["wn"], values.get("zeta", 1.0)))
    if all(name in values for name in DELAYS):
        words.append(f"delay {quantity(sum(values[name] for name in DELAYS), 's')}")
    return words


def _actuator_name(wn: float, zeta: float) -> str:
    if np.isinf(wn):
        return "ideal actuator"
    if np.isnan(wn * zeta):
        return "actuators as each joint has them"
    known = {preset: name for name, preset in PRESETS.items()}.get((wn, zeta))
    if known is not None:
        return quantity(known)
    return f"wn {quantity(wn, 'rad/s')}, ζ {zeta:g}"


def loop_name(specification: Specification, values: Mapping[str, float] | None = None) -> str:
    """A single loop is called by its actuator and its delay: `HyQ, delay 1 ms`.

    What a robot's model says of each joint has no value here.
    """
    own = specification.nominal if values is None else values
    actuator = _actuator_name(own["wn"], own["zeta"])
    cutoff = own["velocity_filter"]
    words = f", velocity filter {quantity(cutoff, 'rad/s')}" if np.isfinite(cutoff) else ""
    delay = sum(own[name] for name in DELAYS)
    if np.isnan(delay):
        return f"{actuator}, delays as each joint has them{words}"
    return f"{actuator}, delay {quantity(delay, 's')}{words}"
