"""One axis of a sweep: a list of values, or a range that is gridded or sampled."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.parameters import FEEDFORWARD, PRESETS, check, check_actuator, of

# Values of an axis, and points drawn from ranges: they are kept in memory.
MOST_SAMPLES = 10_000_000
# Loops of a sweep: they are not.
MOST_LOOPS = 2_000_000_000
SPACINGS = ("linear", "log")
_RANGE_KEYS = ("min", "max", "num", "spacing")


@dataclass(frozen=True)
class Axis:
    """What one parameter is varied over.

    Attributes:
        name: short name of a parameter, or "actuator".
        listed: values or preset names, None for a range.
        low, high: ends of the range, included; 0 for a list.
        number: of values of a gridded range, None for a sampled one.
        log: spacing of the range, logarithmic or linear.
    """

    name: str
    listed: tuple[float, ...] | tuple[str, ...] | None = None
    low: float = 0.0
    high: float = 0.0
    number: int | None = None
    log: bool = False

    @property
    def sampled(self) -> bool:
        """A range without a number of values: drawn by the sampling method."""
        return self.listed is None and self.number is None

    def __len__(self) -> int:
        """Number of values along the axis, 1 for a sampled one."""
        return len(self.listed) if self.listed is not None else self.number or 1

    @property
    def values(self) -> np.ndarray:
        """Values of a listed or gridded axis, shape (len,); numbers, or names of presets."""
        if self.listed is not None:
            return np.asarray(self.listed)
        if self.log:
            return np.geomspace(self.low, self.high, len(self))
        return np.linspace(self.low, self.high, len(self))

    def place(self, fraction: np.ndarray) -> np.ndarray:
        """Values at fractions 0..1 of the range, in its spacing; shape of `fraction`."""
        if self.log:
            return np.asarray(self.low * (self.high / self.low) ** fraction)
        return np.asarray(self.low + (self.high - self.low) * fraction)

    @property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest value of a numeric axis."""
        if self.listed is not None:
            return min(map(float, self.listed)), max(map(float, self.listed))
        return self.low, self.high

    @property
    def document(self) -> list[float] | list[str] | dict[str, Any]:
        """The axis as it is written in a specification."""
        if self.listed is not None:
            return list(self.listed)  # type: ignore[return-value]
        number = {} if self.number is None else {"num": self.number}
        spacing = SPACINGS[self.log]
        return {"min": self.low, "max": self.high, **number, "spacing": spacing}


NO_AXIS = Axis(FEEDFORWARD, listed=(0.0,))
"""An axis that varies nothing: a specification must have one."""


def check_range(said: str, low: Any, high: Any, number: Any) -> None:
    """Raise UserError for ends, or a number of values, that make no range of any parameter.

    Args:
        said: how the message names the range; one of logarithms ends in "log".
        low, high: ends.
        number: of values, None for a range to draw from.
    """
    for word, end in (("low", low), ("high", high)):
        if isinstance(end, bool | str) or np.ndim(end) or not _is_finite(end):
            raise UserError(f"{said}: {word} = {shown(end)} is not a finite number")
    if low >= high:
        advice = "give two" if low == high else "exchange them"
        raise UserError(f"{said}: low = {low:g} is not below high = {high:g}; {advice}")
    if said.endswith("log") and low <= 0:
        raise UserError(f"{said}: low = {low:g} has no logarithm; allowed: above 0")
    if number is not None:
        whole = int(number) if isinstance(number, np.integer) else number
        _number(said, {"num": whole}, sampled=False)


def _is_finite(value: Any) -> bool:
    try:
        return math.isfinite(value)
    except (TypeError, OverflowError):
        return False


def read_axis(name: str, given: Any, *, sampled: bool) -> Axis:
    """The axis of a parameter as a specification gives it.

    Args:
        name: short name of a parameter, or "actuator".
        given: a list, or a table of min, max, num and spacing.
        sampled: the specification has a sampling method, which draws from ranges.

    Raises:
        UserError: it names the key, what was given and what is allowed.
    """
    key = f"axes.{name}"
    if isinstance(given, list):
        return _list(name, key, given)
    if name == "actuator":
        raise UserError(f"{key} = {shown(given)}; allowed: a list of {', '.join(PRESETS)}")
    if isinstance(given, dict):
        return _range(name, key, given, sampled)
    raise UserError(
        f"{key} = {shown(given)} is not a valid axis; allowed: a list, or a range"
        " { min = 1, max = 10, num = 5 }; a fixed value belongs below [parameters]"
    )


def _list(name: str, key: str, given: list[Any]) -> Axis:
    if not given:
        raise UserError(f"{key} = [] is empty; give at least one value")
    if len(given) > MOST_SAMPLES:
        raise UserError(f"{key} has {len(given):,} values; allowed: up to {MOST_SAMPLES:,}")
    read = check_actuator if name == "actuator" else lambda value, at: check(name, value, at)
    listed = tuple(read(value, f"{key}[{index}]") for index, value in enumerate(given))
    if len(set(listed)) < len(listed):
        twice = next(value for value in listed if listed.count(value) > 1)
        raise UserError(f"{key} has {shown(twice)} more than once; give each value once")
    return Axis(name, listed=listed)  # type: ignore[arg-type]


def _range(name: str, key: str, given: dict[str, Any], sampled: bool) -> Axis:
    for word in given:
        if word not in _RANGE_KEYS:
            raise UserError(f"{key}.{shown(word)[1:-1]}: unknown key; {nearest(word, _RANGE_KEYS)}")
    for word in ("min", "max") if sampled else ("min", "max", "num"):
        if word not in given:
            raise UserError(f"{key}.{word} is missing; write {{ min = 1, max = 10, num = 5 }}")
    low, high = (_end(name, f"{key}.{word}", given[word]) for word in ("min", "max"))
    spacing = given.get("spacing", "linear")
    if spacing not in SPACINGS:
        raise UserError(f"{key}.spacing = {shown(spacing)}; {nearest(spacing, SPACINGS)}")
    if low >= high:
        raise UserError(
            f"{key}: min = {low:g} is not below max = {high:g}; exchange them, or give a list"
        )
    if spacing == "log" and low <= 0:
        raise UserError(f"{key}.min = {low:g} has no logarithm; allowed with log spacing: above 0")
    return Axis(name, None, low, high, _number(key, given, sampled), spacing == "log")


def _end(name: str, key: str, given: Any) -> float:
    value = check(name, given, key)
    if math.isinf(value):
        allowed = of(name).bounds.removesuffix(", or inf")
        raise UserError(f"{key} = inf cannot end a range; allowed: {allowed}; inf only in a list")
    return value


def _number(key: str, given: dict[str, Any], sampled: bool) -> int | None:
    if sampled:
        if "num" in given:
            raise UserError(
                f"{key}.num: a sampled range has no num; sampling.samples says how many"
            )
        return None
    number = given["num"]
    if isinstance(number, bool) or not isinstance(number, int) or not 2 <= number <= MOST_SAMPLES:
        raise UserError(
            f"{key}.num = {shown(number)}; allowed: a whole number from 2 to {MOST_SAMPLES:,}"
        )
    return number
