"""Sweeps that refine around the stability boundary only.

The ranges of a specification are refined, its lists are cases that are refined each by itself. The
points of each round follow from the results of the rounds before, and every round is a store of its
own, so that a sweep that was interrupted comes to the same points again. In the end all rounds
become one store with a single dimension, `sample`.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from jaxact.errors import UserError
from jaxact.status import Verdict
from jaxact.sweep import fill, planning, progress
from jaxact.sweep import store as _store
from jaxact.sweep.axes import MOST_SAMPLES, Axis
from jaxact.sweep.layout import Layout
from jaxact.sweep.place import Place
from jaxact.sweep.planning import Planned
from jaxact.sweep.progress import Store
from jaxact.sweep.refinement import Lattice, Refinement
from jaxact.sweep.samples import Samples, explicit
from jaxact.sweep.specification import Specification

if TYPE_CHECKING:
    from jaxact.sweep.conduct import How

ROUNDS = "rounds"
# Loops in a chunk of a round: all rounds are computed by one compiled kernel.
_ROUND = 8192
_MOST_AXES = 3


def check(specification: Specification) -> list[Axis]:
    """The axes that are refined; raises UserError for a specification without a border to find."""
    if specification.sampling is not None:
        raise UserError("--adaptive: refines a grid; remove the section [sampling]")
    ranges = [axis for axis in specification.axes if axis.listed is None]
    if not ranges:
        raise UserError("--adaptive: no axis is a range { min, max, num } that could be refined")
    if len(ranges) > _MOST_AXES:
        names = ", ".join(axis.name for axis in ranges)
        raise UserError(
            f"--adaptive: {names} are ranges; up to {_MOST_AXES} can be refined, write the others"
            " as lists"
        )
    return ranges


def lattice(specification: Specification, width: float) -> Lattice:
    """The lattice whose cells are at most so wide.

    specification: checked
    width: relative; of a linear range, to the larger of its ends

    Raises UserError as `check`.
    """
    ranges = check(specification)
    halvings = tuple(_halvings(axis, width) for axis in ranges)
    cases = math.prod(len(axis) for axis in specification.axes if axis.listed is not None)
    found = Lattice(cases, tuple(len(axis) - 1 for axis in ranges), halvings)
    if math.prod(found.shape) * cases >= 2**62:
        raise UserError(f"--width {width:g}: is too fine for these ranges; give a larger one")
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

    specification: checked
    grid: its lattice
    points: their numbers, shape (n,)
    first: number of the first loop
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
    folder: Place, specification: Specification, samples: Samples, width: float, how: How
) -> Store:
    """Refine the border of stability, and make one store of all rounds.

    folder: of the results
    specification: checked
    samples: of the coarse grid
    width: relative width of the border in the end
    how: to run it

    A cell of the grid is refined where its corners differ in whether they are stable, or in the
    sign of their growth rate.

    Raises UserError as `jaxact.sweep.fill.fill`, and where the border is so ragged that more loops
    would be needed than a sweep may have.
    """
    grid = lattice(specification, width)
    rounds, target = folder.inside(ROUNDS), folder.inside(_store.STORE)
    planned = _round_plan(how.planner(specification, samples), samples)
    more: dict[str, object] = {"width": width}
    whole = progress.existing(target)
    if how.resume and whole is not None:
        _demand_same(target, specification, planned, more)
        return whole
    if not how.resume:
        rounds.remove()
    refinement = Refinement(grid)
    asked: list[np.ndarray] = []
    results: list[dict[str, np.ndarray]] = []
    while refinement.ask().size:
        points, first = refinement.ask(), sum(map(len, asked))
        if first + len(points) > MOST_SAMPLES:
            raise UserError(
                f"--width {width:g}: the border is so ragged that {first + len(points):,} loops do"
                " not suffice; give a larger width, or a smaller range"
            )
        found = _round(
            rounds.inside(f"{len(asked):03d}"), specification, samples,
            samples_at(specification, grid, points, first=first), planned, more, how,
        )  # fmt: skip
        asked.append(points)
        results.append(found)
        stable = found["verdict"] == Verdict.STABLE
        refinement.tell(stable + 2 * (found["growth_rate"] < 0.0))
    store = _joined(target, specification, grid, np.concatenate(asked), results, planned, more)
    rounds.remove()
    return store


def _round_plan(planned: Planned, samples: Samples) -> Planned:
    """Small chunks, the same in all rounds."""
    whole = planned.tile * planned.devices
    return dataclasses.replace(planned, loops=min(planned.loops, -(-_ROUND // whole) * whole))


def _round(
    target: Place,
    specification: Specification,
    outline: Samples,
    samples: Samples,
    planned: Planned,
    more: dict[str, object],
    how: How,
) -> dict[str, np.ndarray]:
    """The results of one round, from its store where they are there already."""
    store = fill.fill(
        target, specification, samples, planned, outline=outline,
        workers=how.workers, resume=how.resume, more=more, moved=how.moved,
    )  # fmt: skip
    parts = [store.read(number) for number in range(len(store.layout))]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _demand_same(
    target: Place, specification: Specification, planned: Planned, more: dict[str, object]
) -> None:
    there = _store.identity_of(target) or {}
    layout = Layout(tuple(there["shape"]), tuple(there["chunk"]))
    fill.same(target, specification, planning.identity(specification, planned, layout, **more))


def _joined(
    target: Place,
    specification: Specification,
    grid: Lattice,
    points: np.ndarray,
    results: list[dict[str, np.ndarray]],
    planned: Planned,
    more: dict[str, object],
) -> Store:
    """One store of all rounds."""
    samples = samples_at(specification, grid, points)
    layout = planned.layout(samples)
    identity = planning.identity(specification, planned, layout, **more)
    attributes = _store.provenance(specification, planned.device) | {
        "complete": False,
        "adaptive": _store.as_json(
            {
                "width": more["width"],
                "refined": [axis.name for axis in check(specification)],
                "cases": [axis.name for axis in specification.axes if axis.listed is not None],
                "resolution": list(grid.shape),
                "share": len(points) / (grid.cases * grid.size),
            }
        ),
    }
    store = Store(target, layout, specification.precision, planned.tile)
    target.remove()
    progress.repair(
        target,
        _store.skeleton(specification, samples, layout, _store.as_json(identity), attributes),
    )
    whole = {name: np.concatenate([part[name] for part in results]) for name in results[0]}
    for number in range(len(layout)):
        first, count = layout.span(number)
        part = {name: values[first : first + count] for name, values in whole.items()}
        store.write(number, part, planned.tile)
    return store
