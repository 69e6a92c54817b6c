"""Chunks of a sweep, computed on the devices of this process."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxact.errors import UserError
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.sweeping.progress import Store
from jaxact.sweeping.variables import of_margins

if TYPE_CHECKING:
    from jaxact.simulation.execute import RunningBatches
    from jaxact.simulation.plans import Plan
    from jaxact.simulation.spectra import Rates
    from jaxact.sweeping.margins_computer import MarginsComputer


@dataclass(frozen=True)
class ChunkTask:
    """All that is needed to compute any chunk of a store, here or on another machine.

    Attributes:
        specification: checked; its tile is that of the store.
        samples: all loops.
        outline: loops that span all values of theirs, from which the kernel's static options
            follow.
        together: loops that are computed together.
        store: where the results go.
    """

    specification: Specification
    samples: Samples
    outline: Samples
    together: int
    store: Store


class Computer:
    """Computes chunks; once a device runs out of memory, in tiles of half the size.

    While one is simulated, `helper` prepares the growth rates of the next, so that the devices need
    not wait for what is done outside them; nobody does where it is None.
    """

    def __init__(self, work: ChunkTask, helper: Executor | None = None) -> None:
        from jaxact.simulation import engines

        self._work = work
        # For the built-in plants, of which a second of work is a million loops.
        small = not work.specification.robot and not engines.old_jax()
        self._helper = helper if small else None
        self._plan(work.store.tile)

    def _plan(self, tile: int) -> None:
        from jaxact.simulation import plans

        self._tile = tile
        self._prepared: dict[int, Future[list[Rates]]] = {}
        self._specification = dataclasses.replace(self._work.specification, tile=tile)
        self._groups = plans.groups(
            self._specification,
            self._work.outline,
            together=self._work.together,
            refined=self._work.outline is not self._work.samples,
        )

    @property
    def plan(self) -> tuple[Plan, Specification] | None:
        """The plan of the largest group of samples, and the specification with its tile."""
        return max(self._groups, key=lambda group: group.batch), self._specification

    def __call__(self, number: int) -> tuple[dict[str, np.ndarray], int]:
        """The results of a chunk by variable, and the tile they were computed with."""
        return self.finish(number, self.begin(number))

    def begin(self, number: int, following: int | None = None) -> tuple[RunningBatches, int] | None:
        """Set the devices to compute a chunk, for `finish`.

        Args:
            number: of the chunk.
            following: the chunk that will be asked for next, if there is one.
        """
        from jaxact.simulation import execute

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
        self, number: int, begun: tuple[RunningBatches, int] | None
    ) -> tuple[dict[str, np.ndarray], int]:
        """The results of a chunk by variable, and the tile they were computed with."""
        from jaxact.simulation import execute

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
        running: deque[tuple[int, tuple[RunningBatches, int] | None]] = deque()
        for number, following in _in_pairs(numbers):
            running.append((number, self.begin(number, following)))
            if len(running) > (self._helper is not None):
                ended, begun = running.popleft()
                yield ended, self.finish(ended, begun)
        for ended, begun in running:
            yield ended, self.finish(ended, begun)

    def _begun(self, number: int) -> list[Rates]:
        """Growth rates of a chunk [1/s], and all that is needed to simulate it."""
        if self._helper is None:
            return self._growth(number)
        if number not in self._prepared:
            from jaxact.simulation import execute

            # The first chunk: two programs are compiled in less time side by side.
            self._prepared[number] = self._helper.submit(self._growth, number)
            numbers = self._work.store.layout.numbers(number)
            execute.prepare(self._groups, self._specification, self._work.samples, numbers)
        return self._prepared.pop(number).result()

    def _growth(self, number: int) -> list[Rates]:
        """Growth rates of a chunk."""
        from jaxact.simulation import execute

        numbers = self._work.store.layout.numbers(number)
        return execute.growth_rates(self._groups, self._specification, self._work.samples, numbers)


def computer_of(work: ChunkTask, helper: Executor | None = None) -> Computer | MarginsComputer:
    """Who computes the chunks: as `Computer` where loops are simulated."""
    if of_margins(work.specification):
        from jaxact.sweeping.margins_computer import MarginsComputer

        return MarginsComputer(work)
    return Computer(work, helper)


def _in_pairs(numbers: Iterable[int]) -> Iterator[tuple[int, int | None]]:
    """Each number with the one that follows it."""
    ahead = iter(numbers)
    number = next(ahead, None)
    while number is not None:
        following = next(ahead, None)
        yield number, following
        number = following


def _out_of_memory(error: Exception) -> bool:
    words = str(error)
    return isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in words
