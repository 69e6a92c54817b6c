"""A box of what is not known exactly, samples of it, its corners, and its worst interior point.

`wn=0.8..1.2,zeta=0.7..1.1,delay=0..5e-3,mass=0.5..1.0`: wn and zeta as factors on the actuator's
own, mass [kg] and delay [s] as they are; an `x` behind an end, `mass=0.8x..1.2x`, makes it a factor
as well.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.tuning.joint.ensemble import PARAMETERS, Ensemble, ensemble

_SHORT = {"mass": "mass", "wn": "natural_frequency", "zeta": "damping_ratio", "delay": "delay"}
_FACTORS = ("wn", "zeta")
_ASCENTS = 24

Rise = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Points of the unit box (n, d) -> values (n,) and slopes (n, d)."""


@dataclass(frozen=True)
class Box:
    """Ranges around one nominal plant.

    nominal: the plant, an ensemble of one
    low, high: ends by field name of `Ensemble`, only of what varies
    """

    nominal: Ensemble
    low: Mapping[str, float]
    high: Mapping[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """What varies, in the order of the ensemble's fields."""
        return tuple(name for name in PARAMETERS if name in self.low)

    def place(self, fraction: np.ndarray, names: tuple[str, ...] = ()) -> Ensemble:
        """Members at fractions 0..1 of the ranges, shape (n, varied)."""
        values = {p: np.full(len(fraction), getattr(self.nominal, p)[0]) for p in PARAMETERS}
        for column, name in enumerate(self.names):
            span = self.high[name] - self.low[name]
            values[name] = self.low[name] + span * fraction[:, column]
        return Ensemble(**values, sampling=self.nominal.sampling, names=names)

    def corners(self) -> Ensemble:
        """All corners."""
        fraction = np.array(list(itertools.product((0.0, 1.0), repeat=len(self.names))))
        short = {long: word for word, long in _SHORT.items()}
        names = []
        for row in fraction:
            signs = ("+" if up else "-" for up in row)
            ends = (f"{short[n]}{sign}" for n, sign in zip(self.names, signs, strict=True))
            names.append(f"corner {' '.join(ends)}")
        return self.place(fraction, tuple(names))

    def sample(self, number: int, seed: int) -> Ensemble:
        """Points of a scrambled Sobol sequence."""
        from scipy.stats import qmc

        power = max(number - 1, 1).bit_length()
        points = qmc.Sobol(len(self.names), scramble=True, rng=seed).random_base2(power)
        return self.place(points[:number], tuple(f"sample {i}" for i in range(number)))


def read_box(text: str, nominal: Ensemble) -> Box:
    """The box that a text describes, see the module.

    nominal: an ensemble of one

    Raises UserError for what cannot be read, and for values out of their domain.
    """
    low: dict[str, float] = {}
    high: dict[str, float] = {}
    for part in text.split(","):
        word, equals, span = part.strip().partition("=")
        first, dots, last = span.partition("..")
        if not equals or not dots:
            raise UserError(f"`uncertainty` {shown(part.strip())}: write it as NAME=LOW..HIGH")
        if word not in _SHORT:
            raise UserError(f"`uncertainty` {shown(word)}; {nearest(word, _SHORT)}")
        name = _SHORT[word]
        if name in low:
            raise UserError(f"`uncertainty` {word} is given twice")
        own = float(getattr(nominal, name)[0])
        low[name], high[name] = (_end(end, word, own, part.strip()) for end in (first, last))
        if low[name] > high[name]:
            raise UserError(f"`uncertainty` {part.strip()}: the lower end is above the upper")
    box = Box(nominal, low, high)
    corners = box.corners()
    ensemble(*(getattr(corners, name) for name in PARAMETERS))
    return box


def _end(text: str, word: str, own: float, part: str) -> float:
    factor = word in _FACTORS or text.strip().endswith("x")
    try:
        value = float(text.strip().removesuffix("x"))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UserError(f"`uncertainty` {shown(part)}: {shown(text)} is not a number")
    if factor and not math.isfinite(own):
        raise UserError(
            f"`uncertainty` {part}: the actuator is ideal, its {word} cannot vary by a factor; "
            "give `wn` and `zeta` or an `actuator`"
        )
    return value * own if factor else value


def worst_inside(box: Box, rise: object, seed: int = 0, starts: int = 24) -> np.ndarray:
    """Fractions in the box where a function is largest, by projected ascent from many points.

    rise: function of members -> (values (n,), derivatives by their parameters (n, 4)); NaN counts
        as worst
    starts: of the ascent, besides the centre

    Returns the best fraction of every start, shape (starts + 1, varied); all are returned because
    they may belong to different peaks.
    """
    names = box.names
    columns = [PARAMETERS.index(name) for name in names]
    span = np.array([box.high[n] - box.low[n] for n in names])

    def in_box(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value, slope = rise(box.place(u))  # type: ignore[operator]
        return value, slope[:, columns] * span

    return ascend(in_box, spread(len(names), starts, seed))


def spread(dimensions: int, starts: int, seed: int) -> np.ndarray:
    """The centre of a box and points all over it, as fractions, shape (starts + 1, dimensions)."""
    from scipy.stats import qmc

    power = max(starts - 1, 1).bit_length()
    points = qmc.Sobol(dimensions, scramble=True, rng=seed).random_base2(power)[:starts]
    return np.concatenate([np.full((1, dimensions), 0.5), points])


def ascend(rise: Rise, u: np.ndarray, rounds: int = _ASCENTS) -> np.ndarray:
    """Where projected ascent leads from each point of the unit box, shape (n, dimensions).

    rise: NaN counts as worst
    u: where it begins, shape (n, dimensions)
    rounds: most steps
    """
    value, slope = _rise(rise, u)
    radius = np.full(len(u), 0.25)
    for _ in range(rounds):
        # The largest linear step in a box of that radius: every parameter to its better side.
        trial = np.clip(u + radius[:, None] * np.sign(slope), 0.0, 1.0)
        there, there_slope = _rise(rise, trial)
        taken = there > value
        u = np.where(taken[:, None], trial, u)
        value = np.where(taken, there, value)
        slope = np.where(taken[:, None], there_slope, slope)
        radius = np.where(taken, np.minimum(1.5 * radius, 0.5), 0.4 * radius)
        if np.all(radius < 1e-4):
            break
    return u


def _rise(rise: Rise, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    value, slope = rise(u)
    return np.where(np.isnan(value), np.inf, value), np.nan_to_num(slope)
