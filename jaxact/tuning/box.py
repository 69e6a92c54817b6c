"""What is not known of a loop: a box of ranges, points of it, and the way to its worst ones.

    wn=0.8..1.2,delay=0..5e-3,payload=0..2,mass=0.8x..1.2x

wn, zeta, inertia_scale and contact_friction are factors on what is given (the scales are 1 where
nothing is), every other parameter is in its unit; an `x` behind both ends makes them factors, too.
The order in which they are written does not matter; a range of no width, mass=0.7..0.7, gives a
value and leaves nothing uncertain. Of a robot, `wn@.*_knee=0.9..1.1` is of the
joints that match the pattern in full, by their names or their actuators'; the others stay as they
are.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.parameters import (
    CONTACT_FRICTION,
    INERTIA_SCALE,
    JOINT_FRICTION,
    MASS,
    WN,
    ZETA,
    base,
    canonical,
    check,
    known,
    mass_word,
    of,
)

_FACTORS = (WN, ZETA, INERTIA_SCALE, CONTACT_FRICTION)
# What cannot vary where it is not among the parameters that can, and why.
_REFUSED = {
    MASS: "a robot's masses are its model's; vary payload or inertia_scale",
    JOINT_FRICTION: "any dry friction at all holds a linearised joint alike, so that bounds say "
    "nothing of its amount; sweep it instead",
}
# Nobody knows a parameter so badly that it is surely this many times what it is taken for.
_FAR = 5.0
# Share of a range's end by which a value may be outside of it.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Range:
    """A range of one parameter.

    Attributes:
        name: of the parameter.
        low, high: its ends, in its unit or as factors.
        factor: whether they are factors.
    """

    name: str
    low: float
    high: float
    factor: bool

    @property
    def known(self) -> bool:
        """Whether it has no width: what it is of has this one value, and is not uncertain."""
        return self.low == self.high

    def leaves_out(self, value: float) -> bool:
        """Whether a value, in the unit of the ends, is outside by more than rounding."""
        room = _ROUNDING * max(abs(self.low), abs(self.high))
        return not self.low - room <= value <= self.high + room

    def ends(self, given: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """The ends of every key of the parameter, in its unit.

        Args:
            given: nominal values by key, those of some joints (`wn@.*_knee`) too.

        Raises:
            UserError: a factor on nothing or on infinity, one value for joints that differ, or ends
                out of the parameter's bounds.
        """
        said = f"`uncertainty` {self.name}"
        if self.factor and not np.isfinite(list(given.values())).all():
            raise UserError(
                f"{said}: the actuator is ideal, its {base(self.name)} cannot vary by a factor; "
                "give `wn` and `zeta` or an `actuator`"
            )
        if self.factor and not any(given.values()):
            raise UserError(
                f"{said}: is 0, which no factor changes; write both ends in its unit, without x"
            )
        if not self.factor and len(given) > 1:
            raise UserError(f"{said}: joints differ in it; write the ends as factors, 0.8x")

        def end(key: str, value: float) -> float:
            return check(key, value * given[key] if self.factor else value, f"{said}: {key}")

        return {key: (end(key, self.low), end(key, self.high)) for key in given}


@dataclass(frozen=True)
class Points:
    """Points of a box; n of them.

    Attributes:
        fraction: of the ranges, from 0 to 1, shape (n, ranges).
        names: what they are called.
    """

    fraction: np.ndarray
    names: tuple[str, ...]

    def __len__(self) -> int:
        """Number of points."""
        return len(self.fraction)


@dataclass(frozen=True)
class Box:
    """Ranges of what is not known; () where everything is."""

    ranges: tuple[Range, ...] = ()

    def __len__(self) -> int:
        """Number of ranges."""
        return len(self.ranges)

    @property
    def known(self) -> Box:
        """The ranges of no width: they give values, and are no dimensions of what is uncertain."""
        return Box(tuple(one for one in self.ranges if one.known))

    @property
    def uncertain(self) -> Box:
        """The ranges that have a width."""
        return Box(tuple(one for one in self.ranges if not one.known))

    def corners(self) -> Points:
        """All corners."""
        fraction = np.array(list(itertools.product((0.0, 1.0), repeat=len(self))))
        names = [one.name for one in self.ranges]
        signs = [("+" if up else "-" for up in row) for row in fraction]
        ends = [" ".join(map(str.__add__, names, sign)) for sign in signs]
        return Points(fraction, tuple(f"corner {end}" for end in ends))

    def sample(self, number: int, seed: int) -> Points:
        """Points of a scrambled Sobol sequence."""
        return Points(sobol(len(self), number, seed), tuple(f"sample {i}" for i in range(number)))

    def members(self, number: int, seed: int) -> Points:
        """Samples and all corners; the one nominal point where everything is known."""
        if not self.ranges:
            return NOMINAL
        parts = self.sample(number, seed), self.corners()
        fraction = np.concatenate([part.fraction for part in parts])
        return Points(fraction, parts[0].names + parts[1].names)


KNOWN = Box()
"""Where everything is known."""

NOMINAL = Points(np.zeros((1, 0)), ("nominal",))
"""The only point where everything is known."""


def read_box(text: str, varied: Collection[str], *, patterns: bool = False) -> Box:
    """The box that a text describes, see the module.

    Args:
        text: `NAME=LOW..HIGH,...`; "" for none.
        varied: names of the parameters that can vary.
        patterns: whether some joints may vary apart from the others.

    Raises:
        UserError: what cannot be read.
    """
    ranges: list[Range] = []
    for part in (part.strip() for part in text.split(",") if text):
        said, equals, ends = part.partition("=")
        name = canonical(said)
        first, dots, last = ends.partition("..")
        if not equals or not dots:
            raise UserError(f"`uncertainty` {shown(part)}: write it as NAME=LOW..HIGH")
        if base(name) not in varied or not (name in varied or (patterns and known(name))):
            why = _REFUSED.get(name)
            raise UserError(
                f"`uncertainty` {said}: {why}" if why
                else f"`uncertainty` {shown(said)}; {nearest(said, varied)}"
            )  # fmt: skip
        if name in (other.name for other in ranges):
            raise UserError(f"`uncertainty` {name} is given twice")
        always = base(name) in _FACTORS
        factors = [always or end.strip().endswith("x") for end in (first, last)]
        if factors[0] != factors[1]:
            raise UserError(f"`uncertainty` {part}: write both ends as factors, or none")
        low, high = _number(first, part), _number(last, part)
        if low > high:
            raise UserError(f"`uncertainty` {part}: the lower end is above the upper")
        if factors[0] and (low < 0.0 or (always and low == 0.0)):
            raise UserError(f"`uncertainty` {part}: must be positive")
        if always and not (low < _FAR and high > 1.0 / _FAR):
            raise UserError(
                f"`uncertainty` {part}: these are factors on the nominal {base(name)}, no values of"
                " it; write e.g. 0.8..1.2"
            )
        if not factors[0]:
            check(name, low, f"`uncertainty` {name}")
        ranges.append(Range(name, low, high, factors[0]))
    order = list(varied)
    return Box(tuple(sorted(ranges, key=lambda one: (order.index(base(one.name)), one.name))))


def inside(
    box: Box,
    given: Mapping[str, float],
    defaults: Mapping[str, float],
    unit: str | None = None,
) -> tuple[dict[str, float], Box]:
    """What a loop must have to be among those that a box holds, of what it was not given.

    Args:
        box: what is uncertain.
        given: values that were given, by key.
        defaults: of others.
        unit: of the joint's position, None for m.

    Returns:
        The middle of every range that leaves out the default; and the box, the same one, whose
        factors are on these values.

    Raises:
        UserError: a range leaves out the value given, so that its certificate is not of this loop.
    """
    found: dict[str, float] = {}
    ranges: list[Range] = []
    for one in box.ranges:
        own = given.get(one.name, defaults.get(one.name))
        if own is not None and one.leaves_out(1.0 if one.factor else float(own)):
            if one.name in given:
                said = mass_word(unit) if one.name == MASS else one.name
                raise UserError(f"`uncertainty` {said}: {_left_out(one, float(own), unit)}")
            middle = 0.5 * (one.low + one.high)
            if not one.factor:
                found[one.name] = middle
            elif math.isfinite(own) and own:  # what no factor changes is refused with the ends
                found[one.name] = middle * float(own)
                one = replace(one, low=one.low / middle, high=one.high / middle)
        ranges.append(one)
    return found, Box(tuple(ranges))


def _left_out(one: Range, own: float, joint: str | None) -> str:
    name, unit = base(one.name), of(base(one.name), joint).unit
    ends = f"{one.low:g} to {one.high:g}"
    said = mass_word(joint) if name == MASS else name
    certified = "so that what is certified would not hold for the loop with its new gains"
    if one.factor:
        return f"a factor of {ends} leaves out 1, the loop's own {said}, {certified}"
    return (
        f"{ends} {unit} leaves out the loop's own {own:g} {unit}, {certified}; give a value of "
        f"{said} within, or the ends as factors, 0.8x..1.2x"
    )


def _number(text: str, part: str) -> float:
    try:
        value = float(text.strip().removesuffix("x"))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UserError(f"`uncertainty` {shown(part)}: {shown(text)} is not a number")
    return value


def sobol(dimensions: int, number: int, seed: int) -> np.ndarray:
    """Points of a scrambled Sobol sequence in the unit box, shape (number, dimensions)."""
    from scipy.stats import qmc

    power = max(number - 1, 1).bit_length()
    return qmc.Sobol(dimensions, scramble=True, rng=seed).random_base2(power)[:number]
