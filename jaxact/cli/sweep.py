"""`jaxact sweep`: simulate every loop of a specification and keep the results."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg

from jaxact.cli import _progress


def main(
    specification: Annotated[
        Positional[Path], arg(metavar="SPECIFICATION", help="TOML file that says what is varied.")
    ],
    *,
    out: Annotated[
        Path | None,
        arg(
            metavar="DIR",
            help="Folder of the results, made if it is not there.",
            help_behavior_hint="(default: results/<name of the specification>)",
        ),
    ] = None,
    set: Annotated[  # noqa: A002 - the option's name
        UseAppendAction[tuple[str, ...]],
        arg(metavar="KEY=VALUE", help="Change the specification for this run; see below."),
    ] = (),
    overwrite: Annotated[
        bool, arg(help="Replace the results of an earlier sweep in the same folder.")
    ] = False,
    quiet: Annotated[bool, arg(help="Show no progress and no summary.")] = False,
) -> None:
    """Simulate thousands of closed loops over a grid or a sample of parameters.

    The results go to sweep.zarr in the results folder: an xarray dataset with growth rate, verdict
    and response figures of every loop, units, and the whole specification. `jaxact plot` draws it.

    What --set takes: a parameter (kp=400 [N/m], delay=0.002 [s], actuator=hyq), then fixed;
    a list or a range (kp='[100, 200]', kd='{min=1, max=100, num=8, spacing="log"}'), which is then
    varied; an option (engine=mass, duration=4 [s]); or a key in a section (axes.kp.num=128).
    `jaxact parameters` lists all parameters with their units.

    examples:
      jaxact sweep experiments/paper_gain_map.toml
      jaxact sweep experiments/paper_gain_map.toml --set engine=mass --out results/exact
      jaxact sweep experiments/paper_gain_map.toml --set axes.kp.num=128 --overwrite
    """
    from jaxact.sweep import reading, store
    from jaxact.sweep.samples import expand
    from jaxact.sweep.summary import summary

    asked = reading.load(specification, set)
    folder = out if out is not None else Path("results") / specification.stem
    samples = expand(asked)
    with store.destination(folder / store.STORE, overwrite=overwrite) as partial:
        from jaxact.sweep.execute import run

        started = time.perf_counter()
        with _progress.bar(len(samples), quiet=quiet) as move:
            results = store.dataset(asked, samples, run(asked, samples, progress=move))
        seconds = time.perf_counter() - started
        store.write(results, partial)
    if not quiet:
        print(
            f"{folder / store.STORE}: {len(samples) / seconds:,.0f} loops/s, {seconds:.1f} s in all"
        )
        print(summary(results))
