"""`jaxact status`: how far a sweep is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

import numpy as np
from tyro.conf import Positional, arg

from jaxact.errors import UserError

if TYPE_CHECKING:
    from jaxact.sweep.place import Entry


def main(
    result: Annotated[
        Positional[str],
        arg(metavar="RESULT", help="Results folder of a sweep, or its sweep.zarr; path or URL."),
    ],
    *,
    quick: Annotated[
        bool, arg(help="Look at names and sizes of files only, not at every checksum.")
    ] = False,
) -> None:
    """Show how far a sweep is: chunks done, missing and damaged, rate, time left.

    examples:
      jaxact status results/paper_gain_map
      jaxact status results/paper_gain_map --quick
    """
    from jaxact.sweep import store

    with store.readable(result):
        _show(result, quick=quick)


def _show(result: str, *, quick: bool) -> None:
    from jaxact.sweep import adaptive, lock, progress, store
    from jaxact.sweep import place as _place
    from jaxact.sweep.progress import State

    folder = _place.at(result.rstrip("/").removesuffix(f"/{store.STORE}"))
    owner = lock.holder(folder)
    rounds = folder.inside(adaptive.ROUNDS).entries()
    if rounds:
        _of_rounds(rounds, owner)
        return
    target = store.find(result)
    there = progress.existing(target)
    if there is None:
        raise UserError(f"{target.name}: says not how it is cut up; `--resume` mends it")
    entries = target.entries()
    numbers = range(len(there.layout))
    found = [there.glance(n, entries) if quick else there.look(n) for n in numbers]
    loops = dict.fromkeys(State, 0)
    for number, finding in zip(numbers, found, strict=True):
        loops[finding.state] += there.layout.span(number)[1]
    for state in State:
        count = sum(finding.state is state for finding in found)
        print(f"{state.value:8} {count:,} of {len(found):,} chunks, {loops[state]:,} loops")
    for number, finding in zip(numbers, found, strict=True):
        if finding.state is State.DAMAGED:
            print(f"  chunk {number}: {finding.why}")
    todo = loops[State.MISSING] + loops[State.DAMAGED]
    _of_time(progress.times(entries), loops[State.DONE], todo)
    complete = (store.attributes_of(target) or {}).get("complete", False)
    if complete and loops[State.DONE] == sum(loops.values()):
        print("complete")
    else:
        print(f"running: {owner}" if owner else "not running; continue with jaxact sweep --resume")


def _of_rounds(entries: Mapping[str, Entry], owner: str) -> None:
    """An adaptive sweep on its way: how many rounds there will be is not known before."""
    rounds = {key.partition("/")[0] for key in entries}
    receipts = [key for key in entries if "/progress/receipt/c." in key]
    print(f"adaptive: round {len(rounds)}, {len(receipts):,} chunks done")
    print(f"running: {owner}" if owner else "not running; continue with jaxact sweep --resume")


def _of_time(written: np.ndarray, done: int, left: int) -> None:
    """Rate and time left, from when the chunks were written; pauses do not count."""
    from jaxact.cli.sweep import duration

    gaps = np.diff(written)
    gaps = gaps[gaps > 0.0]
    if gaps.size < 2:
        return
    working = gaps[gaps <= 10.0 * np.median(gaps)]
    rate = done / len(written) / float(working.mean())
    print(f"rate     {rate:,.4g} loops/s")
    if left and rate:
        print(f"left     {duration(left / rate)}")
