"""`make bench`: ratios against named rivals, printed and written to results/benchmarks/."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

from jaxact.cli import _xla

RESULTS = Path("results/benchmarks")


def main() -> None:
    """Run all benchmarks, or `--quick`, small ones that show only that they run."""
    parser = argparse.ArgumentParser(prog="benchmarks", description=main.__doc__)
    parser.add_argument("--quick", action="store_true", help="small sizes, nothing written")
    quick = parser.parse_args().quick
    _xla.prepare(all_cores=True)  # before JAX starts, as the command line does

    from benchmarks.timing import Row, machine

    rows: list[Row] = []
    for row in _rows(quick):
        rows.append(row)
        print(f"{row.what}: {row.ratio:.3g} times {row.rival} (target: {row.target})", flush=True)
    table = _table(rows, machine())
    print(table)
    if quick:
        return
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / "benchmarks.md").write_text(table, encoding="utf-8")
    figures = [dataclasses.asdict(row) | {"ratio": row.ratio} for row in rows]
    document = {"machine": machine(), "rows": figures}
    (RESULTS / "benchmarks.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    print(f"written to {RESULTS}")


def _rows(quick: bool) -> Iterator:
    """The lines of the table, each measured as it is asked for."""
    from benchmarks import commands, environments, margins, robots, tuning

    yield from commands.rows(quick)
    yield from _mass(quick)
    yield from _mjx(quick)
    yield from robots.rows(quick)
    yield from environments.rows(quick)
    yield from margins.rows(quick)
    yield from tuning.rows(quick)


def _mass(quick: bool) -> Iterator:
    import jax

    from benchmarks import rivals, sweeps
    from benchmarks.timing import Row, alternate
    from jaxact.loops.samples import expand

    asked = sweeps.specification("mass", 64 if quick else 512, 0.2 if quick else 2.0)
    samples = expand(asked)
    ticks = sweeps.steps(asked, samples) // len(samples)
    small = sweeps.specification("mass", 32 if quick else 64, 0.2)
    small_ticks = sweeps.steps(small, expand(small)) // len(expand(small))
    batch = rivals.mujoco_batch(expand(small), small_ticks, delayed=True)
    yield Row(
        "mass sweep, growth rates and metrics included",
        "mujoco.batch with its own delay, no metrics",
        *alternate(sweeps.whole(asked), batch, 3),
        "loop step",
        "at least 500",
        500.0,
    )
    loop = rivals.c_loop(samples, ticks)
    if loop is None:
        print("no C compiler: the C loop is left out")
        return
    old = tuple(int(part) for part in jax.__version__.split(".")[:2]) < (0, 11)
    factor = 4.0 if old else 2.0
    target = f"at least {1 / factor:g} (jax {jax.__version__})"
    yield Row(
        "mass rollouts with metrics",
        "C loop of the same arithmetic, AVX, all threads",
        *alternate(sweeps.rollouts(asked), loop),
        "loop step",
        target,
        1 / factor,
    )
    yield Row(
        "mass sweep, growth rates included",
        "C loop without growth rates",
        *alternate(sweeps.whole(asked), loop, 3),
        "loop step",
        "at least 0.77 (1.3 times as long)",
        1 / 1.3,
    )
    gains = 64 if quick else 3200
    yield Row(
        f"the whole command `jaxact sweep` over {gains**2:,} loops, programs kept from before",
        "C loop without growth rates, store or start",
        *alternate(sweeps.command("mass", gains, 2.0), loop, 3),
        "loop step",
        "at least 0.77 (1.3 times as long)",
        1 / 1.3,
    )


def _mjx(quick: bool) -> Iterator:
    from benchmarks import rivals, sweeps
    from benchmarks.timing import Row, alternate
    from jaxact.loops.samples import expand
    from jaxact.simulation import plans

    gains, duration = (16, 0.04) if quick else (32, 0.5)
    coarse = sweeps.specification("mjx", gains, duration, physics_step=0.001)
    samples = expand(coarse)
    ticks = sweeps.steps(coarse, samples) // len(samples)
    yield Row(
        "MJX sweep, growth rates and metrics included",
        "mujoco.batch with its own delay, no metrics",
        *alternate(
            sweeps.whole(coarse), rivals.mujoco_batch(samples, min(ticks, 200), delayed=True), 3
        ),
        "physics step",
        "at least 2",
        2.0,
    )
    full = sweeps.with_everything(coarse)
    (plan,) = plans.groups(full, samples)
    for own_step, rival, target, wanted in (
        (False, "MJX's own step with a bare PD command", "at least 0.8 (25 % more)", 0.8),
        (True, "jaxact's step of MJX's model with a bare PD command", "none: what it costs", 0.0),
    ):
        bare = rivals.bare_mjx(samples, ticks, plan.tile, plan.devices, own_step=own_step)
        yield Row(
            "MJX rollout with the full drive and metrics (noise, quantisation, three delays)",
            rival,
            *alternate(sweeps.rollouts(full), bare, 3),
            "physics step",
            target,
            wanted,
        )


def _table(rows: list, machine: dict[str, str]) -> str:
    """The results as Markdown."""
    lines = ["# Benchmarks", "", "Made by `make bench`; each line is one run against a rival.", ""]
    lines += [f"- {name}: {value}" for name, value in machine.items() if value]
    lines += ["", "| what | rival | ours | rival's | times faster | target | met |"]
    lines.append("|---|---|---|---|---|---|---|")
    for row in rows:
        ours, theirs = (f"{seconds * 1e9:,.3g} ns" for seconds in (row.ours, row.theirs))
        met = ("yes" if row.ratio >= row.wanted else "no") if row.wanted else "-"
        lines.append(
            f"| {row.what} | {row.rival} | {ours} | {theirs} per {row.unit} "
            f"| {row.ratio:.3g} | {row.target} | {met} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
