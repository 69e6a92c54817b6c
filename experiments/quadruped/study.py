"""What the experiment computes: verdicts, critical gain scales, and a map, of each situation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cases
import critical
import numpy as np
from cases import Drives

from jaxact.loops.specification import Specification
from jaxact.status import Verdict

LOWEST, HIGHEST = 0.3, 6.0  # gain scales
# Rollouts are searched from here to there, as multiples of the linear answer.
ABOVE, BELOW = 2.0, 0.6


@dataclass(frozen=True)
class Size:
    """How much is computed.

    situations: by name
    map_scales, map_delays: points of the map
    rollout: of critical gain scales [s]
    points, rounds: of the search for them in rollouts
    linear_points, linear_rounds: of the search for them by the growth rate
    duration: of the rollouts with push and errors [s]; None: as specified
    """

    situations: tuple[str, ...] = cases.SITUATIONS
    map_scales: int = 49
    map_delays: int = 21
    rollout: float = 4.0
    points: int = 6
    rounds: int = 3
    linear_points: int = 16
    linear_rounds: int = 3
    duration: float | None = None


FULL = Size()
QUICK = Size(
    ("three",), 5, 2, rollout=0.3, points=3, rounds=1, linear_points=4, linear_rounds=1,
    duration=0.45,
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A drive in a situation; without a push and with one.

    verdicts: names of verdicts of nominal and tripled gains, shape (pushes, scales)
    growth_rates: of nominal and tripled gains [1/s]
    """

    actuator: str
    delay: float
    bare: bool
    verdicts: tuple[tuple[str, ...], ...]
    growth_rates: tuple[float, ...]

    def calm(self, scale: int) -> bool:
        """Whether it is stable at one of the gain scales, pushed or not."""
        return all(row[scale] == Verdict.STABLE.label for row in self.verdicts)


@dataclass(frozen=True)
class Critical:
    """Where a drive in a situation is stable; gain scales within LOWEST to HIGHEST.

    topples: smallest stable one, 0: stable from LOWEST on; NaN: never stable
    linear: largest stable one by the growth rate, inf: stable to HIGHEST; NaN: never
    rollouts: the same by nonlinear rollouts alone, NaN where it was not searched
    """

    actuator: str
    delay: float
    topples: float
    linear: float
    rollouts: float

    @property
    def difference(self) -> float:
        """Of the rollouts from the linear one, relative."""
        return self.rollouts / self.linear - 1.0 if np.isfinite(self.linear) else np.nan


@dataclass(frozen=True)
class Map:
    """Growth rates [1/s], shape (actuators, delays, scales); axes beside it."""

    delays: np.ndarray
    scales: np.ndarray
    growth_rates: np.ndarray


@dataclass(frozen=True)
class Situation:
    """Everything about one situation."""

    cases: tuple[Case, ...]
    critical: tuple[Critical, ...]
    map: Map


def situation(specification: Specification, size: Size) -> Situation:
    """Everything about one situation.

    specification: with its push and its errors
    size: how much is computed
    """
    smooth = cases.smooth(specification, size.rollout)
    return Situation(_cases(specification, smooth), _critical(smooth, size), _map(smooth, size))


def _cases(specification: Specification, smooth: Specification) -> tuple[Case, ...]:
    drives = cases.drives(bare=True)
    columns = drives.columns(cases.SCALES)
    growth = critical.growth_rates(smooth, columns)
    columns |= drives.errors(specification, len(cases.SCALES))
    pushes = (replace(specification, push=None), specification)
    codes = np.stack([critical.simulated(one, columns, growth)["verdict"] for one in pushes])
    codes = codes.reshape(len(pushes), len(cases.SCALES), len(drives))
    rates = growth.reshape(len(cases.SCALES), len(drives))
    return tuple(
        Case(
            actuator=str(drives.actuators[place]),
            delay=float(drives.delays[place]),
            bare=bool(drives.bare[place]),
            verdicts=tuple(
                tuple(Verdict(int(code)).label for code in row) for row in codes[:, :, place]
            ),
            growth_rates=tuple(float(rate) for rate in rates[:, place]),
        )
        for place in range(len(drives))
    )


def _critical(smooth: Specification, size: Size) -> tuple[Critical, ...]:
    drives = cases.drives(bare=False)
    columns = drives.columns()

    def decays(columns):
        return critical.growth_rates(smooth, columns) < 0.0

    search = {"points": size.linear_points, "rounds": size.linear_rounds}
    topples = critical.edge(decays, columns, LOWEST, HIGHEST, **search)
    linear = critical.edge(decays, columns, HIGHEST, LOWEST, **search)
    rollouts = np.full(len(drives), np.nan)
    there = np.flatnonzero(np.isfinite(linear))
    if there.size:
        rollouts[there] = critical.edge(
            lambda columns: critical.die_out(smooth, columns),
            {name: values[there] for name, values in columns.items()},
            linear[there] * ABOVE,
            linear[there] * BELOW,
            points=size.points,
            rounds=size.rounds,
        )
    rows = zip(drives.actuators, drives.delays, topples, linear, rollouts, strict=True)
    return tuple(Critical(str(name), *(float(number) for number in row)) for name, *row in rows)


def _map(smooth: Specification, size: Size) -> Map:
    delays = np.linspace(0.0, max(cases.DELAYS), size.map_delays)
    scales = np.geomspace(LOWEST, HIGHEST, size.map_scales)
    drives: Drives = cases.drives(bare=False, delays=tuple(delays))
    growth = critical.growth_rates(smooth, drives.columns(scales))
    growth = growth.reshape(len(scales), len(cases.ACTUATORS), len(delays))
    return Map(delays, scales, np.moveaxis(growth, 0, 2))
