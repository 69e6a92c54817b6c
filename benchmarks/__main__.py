"""`make bench`: ratios against named rivals, printed and written to results/benchmarks/.

Each group of lines is measured in a process of its own, so that none finds what another one has
left: threads, memory, compiled programs.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks import commands
from benchmarks.timing import Row, failed, machine
from jaxact.cli import _xla

RESULTS = Path("results/benchmarks")
GROUPS = ("commands", "mass", "mjx", "robots", "environments", "margins", "tuning")


def main() -> int:
    """Run all benchmarks, or `--quick`, small ones that show only that they run.

    Returns:
        The exit code: 1 where a line could not be measured.
    """
    parser = argparse.ArgumentParser(prog="benchmarks", description=main.__doc__)
    parser.add_argument("--quick", action="store_true", help="small sizes, nothing written")
    parser.add_argument("--only", choices=GROUPS, help="one group, its lines as JSON")
    asked = parser.parse_args()
    if asked.only:
        for row in _rows(asked.only)(asked.quick):
            print(json.dumps(dataclasses.asdict(row)), flush=True)
        return 0
    rows: list[Row] = []
    for row in (row for group in GROUPS for row in _measured(group, quick=asked.quick)):
        rows.append(row)
        found = row.failure or f"{row.ratio:.3g} times {row.rival}"
        print(f"{row.what}: {found} (target: {row.target})", flush=True)
    _xla.prepare(all_cores=True)  # before JAX starts, as for the lines
    _xla.enlarge_pool()
    table = _table(rows, machine())
    print(table)
    if not asked.quick:
        _write(rows, table)
    return int(any(row.failure for row in rows))


def _write(rows: list[Row], table: str) -> None:
    """Keep the table, and its figures as JSON."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / "benchmarks.md").write_text(table, encoding="utf-8")
    figures = [_figures(row) for row in rows]
    document = {"machine": machine(), "rows": figures}
    (RESULTS / "benchmarks.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    print(f"written to {RESULTS}")


def _figures(row: Row) -> dict[str, object]:
    """What is kept of a line; JSON has no NaN."""
    figures = dataclasses.asdict(row)
    if row.failure:
        return figures | {"ours": None, "theirs": None, "ratio": None}
    del figures["failure"]
    return figures | {"ratio": row.ratio}


def _measured(group: str, *, quick: bool) -> Iterator[Row]:
    """The lines of a group, from a process of its own, and one more where that ends early."""
    words = [sys.executable, "-m", "benchmarks", "--only", group, *(["--quick"] if quick else [])]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("{"):
                yield Row(**json.loads(line))
            else:
                print(line, end="", flush=True)
    if process.returncode:
        yield failed(f"what is left of {group}", f"exit code {process.returncode}")


def _rows(group: str) -> Callable[[bool], Iterator[Row]]:
    """The lines of a group, each measured as it is asked for, in this process."""
    # Before JAX starts, as `jaxact` does: for sweeps all cores.
    _xla.prepare(all_cores=group != "commands")
    _xla.enlarge_pool()
    from benchmarks import environments, joints, margins, robots, tuning

    return {
        "commands": commands.rows, "mass": joints.mass, "mjx": joints.mjx, "robots": robots.rows,
        "environments": environments.rows, "margins": margins.rows, "tuning": tuning.rows,
    }[group]  # fmt: skip


def _table(rows: list[Row], machine: dict[str, str]) -> str:
    """The results as Markdown."""
    lines = ["# Benchmarks", "", "Made by `make bench`; each line is one run against a rival.", ""]
    lines += [f"- {name}: {value}" for name, value in machine.items() if value]
    lines += ["", "| what | rival | ours | rival's | times faster | target | met |"]
    lines.append("|---|---|---|---|---|---|---|")
    for row in rows:
        if row.failure:
            found = f"{row.failure} | - | - | {row.target} | no"
            lines.append(f"| {row.what} | {row.rival} | {found} |")
            continue
        ours, theirs = (f"{seconds * 1e9:,.3g} ns" for seconds in (row.ours, row.theirs))
        met = ("yes" if row.ratio >= row.wanted else "no") if row.wanted else "-"
        lines.append(
            f"| {row.what} | {row.rival} | {ours} | {theirs} per {row.unit} "
            f"| {row.ratio:.3g} | {row.target} | {met} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
