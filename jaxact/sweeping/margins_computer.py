"""Chunks of a sweep of margins: a robot's linearised loops, on the cores of this process."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from jaxact import engines
from jaxact.loops.samples import Samples
from jaxact.parameters import CONTROL_RATE
from jaxact.status import Verdict
from jaxact.sweeping.variables import variables

if TYPE_CHECKING:
    from jaxact.analysis.robot.many import Motion
    from jaxact.loops.specification import Specification
    from jaxact.simulation.plans import Plan
    from jaxact.sweeping.computer import ChunkTask


class MarginsComputer:
    """Computes chunks of margins, as `jaxact.sweeping.computer.Computer` does of rollouts."""

    plan: tuple[Plan, Specification] | None = None

    def __init__(self, work: ChunkTask) -> None:
        from jaxact.robot_margins import families

        self._work = work
        self._threads = threads(work.specification)
        self._specification = linearised(work.specification)
        self._reference = families.reference(work.samples)

    def __call__(self, number: int) -> tuple[dict[str, np.ndarray], int]:
        """The results of a chunk by variable, and the tile of the store."""
        with ThreadPoolExecutor(self._threads) as pool:
            return self._computed(number, pool), self._work.store.tile

    def each(
        self, numbers: Iterable[int]
    ) -> Iterator[tuple[int, tuple[dict[str, np.ndarray], int]]]:
        """The results of chunks in order."""
        with ThreadPoolExecutor(self._threads) as pool:
            for number in numbers:
                yield number, (self._computed(number, pool), self._work.store.tile)

    def _computed(self, number: int, pool: ThreadPoolExecutor) -> dict[str, np.ndarray]:
        numbers = self._work.store.layout.numbers(number)
        return _margins(self._specification, self._work.samples, numbers, self._reference, pool)


def recomputed(
    specification: Specification, samples: Samples, numbers: np.ndarray
) -> dict[str, np.ndarray]:
    """Margins of some loops by variable, shape (n,) each.

    Args:
        specification: checked.
        samples: all its loops.
        numbers: of those, rising, shape (n,).
    """
    from jaxact.robot_margins import families

    asked = linearised(specification)
    with ThreadPoolExecutor(threads(specification)) as pool:
        return _margins(asked, samples, numbers, families.reference(samples), pool)


def linearised(specification: Specification) -> Specification:
    """The same with the engine that its robot is linearised in."""
    return dataclasses.replace(specification, engine=engines.MUJOCO.name, tile=None, devices=None)


def threads(specification: Specification) -> int:
    """Threads that compute: as many as there are cores, or as devices are asked for."""
    if specification.devices is not None:
        return specification.devices
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _margins(
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
    reference: Mapping[str, float],
    pool: ThreadPoolExecutor,
) -> dict[str, np.ndarray]:
    from jaxact.robot_margins import families

    found = families.evaluate(specification, samples, numbers, reference, pool.map)
    rows = {name: np.full(len(found), np.nan) for name in variables(robot=True, margins=True)}
    rate = samples.take(numbers)[CONTROL_RATE]
    for place, one in enumerate(found):
        rows["verdict"][place] = Verdict.INVALID if one is None else _verdict(one[0])
        if one is None:
            continue
        motion, whole = one
        with np.errstate(divide="ignore"):
            rows["growth_rate"][place] = np.log(motion.spectral_radius) * rate[place]
        for name in ("shaking_rate", "toppling_rate", "unstable_roots"):
            rows[name][place] = getattr(motion, name)
        for name, value in vars(whole).items() if whole is not None else ():
            rows[name][place] = value
    return rows


def _verdict(motion: Motion) -> Verdict:
    if not motion.unstable_roots:
        return Verdict.STABLE
    return Verdict.UNSTABLE if motion.shakes else Verdict.TOPPLES
