"""What is not known of a robot and its drives: a box of ranges, its samples and corners.

`wn=0.8..1.2,delay=0..5e-3,payload=0..2,inertia_scale=0.9..1.1`, of all joints alike: wn, zeta,
inertia_scale and contact_friction as factors on what is given (the scales are 1 where nothing is),
delays [s], payload [kg], joint_damping [N m s/rad] and joint_armature [kg m^2] as they are; an `x`
behind both ends makes them factors on what is given, too. Damping and armature are added to the
model's own, as in a sweep (`jaxact.plants.variation`).

The drives are told nothing of it: setpoint and feedforward are those of the robot without.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from jaxact.errors import UserError, nearest, shown

OF_DRIVES = ("wn", "zeta", "delay", "measurement_delay", "output_delay")
OF_BODY = ("payload", "inertia_scale", "joint_damping", "joint_armature", "contact_friction")
VARIED = (*OF_DRIVES, *OF_BODY)
_FACTORS = ("wn", "zeta", "inertia_scale", "contact_friction")
# What cannot vary here, and why.
_REFUSED = {
    "mass": "a robot's masses are its model's; vary payload or inertia_scale",
    "joint_friction": "any dry friction at all holds a linearised joint alike, so that bounds say "
    "nothing of its amount; sweep it instead",
}


@dataclass(frozen=True)
class Span:
    """A range of one parameter.

    name: of the parameter
    low, high: its ends, in its unit or as factors
    factor: whether they are factors
    """

    name: str
    low: float
    high: float
    factor: bool


@dataclass(frozen=True)
class Members:
    """Points of a box; n of them.

    fraction: of the ranges, from 0 to 1, shape (n, spans)
    names: what they are called
    """

    fraction: np.ndarray
    names: tuple[str, ...]

    def __len__(self) -> int:
        """Number of points."""
        return len(self.names)


NOMINAL = Members(np.zeros((1, 0)), ("nominal",))
"""The only member where everything is known."""


def read_spans(text: str) -> tuple[Span, ...]:
    """The ranges that a text describes, see the module.

    Raises UserError for what cannot be read.
    """
    spans: list[Span] = []
    for part in (part.strip() for part in text.split(",")):
        name, equals, ends = part.partition("=")
        first, dots, last = ends.partition("..")
        if not equals or not dots:
            raise UserError(f"`uncertainty` {shown(part)}: write it as NAME=LOW..HIGH")
        if name in _REFUSED:
            raise UserError(f"`uncertainty` {name}: {_REFUSED[name]}")
        if name not in VARIED:
            raise UserError(f"`uncertainty` {shown(name)}; {nearest(name, VARIED)}")
        if name in (span.name for span in spans):
            raise UserError(f"`uncertainty` {name} is given twice")
        factors = [name in _FACTORS or end.strip().endswith("x") for end in (first, last)]
        if factors[0] != factors[1]:
            raise UserError(f"`uncertainty` {part}: write both ends as factors, or none")
        low, high = _number(first, part), _number(last, part)
        if low > high:
            raise UserError(f"`uncertainty` {part}: the lower end is above the upper")
        if low < 0.0 or (name in _FACTORS and low == 0.0):
            raise UserError(f"`uncertainty` {part}: must be positive")
        spans.append(Span(name, low, high, factors[0]))
    return tuple(spans)


def _number(text: str, part: str) -> float:
    try:
        value = float(text.strip().removesuffix("x"))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UserError(f"`uncertainty` {shown(part)}: {shown(text)} is not a number")
    return value


def corners(spans: tuple[Span, ...]) -> Members:
    """All corners of the box."""
    fraction = np.array(list(itertools.product((0.0, 1.0), repeat=len(spans))))
    names = [
        "corner "
        + " ".join(f"{s.name}{'+' if up else '-'}" for s, up in zip(spans, row, strict=True))
        for row in fraction
    ]
    return Members(fraction, tuple(names))


def sample(spans: tuple[Span, ...], number: int, seed: int) -> Members:
    """Points of a scrambled Sobol sequence in the box."""
    from scipy.stats import qmc

    power = max(number - 1, 1).bit_length()
    points = qmc.Sobol(len(spans), scramble=True, rng=seed).random_base2(power)
    return Members(points[:number], tuple(f"sample {i}" for i in range(number)))


def joined(*parts: Members) -> Members:
    """All points of several."""
    return Members(
        np.concatenate([part.fraction for part in parts]),
        tuple(name for part in parts for name in part.names),
    )
