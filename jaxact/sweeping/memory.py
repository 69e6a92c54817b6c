"""How much memory a sweep may take, and how many loops at once that allows."""

from __future__ import annotations

import os
import re
from pathlib import Path

from jaxact.errors import UserError, shown

_UNITS = {"": 1, "k": 2**10, "m": 2**20, "g": 2**30, "t": 2**40}
_SIZE = re.compile(r"(\d+(?:\.\d*)?|\.\d+) ?([kmgt]?)(?:i?b)?")
# Share of the free memory that a sweep takes by itself.
SHARE = 0.25
# Copies of the parameters of a batch: taken from the axes, sorted into tiles, and on the device.
_COPIES = 3
# Copies of its results: from the device, put together, as files, and of the batch being written.
_RESULT_COPIES = 4


def read_size(text: str | int) -> int:
    """A number of bytes from `800M`, `1.5 GiB` or `2000000`; raises UserError for anything else."""
    match = _SIZE.fullmatch(str(text).strip().lower())
    if match is None or float(match[1]) <= 0:
        raise UserError(f"`memory` {shown(text)} is not a size; write it as 800M or 2G")
    return int(float(match[1]) * _UNITS[match[2]])


def free() -> int:
    """Memory that this process can still get [bytes]: of the machine, or of its control group."""
    found = []
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                found.append(int(line.split()[1]) * 1024)
        limit = Path("/sys/fs/cgroup/memory.max").read_text().strip()
        if limit.isdigit():
            used = int(Path("/sys/fs/cgroup/memory.current").read_text())
            found.append(max(int(limit) - used, 0))
    except OSError:
        pass
    if not found:
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2)
    return min(found)


def per_loop(parameters: int, results: int, itemsize: int) -> int:
    """Bytes that a loop of a batch takes on the host, and on a CPU device.

    Args:
        parameters: numbers that a loop is described by.
        results: numbers that are kept of it.
        itemsize: bytes of a number of the rollout.
    """
    return _COPIES * parameters * 8 + _RESULT_COPIES * results * itemsize


def least(base: int, coordinates: int, each: int) -> int:
    """The smallest memory with which a sweep can be run [bytes].

    Args:
        base: what a process takes before it computes the first loop [bytes], see `Engine.memory`.
        coordinates: bytes of the coordinates of the axes.
        each: bytes of a loop, from `per_loop`.
    """
    return base + 4 * coordinates + 1000 * each


def most_loops(budget: int, base: int, coordinates: int, each: int) -> int:
    """Loops that may be computed together.

    Args:
        budget: memory of the whole process [bytes].
        base: what a process takes before it computes the first loop [bytes], see `Engine.memory`.
        coordinates: bytes of the coordinates of the axes, kept all the time.
        each: bytes of a loop, from `per_loop`.

    Raises:
        UserError: there is no room for any.
    """
    needed = least(base, coordinates, each)
    if budget < needed:
        raise UserError(
            f"memory: {text(budget)} are too little; this sweep needs at least {text(needed)},"
            f" {text(base)} of it for Python, JAX and its compiler"
        )
    return (budget - base - 4 * coordinates) // each


def text(size: float) -> str:
    """`1.2 GiB`."""
    for unit in ("B", "KiB", "MiB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1024
    return f"{size:,.3g} GiB"
