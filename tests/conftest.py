"""Strict JAX, two CPU devices, and reproducible properties, for every test."""

import gc
import os
import tempfile
from pathlib import Path

import hypothesis
import kept_programs
import pytest

# Before JAX starts: it reads these once.
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("JAX_NUM_CPU_DEVICES", "2")
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")
os.environ.setdefault("MPLBACKEND", "agg")
# Before NumPy and SciPy start: threads of theirs wait by spinning, on cores that others need.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Compiled kernels of the command line are kept for these tests only, for all workers together.
_RUNS_ALL = "PYTEST_XDIST_WORKER" not in os.environ
if _RUNS_ALL:
    _kept = kept_programs.directory()
    _cache = tempfile.TemporaryDirectory(prefix="jaxact-tests-")
    os.environ["XDG_CACHE_HOME"] = _cache.name
_programs = Path(os.environ["XDG_CACHE_HOME"]) / "tests"
if _RUNS_ALL:
    kept_programs.lend(_kept, _programs)

import jax  # noqa: E402

from jaxact.cli import _xla  # noqa: E402
from jaxact.compilation import programs  # noqa: E402
from jaxact.sweeping import memory  # noqa: E402

_MAPPINGS = 25_000  # of memory, beyond which compiled functions are let go of
_WORKER = 4 * 2**30  # bytes that one takes at most, with what it starts

_xla.enlarge_pool()  # JAX reads it when it starts its devices

# Tracing makes many objects and little garbage; looking for it often takes a tenth of the time.
gc.set_threshold(500_000, 20, 100)

# Two workers that run tests of one module compile its functions once, and so do two runs. Not by
# the environment, which the command line under test would inherit.
jax.config.update("jax_compilation_cache_dir", str(_programs))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
# Where each operation was written is noted while tracing, for profiles that no test takes.
jax.config.update("jax_traceback_in_locations_limit", 0)

hypothesis.settings.register_profile(
    "jaxact",
    deadline=None,  # the first example compiles
    derandomize=True,  # the same examples every time
    database=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("jaxact")


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(exitstatus):
    """The workers have ended by then. An interrupted run may have left half a program."""
    if _RUNS_ALL and exitstatus in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        kept_programs.keep(_programs, _kept)


@pytest.fixture(autouse=True)
def programs_are_not_kept():
    """A command that runs in this process asks for it, for what runs in it afterwards too."""
    yield
    os.environ.pop("JAXACT_PROGRAMS", None)


@pytest.fixture(autouse=True, scope="module")
def mappings_do_not_run_out():
    """A compiled function takes some hundred mappings of memory, and Linux allows 65,530."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > _MAPPINGS:
        programs.let_go()
        jax.clear_caches()
        gc.collect()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    """One more than processors, if there is memory for it: some tests wait for other processes."""
    workers = (os.cpu_count() or 1) + 1
    return workers if memory.free() > workers * _WORKER else None


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Workers keep to files of their own while they can: one compiles what a file compiles."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log) if config.option.dist == "load" else None
