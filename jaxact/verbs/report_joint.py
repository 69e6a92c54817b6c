"""What the report of a joint has: its loops, its map's ranges, the gains that are marked."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.errors import UserError
from jaxact.loops import listed, reading
from jaxact.loops.axes import NO_AXIS
from jaxact.loops.building import loop_of
from jaxact.loops.control_loop import ControlLoop
from jaxact.loops.specification import Specification
from jaxact.parameters import CONTROL_RATE, GAIN_SCALE, KD, KP, LINEAR, SETPOINT_DELAY
from jaxact.reports.page import Content
from jaxact.sweeping import variables
from jaxact.verbs import naming, report_specification, report_sweep
from jaxact.verbs.margins import BothMargins, LoopMargins

if TYPE_CHECKING:
    import xarray as xr

# A window where no sweep has one: so far around the gains, to either side.
_AROUND = 30.0
_MOST_LOOPS = 200
ROBOT = "these are results of a robot; report its model, its specification or its margins instead"
OF_LOOP = (*LINEAR, SETPOINT_DELAY, CONTROL_RATE)

Window = tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Subject:
    """What a report is of.

    Attributes:
        loop: the joint's loops to choose from.
        title: above the page.
        specification: that described them, as text.
        window: ranges of kp and kd of the map, none for those around the gains.
        points: gains to mark, by name.
        simulated: it is of a sweep, whose loops are sampled; else those with a control rate are.
        cells: what was simulated over kp and kd without their common factor, None for nothing.
    """

    loop: ControlLoop
    title: str = ""
    specification: str = ""
    window: Mapping[str, Window] = dataclasses.field(default_factory=dict)
    points: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    simulated: bool = False
    cells: Mapping[str, Any] | None = None


def content(subject: Any) -> Content:
    """The page of whatever a joint's report can be of.

    Args:
        subject: as for `jaxact.report`.

    Raises:
        UserError: a robot, too many loops, or something else.
    """
    return of_subject(_subject(subject))


def of_subject(found: Subject) -> Content:
    """The page of these loops.

    Raises:
        UserError: a robot, too many loops, or gains that have no logarithm.
    """
    if found.loop.kind.plant is not None:
        raise UserError(ROBOT)
    if np.prod(found.loop.shape, initial=1) > _MOST_LOOPS:
        raise UserError(f"a report is of at most {_MOST_LOOPS} loops; vary less, or select some")
    named = naming.named(found.loop)
    rows = [
        {"name": label, "parameters": _parameters(named.one(index), found.loop.kind.velocity)}
        for index, label in enumerate(named.labels)
    ]
    if any(row["parameters"][KP] <= 0.0 or row["parameters"][KD] <= 0.0 for row in rows):
        raise UserError("`kp` and `kd`: a report is over their logarithms; give positive ones")
    gains = [(row["parameters"][KP], row["parameters"][KD]) for row in rows]
    points = dict(found.points) or {"nominal": gains[0]}
    both = np.array([*gains, *points.values()])
    window = found.window or {
        name: (float(column.min()) / _AROUND, float(column.max()) * _AROUND)
        for name, column in zip((KP, KD), both.T, strict=True)
    }
    data = {
        "loops": rows,
        "start": 0,
        "sampled": found.simulated or CONTROL_RATE in found.loop.values,
        "unit": found.loop.kind.unit,
        "window": {name: list(ends) for name, ends in window.items()},
        "points": [{"name": name, KP: kp, KD: kd} for name, (kp, kd) in points.items()],
        "cells": found.cells and {**found.cells, "scale": named.values[GAIN_SCALE].tolist()},
    }
    return Content(
        title=found.title
        or f"Joint: {named.labels[0] if len(rows) == 1 else f'{len(rows)} loops'}",
        description=naming.in_common(found.loop),
        parts={"joint": data},
        made={"Specification": found.specification} if found.specification else {},
    )


def _parameters(values: Mapping[str, float], velocity: str) -> dict[str, Any]:
    """What the page needs of a loop, by short name; gains with their common factor."""
    scale = values[GAIN_SCALE]
    own: dict[str, Any] = {name: values[name] for name in OF_LOOP}
    return own | {KP: scale * values[KP], KD: scale * values[KD], "velocity": velocity}


def _subject(subject: Any) -> Subject:
    """The loops of whatever a report can be of."""
    if isinstance(subject, ControlLoop):
        return Subject(subject)
    if isinstance(subject, LoopMargins | BothMargins):
        return Subject(subject.loop)
    if hasattr(subject, "data_vars"):  # a dataset, whose package is slow to import
        return _of_sweep(subject)
    if isinstance(subject, str | os.PathLike):
        path = Path(subject)
        if path.suffix.lower() in (".xml", ".urdf"):
            raise UserError(ROBOT)
        if path.suffix != ".toml":
            return _of_sweep(_opened(subject))
        if listed.rows(path) is not None:
            return Subject(loop_of(path), specification=path.read_text(encoding="utf-8-sig"))
        return _of_specification(*report_specification.load(path))
    raise UserError(f"a report cannot be of a {type(subject).__name__}; give a loop or a result")


def _opened(where: str | os.PathLike[str]) -> xr.Dataset:
    """The sweep that a path means, which nothing else that a report is of was."""
    from jaxact.sweeping import opening

    try:
        opening.find(os.fspath(where))
    except UserError as error:
        if error.__cause__ is not None:  # it cannot be read, whatever it is
            raise
        raise UserError(
            f"{error}, the folder of a tuning, an identified drive, a robot's model, or a TOML file"
        ) from None
    return opening.open_result(where, unfinished=True)


def _of_sweep(results: xr.Dataset) -> Subject:
    text = results.attrs.get("specification_toml")
    if text is None:
        raise UserError("these results are not of a sweep: they do not say how they were made")
    whole = reading.parse(text)
    if "verdict" not in results:
        return _of_specification(whole, whole.text)
    own = report_sweep.own(whole, results)
    # Of margins the verdicts are those of the exact boundary, and nothing was simulated.
    simulated = variables.KIND not in results.attrs
    found = dataclasses.replace(_of_specification(own, whole.text), simulated=simulated)
    there = simulated and found.window
    return dataclasses.replace(found, cells=report_sweep.cells(own, results) if there else None)


def _of_specification(specification: Specification, text: str) -> Subject:
    """The loops beside the gains that are swept, whose ranges are the map's.

    Gains are those at the joint, with their common factor.

    Args:
        text: of the specification, as it is shown.
    """
    nominal, axes = specification.nominal, specification.axes
    scaling = [axis.ends for axis in axes if axis.name == GAIN_SCALE]
    low, high = scaling[0] if scaling else (nominal[GAIN_SCALE],) * 2
    ends = {axis.name: axis.ends for axis in axes if axis.name in (KP, KD)}
    window = {name: (low * least, high * most) for name, (least, most) in ends.items()}
    if any(low <= 0.0 or low >= high for low, high in window.values()) or len(window) < 2:
        window = {}
    others = tuple(axis for axis in axes if axis.name not in (KP, KD) and not axis.sampled)
    alone = dataclasses.replace(specification, axes=others or (NO_AXIS,), sampling=None)
    scale = float(nominal[GAIN_SCALE])
    points = {"nominal": (scale * float(nominal[KP]), scale * float(nominal[KD]))}
    sweep = axes != (NO_AXIS,)
    return Subject(loop_of(alone), specification.description, text, window, points, simulated=sweep)
