"""What must be in the environment before JAX and NumPy start, and is the command line's to set."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from jaxact.analysis.robot.one_thread import CHOSEN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jaxact.loops.specification import Specification

VECTOR_WIDTH = "--xla_cpu_prefer_vector_width"
POOL = "NPROC"
THREADS = "OPENBLAS_NUM_THREADS"
DEVICE_COUNT = "JAX_NUM_CPU_DEVICES"
PLATFORMS = "JAX_PLATFORMS"
_OLD_DEVICE_COUNT = "--xla_force_host_platform_device_count"
# What a result was computed on matters to `validate`, and what there is to `info`.
_ON_GPU = ("sweep", "validate", "info")


def prepare(*, all_cores: bool = False) -> None:
    """Set what JAX and NumPy read when they start, unless the user's environment says it.

    XLA prefers 256-bit vectors by itself even where the CPU has 512-bit ones, which costs a sweep
    of the mass plant up to half its speed.

    OpenBLAS, which NumPy and SciPy bring along, would start a thread for each core. They wait by
    spinning, on cores that JAX could use, and a robot's matrices are too small for several.

    Args:
        all_cores: one CPU device for each core this process may use, so that a sweep uses them all.
    """
    flags = given = os.environ.get("XLA_FLAGS", "")
    if VECTOR_WIDTH not in given and _has_wide_vectors():
        flags = f"{flags} {VECTOR_WIDTH}=512"
    if flags != given:
        os.environ["XLA_FLAGS"] = flags.strip()
    if not any(name in os.environ for name in CHOSEN):
        os.environ[THREADS] = "1"
    if all_cores and DEVICE_COUNT not in os.environ and _OLD_DEVICE_COUNT not in flags:
        os.environ[DEVICE_COUNT] = str(cores())


def leave_gpu_alone(command: Sequence[str]) -> None:
    """Have JAX compute on the processor where that is faster, unless the user's environment says.

    To start a GPU and to compile for it took the margins of a joint 23 s on an H200; on a processor
    they take one. Sweeps are what fills a GPU, and what MJX-Warp simulates is made for one.

    Args:
        command: the verb and its options.
    """
    if command and command[0] not in _ON_GPU and not any("warp" in word for word in command):
        os.environ.setdefault(PLATFORMS, "cpu")


def enlarge_pool() -> None:
    """Give JAX 0.10 more threads than cores, where those are few.

    It can wait for ever for threads of its own pool, which has one for each core, when large
    operations of several devices wait for each other; a larger pool does not run dry.
    """
    if POOL not in os.environ and _may_run_dry():
        os.environ[POOL] = "8"


def call_at_once(specification: Specification) -> None:
    """Have programs of one device run where they are called, if C MuJoCo waits for each of them.

    To be called before JAX starts its devices. Otherwise another thread runs them, and to wake it
    takes longer than the drive of a few loops. Programs of all devices are started as before.
    """
    engine = specification.simulator
    if specification.robot and (engine is None or not engine.in_jax):
        import jax

        jax.config.update("jax_cpu_enable_async_dispatch", False)


def _may_run_dry() -> bool:
    """By the version of JAX, which is not imported."""
    from importlib import metadata  # takes longer than to read the options

    return metadata.version("jax").startswith("0.10.") and cores() < 8


def cores() -> int:
    """CPU cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _has_wide_vectors() -> bool:
    try:
        return "avx512f" in Path("/proc/cpuinfo").read_text()
    except OSError:
        return False
