"""`jaxact status`: how far a sweep is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from jaxact.cli import _warnings

if TYPE_CHECKING:
    import numpy as np

    from jaxact.sweeping.location import Entry


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
    from jaxact.sweeping import opening

    with opening.readable(result):
        _show(result, quick=quick)


def _show(result: str, *, quick: bool) -> None:
    from jaxact.sweeping import adaptive, integrity, lock, opening, progress, store
    from jaxact.sweeping import location as _location
    from jaxact.sweeping.progress import State

    # a path may be that of the store as it is seen from within its folder
    place = result.rstrip("/") if _location.is_url(result) else str(Path(result).absolute())
    folder = _location.at(place.removesuffix(f"/{store.STORE}"))
    owner = lock.holder(folder)
    rounds = folder.inside(adaptive.ROUNDS)
    if rounds.entries() and adaptive.are_rounds(rounds):
        _of_rounds(rounds.entries(), owner)
        return
    target = opening.find(result)
    description = integrity.description(target)
    if owner and description.wrong:
        print(f"running: {owner}, which has just begun or is about to end")
        return
    integrity.refuse(target, description.wrong)
    _warnings.older(result)
    there = integrity.chunked(target, description)
    if there is None:
        print("complete: was written at once, and every file has its checksum")
        return
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
    if complete or loops[State.DAMAGED]:
        each = dict(zip(numbers, found, strict=True))
        if not complete:
            each = {n: finding for n, finding in each.items() if finding.state is State.DAMAGED}
        integrity.refuse(target, integrity.lost(each.keys(), each.values()))
        print("complete")
    else:
        print(f"running: {owner}" if owner else "not running; continue with jaxact sweep --resume")


def _of_rounds(entries: Mapping[str, Entry], owner: str) -> None:
    """An adaptive sweep on its way: how many rounds there will be is not known before."""
    from jaxact.sweeping.adaptive import chunks_done

    rounds = {key.partition("/")[0] for key in entries}
    print(f"adaptive: round {len(rounds)}, {chunks_done(entries):,} chunks done")
    print(f"running: {owner}" if owner else "not running; continue with jaxact sweep --resume")


def _of_time(written: np.ndarray, done: int, left: int) -> None:
    """Rate and time left, from when the chunks were written; pauses do not count."""
    import numpy as np

    from jaxact.sweeping.progress import duration

    gaps = np.diff(written)
    gaps = gaps[gaps > 0.0]
    if gaps.size < 2:
        return
    # the lower of two medians: of one gap and one pause it is the gap
    working = gaps[gaps <= 10.0 * np.quantile(gaps, 0.5, method="lower")]
    rate = done / len(written) / float(working.mean())
    print(f"rate     {rate:,.4g} loops/s")
    if left and rate:
        print(f"left     {duration(left / rate)}")
