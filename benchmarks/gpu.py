"""`python -m benchmarks.gpu`: throughput of sweeps on a GPU, the drive's share, and the floor.

The floor is what the arithmetic of a control period, or its traffic with the memory, takes at the
rates that this device reaches in two small programs of the same run.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import robots, sweeps
from benchmarks.timing import machine, seconds
from jaxact.loops import loop
from jaxact.loops.samples import expand
from jaxact.simulation import envelope, kernel, metrics, plans
from jaxact.simulation.metrics import Period

RESULTS = Path("results/benchmarks")
_CHAIN = 64


def main() -> None:
    """Measure, print a table and write it to results/benchmarks/gpu.md and gpu.json."""
    parser = argparse.ArgumentParser(prog="benchmarks.gpu", description=main.__doc__)
    text = "small sizes, on any device, nothing written"
    parser.add_argument("--quick", action="store_true", help=text)
    quick = parser.parse_args().quick
    if jax.default_backend() != "gpu" and not quick:
        print("benchmarks.gpu: JAX has no GPU here; --quick runs on any device", file=sys.stderr)
        raise SystemExit(2)
    document = {
        "machine": machine(),
        "peaks": _peaks(quick),
        "mass": _mass(quick),
        "quadruped": _quadruped(quick),
    }
    page = _page(document)
    print(page)
    if not quick:
        RESULTS.mkdir(parents=True, exist_ok=True)
        (RESULTS / "gpu.md").write_text(page, encoding="utf-8")
        (RESULTS / "gpu.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")


def _peaks(quick: bool) -> dict[str, float]:
    """Bytes and float32 operations per second that the device reaches."""
    size = 2**20 if quick else 2**28
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
    tiles = (256, 1024) if quick else (2**14, 2**16, 2**18, 2**20)
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
        "periods_per_iteration": plan.case.rollout.unroll,
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


def _quadruped(quick: bool) -> dict[str, Any]:
    """Rollouts of a quadruped in MJX with the full drive and with a bare PD command."""
    loops, duration = (64, 0.02) if quick else (8192, 0.2)
    tiles = (32,) if quick else (1024, 4096, 8192)
    rows = []
    for tile in tiles:
        asked = robots.specification(robots.QUADRUPED, "mjx", duration, loops)
        asked = dataclasses.replace(asked, tile=tile)
        samples = expand(asked)
        ours, plan = robots.rollouts(asked, samples)
        full, bare = _each(ours), _each(robots.bare(robots.QUADRUPED, samples, plan, own_step=True))
        rows.append({
            "tile": tile,
            "full_seconds_per_step": full,
            "bare_seconds_per_step": bare,
            "drive_share": 1.0 - bare / full,
        })  # fmt: skip
    return {"loops": loops, "tiles": rows}


def _each(run: Callable[[], float]) -> float:
    """Median seconds for one unit of what is run, once it is compiled."""
    units = run()
    return seconds(run) / units


def _page(document: dict[str, Any]) -> str:
    """The results as Markdown."""
    peaks, mass, quadruped = document["peaks"], document["mass"], document["quadruped"]
    arithmetic = mass["operations_per_step"] / peaks["operations_per_second"]
    traffic = 2.0 * mass["carried_bytes"] / peaks["bytes_per_second"]
    traffic /= mass["periods_per_iteration"]
    best = min(row["rollouts_seconds_per_step"] for row in mass["tiles"])
    lines = ["# On a GPU", "", "Made by `python -m benchmarks.gpu`.", ""]
    lines += [f"- {name}: {value}" for name, value in document["machine"].items() if value]
    lines += [
        f"- reached by a copy: {peaks['bytes_per_second'] / 1e9:,.0f} GB/s",
        f"- reached by multiplications and additions: "
        f"{peaks['operations_per_second'] / 1e12:,.2f} Tflop/s",
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
        "",
        f"## Quadruped in MJX, 12 joints, {quadruped['loops']:,} loops",
        "",
        "| loops in a tile | full drive and metrics | bare PD command | share of the drive |",
        "|---|---|---|---|",
    ]
    for row in quadruped["tiles"]:
        full, bare = (row[f"{what}_seconds_per_step"] * 1e9 for what in ("full", "bare"))
        share = f"{row['drive_share']:.1%}"
        lines.append(f"| {row['tile']:,} | {full:,.3g} ns | {bare:,.3g} ns | {share} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
