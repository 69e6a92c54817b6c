"""`jaxact sweep`: simulate every loop of a specification and keep the results."""

from __future__ import annotations

import dataclasses
import json
import os
import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction, arg

from jaxact.cli import _cache, _loops, _progress, _signals, _warnings, _xla
from jaxact.cli._arguments import DriveFile, Gains, NoCache, option
from jaxact.cli._signals import Terminated
from jaxact.engines import AUTO

if TYPE_CHECKING:
    from jaxact.loops.specification import Specification
    from jaxact.sweeping.location import Location


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
    drive: DriveFile = None,
    gains: Gains = None,
    dry_run: Annotated[bool, arg(help="Only say what the sweep would take.")] = False,
    no_cache: NoCache = False,
    quiet: Annotated[bool, arg(help="Show no progress and no summary.")] = False,
) -> None:
    """Simulate thousands of closed loops over a grid or a sample of parameters.

    The results go to sweep.zarr in the results folder: an xarray dataset with growth rate, verdict
    and response metrics of every loop, units, and the whole specification. `jaxact plot` draws it.

    Results are written chunk by chunk. Whatever ends a sweep early, the chunks that are done are
    kept: run the same command with --resume, and only what is missing is computed. `jaxact status`
    shows how far a sweep is.

    With engine = "linear" a robot's margins are computed and nothing is simulated: gain_margin,
    delay_margin, sensitivity_peak, complementary_peak, disk_margin, ... of all joints at once, as
    `jaxact margins --model` has them; not a number where the robot is unstable.

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
    from jaxact.loops import drives, reading

    if gains is not None:  # a path from here, where the specification's own are from its folder
        set = (*set, f"plant.gains={json.dumps(os.path.abspath(gains))}")  # noqa: A001
    asked = reading.load(specification, set, drive)
    known = drive or drives.named_by(specification)
    _loops.identified(known, asked.parameters, robot=asked.robot)
    _cache.prepare(wanted=not no_cache)
    _xla.call_at_once(asked)
    from jaxact.sweeping import location
    from jaxact.verbs import sweep_options

    how = sweep_options.options(
        resume=run.resume, overwrite=run.overwrite, adaptive=run.adaptive, width=run.width
    )
    folder = location.at(out if out is not None else Path("results") / specification.stem)
    _warnings.posture(asked)

    def say(text: str) -> None:
        if not quiet:
            print(f"{text} ...", file=sys.stderr)

    measured = None if dry_run or no_cache else say
    by = {"workers": run.workers, "address": run.address, "say": measured}
    if asked.engine == AUTO:
        local = measured if run.workers == "local" else None
        asked = sweep_options.settled(asked, folder, how, local)
        if not quiet:
            engine = asked.engine
            print(f"engine {engine}, expected to be the fastest here; engine = {engine!r} says it")
    if dry_run:
        with sweep_options.computed_by(how, budget=run.memory, **by) as planned:  # type: ignore[arg-type]
            print(sweep_options.forecast(asked, planned))
        return
    _run(asked, folder, vars(run) | {"say": measured}, quiet=quiet)


def _run(asked: Specification, folder: Location, how: dict[str, Any], *, quiet: bool) -> None:
    from jaxact.sweeping.store import STORE
    from jaxact.verbs.sweep import sweep

    _signals.keep(f"interrupted; what is done is kept, {_continued()}")
    started, done = time.perf_counter(), [0, 0]
    with _progress.bar(0, quiet=quiet) as move:

        def moved(count: int, total: int) -> None:
            done[0], done[1] = done[0] or count, count
            move(count, total)

        try:
            results = sweep(asked, out=folder.name, progress=moved, **how)
        except (KeyboardInterrupt, Terminated) as stop:
            begun = done[1] > 0 or not how["overwrite"]
            raise type(stop)(_how_to_resume(folder, begun=begun)) from None
    if quiet:
        return
    seconds, name = time.perf_counter() - started, folder.inside(STORE).name
    print(f"{name}: {results['verdict'].size:,} loops, {seconds:.1f} s in all")
    print(results.attrs["summary"])


def _how_to_resume(folder: Location, *, begun: bool) -> str:
    """What to say of an interrupted sweep: what is kept, and how to continue.

    Args:
        folder: of the results.
        begun: what is there is of this sweep, none that it would have replaced.
    """
    from jaxact.sweeping import progress
    from jaxact.sweeping.adaptive import ROUNDS, chunks_done
    from jaxact.sweeping.store import STORE

    rounds = folder.inside(ROUNDS).entries()
    target = folder.inside(STORE)
    store = progress.existing(target)
    if not begun:
        return "interrupted; nothing was done yet, what was there stays"
    if rounds:
        kept = f"{chunks_done(rounds):,} chunks are kept"
    elif store is not None:
        kept = f"{len(progress.times(target.entries()))} of {len(store.layout)} chunks are kept"
    else:
        return "interrupted; nothing was done yet, nothing is kept"
    return f"interrupted; {kept}, {_continued()}"


def _continued() -> str:
    given = [word for word in sys.argv[1:] if word not in ("--overwrite", "--resume")]
    return f"continue with: {shlex.join(['jaxact', *given, '--resume'])}"
