"""One claim of the study: its words, its verdict, and how numbers are written beside it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import study

from jaxact.plotting.wording import display_name, quantity

KINDS = ("continuous", "sampled")

# (what it belongs to, one case of it, whether the claim holds there)
Case = tuple[str, str, bool]


@dataclass(frozen=True)
class Claim:
    """One claim, judged.

    Attributes:
        section: of the study.
        quote: its words, shortened.
        reading: what they are taken to say, where they leave it open; "" otherwise.
        cases: for which the claim was judged, and whether it holds there.
        numbers: what was computed, a line each.
        unjudged: why it cannot be judged, "" if it can.
    """

    section: str
    quote: str
    reading: str = ""
    cases: tuple[Case, ...] = ()
    numbers: tuple[str, ...] = ()
    unjudged: str = ""

    @property
    def verdict(self) -> str:
        """One line that says first whether the claim holds."""
        if self.unjudged:
            return f"Cannot be judged: {self.unjudged}"
        good = [case for case in self.cases if case[2]]
        if len(good) == len(self.cases):
            return "Holds"
        return f"Holds for {_grouped(good, self.cases)} only" if good else "Does not hold"


def of_actuators(holds: np.ndarray) -> tuple[Case, ...]:
    """Cases of HyQ and StarLETH from a table of all robots, shape (robots, delays)."""
    return tuple(
        (display_name(name), delay(d), bool(holds[r, d]))
        for r, name in enumerate(study.ROBOTS)
        if name != "ideal"
        for d in range(len(study.DELAYS))
    )


def by_actuator(words: str, values: np.ndarray, unit: str = "") -> str:
    """`words: ideal 1 / 2 / 3, HyQ 1 / 2 / 3, StarLETH 1 / 2 / 3 unit`: a number for each delay."""
    rows = (f"{display_name(name)} {row(v)}" for name, v in zip(study.ROBOTS, values, strict=True))
    return f"{words}: {', '.join(rows)}{' ' if unit else ''}{unit}"


def by_damping(words: str, values: Iterable[Iterable[float]], unit: str = "") -> str:
    """The same for the two damping ratios."""
    pairs = zip(study.DAMPING_RATIOS, values, strict=True)
    rows = (f"ζ {zeta:g}: {row(one)}" for zeta, one in pairs)
    return f"{words}: {', '.join(rows)}{' ' if unit else ''}{unit}"


def delay(d: int) -> str:
    """The d-th delay."""
    return quantity(study.DELAYS[d], "s")


def number(value: float) -> str:
    """Three digits, or all before the point; "-" where there is none."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return quantity(value)
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


def row(values: Iterable[float]) -> str:
    """Numbers separated by strokes."""
    return " / ".join(number(float(value)) for value in values)


def percent(share: float) -> str:
    """`10 %`."""
    return f"{100.0 * share:g} %"


def reaching(x: np.ndarray, values: np.ndarray, level: float) -> float:
    """Smallest x from which on values stay below a level, interpolated along log x.

    x[0] where all do, inf where the last does not. NaN, of unstable loops, counts as above.
    """
    above = np.flatnonzero(~(values < level))
    if not above.size:
        return float(x[0])
    last = int(above[-1])
    if last + 1 == len(x):
        return math.inf
    if math.isnan(values[last]) or math.isinf(values[last]):
        return float(x[last + 1])
    share = (values[last] - level) / (values[last] - values[last + 1])
    return float(np.exp(np.log(x[last]) + share * np.log(x[last + 1] / x[last])))


def _grouped(good: Sequence[Case], cases: Sequence[Case]) -> str:
    """`HyQ (0 ms, 1 ms), StarLETH`: the cases that hold; a group whose cases all do by its name."""
    words = []
    for group in dict.fromkeys(case[0] for case in good):
        holding = [item for name, item, _ in good if name == group]
        whole = len(holding) == sum(case[0] == group for case in cases)
        words.append(group if whole else f"{group} ({', '.join(holding)})")
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
