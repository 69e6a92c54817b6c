"""What loops are called: by their actuator and their delay, or by what tells them apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.loops import conversion
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.parameters import (
    CONTROL_RATE,
    FEEDFORWARD,
    GAIN_SCALE,
    KD,
    KP,
    LOOP_DELAYS,
    MASS,
    OF_JOINT,
    PRESETS,
    VELOCITY_FILTER,
    WN,
    ZETA,
    mass_word,
    of,
)
from jaxact.plotting.wording import quantity

if TYPE_CHECKING:
    from jaxact.loops.control_loop import ControlLoop


@dataclass(frozen=True)
class Loops:
    """Loops of a joint, n of them, one by one.

    Attributes:
        values: every parameter of the table by its short name, shape (n,) each.
        labels: what tells them apart, with units, e.g. `HyQ, delay 1 ms`.
        unit: of the joints' positions, "rad" of rotary ones; None: m.
    """

    values: dict[str, np.ndarray]
    labels: tuple[str, ...]
    unit: str | None = None

    def __len__(self) -> int:
        """Number of loops."""
        return len(self.labels)

    def one(self, index: int) -> dict[str, float]:
        """Parameters of one loop."""
        return {name: float(array[index]) for name, array in self.values.items()}


def labels(samples: Samples) -> tuple[str, ...]:
    """What tells the loops apart, with units: `HyQ, delay 1 ms`; () where nothing does."""
    columns = []
    placed = sorted(samples.coords.items(), key=lambda item: samples.dims.index(item[1].dims[0]))
    for name, place in placed:
        hidden = (
            name in ("sample", "loop", FEEDFORWARD)
            or name.startswith("loop_")
            or (name in (WN, ZETA) and "actuator" in samples.coords)
        )
        if hidden and not (name == FEEDFORWARD and len(place.values) > 1):
            continue
        sizes = [
            n if dim in place.dims else 1
            for dim, n in zip(samples.dims, samples.shape, strict=True)
        ]
        spread = np.broadcast_to(place.values.reshape(sizes), samples.shape)
        units = place.attributes.get("units", "1")
        columns.append([_word(name, value, units) for value in spread.ravel()])
    return tuple(", ".join(words) for words in zip(*columns, strict=True))


def _word(name: str, value: Any, units: str) -> str:
    if name == "actuator":
        return quantity(str(value))
    return f"{name.replace('_', ' ')} {quantity(value, units)}"


def _common_words(values: Mapping[str, float]) -> list[str]:
    """The actuator and the delay, where several loops have them in common.

    Args:
        values: that they have in common, by short name.
    """
    words = []
    if WN in values and (ZETA in values or np.isinf(values[WN])):
        words.append(_actuator_name(values[WN], values.get(ZETA, 1.0)))
    if all(name in values for name in LOOP_DELAYS):
        words.append(f"delay {quantity(conversion.total_delay(values), 's')}")
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
    actuator = _actuator_name(own[WN], own[ZETA])
    cutoff = own[VELOCITY_FILTER]
    words = f", velocity filter {quantity(cutoff, 'rad/s')}" if np.isfinite(cutoff) else ""
    delay = conversion.total_delay(own)
    if np.isnan(delay):
        return f"{actuator}, delays as each joint has them{words}"
    return f"{actuator}, delay {quantity(delay, 's')}{words}"


def named(loop: ControlLoop) -> Loops:
    """A batch of a joint's loops, each with its name."""
    from jaxact.loops import conversion  # imports JAX, which naming alone does without

    samples = conversion.samples(loop)
    words = loop.kind.names or labels(samples)
    if not words:
        words = (loop_name(conversion.linear_specification(loop)),) * len(samples)
    return Loops(dict(samples.values), words, loop.kind.unit)


def of_pictures(loop: ControlLoop) -> Loops:
    """The same as pictures call them: with their velocity filters, where these differ."""
    loops = named(loop)
    cutoff = loops.values[VELOCITY_FILTER]
    if _common(cutoff):
        return loops
    names = [
        label if "velocity filter" in label else f"{label}, {_filter(float(value))}"
        for label, value in zip(loops.labels, cutoff, strict=True)
    ]
    return Loops(loops.values, tuple(names), loops.unit)


def in_common(loop: ControlLoop, *, simulated: bool = False) -> str:
    """What all loops have in common: gains, mass, actuator, delay, and how velocity is had.

    Args:
        loop: a joint's, or a batch.
        simulated: say the control rate, too, which a loop in continuous time has not.
    """
    loops = named(loop)
    own, words = loops.values, []
    for name in (KP, KD, MASS, *OF_JOINT):
        if _common(own[name]) and (name not in OF_JOINT or own[name][0] != 0.0):
            called = mass_word(loops.unit) if name == MASS else name.replace("_", " ")
            words.append(f"{called} {own[name][0]:g} {of(name, loops.unit).unit}")
    scale = own[GAIN_SCALE]
    if _common(scale) and scale[0] != 1.0:
        words.append(f"gain scale {scale[0]:g}")
    if len(loops) > 1:  # a single one is named by its actuator and its delay
        words += _common_words({name: v[0] for name, v in own.items() if _common(v)})
    if simulated and _common(own[CONTROL_RATE]):
        words.append(f"control at {quantity(own[CONTROL_RATE][0], 'Hz')}")
    cutoff = own[VELOCITY_FILTER]
    how = ["differenced"] if loop.kind.velocity == "differenced" else []
    if _common(cutoff) and np.isfinite(cutoff[0]):
        how.append(f"filtered at {cutoff[0]:g} rad/s")
    return ", ".join([*words, f"velocity {' and '.join(how)}"] if how else words)


def _filter(cutoff: float) -> str:
    return f"velocity filter {cutoff:g} rad/s" if np.isfinite(cutoff) else "no velocity filter"


def _common(values: np.ndarray) -> bool:
    """Whether all loops have the same value."""
    return bool((values == values[0]).all())
