"""Sweeps that refine around the stability boundary only.

The ranges of a specification are refined, its lists are cases that are refined each by itself. The
points of each round follow from the results of the rounds before, and every round is a store of its
own, so that a sweep that was interrupted comes to the same points again. In the end all rounds
become one store with a single dimension, `sample`.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxact.errors import InexactWarning, UserError
from jaxact.loops.axes import MOST_SAMPLES, Axis
from jaxact.loops.samples import Samples, explicit
from jaxact.loops.specification import Specification
from jaxact.status import Verdict
from jaxact.sweeping import fill, integrity, planning, progress
from jaxact.sweeping import store as _store
from jaxact.sweeping.layout import Layout
from jaxact.sweeping.location import Location
from jaxact.sweeping.planning import Planned
from jaxact.sweeping.progress import State, Store
from jaxact.sweeping.refinement import RULE, Lattice, Refinement
from jaxact.sweeping.variables import of_margins, variables_of

if TYPE_CHECKING:
    from jaxact.sweeping.computer import ChunkTask
    from jaxact.sweeping.execution import SweepOptions
    from jaxact.sweeping.fill import Workers

ROUNDS = "rounds"
_FIRST = "000"
# Loops in a chunk of a round: all rounds are computed by one compiled kernel.
_ROUND = 8192
_MOST_AXES = 3

# Results of some loops by variable, shape (n,) each.
Rows = dict[str, np.ndarray]


def check(specification: Specification) -> list[Axis]:
    """The axes that are refined; raises UserError for a specification without a border to find."""
    if specification.sampling is not None:
        raise UserError("`adaptive`: refines a grid; remove the section [sampling]")
    if of_margins(specification):
        raise UserError(
            f"`adaptive`: refines where verdicts change, and engine = '{specification.engine}' "
            "computes margins, which change everywhere; leave out `adaptive`"
        )
    ranges = [axis for axis in specification.axes if axis.listed is None]
    if not ranges:
        raise UserError("`adaptive`: no axis is a range { min, max, num } that could be refined")
    if len(ranges) > _MOST_AXES:
        names = ", ".join(axis.name for axis in ranges)
        raise UserError(
            f"`adaptive`: {names} are ranges; up to {_MOST_AXES} can be refined, write the others"
            " as lists"
        )
    return ranges


def lattice(specification: Specification, width: float) -> Lattice:
    """The lattice whose cells are at most so wide.

    Args:
        specification: checked.
        width: relative; of a linear range, to the larger of its ends.

    Raises:
        UserError: as `check`.
    """
    ranges = check(specification)
    halvings = tuple(_halvings(axis, width) for axis in ranges)
    cases = math.prod(len(axis) for axis in specification.axes if axis.listed is not None)
    found = Lattice(cases, tuple(len(axis) - 1 for axis in ranges), halvings)
    if math.prod(found.shape) * cases >= 2**62:
        raise UserError(f"`width` {width:g}: is too fine for these ranges; give a larger one")
    return found


def _halvings(axis: Axis, width: float) -> int:
    cells = len(axis) - 1
    if axis.log:
        needed = math.log(axis.high / axis.low) / math.log1p(width)
    else:
        needed = (axis.high - axis.low) / (max(abs(axis.low), abs(axis.high)) * width)
    return max(0, math.ceil(math.log2(needed / cells) - 1e-9))


def samples_at(
    specification: Specification, grid: Lattice, points: np.ndarray, *, first: int = 0
) -> Samples:
    """The loops at points of the lattice, along one dimension.

    Args:
        specification: checked.
        grid: its lattice.
        points: their numbers, shape (n,).
        first: number of the first loop.
    """
    case, places = grid.places(points)
    listed = [axis for axis in specification.axes if axis.listed is not None]
    index = np.unravel_index(case, [len(axis) for axis in listed]) if listed else ()
    values: dict[str, np.ndarray] = {
        axis.name: axis.values[at] for axis, at in zip(listed, index, strict=True)
    }
    for axis, place, most in zip(check(specification), places.T, grid.shape, strict=True):
        values[axis.name] = axis.place(place / (most - 1))
    columns = {axis.name: values[axis.name] for axis in specification.axes}
    return explicit(specification, columns, first=first)


def refine(
    folder: Location,
    specification: Specification,
    samples: Samples,
    width: float,
    how: SweepOptions,
) -> Store:
    """Refine the border of stability, and make one store of all rounds.

    A cell of the grid is refined where its corners differ in whether they are stable, or in the
    sign of their growth rate. The stores of the rounds stay: they go once the whole is complete.

    Args:
        folder: of the results.
        specification: checked.
        samples: of the coarse grid.
        width: relative width of the border in the end.
        how: to run it.

    Raises:
        UserError: as `jaxact.sweeping.fill.fill`, and where the border is so ragged that more loops
            would be needed than a sweep may have.
    """
    from jaxact.simulation import plans

    grid = lattice(specification, width)
    plans.groups(specification, samples, refined=True)  # refuses what it cannot refine
    rounds, target = folder.inside(ROUNDS), folder.inside(_store.STORE)
    planned = _round_plan(how.planner(specification, samples), samples)
    source = _source(target, rounds, specification, planned, width) if how.resume else None
    planned = planned if source is None else _taken_over(source, planned)
    known = None
    if source == target:
        if integrity.is_whole(target):
            return _existing(target)
        known = KnownSamples.of(_existing(target))
        if not _same(rounds.inside(_FIRST), specification, planned, width):
            rounds.remove()
    refinement = Refinement(grid)
    asked: list[np.ndarray] = []
    results: list[Rows] = []
    while refinement.ask().size:
        points, first = refinement.ask(), sum(map(len, asked))
        if first + len(points) > MOST_SAMPLES:
            raise UserError(
                f"`width` {width:g}: the border is so ragged that {first + len(points):,} loops do"
                " not suffice; give a larger width, or a smaller range"
            )
        found = None if known is None else known.rows(first, len(points))
        found = found or _round(
            rounds, len(asked), specification, samples,
            samples_at(specification, grid, points, first=first), planned, width, known, how,
        )  # fmt: skip
        asked.append(points)
        results.append(found)
        stable = found["verdict"] == Verdict.STABLE
        codes = stable + 2 * (found["growth_rate"] < 0.0)
        refinement.tell(codes)
        if len(asked) == 1:
            _warn_of_calm(codes.reshape(grid.cases, -1))
    origin = _store.beginning(source or rounds.inside(_FIRST))
    points = np.concatenate(asked)
    return _joined(target, specification, grid, points, results, planned, width, origin)


def _warn_of_calm(codes: np.ndarray) -> None:
    """Say that nothing is refined where all loops of a coarse grid agree, shape (cases, loops)."""
    calm = np.all(codes == codes[:, :1], axis=1)
    if not np.any(calm):
        return
    which = "" if len(calm) == 1 else f" in {np.sum(calm)} of {len(calm)} cases"
    warnings.warn(
        f"adaptive:{which} no border of stability lies between the {codes.shape[1]:,} loops of the "
        "starting grid, so nothing is refined there, and a region that is smaller than its cells "
        "is not seen; give a finer grid",
        InexactWarning,
        stacklevel=2,
    )


def chunks_done(entries: Iterable[str]) -> int:
    """How many chunks of all rounds are done, of what their folder holds."""
    return sum("/progress/receipt/c." in key for key in entries)


def are_rounds(rounds: Location) -> bool:
    """Whether a folder holds rounds of a sweep, or nothing."""
    names = {key.partition("/")[0] for key in rounds.entries()}
    if not names:
        return True
    ours = any(_store.is_ours(rounds.inside(name)) for name in names)
    return ours and all(re.fullmatch(r"\d{3,}", name) for name in names)


def _source(
    target: Location, rounds: Location, specification: Specification, planned: Planned, width: float
) -> Location | None:
    """The store that is continued: the whole, or the first round; None where there is neither.

    Raises:
        UserError: all that is there belongs to another sweep.
    """
    there = [p for p in (target, rounds.inside(_FIRST)) if _store.identity_of(p) is not None]
    for place in there:
        if _same(place, specification, planned, width):
            return place
    if there:
        _demand_same(there[0], specification, planned, width)
    return None


def _existing(target: Location) -> Store:
    store = progress.existing(target)
    if store is None:
        raise UserError(f"{target.name}: does not say how it is cut up; `overwrite` begins anew")
    return store


def _taken_over(source: Location, planned: Planned) -> Planned:
    """The plan with the tiles and chunks of the sweep that is continued."""
    there = _store.identity_of(source) or {}
    return dataclasses.replace(
        planned, tile=int(there["tile"]), loops=int(there.get("loops", planned.loops))
    )


def _round_plan(planned: Planned, samples: Samples) -> Planned:
    """Small chunks, the same in all rounds."""
    whole = planned.tile * planned.devices
    return dataclasses.replace(planned, loops=min(planned.loops, -(-_ROUND // whole) * whole))


def _more(planned: Planned, width: float) -> dict[str, object]:
    """Further parts of the identity."""
    return {"width": width, "refinement": RULE, "loops": planned.loops}


@dataclass(frozen=True)
class KnownSamples:
    """Results that a damaged or unfinished whole still has.

    Attributes:
        there: which loops they are of, shape (n,).
        values: of all loops by variable, shape (n,) each.
    """

    there: np.ndarray
    values: Rows

    @staticmethod
    def of(store: Store) -> KnownSamples:
        """What a store has."""
        size = math.prod(store.layout.shape)
        there = np.zeros(size, bool)
        values = {name: np.zeros(size, store.dtype(name)) for name in store.variables}
        for number in range(len(store.layout)):
            first, count = store.layout.span(number)
            for name, part in store.attempt(number)[1].items():
                values[name][first : first + count] = part
                there[first : first + count] = True
        return KnownSamples(there, values)

    def rows(self, first: int, count: int) -> Rows | None:
        """The results of a run of loops, None where not all are known."""
        mine = slice(first, first + count)
        if first + count > self.there.size or not self.there[mine].all():
            return None
        return {name: values[mine] for name, values in self.values.items()}

    def workers(self, others: Workers) -> Workers:
        """Those who compute what is not known."""

        def work(work: ChunkTask, numbers: list[int], begin: Callable[[], None]) -> Iterator[int]:
            begin_once = functools.cache(begin)
            left = []
            for number in numbers:
                first, count = work.store.layout.span(number)
                rows = self.rows(work.samples.first + first, count)
                if rows is None:
                    left.append(number)
                    continue
                begin_once()
                work.store.write(number, rows, work.store.tile)
                yield number
            yield from others(work, left, begin_once)

        return work


def _round(
    rounds: Location,
    number: int,
    specification: Specification,
    outline: Samples,
    samples: Samples,
    planned: Planned,
    width: float,
    known: KnownSamples | None,
    how: SweepOptions,
) -> Rows:
    """The results of one round, from its store where they are there already."""
    store = fill.fill(
        rounds.inside(f"{number:03d}"), specification, samples, planned, outline=outline,
        workers=how.workers if known is None else known.workers(how.workers),
        resume=how.resume, more=_more(planned, width), moved=how.moved,
        clear=None if number else rounds.remove,
    )  # fmt: skip
    parts = [store.read(chunk) for chunk in range(len(store.layout))]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _demand_same(
    target: Location, specification: Specification, planned: Planned, width: float
) -> None:
    there = _store.identity_of(target) or {}
    layout = Layout(tuple(there["shape"]), tuple(there["chunk"]))
    wanted = planning.identity(specification, planned, layout, **_more(planned, width))
    fill.same(target, specification, wanted)


def _same(target: Location, specification: Specification, planned: Planned, width: float) -> bool:
    """Whether a store is of this sweep."""
    if _store.identity_of(target) is None:
        return False
    try:
        _demand_same(target, specification, planned, width)
    except UserError:
        return False
    return True


def _joined(
    target: Location,
    specification: Specification,
    grid: Lattice,
    points: np.ndarray,
    results: list[Rows],
    planned: Planned,
    width: float,
    origin: dict[str, object],
) -> Store:
    """One store of all rounds; what is whole in one of the same sweep stays."""
    samples = samples_at(specification, grid, points)
    layout = planned.layout(samples)
    identity = planning.identity(specification, planned, layout, **_more(planned, width))
    attributes = _store.provenance(specification, planned.device) | origin
    attributes |= {"complete": False, "adaptive": _described(specification, grid, points, width)}
    names = variables_of(specification)
    store = Store(target, layout, specification.precision, planned.tile, names)
    files = _store.skeleton(specification, samples, layout, _store.as_json(identity), attributes)
    if _store.identity_of(target) != identity:
        target.remove()
    target.clean()
    progress.repair(target, files)
    whole = {name: np.concatenate([part[name] for part in results]) for name in results[0]}
    for number in range(len(layout)):
        first, count = layout.span(number)
        part = {name: values[first : first + count] for name, values in whole.items()}
        if store.look(number).state is not State.DONE:
            store.write(number, part, planned.tile)
    return store


def _described(
    specification: Specification, grid: Lattice, points: np.ndarray, width: float
) -> str:
    """What was refined, JSON."""
    return _store.as_json(
        {
            "width": width,
            "refined": [axis.name for axis in check(specification)],
            "cases": [axis.name for axis in specification.axes if axis.listed is not None],
            "resolution": list(grid.shape),
            "share": len(points) / (grid.cases * grid.size),
        }
    )
