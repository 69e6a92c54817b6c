"""MJX against C MuJoCo: positions of robots in the air, maps of verdicts of robots with contacts.

    python experiments/engines/run.py

The identical drive, two simulators that differ in code, in precision (float32 in MJX), and in how
they end the iterations of a contact. Writes a page and its numbers to results/engines/; some ten
minutes. Exit code 1 if the engines do not agree as they should.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import cases
import maps
import parity
from maps import Comparison
from parity import Parity

from jaxact.errors import UserError
from jaxact.plotting.wording import display_name, quantity

OUT = cases.HERE.parent.parent / "results" / "engines"
PRECISIONS = ("float64", "float32")


def main() -> int:
    """Compare, write and print; 1 if the engines disagree, 2 after saying what is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the results")
    parser.add_argument("--number", type=int, help="gains along each axis of a map")
    parser.add_argument("--free", nargs="*", default=cases.FREE, choices=cases.FREE)
    parser.add_argument("--standing", nargs="*", default=cases.STANDING, choices=cases.STANDING)
    options = parser.parse_args()
    try:
        return _run(options)
    except UserError as error:
        print(f"run.py: {error}", file=sys.stderr)
        return 2


def _run(options: argparse.Namespace) -> int:
    motions = [parity.compare(name, p) for name in options.free for p in PRECISIONS]
    found: list[Comparison] = []
    for name in options.standing:
        found += maps.compare(name, options.number)
    options.out.mkdir(parents=True, exist_ok=True)
    numbers = {"motions": [asdict(one) for one in motions], "maps": [asdict(one) for one in found]}
    (options.out / "numbers.json").write_text(json.dumps(numbers, indent=1) + "\n")
    page = _page(motions, found)
    (options.out / "README.md").write_text(page, encoding="utf-8")
    print(page)
    return 0 if all(one.fine for one in (*motions, *found)) else 1


def _row(found: Comparison) -> str:
    actuator, delay = found.drive
    return (
        f"| {found.description} | {display_name(actuator)}, {quantity(delay, 's')} | {found.loops} "
        f"| {found.stable:.1%} | {found.agree:.2%} | {found.same:.2%} | {found.far} |"
    )


def _page(motions: Sequence[Parity], found: Sequence[Comparison]) -> str:
    lines = [
        "# MJX against C MuJoCo, with the same drives",
        "",
        "Made by `python experiments/engines/run.py`.",
        "",
        "Positions over the first 100 ms of robots that touch nothing, the worst of the drives "
        f"(at most {parity.ALLOWED:g} rad is asked):",
        "",
        "| robot | joints | precision of MJX | moves, at least [rad or m] | apart, at most |",
        "|---|---|---|---|---|",
        *(
            f"| {one.description} | {one.joints} | {one.precision} | {one.moved:.2g} "
            f"| {one.apart:.1e} |"
            for one in motions
        ),
        "",
        "Verdicts of maps of gains with contacts, MJX in float32. At least "
        f"{maps.SHARE:.0%} of the loops must be stable in both or in neither; near the others "
        "there must be a boundary: within 5 % in gain C MuJoCo itself must come to both verdicts. "
        "The motions are each engine's own; the growth rates that verdicts also ask for are those "
        "of the robot linearised in C MuJoCo, for both.",
        "",
        "| robot | drive | gains | stable | agree | same in every word | differ far from it |",
        "|---|---|---|---|---|---|---|",
        *map(_row, found),
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
