"""`jaxact sweep`: simulate every loop of a specification and keep the results."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import shlex
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from jaxact.cli import _cache, _progress, _signals, _warnings, _xla
from jaxact.cli._arguments import NoCache, option
from jaxact.cli._signals import Terminated
from jaxact.errors import UserError
from jaxact.plants.engines import AUTO, names

if TYPE_CHECKING:
    from jaxact.loops.samples import Samples
    from jaxact.loops.specification import Specification
    from jaxact.sweeping.execution import SweepOptions
    from jaxact.sweeping.location import Location
    from jaxact.sweeping.planning import Planned


# Loops that take so many times as long as the start at least make a time that can be told.
_MOSTLY_LOOPS = 20.0


@dataclasses.dataclass(frozen=True)
class Run:
    """How far the sweep goes, and with what."""

    resume: Annotated[
        bool, arg(help="Continue a sweep that was interrupted, if one is there; see below.")
    ] = False
    overwrite: Annotated[
        bool, arg(help="Replace the results of an earlier sweep in the same folder.")
    ] = False
    adaptive: Annotated[
        bool, arg(help="Refine around the stability boundary only, from the grid that is given.")
    ] = False
    width: Annotated[
        float | None,
        option("W", "Relative width to which --adaptive finds the boundary.", "0.001"),
    ] = None
    memory: Annotated[
        str | None,
        option("SIZE", "Most memory to take, e.g. 800M or 4G.", "a quarter of what is free"),
    ] = None
    workers: Annotated[
        Literal["local", "ray"],
        arg(help="Who computes: all devices of this machine, or a Ray cluster (jaxact[ray])."),
    ] = "local"
    address: Annotated[
        str | None,
        option(
            "ADDRESS",
            "Ray cluster; auto: the one this machine belongs to.",
            "a new one on this machine",
        ),
    ] = None

    def check(self) -> None:
        """Raise UserError for what cannot be had together."""
        width, address = self.width, self.address
        if self.resume and self.overwrite:
            raise UserError("--resume continues what is there, --overwrite replaces it: give one")
        if width is not None and not self.adaptive:
            raise UserError(f"--width {width:g}: is for --adaptive")
        if width is not None and not 1e-9 <= width < 1.0:
            raise UserError(f"--width {width:g}: allowed: from 1e-9 to below 1")
        if address is not None and self.workers != "ray":
            raise UserError(f"--address {address}: is for --workers ray")


def main(
    specification: Annotated[
        Positional[Path], arg(metavar="SPECIFICATION", help="TOML file that says what is varied.")
    ],
    run: Run,
    *,
    out: Annotated[
        str | None,
        option(
            "DIR",
            "Folder of the results, made if it is not there; or a URL, e.g. s3://bucket/name.",
            "results/<name of the specification>",
        ),
    ] = None,
    set: Annotated[  # noqa: A002 - the option's name
        UseAppendAction[tuple[str, ...]],
        option("KEY=VALUE", "Change the specification for this run; see below."),
    ] = (),
    dry_run: Annotated[bool, arg(help="Only say what the sweep would take.")] = False,
    no_cache: NoCache = False,
    quiet: Annotated[bool, arg(help="Show no progress and no summary.")] = False,
) -> None:
    """Simulate thousands of closed loops over a grid or a sample of parameters.

    The results go to sweep.zarr in the results folder: an xarray dataset with growth rate, verdict
    and response figures of every loop, units, and the whole specification. `jaxact plot` draws it.

    Results are written chunk by chunk. Whatever ends a sweep early, the chunks that are done are
    kept: run the same command with --resume, and only what is missing is computed. `jaxact status`
    shows how far a sweep is.

    What --set takes: a parameter (kp=400 [N/m], delay=0.002 [s], actuator=hyq), then fixed;
    a list or a range (kp='[100, 200]', kd='{min=1, max=100, num=8, spacing="log"}'), which is then
    varied; an option (engine=mass, duration=4 [s]); or a key in a section (axes.kp.num=128).
    `jaxact parameters` lists all parameters with their units.

    examples:
      jaxact sweep experiments/paper_gain_map.toml
      jaxact sweep experiments/paper_gain_map.toml --set engine=mass --out results/exact
      jaxact sweep experiments/paper_gain_map.toml --set axes.kp.num=128 --dry-run
      jaxact sweep experiments/paper_gain_map.toml --resume
      jaxact sweep experiments/paper_gain_map.toml --adaptive --out results/boundary
    """
    from jaxact.loops import reading
    from jaxact.sweeping import location as _location
    from jaxact.sweeping import memory as _memory

    asked = reading.load(specification, set)
    run.check()
    budget = None if run.memory is None else _memory.read_size(run.memory)
    folder = _location.at(out if out is not None else Path("results") / specification.stem)
    _cache.prepare(wanted=not no_cache)
    _xla.call_at_once(asked)
    from jaxact.sweeping.execution import SweepOptions

    how = SweepOptions(resume=run.resume, overwrite=run.overwrite)
    if run.adaptive:
        how = dataclasses.replace(how, width=0.001 if run.width is None else run.width)
    local = run.workers == "local"
    if local and not no_cache:
        from jaxact.sweeping import fill, throughput

        how = dataclasses.replace(how, workers=functools.partial(fill.here, keep=throughput.keep))
    _warnings.posture(asked.plant)
    measure = not (dry_run or no_cache)
    if asked.engine == AUTO:
        asked = _settled(asked, folder, how, measure=measure and local, quiet=quiet)
    with _computed_by(how, run.workers, run.address, budget, measure=measure, quiet=quiet) as how:
        if dry_run:
            print(_forecast(asked, how))
            return
        _run(asked, folder, how, quiet=quiet)


def _run(asked: Specification, folder: Location, how: SweepOptions, *, quiet: bool) -> None:
    from jaxact.sweeping import execution, opening

    _signals.keep(f"interrupted; what is done is kept, {_continued()}")
    started, done = time.perf_counter(), [0, 0]
    with _progress.bar(0, quiet=quiet) as move:

        def moved(count: int, total: int) -> None:
            done[0], done[1] = done[0] or count, count
            move(count, total)

        try:
            filled = execution.sweep(asked, folder, dataclasses.replace(how, moved=moved))
        except (KeyboardInterrupt, Terminated) as stop:
            begun = done[1] > 0 or not how.overwrite
            raise type(stop)(_how_to_resume(folder, begun=begun)) from None
    if quiet:
        return
    seconds = time.perf_counter() - started
    results = opening.opened(filled.location)
    print(f"{filled.location.name}: {results['verdict'].size:,} loops, {seconds:.1f} s in all")
    print(results.attrs["summary"])


@contextlib.contextmanager
def _computed_by(
    how: SweepOptions,
    workers: str,
    address: str | None,
    budget: int | None,
    *,
    measure: bool,
    quiet: bool,
) -> Iterator[SweepOptions]:
    """Planner and workers: this process, or a Ray cluster that stays attached meanwhile."""
    from jaxact.sweeping import planning

    if workers == "local":

        def say(text: str) -> None:
            if not quiet:
                print(f"{text} ...", file=sys.stderr)

        plan = functools.partial(planning.plan, budget=budget, say=say if measure else None)
        yield dataclasses.replace(how, planner=plan)
        return
    from jaxact.sweeping import cluster

    with cluster.attached(address) as attached:
        plan = functools.partial(attached.plan, budget=budget)
        yield dataclasses.replace(how, planner=plan, workers=attached.work)


def _settled(
    asked: Specification, folder: Location, how: SweepOptions, *, measure: bool, quiet: bool
) -> Specification:
    """The specification with an engine in place of "auto": a sweep that goes on keeps its own."""
    from jaxact.loops.samples import expand
    from jaxact.sweeping import store, throughput

    def say(text: str) -> None:
        if not quiet:
            print(f"{text} ...", file=sys.stderr)

    engine = None
    with contextlib.suppress(OSError):  # said when the sweep begins
        there = store.identity_of(folder.inside(store.STORE)) if how.resume else None
        engine = (there or {}).get("engine")
    if engine not in names(robot=True):
        engine = throughput.fastest(asked, expand(asked), say=say if measure else None)
    if not quiet:
        print(f"engine {engine}, expected to be the fastest one here; engine = {engine!r} says it")
    return dataclasses.replace(asked, engine=engine)


def _forecast(asked: Specification, how: SweepOptions) -> str:
    """What a sweep would take, in a few lines."""
    from jaxact.loops.samples import expand
    from jaxact.sweeping import adaptive, memory

    samples = expand(asked)
    planned: Planned = how.planner(asked, samples)
    layout = planned.layout(samples)
    first = f"{len(samples):,} loops" + _shape(samples)
    if how.width is not None:
        grid = adaptive.lattice(asked, how.width)
        fine = " x ".join(f"{n:,}" for n in grid.shape)
        first += f", refined to a grid of {fine} at the boundary"
    size = sum(layout.loops * (1 if name == "verdict" else 4) for name in _variables(asked))
    if asked.precision == "float64":
        size *= 2
    basis = "measured on this machine" if planned.measured else "roughly; nothing measured here yet"
    return "\n".join(
        [
            first,
            f"{len(layout):,} chunks of up to {layout.loops:,} loops,"
            f" in tiles of {planned.tile:,} on {planned.device}",
            f"memory: about {memory.text(planned.peak)} of {memory.text(planned.memory)} allowed;"
            f" on disk: {memory.text(size * len(layout))}",
            _time(planned, basis),
        ]
    )


def _time(planned: Planned, basis: str) -> str:
    """How long it takes; where starting may take longer than the loops, at least how long."""
    whole = duration(planned.startup + planned.seconds)
    if planned.seconds > _MOSTLY_LOOPS * planned.startup:
        return f"time: about {whole} ({basis})"
    return (
        f"time: at least {whole}: {duration(planned.seconds)} for the loops ({basis}), the rest to "
        "start; compiling what has not been compiled before takes longer"
    )


def _variables(specification: Specification) -> tuple[str, ...]:
    from jaxact.sweeping.store import variables

    return variables(robot=specification.robot)


def _shape(samples: Samples) -> str:
    sizes = (f"{name} {n:,}" for name, n in zip(samples.dims, samples.shape, strict=True))
    return f" ({' x '.join(sizes)})"


def duration(seconds: float) -> str:
    """`45 s`, `12 min`, `3.4 h`, `2.1 days`."""
    for unit, size, most in (("s", 1.0, 100.0), ("min", 60.0, 100.0), ("h", 3600.0, 48.0)):
        if seconds < most * size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds / 86400:,.3g} days"


def _how_to_resume(folder: Location, *, begun: bool) -> str:
    """What to say of an interrupted sweep: what is kept, and how to continue.

    folder: of the results
    begun: what is there is of this sweep, none that it would have replaced
    """
    from jaxact.sweeping import progress
    from jaxact.sweeping.adaptive import ROUNDS
    from jaxact.sweeping.store import STORE

    rounds = folder.inside(ROUNDS).entries()
    target = folder.inside(STORE)
    store = progress.existing(target)
    if not begun:
        return "interrupted; nothing was done yet, what was there stays"
    if rounds:
        kept = f"{len(progress.times(rounds))} chunks are kept"
    elif store is not None:
        kept = f"{len(progress.times(target.entries()))} of {len(store.layout)} chunks are kept"
    else:
        return "interrupted; nothing was done yet, nothing is kept"
    return f"interrupted; {kept}, {_continued()}"


def _continued() -> str:
    given = [word for word in sys.argv[1:] if word not in ("--overwrite", "--resume")]
    return f"continue with: {shlex.join(['jaxact', *given, '--resume'])}"
