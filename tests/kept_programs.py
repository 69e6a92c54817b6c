"""Programs that JAX compiled for the tests, kept from one run to the next.

Compiling is two fifths of what the tests cost, and most programs are those of the run before. JAX
itself finds a program by all that it is compiled from, its options and its own version; of the
processor it knows too little, so each kind of processor has its own.
"""

import contextlib
import hashlib
import os
import platform
import shutil
from pathlib import Path

_MOST = 2**31  # bytes
_PROCESSOR = ("model name", "flags", "CPU part", "Features")


def directory():
    """In the user's cache, for this kind of processor."""
    told = os.environ.get("XDG_CACHE_HOME", "")
    try:
        cache = Path(told) if os.path.isabs(told) else Path.home() / ".cache"
    except RuntimeError:  # a user without a home
        cache = Path(os.devnull)
    return cache / "jaxact-tests" / hashlib.sha256(_processor().encode()).hexdigest()[:16]


def _processor():
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.exists() else []
    told = sorted({line for line in lines if line.startswith(_PROCESSOR)})
    return "\n".join([platform.machine(), platform.processor(), *told])


def lend(kept, to):
    """Give a run what was kept; it writes to a directory of its own, since it may be killed."""
    to.mkdir(parents=True, exist_ok=True)
    for program in kept.glob("*-cache"):
        with contextlib.suppress(OSError):  # dropped by another run, or there is no room
            _share(program, to / program.name)


def keep(of_the_run, kept):
    """Keep what a run compiled that has ended by itself; nothing where nothing can be written."""
    with contextlib.suppress(OSError):
        kept.mkdir(mode=0o700, parents=True, exist_ok=True)
        for program in of_the_run.glob("*-cache"):
            if not (kept / program.name).exists() and _is_whole(program):
                _share(program, kept / program.name)
        _drop_oldest(kept)


def _drop_oldest(kept):
    size = 0
    told = [(program.stat(), program) for program in kept.glob("*-cache")]
    for about, program in sorted(told, key=lambda each: -each[0].st_mtime):
        size += about.st_size
        if size > _MOST:
            program.unlink()


def _is_whole(program):
    from jax._src import compilation_cache  # not before conftest.py has set the environment

    try:
        compilation_cache.decompress_executable(program.read_bytes())
    except Exception:  # each compression has its own
        return False
    return True


def _share(program, place):
    try:
        os.link(program, place)
    except FileExistsError:
        pass
    except OSError:  # on another file system
        unfinished = place.with_suffix(f".{os.getpid()}")
        shutil.copy2(program, unfinished)
        unfinished.replace(place)
