"""Filling a store: what is missing is computed chunk by chunk, and written beside the next one."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.errors import UserError
from jaxact.sweep import place as _place
from jaxact.sweep import planning, progress
from jaxact.sweep import store as _store
from jaxact.sweep.place import Place
from jaxact.sweep.planning import Planned
from jaxact.sweep.progress import State, Store
from jaxact.sweep.samples import Samples
from jaxact.sweep.specification import Specification

if TYPE_CHECKING:
    from jaxact.sweep.execute import Begun
    from jaxact.sweep.plans import Plan

# Chunks that are computed and not yet written, at most.
_WAITING = 1


@dataclass(frozen=True)
class Work:
    """All that is needed to compute any chunk of a store, here or on another machine.

    specification: checked; its tile is that of the store
    samples: all loops
    outline: loops that span all values of theirs, from which the kernel's static options follow
    together: loops that are computed together
    store: where the results go
    """

    specification: Specification
    samples: Samples
    outline: Samples
    together: int
    store: Store


# Computes chunks by their numbers and says, for each that is in the store, which it was.
Workers = Callable[[Work, list[int], Callable[[], None]], Iterator[int]]


def fill(
    target: Place,
    specification: Specification,
    samples: Samples,
    planned: Planned,
    *,
    workers: Workers,
    outline: Samples | None = None,
    resume: bool = False,
    more: dict[str, object] | None = None,
    moved: Callable[[int, int], None] = lambda done, total: None,
) -> Store:
    """Make a store complete; what is in it already, whole, stays when it is resumed.

    target: where the store is, or will be once its first chunk is computed
    specification: checked
    samples: expanded from it
    planned: how it is computed
    workers: who computes
    outline: loops that span all values of the samples; None: the samples themselves
    resume: continue what is there; otherwise it is replaced
    more: further parts of the identity
    moved: called with the number of loops done and in all

    Raises UserError if what is there belongs to another specification, OSError if the store cannot
    be written.
    """
    old = progress.existing(target) if resume else None
    layout = planned.layout(samples)
    wanted = planning.identity(specification, planned, layout, **(more or {}))
    attributes = _store.provenance(specification, planned.device)
    if old is not None:
        wanted = same(target, specification, wanted)
        layout = old.layout
        attributes = _kept(target) or attributes
    tile = int(str(wanted["tile"]))
    specification = dataclasses.replace(specification, tile=tile)
    store = Store(target, layout, specification.precision, tile)

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
            target.remove()
            progress.repair(target, files)

    together = layout.loops if outline is None else planned.loops
    work = Work(specification, samples, outline or samples, together, store)
    for number in workers(work, numbers, begin):
        done += layout.span(number)[1]
        moved(done, len(samples))
    return store


def same(
    target: Place, specification: Specification, wanted: dict[str, object]
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


def _kept(target: Place) -> dict[str, Any] | None:
    """What a store says of its beginning; None where that is lost."""
    found = _store.attributes_of(target)
    if found is None:
        return None
    ours = ("complete", "summary", "coordinates", _store.IDENTITY)
    return {key: value for key, value in found.items() if key not in ours}


def _whole(target: Place, description: dict[str, bytes]) -> bool:
    """Whether a finished store has all of its description."""
    root = _store.attributes_of(target) or {}
    return bool(root.get("complete")) and all(
        target.read(key) == content for key, content in description.items() if key != _store.ROOT
    )


def here(
    work: Work,
    numbers: Iterable[int],
    begin: Callable[[], None],
    *,
    keep: Callable[[Plan, Specification, float], None] = lambda plan, asked, rate: None,
) -> Iterator[int]:
    """Compute chunks on the devices of this process; one is written while the next is computed.

    work, numbers, begin: see `Workers`
    keep: told the plan and its rate [physics steps per second on one device] in the end
    """
    waiting: deque[tuple[int, Future[None]]] = deque()
    started, loops = None, 0

    def write(number: int, results: dict[str, np.ndarray], tile: int, *, first: bool) -> None:
        if first:
            begin()
        work.store.write(number, results, tile)

    with ThreadPoolExecutor(1) as writer, ThreadPoolExecutor(1) as helper:
        compute = Computer(work, helper)
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
    if loops:
        plan, asked = compute.plan
        keep(plan, asked, loops * plan.steps / (spent * plan.devices))


def _in_pairs(numbers: Iterable[int]) -> Iterator[tuple[int, int | None]]:
    """Each number with the one that follows it."""
    ahead = iter(numbers)
    number = next(ahead, None)
    while number is not None:
        following = next(ahead, None)
        yield number, following
        number = following


def _written(number: int, future: Future[None]) -> int:
    future.result()
    return number


class Computer:
    """Computes chunks; once a device runs out of memory, in tiles of half the size.

    While one is simulated, `helper` prepares the growth rates of the next, so that the devices need
    not wait for what is done outside them; nobody does where it is None.
    """

    def __init__(self, work: Work, helper: Executor | None = None) -> None:
        from jaxact.sweep import engines

        self._work = work
        # For the built-in plants, of which a second of work is a million loops.
        small = work.specification.plant is None and not engines.old_jax()
        self._helper = helper if small else None
        self._plan(work.store.tile)

    def _plan(self, tile: int) -> None:
        from jaxact.sweep import plans

        self._tile = tile
        self._prepared: dict[int, Future[list[np.ndarray]]] = {}
        self._specification = dataclasses.replace(self._work.specification, tile=tile)
        self._groups = plans.groups(
            self._specification, self._work.outline, together=self._work.together
        )

    @property
    def plan(self) -> tuple[Plan, Specification]:
        """The plan of the largest group of samples, and the specification with its tile."""
        return max(self._groups, key=lambda group: group.batch), self._specification

    def __call__(self, number: int) -> tuple[dict[str, np.ndarray], int]:
        """The results of a chunk by variable, and the tile they were computed with."""
        return self.finish(number, self.begin(number))

    def begin(self, number: int, following: int | None = None) -> tuple[Begun, int] | None:
        """Set the devices to compute a chunk, for `finish`.

        number: of the chunk
        following: the chunk that will be asked for next, if there is one
        """
        from jaxact.sweep import execute

        numbers = self._work.store.layout.numbers(number)
        try:
            growth = self._begun(number)
            if following is not None and self._helper is not None:
                self._prepared[following] = self._helper.submit(self._growth, following)
            begun = execute.begin(
                self._groups, self._specification, self._work.samples, numbers, growth
            )
        except (RuntimeError, MemoryError) as error:
            self._smaller(error, self._tile)
            return None
        return begun, self._tile

    def finish(
        self, number: int, begun: tuple[Begun, int] | None
    ) -> tuple[dict[str, np.ndarray], int]:
        """The results of a chunk by variable, and the tile they were computed with."""
        from jaxact.sweep import execute

        while True:
            if begun is not None:
                try:
                    return execute.finish(begun[0]), begun[1]
                except (RuntimeError, MemoryError) as error:
                    self._smaller(error, begun[1])
            begun = self.begin(number)

    def _smaller(self, error: Exception, tile: int) -> None:
        """Halve the tile with which a device has run out of memory; raises any other error."""
        if not _out_of_memory(error):
            raise error
        if tile > self._tile:
            return  # it was begun before another chunk had the tile halved
        if self._tile == 1:
            raise UserError(
                "a device has too little memory for a single loop; shorten the delays or"
                " the duration, or use another device"
            ) from error
        self._plan(self._tile // 2)

    def each(
        self, numbers: Iterable[int]
    ) -> Iterator[tuple[int, tuple[dict[str, np.ndarray], int]]]:
        """The results of chunks in order; with a helper, devices begin one before they end one."""
        running: deque[tuple[int, tuple[Begun, int] | None]] = deque()
        for number, following in _in_pairs(numbers):
            running.append((number, self.begin(number, following)))
            if len(running) > (self._helper is not None):
                ended, begun = running.popleft()
                yield ended, self.finish(ended, begun)
        for ended, begun in running:
            yield ended, self.finish(ended, begun)

    def _begun(self, number: int) -> list[np.ndarray]:
        """Growth rates of a chunk [1/s], and all that is needed to simulate it."""
        if self._helper is None:
            return self._growth(number)
        if number not in self._prepared:
            from jaxact.sweep import execute

            # The first chunk: two programs are compiled in less time side by side.
            self._prepared[number] = self._helper.submit(self._growth, number)
            numbers = self._work.store.layout.numbers(number)
            execute.prepare(self._groups, self._specification, self._work.samples, numbers)
        return self._prepared.pop(number).result()

    def _growth(self, number: int) -> list[np.ndarray]:
        """Growth rates of a chunk [1/s]."""
        from jaxact.sweep import execute

        numbers = self._work.store.layout.numbers(number)
        return execute.growth_rates(self._groups, self._specification, self._work.samples, numbers)


def _out_of_memory(error: Exception) -> bool:
    words = str(error)
    return isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in words


def refuse_existing(target: Place, *, resume: bool, overwrite: bool) -> None:
    """Raise UserError unless a store may be begun, continued or replaced there."""
    name = target.name
    if isinstance(target, _place.Folder):
        path = target.path
        foreign = path.is_symlink() or (path.exists() and not path.is_dir())
    else:
        foreign = False
    if not foreign and not _store.is_ours(target):
        foreign = bool(target.entries())
        if not foreign:
            return
    if foreign:
        raise UserError(
            f"{name}: exists and is no result of a sweep, so it stays; give another --out"
        )
    if not resume and not overwrite:
        raise UserError(
            f"{name}: exists; continue it with --resume, replace it with --overwrite, or give"
            " another --out"
        )
