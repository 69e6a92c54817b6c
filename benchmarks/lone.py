"""One robot by itself against real time, in a process that has a single core."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time

from jaxact.cli import _xla

_REPEATS = 5


def on_one_core(duration: float) -> float:
    """Median seconds per control period of 1 ms, after a first rollout.

    The process is confined to a core before JAX starts its threads, where the system can do that.

    Args:
        duration: of a rollout [s].
    """
    command = [sys.executable, "-m", "benchmarks.lone", str(duration)]
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_setaffinity") else None
    if allowed is not None:
        os.sched_setaffinity(0, {min(allowed)})  # which the process inherits
    try:
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    finally:
        if allowed is not None:
            os.sched_setaffinity(0, allowed)
    return float(done.stdout)


def _main() -> None:
    _xla.prepare(all_cores=True)
    _xla.enlarge_pool()

    from benchmarks import robots
    from jaxact.loops.samples import expand

    asked = robots.specification(robots.WITH_ARM, "mujoco", float(sys.argv[1]), 1)
    _xla.call_at_once(asked)
    rollout, _ = robots.rollouts(asked, expand(asked))
    rollout()
    seconds = []
    for _ in range(_REPEATS):
        start = time.perf_counter()
        units = rollout()
        seconds.append((time.perf_counter() - start) / units)
    print(statistics.median(seconds))


if __name__ == "__main__":
    _main()
