"""`python -m benchmarks.gpu`: throughput of sweeps on a GPU, with and without the drive.

The floor is what the arithmetic of a control period, or its traffic with the memory, takes at the
rates that this device reaches in two small programs of the same run.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import rivals, robots, sweeps
from benchmarks.timing import machine, seconds
from jaxact.loops import loop
from jaxact.loops.samples import Samples, expand
from jaxact.loops.specification import Specification
from jaxact.plants import warp
from jaxact.simulation import envelope, kernel, metrics, plans, stopping
from jaxact.simulation.metrics import Period

RESULTS = Path("results/benchmarks")
_CHAIN = 512


def main() -> None:
    """Measure, print a table and write it to results/benchmarks/gpu.md and gpu.json."""
    parts = {"mass": _mass, "joint": _joint, "quadruped": _quadruped, "warp": _warp}
    parser = argparse.ArgumentParser(prog="benchmarks.gpu", description=main.__doc__)
    text = "small sizes, on any device, nothing written"
    parser.add_argument("--quick", action="store_true", help=text)
    text = "measure this only, nothing written; may be given again"
    parser.add_argument("--only", action="append", choices=parts, help=text)
    asked = parser.parse_args()
    if jax.default_backend() != "gpu" and not asked.quick:
        print("benchmarks.gpu: JAX has no GPU here; --quick runs on any device", file=sys.stderr)
        raise SystemExit(2)
    document: dict[str, Any] = {"machine": machine(), "peaks": _peaks(asked.quick)}
    for name in asked.only or parts:
        begun = time.perf_counter()
        document[name] = parts[name](asked.quick)
        print(f"{name}: {time.perf_counter() - begun:.0f} s", file=sys.stderr, flush=True)
        if not asked.quick and not asked.only:  # so that what is there stays if the next one fails
            RESULTS.mkdir(parents=True, exist_ok=True)
            (RESULTS / "gpu.md").write_text(_page(document), encoding="utf-8")
            (RESULTS / "gpu.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    print(_page(document))


def _peaks(quick: bool) -> dict[str, float]:
    """Bytes and float32 operations per second that the device reaches."""
    size = 2**20 if quick else 2**30
    row = jnp.ones(size, jnp.float32)

    def chained(x: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, _CHAIN, lambda _, y: y * 0.999 + 0.001, x, unroll=_CHAIN)

    copy, chain = jax.jit(lambda x: x + 1.0), jax.jit(chained)
    few = row[: size // 16]
    return {
        "bytes_per_second": 8.0 * size / seconds(lambda: jax.block_until_ready(copy(row))),
        "operations_per_second": (
            2.0 * _CHAIN * few.size / seconds(lambda: jax.block_until_ready(chain(few)))
        ),
    }


def _mass(quick: bool) -> dict[str, Any]:
    """Sweeps and rollouts of the mass plant by the size of a tile, and what bounds them."""
    gains, duration = (32, 0.1) if quick else (1024, 1.0)
    asked = sweeps.specification("mass", gains, duration)
    tiles = (256, 1024) if quick else (2**16, 2**18, 10**6)
    rows = []
    for tile in tiles:
        own = dataclasses.replace(asked, tile=tile)
        rows.append({
            "tile": tile,
            "rollouts_seconds_per_step": _each(sweeps.rollouts(own)),
            "sweep_seconds_per_step": _each(sweeps.whole(own)),
        })  # fmt: skip
    samples = expand(asked)
    (plan,) = plans.groups(asked, samples)
    return {
        "loops": len(samples),
        "control_periods": plan.case.rollout.ticks,
        "periods_per_iteration": stopping.together(
            plan.case.rollout.ticks // metrics.SEGMENTS, plan.case.rollout.unroll
        ),
        **_work(plan, asked, samples),
        "tiles": rows,
    }


def _work(plan: plans.Plan, asked: Any, samples: Any) -> dict[str, int]:
    """Operations of one control period with its metrics, and bytes of what it carries on."""
    template = kernel.template_of(plan.case, asked.setting, "metrics")
    values = {name: jnp.float32(value[0]) for name, value in samples.take(np.zeros(1, int)).items()}
    prepared, state, setpoint = kernel.start(plan.case, template, values)
    start, _ = prepared.plant.measure(state.plant)
    reference = metrics.reference(start, setpoint.position)
    carry = state, metrics.init(start), envelope.init(start)

    def period(carry: Any, number: jax.Array) -> Any:
        state, running, within = carry
        state, (output, _) = loop.step(prepared, plan.case.drive, state, setpoint)
        periods = [Period(output, reference, number)]
        return state, *metrics.update(running, within, periods)

    traced = jax.make_jaxpr(period)(carry, jnp.float32(1.0))
    return {
        "operations_per_step": _operations(traced.jaxpr),
        "carried_bytes": sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(carry)),
    }


def _operations(jaxpr: Any) -> int:
    """Arithmetic operations on floating-point numbers in a program, comparisons included."""
    count = 0
    for equation in jaxpr.eqns:
        inner = equation.params.get("jaxpr")
        if inner is not None:
            count += _operations(getattr(inner, "jaxpr", inner))
        elif any(jnp.issubdtype(atom.aval.dtype, jnp.floating) for atom in equation.invars):
            if equation.primitive.name not in ("broadcast_in_dim", "reshape", "squeeze", "slice"):
                count += max(variable.aval.size for variable in equation.outvars)
    return count


def _joint(quick: bool) -> dict[str, Any]:
    """Rollouts of a joint in MJX with the full drive, and with a bare PD command."""
    gains, duration = (16, 0.04) if quick else (256, 0.5)
    tiles = (256,) if quick else (4096, 65536)
    asked = sweeps.specification("mjx", gains, duration, physics_step=0.001)
    asked = sweeps.with_everything(asked)
    samples = expand(asked)
    ticks = sweeps.steps(asked, samples) // len(samples)
    rows = []
    for tile in tiles:
        own = dataclasses.replace(asked, tile=tile)
        bare = rivals.bare_mjx(samples, ticks, tile, 1, own_step=True)
        rows.append(_row(tile, sweeps.rollouts(own), bare))
    return {"loops": len(samples), "tiles": rows}


def _quadruped(quick: bool) -> dict[str, Any]:
    """Rollouts of a quadruped in MJX with the full drive and with a bare PD command."""
    found = _robot("mjx", (32,) if quick else (2048, 8192), quick)
    # The same tile last, so that its samples and plan are those of the rival.
    asked, samples = _asked("mjx", found["tiles"][-1]["tile"], quick)
    plan = robots.rollouts(asked, samples)[1]
    mjx = robots.bare(robots.QUADRUPED, samples, plan, own_step=False)
    return found | {"mjx_seconds_per_step": _each(mjx)}


def _warp(quick: bool) -> dict[str, Any]:
    """The same in MJX-Warp; why not, where it is not there."""
    missing = warp.lacking()
    if missing:
        return {"missing": missing}
    return _robot("warp", (32,) if quick else (2048, 8192), quick)


def _robot(engine: str, tiles: tuple[int, ...], quick: bool) -> dict[str, Any]:
    """Rollouts of the quadruped by the loops in a tile, as many loops as the largest holds."""
    rows = []
    for tile in tiles:
        asked, samples = _asked(engine, tile, quick)
        ours, plan = robots.rollouts(asked, samples)
        bare = robots.bare(robots.QUADRUPED, samples, plan, own_step=True)
        rows.append(_row(tile, ours, bare))
    return {"loops": len(samples), "tiles": rows}


def _asked(engine: str, tile: int, quick: bool) -> tuple[Specification, Samples]:
    """The quadruped's sweep."""
    loops, duration = (64, 0.02) if quick else (8192, 0.2)
    asked = robots.specification(robots.QUADRUPED, engine, duration, loops)
    asked = dataclasses.replace(asked, tile=tile)
    return asked, expand(asked)


def _row(tile: int, ours: Callable[[], float], bare: Callable[[], float]) -> dict[str, float]:
    """Seconds of a step with the drive and without."""
    times = {"full_seconds_per_step": _each(ours), "bare_seconds_per_step": _each(bare)}
    return {"tile": tile, **times}


def _each(run: Callable[[], float]) -> float:
    """Median seconds for one unit of what is run, once it is compiled."""
    units = run()
    return seconds(run, repeats=3, warm=True) / units


def _page(document: dict[str, Any]) -> str:
    """The results as Markdown."""
    peaks = document["peaks"]
    lines = ["# On a GPU", "", "Made by `python -m benchmarks.gpu`.", ""]
    lines += [f"- {name}: {value}" for name, value in document["machine"].items() if value]
    lines += [
        f"- reached by a copy: {peaks['bytes_per_second'] / 1e9:,.0f} GB/s",
        f"- reached by multiplications and additions: "
        f"{peaks['operations_per_second'] / 1e12:,.2f} Tflop/s",
    ]
    if "mass" in document:
        lines += _of_mass(document["mass"], peaks)
    if "joint" in document:
        lines += _table("A joint in MJX", document["joint"])
    if "quadruped" in document:
        lines += _table("Quadruped in MJX, 12 joints", document["quadruped"])
        own = min(row["bare_seconds_per_step"] for row in document["quadruped"]["tiles"])
        other = document["quadruped"]["mjx_seconds_per_step"]
        lines += ["", f"MJX's own step with a bare PD command takes {other * 1e9:,.3g} ns, "]
        lines[-1] += f"{other / own:.3g} times as long as jaxact's of the same model."
    if "warp" in document:
        lines += _table("Quadruped in MJX-Warp", document["warp"])
    return "\n".join(lines) + "\n"


def _of_mass(mass: dict[str, Any], peaks: dict[str, float]) -> list[str]:
    """The mass plant's throughput beside the floor."""
    arithmetic = mass["operations_per_step"] / peaks["operations_per_second"]
    traffic = 2.0 * mass["carried_bytes"] / peaks["bytes_per_second"]
    traffic /= mass["periods_per_iteration"]
    best = min(row["rollouts_seconds_per_step"] for row in mass["tiles"])
    lines = [
        "",
        f"## Mass plant, {mass['loops']:,} loops, {mass['control_periods']:,} control periods",
        "",
        "| loops in a tile | rollouts with metrics | sweep, growth rates included |",
        "|---|---|---|",
    ]
    for row in mass["tiles"]:
        times = (row[f"{what}_seconds_per_step"] * 1e12 for what in ("rollouts", "sweep"))
        lines.append(f"| {row['tile']:,} | " + " | ".join(f"{t:,.3g} ps" for t in times) + " |")
    lines += [
        "",
        f"A control period of one loop takes {mass['operations_per_step']} operations, "
        f"{arithmetic * 1e12:.3g} ps at the rate above, and carries {mass['carried_bytes']} bytes "
        f"on: read and written once in {mass['periods_per_iteration']} periods, "
        f"{traffic * 1e12:.3g} ps. The best rollouts take {best / max(arithmetic, traffic):.3g} "
        "times the longer of the two.",
    ]
    return lines


def _table(title: str, found: dict[str, Any]) -> list[str]:
    """Rollouts with the full drive beside those with a bare PD command."""
    if "missing" in found:
        return ["", f"## {title}", "", f"Not measured: {found['missing']}."]
    lines = [
        "",
        f"## {title}, {found['loops']:,} loops",
        "",
        "A step of one loop. With the full drive every loop is simulated from several starts, all "
        "but one of them side by side, so that there are more of them at once than in the tile.",
        "",
        "| loops in a tile | full drive and metrics | bare PD command |",
        "|---|---|---|",
    ]
    for row in found["tiles"]:
        full, bare = (row[f"{what}_seconds_per_step"] * 1e9 for what in ("full", "bare"))
        lines.append(f"| {row['tile']:,} | {full:,.3g} ns | {bare:,.3g} ns |")
    return lines


if __name__ == "__main__":
    main()
