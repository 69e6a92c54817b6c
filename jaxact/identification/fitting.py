"""Bounded least squares with forward derivatives, from several starts.

    minimise  sum_i r_i(x)^2,      x within its bounds

The delay of a held command makes the sum smooth between control ticks and gives it a kink at each:
its range is therefore cut at whole periods, each piece is a problem of its own, and those whose
start is best are solved. Positive unknowns are searched as logarithms.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from jaxact.parameters import DELAY

Values = Mapping[str, jax.Array]

# The most promising pieces are solved; from a solution at a tick the search goes on beyond it.
_MOST_PIECES = 2
_MOST_CROSSED = 4
_TOLERANCE = 1e-8
_MOST_EVALUATIONS = 40
# Unknowns that are differentiated together are padded to a multiple of this.
_LANES = 4
_LARGEST_EXPONENT = 700.0
# At most so many starts are looked at before the best ones are solved.
_MOST_STARTS = 256


@dataclass(frozen=True)
class Unknown:
    """A number that is sought.

    Attributes:
        name: as it is reported.
        unit: "1" for none.
        low, high: bounds, both finite.
        starts: where the search begins.
        positive: sought as a logarithm.
        nuisance: of no interest itself, such as where a log begins.
        inverse_of: name of the model's number and a factor, where what is reported is the factor
            over that number: a time constant instead of a frequency.
    """

    name: str
    unit: str
    low: float
    high: float
    starts: tuple[float, ...]
    positive: bool = False
    nuisance: bool = False
    inverse_of: tuple[str, float] | None = None

    @property
    def model_name(self) -> str:
        """Of the model's number that it is."""
        return self.inverse_of[0] if self.inverse_of else self.name

    def inner(self, value: float) -> float:
        """The value as it is searched."""
        if self.inverse_of:
            return math.log(self.inverse_of[1] / value)
        return math.log(value) if self.positive else value

    def value(self, inner: float) -> float:
        """The value that is searched as `inner`."""
        if self.inverse_of:
            return self.inverse_of[1] * math.exp(min(-inner, _LARGEST_EXPONENT))
        return math.exp(min(inner, _LARGEST_EXPONENT)) if self.positive else float(inner)


@dataclass(frozen=True)
class Problem:
    """What is fitted to what.

    All numbers of the model are arguments of one compiled function, sought or not, so that it
    serves every rung of a ladder.

    Attributes:
        unknowns: sought.
        numbers: of the model by name, with the values of those that are not sought; positive ones
            are searched as logarithms.
        positive: names of the positive ones.
        simulate: (values by name, inputs of one log) -> the signal, shape (rows,); pure and
            hashable.
        inputs: of each log, pytrees of arrays.
        measured: of each log, shape (rows,).
        scale: by which residuals are multiplied.
        period: control period at whose multiples the delay has kinks [s]; None where it has none.
    """

    unknowns: tuple[Unknown, ...]
    numbers: Mapping[str, float]
    positive: frozenset[str]
    simulate: Callable[[Values, Any], jax.Array]
    inputs: tuple[Any, ...]
    measured: tuple[np.ndarray, ...]
    scale: float
    period: float | None

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns."""
        return tuple(unknown.name for unknown in self.unknowns)

    @property
    def lengths(self) -> tuple[int, ...]:
        """Rows of each log."""
        return tuple(len(rows) for rows in self.measured)

    def values(self, point: np.ndarray) -> dict[str, float]:
        """The unknowns by name at a point of the search."""
        return {u.name: u.value(x) for u, x in zip(self.unknowns, point.tolist(), strict=True)}

    def model_values(self, point: np.ndarray) -> dict[str, float]:
        """All numbers of the model at a point of the search."""
        sought = zip(self.unknowns, self.values(point).values(), strict=True)
        own = {
            u.model_name: u.inverse_of[1] / value if u.inverse_of else value for u, value in sought
        }
        return {**self.numbers, **own}

    def outer(self, point: np.ndarray) -> np.ndarray:
        """Residuals at a point of the search, shape (rows,)."""
        return np.asarray(_outer(self._whole(point), *self._data()))

    def slopes(self, point: np.ndarray) -> np.ndarray:
        """Derivatives of the residuals there, shape (rows, unknowns)."""
        places = self._places()
        # Padded, so that the rungs of a ladder share a program whatever they leave free.
        lanes = _LANES * -(-len(places) // _LANES)
        directions = np.zeros((lanes, len(self.numbers)))
        directions[np.arange(len(places)), places] = 1.0
        every = _slopes(self._whole(point), jnp.asarray(directions), *self._data())
        return np.asarray(every)[: len(places)].T

    def _places(self) -> list[int]:
        names = list(self.numbers)
        return [names.index(u.model_name) for u in self.unknowns]

    def _whole(self, point: np.ndarray) -> jax.Array:
        whole = np.array(
            [math.log(v) if name in self.positive else v for name, v in self.numbers.items()]
        )
        whole[self._places()] = point
        return jnp.asarray(whole)

    def _data(self) -> tuple[Any, ...]:
        described = tuple((name, name in self.positive) for name in self.numbers)
        return self.inputs, self.measured, self.scale, self.simulate, described


def _residuals(whole, inputs, measured, scale, simulate, described):
    values = {
        name: _exponential(whole[at]) if positive else whole[at]
        for at, (name, positive) in enumerate(described)
    }
    rows = [
        scale * (simulate(_of_log(values, number), own) - given)
        for number, (own, given) in enumerate(zip(inputs, measured, strict=True))
    ]
    return jnp.concatenate(rows)


def _exponential(x: jax.Array) -> jax.Array:
    """exp(x), whose derivative is 0 and not undefined where x is infinite."""
    infinite = jnp.isinf(x)
    return jnp.where(infinite, jnp.inf, jnp.exp(jnp.where(infinite, 0.0, x)))


def _of_log(values: Values, number: int) -> Values:
    """The numbers of one log: `name[2]` is the `name` of log 2 alone."""
    own = {name: value for name, value in values.items() if "[" not in name}
    mark = f"[{number}]"
    return own | {
        name.removesuffix(mark): value for name, value in values.items() if name.endswith(mark)
    }


# Logs are arguments, so that a program serves all logs of its length.
_outer = jax.jit(_residuals, static_argnums=(4, 5))


@partial(jax.jit, static_argnums=(5, 6))
def _slopes(whole, directions, *data):
    """Derivatives of the residuals along each direction, shape (directions, rows)."""
    return jax.vmap(lambda along: jax.jvp(lambda x: _residuals(x, *data), (whole,), (along,))[1])(
        directions
    )


@dataclass(frozen=True)
class Fit:
    """A solved problem.

    Attributes:
        problem: it.
        point: solution in the coordinates of the search, shape (unknowns,).
        residuals: there, shape (rows,).
        slopes: derivatives of the residuals there, shape (rows, unknowns).
        at_bounds: unknowns that lie at a bound of their range.
        evaluations: of the residuals, in all.
    """

    problem: Problem
    point: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray
    at_bounds: tuple[str, ...]
    evaluations: int

    @property
    def values(self) -> dict[str, float]:
        """The unknowns by name."""
        return self.problem.values(self.point)

    @property
    def square_sum(self) -> float:
        """Sum of the squared residuals."""
        return float(self.residuals @ self.residuals)


def solve(
    sought: Problem,
    *,
    loss: str = "linear",
    fixed: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
) -> Fit:
    """The least squares, from the most promising starts.

    Args:
        sought: the problem.
        loss: of `scipy.optimize.least_squares`; "soft_l1" and "huber" bear outliers.
        fixed: unknowns that are held at a value.
        start: unknowns that begin at a value instead of each of their starts.

    Returns:
        The best solution found.
    """
    held = {} if fixed is None else dict(fixed)
    best: Fit | None = None
    counted = 0
    seen: set[int | None] = set()
    waiting = _begin(sought, held, {} if start is None else start)[:_MOST_PIECES]
    while waiting and len(seen) < _MOST_PIECES + _MOST_CROSSED:
        piece, point = waiting.pop(0)
        if piece in seen:
            continue
        seen.add(piece)
        found = _solve_piece(sought, held, point, piece, loss)
        counted += found.evaluations
        if best is None or found.square_sum < best.square_sum:
            best = found
            waiting = [(beyond, found.point) for beyond in _beyond(sought, found, piece)] + waiting
    assert best is not None
    return replace(best, evaluations=counted)


def _solve_piece(
    sought: Problem, held: Mapping[str, float], point: np.ndarray, piece: int | None, loss: str
) -> Fit:
    """The least squares with the delay between two ticks."""
    low, high = _bounds(sought, piece)
    free = [index for index, u in enumerate(sought.unknowns) if u.name not in held]
    base = np.clip(point, low, high)
    for index, unknown in enumerate(sought.unknowns):
        if unknown.name in held:
            base[index] = unknown.inner(held[unknown.name])
    if not free:
        return at(sought, base, evaluations=1)

    def full(inner: np.ndarray) -> np.ndarray:
        whole = base.copy()
        whole[free] = inner
        return whole

    margin = 1e-9 * (high - low)
    solved = least_squares(
        lambda inner: sought.outer(full(inner)),
        np.clip(base, low + margin, high - margin)[free],
        jac=lambda inner: sought.slopes(full(inner))[:, free],
        bounds=(low[free], high[free]),
        x_scale="jac",
        loss=loss,
        xtol=_TOLERANCE, ftol=_TOLERANCE, gtol=_TOLERANCE,
        max_nfev=_MOST_EVALUATIONS,
    )  # fmt: skip
    return at(sought, full(solved.x), evaluations=int(solved.nfev))


def _beyond(sought: Problem, found: Fit, piece: int | None) -> list[int]:
    """The piece beyond the tick at which a solution's delay lies."""
    if piece is None or sought.period is None:
        return []
    delay = found.point[sought.names.index(DELAY)] / sought.period
    last = round(sought.unknowns[sought.names.index(DELAY)].high / sought.period) - 1
    if delay - piece < 1e-3 and piece > 0:
        return [piece - 1]
    if piece + 1 - delay < 1e-3 and piece < last:
        return [piece + 1]
    return []


def at(sought: Problem, point: np.ndarray, *, evaluations: int = 0) -> Fit:
    """A problem's residuals and slopes at a point, as a fit."""
    low, high = _bounds(sought)
    span = high - low
    touched = (point - low < 1e-4 * span) | (high - point < 1e-4 * span)
    return Fit(
        problem=sought,
        point=point,
        residuals=sought.outer(point),
        slopes=sought.slopes(point),
        at_bounds=tuple(
            u.name for u, there in zip(sought.unknowns, touched.tolist(), strict=True) if there
        ),
        evaluations=evaluations,
    )


def _bounds(sought: Problem, piece: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the search, of the delay between the ticks `piece` and `piece + 1`."""
    both = np.array([sorted((u.inner(u.low), u.inner(u.high))) for u in sought.unknowns], float)
    low, high = both[:, 0].copy(), both[:, 1].copy()
    if piece is not None and sought.period is not None:
        index = sought.names.index(DELAY)
        low[index] = piece * sought.period
        high[index] = min(high[index], (piece + 1) * sought.period)
    return low, high


def _begin(
    sought: Problem, held: Mapping[str, float], start: Mapping[str, float]
) -> list[tuple[int | None, np.ndarray]]:
    """(piece, point) of the best start of each piece, the best first."""
    chosen = {**start, **held}
    each = [
        (min(max(chosen[u.name], u.low), u.high),) if u.name in chosen else u.starts
        for u in sought.unknowns
    ]
    rows = itertools.islice(itertools.product(*each), _MOST_STARTS)
    points = [
        np.array([u.inner(x) for u, x in zip(sought.unknowns, row, strict=True)], float)
        for row in rows
    ]
    if len(points) == 1:
        return [(_piece(sought, points[0], held), points[0])]
    # One after another: side by side they would need a compilation of their own.
    costs = [float(np.sum(np.square(sought.outer(point)))) for point in points]
    found: dict[int | None, np.ndarray] = {}
    for index in np.argsort(costs, kind="stable").tolist():
        if math.isfinite(costs[index]):
            found.setdefault(_piece(sought, points[index], held), points[index])
    return list(found.items()) or [(_piece(sought, points[0], held), points[0])]


def _piece(sought: Problem, point: np.ndarray, held: Mapping[str, float]) -> int | None:
    """Number of the tick before the point's delay; None where nothing has kinks."""
    if sought.period is None or DELAY not in sought.names or DELAY in held:
        return None
    index = sought.names.index(DELAY)
    last = round(sought.unknowns[index].high / sought.period) - 1
    return min(math.floor(point[index] / sought.period + 1e-9), max(last, 0))
