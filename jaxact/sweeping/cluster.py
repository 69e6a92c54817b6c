"""Computing chunks as Ray tasks: one for each GPU of a cluster, or for each core.

A task computes one chunk on one device and writes it to the store itself; only its number comes
back. A task whose worker was lost is started again elsewhere.
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from jaxact.errors import UserError
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.sweeping import planning
from jaxact.sweeping.computer import ChunkTask, computer_of
from jaxact.sweeping.planning import Planned

# How often a task is started again after its worker was lost.
_RETRIES = 8
# Tasks that wait for a free worker, for each that runs.
_AHEAD = 2
# Chunks for each worker, at least, so that they end at about the same time.
_SHARES = 4
# What a worker must have from the environment of the process that asks, for the same bits.
_ENVIRONMENT = (
    "XLA_FLAGS", "NPROC", "JAX_PLATFORMS", "JAX_COMPILATION_CACHE_DIR",
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "JAX_NUMPY_RANK_PROMOTION",
    "OPENBLAS_NUM_THREADS",
)  # fmt: skip


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster that this process is attached to.

    Attributes:
        ray: the module.
        slots: tasks that run at once.
        resources: of a task.
    """

    ray: Any
    slots: int
    resources: dict[str, float]

    def plan(self, specification: Specification, samples: Samples, budget: int | None) -> Planned:
        """Plan a sweep on a worker, which may be another kind of machine than this one."""
        task = self._task(_plan)
        with _explained(self.ray):
            planned: Planned = self.ray.get(task.remote(_single(specification), samples, budget))
        loops = min(planned.loops, max(planned.tile, len(samples) // (_SHARES * self.slots)))
        together = f"Ray, {self.slots} x {planned.device.partition(' x ')[2]}"
        seconds = planned.seconds / self.slots
        return dataclasses.replace(planned, loops=loops, device=together, seconds=seconds)

    def work(self, work: ChunkTask, numbers: list[int], begin: Callable[[], None]) -> Iterator[int]:
        """Compute chunks; see `jaxact.sweeping.fill.Workers`."""
        if not numbers:
            return
        begin()
        task = self._task(_compute)
        alone = dataclasses.replace(work, specification=_single(work.specification))
        shared = self.ray.put(alone)
        queue = iter(numbers)
        running: dict[Any, int] = {}
        try:
            while True:
                while len(running) < _AHEAD * self.slots:
                    number = next(queue, None)
                    if number is None:
                        break
                    running[task.remote(shared, number)] = number
                if not running:
                    return
                ready, _ = self.ray.wait(list(running), timeout=1.0)
                for done in ready:
                    with _explained(self.ray):
                        self.ray.get(done)
                    yield running.pop(done)
        finally:
            for left in running:
                with contextlib.suppress(Exception):
                    self.ray.cancel(left, force=True)

    def _task(self, function: Callable[..., Any]) -> Any:
        return self.ray.remote(max_retries=_RETRIES, **self.resources)(function)


@contextlib.contextmanager
def attached(address: str | None) -> Iterator[Cluster]:
    """Attach this process to a Ray cluster, or start one on this machine.

    Args:
        address: of the cluster, "auto" for the one this machine belongs to; None: a new local one.

    Raises:
        UserError: there is no Ray, or no such cluster.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as error:
        raise UserError(f"`workers` ray: {error}; install jaxact[ray]") from None
    variables = {name: os.environ[name] for name in _ENVIRONMENT if name in os.environ}
    try:
        ray.init(
            address=address,
            runtime_env={"env_vars": variables | {"JAX_NUM_CPU_DEVICES": "1"}},
            log_to_driver=False,
            logging_level=logging.ERROR,
            include_dashboard=None if address else False,
        )
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise UserError(f"`address` {address}: no Ray cluster there ({error})") from None
    try:
        there = ray.cluster_resources()
        graphics = int(there.get("GPU", 0)) if os.environ.get("JAX_PLATFORMS") != "cpu" else 0
        slots = graphics or max(1, int(there.get("CPU", 1)))
        kind = {"num_gpus": 1.0, "num_cpus": 1.0} if graphics else {"num_cpus": 1.0}
        yield Cluster(ray, slots, kind)
    finally:
        ray.shutdown()


def _single(specification: Specification) -> Specification:
    """The same sweep on one device, which changes no result."""
    return dataclasses.replace(specification, devices=1)


@contextlib.contextmanager
def _explained(ray: Any) -> Iterator[None]:
    """What went wrong in a task as it would have been raised here."""
    try:
        yield
    except ray.exceptions.RayTaskError as error:
        cause = error.cause
        raise (cause if isinstance(cause, UserError | OSError) else error) from None
    except ray.exceptions.RayError as error:
        words = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UserError(
            f"`workers` ray: workers were lost {_RETRIES + 1} times over one chunk ({words}); what"
            " is done is kept, continue with `resume`"
        ) from None


def _plan(specification: Specification, samples: Samples, budget: int | None) -> Planned:
    return planning.plan(specification, samples, budget=budget)


def _compute(work: ChunkTask, number: int) -> int:
    """Compute and write a chunk, in a worker, which keeps what it has compiled."""
    results, tile = computer_of(work)(number)
    work.store.write(number, results, tile)
    return number
