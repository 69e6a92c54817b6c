"""Timing two things side by side, so that what else the machine does falls on both."""

from __future__ import annotations

import math
import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        what: what is measured.
        rival: what it is held against.
        ours, theirs: median seconds per unit of work.
        unit: the unit of work.
        target: what the ratio should be, in words.
        wanted: smallest ratio theirs / ours that meets the target.
        failure: why it could not be measured, "" where it was.
    """

    what: str
    rival: str
    ours: float
    theirs: float
    unit: str
    target: str
    wanted: float
    failure: str = ""

    @property
    def ratio(self) -> float:
        """How many times faster than the rival."""
        return self.theirs / self.ours


def failed(what: str, why: str, rival: str = "-", target: str = "-", wanted: float = 1.0) -> Row:
    """A line of something that could not be measured."""
    return Row(what, rival, math.nan, math.nan, "-", target, wanted, why)


def alternate(
    ours: Callable[[], float], theirs: Callable[[], float], repeats: int = 5
) -> tuple[float, float]:
    """Median seconds per unit of work of two functions called in turn.

    Args:
        ours, theirs: do the work once and return how many units it was; called once beforehand to
            compile and warm up.
        repeats: timed calls of each.
    """
    seconds: tuple[list[float], list[float]] = ([], [])
    for function in (ours, theirs):
        function()
    for _ in range(repeats):
        for place, function in enumerate((ours, theirs)):
            start = time.perf_counter()
            units = function()
            seconds[place].append((time.perf_counter() - start) / units)
    return statistics.median(seconds[0]), statistics.median(seconds[1])


def seconds(function: Callable[[], object], repeats: int = 5, *, warm: bool = False) -> float:
    """Median seconds of a call, after a first one that compiles and warms up unless it is warm."""
    if not warm:
        function()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)


def machine() -> dict[str, str]:
    """The machine and the versions that the figures belong to."""
    import jax
    import jaxlib
    import mujoco

    model = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            model = next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        pass
    return {
        "processor": model,
        "cores": str(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "jaxlib": jaxlib.__version__,
        "mujoco": mujoco.__version__,
        "devices": ", ".join(f"{each} ({each.device_kind})" for each in jax.local_devices()),
        "XLA_FLAGS": os.environ.get("XLA_FLAGS", ""),
    }
