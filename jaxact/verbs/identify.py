"""Identifying a drive from logs, and drawing what came out."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib import pyplot
from matplotlib.axes import Axes

from jaxact.errors import UserError, nearest, shown
from jaxact.identification import identify as _joints
from jaxact.identification import knowledge
from jaxact.identification.fitting import LEAST_SQUARES
from jaxact.identification.identify import Source
from jaxact.identification.log import Log
from jaxact.identification.reading import ColumnMap, Columns, read_columns
from jaxact.identification.replay import Replay, replay
from jaxact.identification.result import Identified
from jaxact.identification.robot import SUFFIXES, IdentifiedRobot, identify_robot
from jaxact.parameters import CONTROL_RATE, DELAY
from jaxact.plotting import identification as _pictures
from jaxact.plotting.identification import Compared, Step
from jaxact.verbs import notebook
from jaxact.verbs.given_axes import on_axes
from jaxact.verbs.report_identified import OF_THE_DRIVE, compared

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "identification_sheet", "identify", "profile_likelihood", "replay", "replay_sheet",
    "residual_autocorrelation", "robot_sheet",
]  # fmt: skip
# How results look is not their own layer's to know.
Identified._repr_html_ = notebook.identified  # type: ignore[attr-defined]
IdentifiedRobot._repr_html_ = notebook.identified_robot  # type: ignore[attr-defined]


def identify(
    logs: Source | Sequence[Source],
    plant: str | os.PathLike[str] = "none",
    *,
    validate: Source | Sequence[Source] = (),
    columns: ColumnMap | Mapping[str, Columns] | str | os.PathLike[str] | None = None,
    joint: str = "",
    groups: Sequence[str] = (),
    control_rate: float | None = None,
    loss: str = "linear",
    method: str = LEAST_SQUARES,
    bootstrap: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Any:
    """Find the drive behind logs: its dynamics, delay, friction, and how well each is known.

        found = jaxact.identify("log.csv", "pendulum", validate="other.csv", columns="map.toml")
        print(found)
        jaxact.margins(found.loop)

    A ladder of models is fitted by least squares on the logs' own time stamps, and each is tried
    on logs it has not seen; the simplest is chosen that is within 1 % of the best and all of whose
    numbers are identified.

    Args:
        logs: to fit; files (CSV or NPZ), or objects `Log`, of one joint; of a robot files of all
            joints.
        plant: what the drive moves: "none" where its force was measured, "mass" or "pendulum"; or
            the MJCF or URDF file of a robot, in the air or on a test bench.
        validate: logs to try the models on; without them the last 30 % of each log.
        columns: what the columns are: a TOML file, or from `read_columns`.
        joint: of several in a file.
        groups: of a robot, patterns found in the names of joints: those of one share a drive; none:
            every joint its own.
        control_rate: at which the drive's own controller runs [Hz]; None for once a row.
        loss: of the least squares; "soft_l1" and "huber" bear outliers.
        method: "trf", least squares on all logs at once; "adam" on a few at a time, for dozens,
            where one step with all of them takes long. It ends near the least squares, not at it.
        bootstrap: intervals by resampling blocks instead of the kernel's estimate.
        progress: is told each model's name as its turn comes.

    Returns:
        The identified drive, `jaxact.identification.result.Identified`; of a robot those of its
        joints, `jaxact.identification.robot.IdentifiedRobot`.

    Raises:
        UserError: logs that cannot be read or used, or that lack what the plant needs.
    """
    for name, given_logs in (("logs", logs), ("validate", validate)):
        _demand_logs(given_logs, name)
    read = read_columns(Path(columns)) if isinstance(columns, str | os.PathLike) else columns
    given: dict[str, Any] = {
        "validate": validate, "columns": read, "joint": joint, CONTROL_RATE: control_rate,
        "loss": loss, "method": method, "bootstrap": bootstrap, "progress": progress,
    }  # fmt: skip
    if Path(plant).suffix.lower() in SUFFIXES:
        return identify_robot(logs, Path(plant), groups=groups, **given)
    if groups:
        raise UserError("`groups`: are of a robot's joints; give its model file as `plant`")
    return _joints.identify(logs, str(plant), **given)


def _demand_logs(logs: Any, name: str) -> None:
    """Raise UserError for what is neither a log nor a list of them."""
    one = Log | str | os.PathLike
    several = logs if isinstance(logs, list | tuple) else [logs] * (not isinstance(logs, Iterable))
    for each in several:
        if not isinstance(each, one):
            raise UserError(
                f"`{name}`: a value of type {type(each).__name__} is not a log; give a CSV or NPZ"
                " file, or several in a list"
            )


def robot_sheet(identified: IdentifiedRobot) -> Figure:
    """Measured and simulated of every drive that was identified on a robot, one below the other."""
    drawn = [
        replace(compared(part.found), title=f"{part.name}: {part.found.chosen.rung.name}")
        for part in identified.parts
    ]
    return _pictures.joints(drawn, title=identified.robot.path.name, footer=identified.sentence)


def identification_sheet(identified: Identified, *, title: str = "", log: int = 0) -> Figure:
    """Measured and simulated, residual, frequency response, ladder and autocorrelation.

    Args:
        identified: from `jaxact.identify`.
        title: above; the verdict by default.
        log: number of the validation log that is drawn.

    Returns:
        The figure.
    """
    ladder = identified.ladder
    footer = "; ".join(log.title for log in ladder.fitted)
    # The first two of the drive's numbers that the model has.
    names = [e.name for e in ladder.chosen.knowledge.estimates if e.name in OF_THE_DRIVE]
    return _pictures.sheet(
        compared(identified, log),
        steps(identified),
        [_profile(identified, name) for name in sorted(names, key=OF_THE_DRIVE.index)[:2]],
        title=title or f"{identified.verdict.level.value}: {ladder.chosen.rung.name}",
        footer=f"{identified.verdict.sentence}. Fitted: {footer}",
    )


@on_axes
def profile_likelihood(
    identified: Identified, name: str = DELAY, *, ax: Axes | None = None
) -> Axes:
    """How well the other unknowns of the chosen model make up for each value of one.

    Args:
        identified: from `jaxact.identify`.
        name: of the unknown.
        ax: of the values and the rise of the sum of squares, 1 at the ends of a 95 % interval.
    """
    _demand(identified)
    ax = pyplot.subplots()[1] if ax is None else ax
    _pictures.profile_likelihood(ax, _profile(identified, name))
    return ax


@on_axes
def residual_autocorrelation(
    identified: Identified, *, log: int = 0, ax: Axes | None = None
) -> Axes:
    """Autocorrelation of what the chosen model leaves of a validation log, and white noise's band.

    Args:
        identified: from `jaxact.identify`.
        log: number of the validation log.
        ax: of lag and autocorrelation.
    """
    _demand(identified)
    ax = pyplot.subplots()[1] if ax is None else ax
    _pictures.autocorrelation(ax, compared(identified, log))
    return ax


def _demand(identified: Any) -> None:
    if not isinstance(identified, Identified):
        raise UserError(
            f"identified: a value of type {type(identified).__name__} is not an identified drive;"
            " give what jaxact.identify(...) returned of one joint"
        )


def _profile(identified: Identified, name: str) -> _pictures.Profile:
    chosen = identified.ladder.chosen
    names = [estimate.name for estimate in chosen.knowledge.estimates]
    if name not in names:
        raise UserError(f"{shown(name)} is not an unknown of the model; {nearest(name, names)}")
    found = knowledge.profile(chosen.fit, chosen.knowledge[name])
    one = found.estimate
    factor, unit = (1e3, "ms") if one.unit == "s" else (1.0, "" if one.unit == "1" else one.unit)
    return _pictures.Profile(
        name, unit, factor * one.value, factor * one.low, factor * one.high,
        factor * found.values, found.rises,
    )  # fmt: skip


def replay_sheet(replayed: Replay, *, title: str = "") -> Figure:
    """Measured and simulated over each other, and the residual.

    Args:
        replayed: from `jaxact.replay`.
        title: above; drive and log by default.

    Returns:
        The figure.
    """
    log = replayed.log
    drawn = Compared(
        title="", time=log.time, stimulus=replayed.stimulus, measured=replayed.measured,
        simulated=replayed.simulated, signal=replayed.signal, unit=replayed.unit,
    )  # fmt: skip
    return _pictures.replay(
        drawn,
        title=title or f"{log.title} by {replayed.drive}",
        footer=f"rms error {replayed.rms:.3g} {replayed.unit}, {100.0 * replayed.nrmse:.3g} % of"
        f" the standard deviation; largest {replayed.largest:.3g} {replayed.unit}",
    )


def steps(identified: Identified) -> list[Step]:
    """The ladder as it is drawn."""
    ladder = identified.ladder
    return [
        Step(
            name=one.rung.name,
            size=one.size,
            error=one.error,
            identified=one.knowledge.identified,
            chosen=one is ladder.chosen,
        )
        for one in ladder.candidates
    ]
