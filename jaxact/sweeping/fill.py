"""Filling a store: what is missing is computed chunk by chunk, and written beside the next one."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.sweeping import planning, progress
from jaxact.sweeping import store as _store
from jaxact.sweeping.computer import ChunkTask, computer_of
from jaxact.sweeping.location import Location
from jaxact.sweeping.planning import Planned
from jaxact.sweeping.progress import State, Store
from jaxact.sweeping.variables import variables_of

if TYPE_CHECKING:
    from jaxact.simulation.plans import Plan

# Chunks that are computed and not yet written, at most.
_WAITING = 1

# Computes chunks by their numbers and says, for each that is in the store, which it was.
Workers = Callable[[ChunkTask, list[int], Callable[[], None]], Iterator[int]]


def fill(
    target: Location,
    specification: Specification,
    samples: Samples,
    planned: Planned,
    *,
    workers: Workers,
    outline: Samples | None = None,
    resume: bool = False,
    more: dict[str, object] | None = None,
    clear: Callable[[], None] | None = None,
    moved: Callable[[int, int], None] = lambda done, total: None,
) -> Store:
    """Make a store complete; what is in it already, whole, stays when it is resumed.

    Args:
        target: where the store is, or will be once its first chunk is computed.
        specification: checked.
        samples: expanded from it.
        planned: how it is computed.
        workers: who computes.
        outline: loops that span all values of the samples; None: the samples themselves.
        resume: continue what is there; otherwise it is replaced.
        more: further parts of the identity.
        clear: removes what it replaces, once there is something to put in; None: the old store.
        moved: called with the number of loops done and in all.

    Raises:
        UserError: what is there belongs to another specification.
        OSError: the store cannot be written.
    """
    old = progress.existing(target) if resume else None
    layout = planned.layout(samples)
    wanted = planning.identity(specification, planned, layout, **(more or {}))
    attributes = _store.provenance(specification, planned.device)
    if old is not None:
        wanted = same(target, specification, wanted)
        layout = old.layout
        attributes |= _store.beginning(target)
    tile = int(str(wanted["tile"]))
    specification = dataclasses.replace(specification, tile=tile)
    store = Store(target, layout, specification.precision, tile, variables_of(specification))

    @functools.cache
    def description() -> dict[str, bytes]:
        """All files but the results, once they are needed: what makes them is slow to import."""
        unfinished = attributes | {"complete": False}
        return _store.skeleton(specification, samples, layout, _store.as_json(wanted), unfinished)

    numbers = list(range(len(layout)))
    if old is not None:
        target.clean()
        numbers = [n for n in numbers if store.look(n).state is not State.DONE]
        if numbers or not _whole(target, description()):
            progress.repair(target, description())
    done = len(samples) - sum(layout.span(n)[1] for n in numbers)
    moved(done, len(samples))

    def begin() -> None:
        """Make the store, in place of an old one, as soon as there is something to put in it."""
        if old is None:
            files = description()
            (clear or target.remove)()
            progress.repair(target, files)

    together = layout.loops if outline is None else planned.loops
    work = ChunkTask(specification, samples, outline or samples, together, store)
    for number in workers(work, numbers, begin):
        done += layout.span(number)[1]
        moved(done, len(samples))
    return store


def same(
    target: Location, specification: Specification, wanted: dict[str, object]
) -> dict[str, object]:
    """The identity of the store that is continued; raises UserError if it is another sweep's."""
    there = _store.identity_of(target) or {}
    taken = {key: there[key] for key in planning.TAKEN_OVER if key in there}
    compared = {key: value for key, value in wanted.items() if key not in planning.TAKEN_OVER}
    if specification.tile is not None:
        compared["tile"] = wanted["tile"]
    progress.demand_equal(
        {key: value for key, value in there.items() if key in compared or key not in taken},
        compared,
        target.name,
    )
    return wanted | taken


def _whole(target: Location, description: dict[str, bytes]) -> bool:
    """Whether a finished store has all of its description."""
    root = _store.attributes_of(target) or {}
    return bool(root.get("complete")) and all(
        target.read(key) == content for key, content in description.items() if key != _store.ROOT
    )


def here(
    work: ChunkTask,
    numbers: Iterable[int],
    begin: Callable[[], None],
    *,
    keep: Callable[[Plan, Specification, float], None] = lambda plan, asked, rate: None,
) -> Iterator[int]:
    """Compute chunks on the devices of this process; one is written while the next is computed.

    Args:
        work, numbers, begin: see `Workers`.
        keep: told the plan and its rate [physics steps per second on one device] in the end.
    """
    waiting: deque[tuple[int, Future[None]]] = deque()
    started, loops = None, 0

    def write(number: int, results: dict[str, np.ndarray], tile: int, *, first: bool) -> None:
        if first:
            begin()
        work.store.write(number, results, tile)

    with ThreadPoolExecutor(1) as writer, ThreadPoolExecutor(1) as helper:
        compute = computer_of(work, helper)
        for number, (results, tile) in compute.each(numbers):
            waiting.append((number, writer.submit(write, number, results, tile, first=not started)))
            # the first chunk is compiled for
            loops += 0 if started is None else work.store.layout.span(number)[1]
            started = started or time.perf_counter()
            while len(waiting) > _WAITING:
                yield _written(*waiting.popleft())
        spent = 0.0 if started is None else time.perf_counter() - started
        while waiting:
            yield _written(*waiting.popleft())
    if loops and compute.plan is not None:
        plan, asked = compute.plan
        keep(plan, asked, loops * plan.steps / (spent * plan.devices))


def _written(number: int, future: Future[None]) -> int:
    future.result()
    return number
