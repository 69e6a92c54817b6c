"""Other processes of this machine that compute a share of many tasks.

What takes the time of margins is many small steps of NumPy, of which threads of one process do
hardly any at once. A helper is a program of its own, not a copy of this process: what the user runs
is not run again, and threads of JAX are not forked.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any

# What a helper runs: it reads tasks until there are none.
_PROGRAM = "from jaxact.analysis.robot import processes; processes.serve()"
HELPER = "JAXACT_HELPER"
"""The environment variable that is there in a helper."""
# It computes beside others, on the processor.
_ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1", "JAX_NUM_CPU_DEVICES": "1", "JAX_PLATFORMS": "cpu", HELPER: "1",
}  # fmt: skip

# What is raised where something cannot be sent.
_UNSENT = (pickle.PickleError, TypeError, AttributeError)

# From what all tasks have in common to what computes one of them.
Prepare = Callable[[Any], Callable[[Any], Any]]


@dataclass
class _Task:
    """A task that somebody computes; `result` is empty until it is, and where a helper was lost."""

    task: Any
    result: list[Any] = field(default_factory=list)
    done: threading.Event = field(default_factory=threading.Event)


class Helpers:
    """Compute tasks beside this process; those of a helper that is lost are computed here."""

    def __init__(self, count: int, prepare: Prepare, shared: Any) -> None:
        """Start them.

        Args:
            count: how many; none are started where `shared` cannot be sent.
            prepare: a function of a module; what it raises in a helper ends that helper only.
            shared: what all tasks have in common.
        """
        self._compute = prepare(shared)
        self._tasks: SimpleQueue[_Task | None] = SimpleQueue()
        self._running: list[subprocess.Popen[bytes]] = []
        try:
            first = pickle.dumps((prepare, shared))
        except _UNSENT:
            return
        with contextlib.suppress(OSError):
            for _ in range(count):
                helper = _started()
                self._running.append(helper)
                threading.Thread(target=self._follow, args=(helper, first), daemon=True).start()

    def map(self, tasks: Sequence[Any]) -> list[Any]:
        """The results of tasks in order, of which this process computes as many as it can."""
        return list(self.each(tasks))

    def each(self, tasks: Sequence[Any]) -> Generator[Any, None, None]:
        """As `map`, one result after the other; no more tasks are begun once nobody asks for it."""
        every = [_Task(task) for task in tasks]
        for one in every:
            self._tasks.put(one)
        try:
            for one in every:
                while not one.done.is_set() and (here := self._next()) is not None:
                    here.result.append(self._compute(here.task))
                    here.done.set()
                one.done.wait()
                if not one.result:
                    one.result.append(self._compute(one.task))
                yield one.result[0]
        finally:
            while self._next() is not None:
                pass

    def _next(self) -> _Task | None:
        """A task that nobody has begun, None where there is none."""
        try:
            return self._tasks.get_nowait()
        except Empty:
            return None

    def close(self) -> None:
        """End them."""
        for helper in self._running:
            helper.kill()
            helper.wait()
            self._tasks.put(None)
        self._running = []

    def _follow(self, helper: subprocess.Popen[bytes], first: bytes) -> None:
        """Hand a helper tasks from when it is ready until it is lost."""
        assert helper.stdin is not None
        assert helper.stdout is not None
        own: _Task | None = None
        try:
            with contextlib.suppress(OSError, ValueError, EOFError, *_UNSENT):
                helper.stdin.write(first)
                helper.stdin.flush()
                pickle.load(helper.stdout)  # it is ready
                while (own := self._tasks.get()) is not None:
                    pickle.dump(own.task, helper.stdin)
                    helper.stdin.flush()
                    own.result.append(pickle.load(helper.stdout))
                    own.done.set()
        finally:
            if own is not None:  # or `map` would wait for it for ever
                own.done.set()
            for pipe in (helper.stdin, helper.stdout):
                with contextlib.suppress(OSError):
                    pipe.close()


@contextlib.contextmanager
def helping(count: int, prepare: Prepare, shared: Any) -> Iterator[Helpers]:
    """Helpers while a block runs; as `Helpers`."""
    helpers = Helpers(count, prepare, shared)
    try:
        yield helpers
    finally:
        helpers.close()


def _started() -> subprocess.Popen[bytes]:
    paths = os.pathsep.join(path for path in sys.path if path)
    return subprocess.Popen(
        [sys.executable, "-c", _PROGRAM],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | _ENVIRONMENT | {"PYTHONPATH": paths},
        # Ctrl-C is for this process, which ends its helpers.
        start_new_session=True,
    )


def serve() -> None:
    """Be a helper: ready once prepared, then a result for each task until there are no more."""
    tasks, results = sys.stdin.buffer, os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # What is printed must not get between the results.
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    with contextlib.suppress(EOFError, BrokenPipeError):
        prepare, shared = pickle.load(tasks)
        compute = prepare(shared)
        answer: Any = None
        while True:
            pickle.dump(answer, results)
            results.flush()
            answer = compute(pickle.load(tasks))
