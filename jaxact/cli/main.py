"""Entry point of `jaxact`: picks the verb, reads its options, turns errors into one line.

A verb is a module `jaxact.cli.<verb>` with a function `main`, whose typed arguments are the
options and whose docstring is the help. It imports what is heavy (JAX, xarray, matplotlib) inside
functions, so that `--help` and every mistake in what was typed answer at once. This module imports
next to nothing, so that a Ctrl-C while Python still imports finds somebody who takes it.
"""

from __future__ import annotations

import sys

from jaxact.cli import _signals
from jaxact.cli._signals import Terminated

TYPE_CHECKING = False  # `typing` takes longer to import than all of this
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import NoReturn

    from jaxact.errors import UserError

VERBS = {
    "sweep": "simulate thousands of loops over a grid or a sample of parameters, keep the results",
    "status": "show how far a sweep is: done, missing, damaged, rate, time left",
    "validate": "check every chunk of a result, and compute some of its loops again",
    "plot": "draw the stability map of a sweep, with the exact boundary over it",
    "simulate": "simulate one loop, keep its trajectory as a picture and as numbers",
    "step": "simulate and draw the step responses of loops over each other",
    "margins": "all stability margins of one loop or thousands, exact, continuous and sampled",
    "bode": "draw the Bode plot of loops, with the margins drawn in",
    "nyquist": "draw the Nyquist plot of loops, with the disk margin drawn in",
    "sensitivity": "draw the sensitivity functions of loops, with their peaks",
    "report": "write one HTML file: a joint's stability map that one can click, and its margins",
    "render": "film a robot twice, side by side: bare, and with the drive model",
    "tune": "find the best gains of a joint by gradient descent on its margins, and certify them",
    "identify": "find a drive's dynamics, delay and friction from logs of the real thing",
    "export": "write a sweep's results as one NetCDF file, or a robot's gains in another format",
    "parameters": "list every parameter of a loop: unit, default, bounds, meaning",
    "check": "show what will be driven in a robot model, and every field that engines would ignore",
    "info": "show versions, devices, precision and caches: what a bug report needs",
}

# Those that keep what they compile and have no option that says otherwise.
_COMPILE = (
    "plot", "simulate", "step", "margins", "bode", "nyquist", "sensitivity", "render",
    "identify", "report",
)  # fmt: skip

USAGE_ERROR = 2
INTERRUPTED = 130
TERMINATED = 143


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: what follows `jaxact`, the process's own by default.

    Returns:
        The exit code. 0: done. 2: a mistake in what was given, told in one line on standard error,
        nothing written. 130: interrupted with Ctrl-C. 143: terminated. 129: its terminal has gone.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        return _run(given)
    except (KeyboardInterrupt, Terminated) as stop:
        _signals.over()
        _say(str(stop) or _signals.farewell())
        return _signals.code() or (TERMINATED if isinstance(stop, Terminated) else INTERRUPTED)
    except Exception as error:
        if _signals.code():  # a library has made another exception of it
            _signals.over()
            _say(_signals.farewell())
            return _signals.code()
        return _explained(error, given[0] if given else "")


def _explained(error: Exception, verb: str) -> int:
    """Say in a line what a user can mend, and return the exit code; raises what is none of that."""
    import errno

    from jaxact.errors import UserError

    if isinstance(error, UserError):
        print(f"jaxact: {_one_line(error, verb)}", file=sys.stderr)
        return USAGE_ERROR
    if isinstance(error, BrokenPipeError):
        # the reader of our output (`| head`) has gone; keep Python from complaining at exit
        sys.stdout = None
        return 0
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        sys.stdout = None  # what is left in it cannot be written at exit either
        print("jaxact: the disk is full; make room and run the command again", file=sys.stderr)
        return USAGE_ERROR
    raise error


def _run(given: list[str]) -> int:
    """Run a command; raises what ends it early."""
    if not given or given[0] in ("-h", "--help", "help"):
        print(_overview())
        return 0
    if given[0] in ("-V", "--version"):
        from jaxact import __version__

        print(f"jaxact {__version__}")
        return 0
    from jaxact import files
    from jaxact.cli import _gl, _options, _warnings, _xla

    verb = _options.choose("command", given[0], VERBS)
    _gl.prepare()
    _xla.prepare(all_cores=verb in ("sweep", "validate"))
    with files.read_once(), _warnings.as_lines():
        ready = _options.read(_options.main_of(verb), f"jaxact {verb}", given[1:])
        _xla.enlarge_pool()
        ready()
    if sys.stdout is not None:
        sys.stdout.flush()
    return 0


def _say(words: str) -> None:
    """One line on standard error, which may have gone."""
    import contextlib

    with contextlib.suppress(OSError):
        print(f"jaxact: {words}", file=sys.stderr, flush=True)


def _overview() -> str:
    width = max(map(len, VERBS))
    verbs = "\n".join(f"  {name:{width}}  {summary}" for name, summary in VERBS.items())
    return f"""\
usage: jaxact COMMAND ...

Stability maps, exact margins and actuator models for joint controllers.

commands:
{verbs}

options:
  -h, --help     show this; `jaxact COMMAND --help` shows a command's options, units and examples
  -V, --version  show the version

examples:
  jaxact sweep experiments/paper_gain_map.toml
  jaxact plot results/paper_gain_map
  jaxact simulate --actuator starleth --delay 0.005"""


def _one_line(error: UserError, verb: str) -> str:
    """The message in one line; an option's name in backquotes, as libraries say it, with dashes."""
    from jaxact.cli import _options

    line = _options.typed(" ".join(str(error).split()), verb)
    return "".join(letter if letter.isprintable() else "?" for letter in line)


def entry() -> NoReturn:
    """Run the command line of this process and end it."""
    _signals.listen()
    import gc
    import warnings

    # Zarr writes in a thread of its own, which may still warn of this when an interruption has
    # ended what asked it not to.
    warnings.filterwarnings("ignore", message="Consolidated metadata is currently not part")
    # Tracing makes hundreds of thousands of objects, few of which are garbage: looking for it after
    # every few hundred takes a tenth of a command's time.
    gc.set_threshold(50_000, 20, 100)
    verb = sys.argv[1] if len(sys.argv) > 1 else ""
    if verb in VERBS:
        from jaxact.cli import _xla

        _xla.leave_gpu_alone(sys.argv[1:])
    if verb in _COMPILE:
        from jaxact.cli import _cache

        _cache.prepare(quiet=True)
    sys.exit(_signals.taken(main))
