"""Chunks of a sweep of margins: a robot's linearised loops, on the cores of this machine."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxact import engines
from jaxact.analysis.robot.one_thread import one_thread
from jaxact.analysis.robot.processes import Helpers, helping
from jaxact.errors import UserError
from jaxact.loops.samples import Samples
from jaxact.loops.weak_joints import tell_leaving
from jaxact.parameters import CONTROL_RATE
from jaxact.status import Verdict
from jaxact.sweeping.variables import variables

if TYPE_CHECKING:
    from jaxact.analysis.robot.many import Motion
    from jaxact.loops.specification import Specification
    from jaxact.robot_margins.families import Found
    from jaxact.simulation.plans import Plan
    from jaxact.sweeping.computer import ChunkTask

# Loops for each process beside this one, at least: what one does while another starts.
_WORTH = 64


@dataclass(frozen=True)
class _Shared:
    """What all tasks of a sweep have in common.

    Attributes:
        specification: with the engine that its robot is linearised in.
        samples: all loops.
        reference: gains by key, from `families.reference`.
        model: digest of the robot.
    """

    specification: Specification
    samples: Samples
    reference: Mapping[str, float]
    model: str


class MarginsComputer:
    """Computes chunks of margins, as `jaxact.sweeping.computer.Computer` does of rollouts."""

    plan: tuple[Plan, Specification] | None = None

    def __init__(self, work: ChunkTask) -> None:
        self._work = work
        self._shared = _shared(work.specification, work.samples)

    def __call__(self, number: int) -> tuple[dict[str, np.ndarray], int]:
        """The results of a chunk by variable, and the tile of the store."""
        ((_, found),) = self.each([number])
        return found

    def each(
        self, numbers: Iterable[int]
    ) -> Iterator[tuple[int, tuple[dict[str, np.ndarray], int]]]:
        """The results of chunks in order."""
        chunks = list(numbers)
        layout = self._work.store.layout
        count = helping_processes(
            self._work.specification, sum(layout.span(number)[1] for number in chunks)
        )
        with one_thread(), helping(count, _computing, self._shared) as pool:
            for number in chunks:
                found = _margins(self._shared, layout.numbers(number), pool)
                yield number, (found, self._work.store.tile)


def recomputed(
    specification: Specification, samples: Samples, numbers: np.ndarray
) -> dict[str, np.ndarray]:
    """Margins of some loops by variable, shape (n,) each.

    Args:
        specification: checked.
        samples: all its loops.
        numbers: of those, rising, shape (n,).
    """
    shared = _shared(specification, samples)
    count = helping_processes(specification, len(numbers))
    with one_thread(), helping(count, _computing, shared) as pool:
        return _margins(shared, numbers, pool)


def _shared(specification: Specification, samples: Samples) -> _Shared:
    from jaxact.robot_margins import families

    asked = linearised(specification)
    return _Shared(asked, samples, families.reference(samples), _model(asked, samples))


def _model(specification: Specification, samples: Samples) -> str:
    from jaxact.simulation import plans

    return plans.groups(specification, samples)[0].case.model


def _computing(shared: _Shared) -> Callable[[np.ndarray], list[Found]]:
    """What computes the margins of some samples, by their numbers, rising."""
    from jaxact.robot_margins import families

    if _model(shared.specification, shared.samples) != shared.model:
        raise UserError("the robot's model has changed since the sweep began")

    return families.Families(shared.specification, shared.samples, shared.reference).evaluate


def linearised(specification: Specification) -> Specification:
    """The same with the engine that its robot is linearised in."""
    return dataclasses.replace(specification, engine=engines.MUJOCO.name, tile=None, devices=None)


def processes(specification: Specification) -> int:
    """Processes that compute: as many as there are cores, or as devices are asked for."""
    if specification.devices is not None:
        return specification.devices
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def helping_processes(specification: Specification, loops: int) -> int:
    """Processes beside this one; few loops are done before one has started."""
    return min(processes(specification) - 1, loops // _WORTH)


def _margins(shared: _Shared, numbers: np.ndarray, pool: Helpers) -> dict[str, np.ndarray]:
    from jaxact.robot_margins import families

    parts = families.parts(shared.samples, numbers)
    by_number = {
        int(number): one
        for part, found in zip(parts, pool.map(parts), strict=True)
        for number, one in zip(part, found, strict=True)
    }
    found = [by_number[int(number)] for number in numbers]
    tell_leaving(one[0].leaves for one in found if one is not None)
    rows = {name: np.full(len(found), np.nan) for name in variables(robot=True, margins=True)}
    rate = shared.samples.take(numbers)[CONTROL_RATE]
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
