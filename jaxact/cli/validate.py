"""`jaxact validate`: are the results what was computed, and what would be computed again?"""

from __future__ import annotations

from typing import Annotated

from tyro.conf import Positional, arg

from jaxact.cli import _cache, _warnings
from jaxact.cli._arguments import NoCache
from jaxact.errors import UserError


def main(
    result: Annotated[
        Positional[str],
        arg(metavar="RESULT", help="Results folder of a sweep, or its sweep.zarr; path or URL."),
    ],
    *,
    samples: Annotated[
        int, arg(metavar="N", help="Loops to compute again, drawn at random; 0: none.")
    ] = 64,
    seed: Annotated[int, arg(metavar="N", help="Of that draw.")] = 0,
    no_cache: NoCache = False,
) -> None:
    """Check every checksum of a result, and compute some of its loops again.

    Loops computed again must have the same bits where versions and machine are those of the sweep,
    the same numbers to rounding elsewhere. Exit code 2 where anything differs.

    examples:
      jaxact validate results/paper_gain_map
      jaxact validate results/paper_gain_map --samples 1000 --seed 7
    """
    if samples < 0:
        raise UserError(f"--samples {samples}: allowed: 0 or more")
    from jaxact.sweeping import opening

    target = opening.find(result)
    _cache.prepare(wanted=not no_cache)
    from jaxact.sweeping import integrity, validation

    with opening.readable(result):
        checked = validation.checksums(target)
    if checked.chunks:
        print(f"{checked.done:,} of {checked.chunks:,} chunks are whole")
    if checked.wrong:
        more = "; ..." if len(checked.wrong) > 3 else ""
        raise UserError(
            f"{target.name}: {_count(len(checked.wrong))} not whole:"
            f" {'; '.join(checked.wrong[:3])}{more}; {integrity.mended_by(target)}"
        )
    _warnings.older(result)
    if checked.foreign:
        print(
            f"{len(checked.foreign):,} files are not part of the store: {checked.foreign[0]}, ..."
        )
    if not checked.chunks:
        print("every file has its checksum; nothing was swept here that could be computed again")
        return
    if not samples:
        return
    again = validation.recompute(target, samples, seed)
    print(f"{again.loops:,} loops computed again: {again.words}")
    if again.wrong:
        raise UserError(
            f"{target.name}: {again.wrong} of {again.loops} loops differ from what is computed now:"
            f" {again.example}"
        )


def _count(parts: int) -> str:
    return "1 part is" if parts == 1 else f"{parts} parts are"
