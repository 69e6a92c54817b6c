"""What is fitted to what: unknowns, logs, and the residuals with their forward derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.compilation.programs import Program
from jaxact.parameters import DELAY, WN, ZETA

# Unknowns that are differentiated together are padded to a multiple of this, so that the rungs of a
# ladder share a program whatever they leave free.
_LANES = 12
_LARGEST_EXPONENT = 700.0
# A residual in shares of the signal's spread, or a slope of it, that nothing is to be made of.
_HOPELESS = 1e50


@dataclass(frozen=True)
class Unknown:
    """A number that is sought.

    Attributes:
        name: as it is reported.
        unit: "1" for none.
        low, high: bounds, both finite.
        starts: where the search begins.
        positive: sought as a logarithm.
        log: number of the only log that it is of, such as where that log begins: of no interest
            itself; None where it is of all.
        inverse_of: name of the model's number and a factor, where what is reported is the factor
            over that number: a time constant instead of a frequency.
    """

    name: str
    unit: str
    low: float
    high: float
    starts: tuple[float, ...]
    positive: bool = False
    log: int | None = None
    inverse_of: tuple[str, float] | None = None

    @property
    def nuisance(self) -> bool:
        """Whether it is of one log only."""
        return self.log is not None

    @property
    def model_name(self) -> str:
        """Of the model's number that it is."""
        if self.nuisance:
            return self.name.partition("[")[0]
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
    serves every rung of a ladder; logs are filled up to a few lengths, so that it serves them all.

    Attributes:
        unknowns: sought.
        numbers: of the model by name, with the values of those that are not sought; positive ones
            are searched as logarithms.
        positive: names of the positive ones.
        simulate: (values by name, inputs of one log) -> the signal, shape (rows or more,); pure
            and hashable.
        inputs: of each log, pytrees of arrays.
        measured: of each log, shape (rows,).
        scale: by which residuals are multiplied.
        period: control period at whose multiples the delay has kinks [s]; None where it has none.
    """

    unknowns: tuple[Unknown, ...]
    numbers: Mapping[str, float]
    positive: frozenset[str]
    simulate: Callable[[Mapping[str, Any], Any], jax.Array]
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
        """All numbers of the model at a point of the search, those of single logs apart."""
        sought = zip(self.unknowns, self.values(point).values(), strict=True)
        own = {
            u.model_name: u.inverse_of[1] / value if u.inverse_of else value
            for u, value in sought
            if not u.nuisance
        }
        return {**self.numbers, **own}

    def evaluate(
        self, point: np.ndarray, logs: Sequence[int] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals at a point of the search, and their derivatives by the unknowns.

        Args:
            point: shape (unknowns,).
            logs: numbers of those that are looked at; None for all.

        Returns:
            Of the logs one after another, shapes (rows,) and (rows, unknowns).
        """
        with jax.enable_x64(True):
            # All are under way before the first is waited for.
            chosen = range(len(self.inputs)) if logs is None else logs
            started = [(self._started(point, number), self.measured[number]) for number in chosen]
        rests, slopes = [], []
        for (signal, along, places), measured in started:
            rows = len(measured)
            rests.append(_bounded(self.scale * (np.asarray(signal)[:rows] - measured)))
            own = np.zeros((rows, len(self.unknowns)))
            own[:, places] = _bounded(self.scale * np.asarray(along)[: len(places), :rows].T)
            slopes.append(own)
        return np.concatenate(rests), np.concatenate(slopes)

    def _started(self, point: np.ndarray, number: int) -> tuple[jax.Array, jax.Array, list[int]]:
        """Signal of one log, its derivatives, and by which unknowns they are."""
        order = {name: at for at, name in enumerate(self.numbers)}
        places = [at for at, u in enumerate(self.unknowns) if u.log in (None, number)]
        whole = np.array(
            [math.log(v) if name in self.positive else v for name, v in self.numbers.items()]
        )
        directions = np.zeros((max(_LANES * -(-len(places) // _LANES), _LANES), len(whole)))
        for lane, at in enumerate(places):
            column = order[self.unknowns[at].model_name]
            whole[column] = point[at]
            directions[lane, column] = 1.0
        signal, along = _signal(
            whole, directions, self.inputs[number], simulate=self.simulate,
            described=tuple((name, name in self.positive) for name in self.numbers),
        )  # fmt: skip
        return signal, along, places


def _bounded(values: np.ndarray) -> np.ndarray:
    """Numbers whose squares can be added up, also of a simulation that has diverged."""
    return np.clip(np.nan_to_num(values, nan=_HOPELESS), -_HOPELESS, _HOPELESS)


def effective_lag(values: Mapping[str, float]) -> float:
    """``delay + 2 zeta / wn`` [s]: what slow excitation sees of a drive, as one number.

    Args:
        values: of the model.
    """
    return float(values[DELAY] + 2.0 * values[ZETA] / values[WN])


@Program
def _signal(whole, directions, inputs, *, simulate, described):
    """Signal of one log, and its derivatives along each direction, shape (directions, rows)."""

    def made(x):
        values = {
            name: _exponential(x[at]) if positive else x[at]
            for at, (name, positive) in enumerate(described)
        }
        return simulate(values, inputs)

    return jax.vmap(lambda along: jax.jvp(made, (whole,), (along,)), out_axes=(None, 0))(directions)


def _exponential(x: jax.Array) -> jax.Array:
    """exp(x), whose derivative is 0 and not undefined where x is infinite."""
    infinite = jnp.isinf(x)
    return jnp.where(infinite, jnp.inf, jnp.exp(jnp.where(infinite, 0.0, x)))
