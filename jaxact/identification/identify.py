"""Logs in, an identified drive out."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import jax
import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.identification import between_rows, forces, inspection, motion, rivals, unrefuted
from jaxact.identification.alignment import aligned
from jaxact.identification.alike import demand_alike
from jaxact.identification.fitting import ADAM, LEAST_SQUARES, METHODS
from jaxact.identification.ladder import Ladder, climb, too_long
from jaxact.identification.log import Log, check, renewed, stretches
from jaxact.identification.model import LONG_DELAYS
from jaxact.identification.reading import ColumnMap, Columns, read, read_columns
from jaxact.identification.result import Identified, check_gains, inspected
from jaxact.identification.verdict import judge, withdrawn
from jaxact.parameters import FEEDFORWARD, SETPOINT

# Gains that explain so much of a command are those of its controller.
_ALL_OF_IT = 0.9999
# What a difference leaves unexplained of it, at most of what another velocity does.
_SURELY = 0.1

PLANTS = ("none", *motion.PLANTS)
LOSSES = ("linear", "soft_l1", "huber")

Source = Log | str | os.PathLike[str]


def identify(
    logs: Source | Sequence[Source],
    plant: str = "none",
    *,
    validate: Source | Sequence[Source] = (),
    columns: ColumnMap | Mapping[str, Columns] | str | os.PathLike[str] | None = None,
    joint: str = "",
    control_rate: float | None = None,
    loss: str = "linear",
    method: str = LEAST_SQUARES,
    bootstrap: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Identified:
    """Find the drive behind logs of one joint, see `jaxact.identify`.

    Args:
        logs: to fit; files (CSV or NPZ) or `Log`s of one joint.
        plant: what the drive moves: "none" where its force was measured, "mass" or "pendulum".
        validate: logs to try the models on; without them the last 30 % of each log.
        columns: what the columns are: a TOML file, or from `read_columns`.
        joint: of several in a file.
        control_rate: at which the drive's own controller runs [Hz]; None for once a row.
        loss: of the least squares; "soft_l1" and "huber" bear outliers.
        method: "trf", least squares on all logs at once; "adam" on a few at a time, for dozens,
            where one step with all of them takes long. It ends near the least squares, not at it.
        bootstrap: intervals by resampling blocks instead of the kernel's estimate.
        progress: is told each model's name as its turn comes.

    Returns:
        The identified drive.

    Raises:
        UserError: logs that cannot be read or used, or that lack what the plant needs.
    """
    if plant not in PLANTS:
        raise UserError(f"plant = {shown(plant)}; {nearest(plant, PLANTS)}")
    if loss not in LOSSES:
        raise UserError(f"loss = {shown(loss)}; {nearest(loss, LOSSES)}")
    if method not in METHODS:
        raise UserError(f"method = {shown(method)}; {nearest(method, METHODS)}")
    if method == ADAM and loss != "linear":
        raise UserError("`loss` is of the least squares; leave it out, or `method`")
    if control_rate is not None and not 0.1 <= control_rate <= 1e5:
        raise UserError(
            f"`control_rate` = {control_rate:g} is out of range; allowed: 0.1 to 1e5 Hz"
        )
    if isinstance(columns, str | os.PathLike):
        columns = read_columns(Path(columns))
    fitted, held = (
        prepared(logs_of(each, columns, joint), moves=plant != "none") for each in (logs, validate)
    )
    if not fitted:
        raise UserError("`logs` is empty; give at least one log")
    check_gains((*fitted, *held))
    way = {"loss": loss, "method": method, "bootstrap": bootstrap, "report": progress}
    with jax.enable_x64(True):
        ladder = _climbed(plant, control_rate, fitted, held, way)
        if plant != "none":
            ladder = between_rows.doubted(ladder, plant, control_rate)
        verdict = judge(ladder)
        ladder = rivals.heard(ladder)
        if method == LEAST_SQUARES:
            ladder = unrefuted.allowed(ladder, loss=loss)
        ladder = withdrawn(ladder, verdict)
        return Identified(plant, ladder, inspected(ladder), verdict, control_rate)


def _climbed(
    plant: str,
    control_rate: float | None,
    fitted: Sequence[Log],
    held: Sequence[Log],
    way: Mapping[str, Any],
) -> Ladder:
    """The ladder, anew with longer delays where those of its best models end at the longest."""

    def to(longest: float) -> Ladder:
        if plant == "none":
            forces.demand(held)
            return climb(forces.family(fitted, longest=longest), fitted, held, **way)
        family = motion.family(fitted, plant, control_rate, longest=longest)
        simulate = cast(motion.Simulate, family.simulate)
        demand_alike((*fitted, *held), simulate.structure, simulate.sought_gains)
        _demand_motion(fitted)
        return climb(family, fitted, held, **way)

    ladder = to(LONG_DELAYS[0])
    for longest in LONG_DELAYS[1:]:
        ended = too_long(ladder)
        if ended is None:
            break
        # Slow logs, and short ones, have a range of their own.
        if ended.value < 0.9 * longest:
            ladder = to(longest)
    return ladder


def prepared(logs: Sequence[Log], *, moves: bool = True) -> list[Log]:
    """Logs as they are fitted, or replayed: what was done to them is in their notes.

    They are cut where time is missing, and what was measured less often is interpolated; columns
    that their controller shows to be some rows apart are brought together; and of a joint that
    moves gains that the map does not state are taken from the command.

    Args:
        logs: as they are read.
        moves: their position is looked at, not their force alone.

    Raises:
        UserError: of a log nothing is left.
    """
    found = [aligned(renewed(part), moves=moves) for log in logs for part in stretches(log)]
    return [with_gains(log) for log in found] if moves else found


def _demand_motion(logs: Sequence[Log]) -> None:
    for log in logs:
        if np.ptp(log["position"]) == 0.0:
            raise UserError(
                f"{log.title}: the joint does not move; give a log in which it does, or plant = "
                '"none" for its force alone'
            )


def with_gains(log: Log) -> Log:
    """A log whose map states no gains, with those that its command is made of, if it is.

    Under the controller a joint stays near its log; under commands alone it drifts away.
    """
    if log.gains[0] is not None:
        return _differenced(log)
    found = inspection.recomputed(log)
    if found is None or found.explained < _ALL_OF_IT or found.kp <= 0.0:
        return log
    if abs(found.offset) > 0.01 * np.std(log["command"]) or FEEDFORWARD in log:
        return log
    note = f"kp {found.kp:.4g} and kd {found.kd:.4g} are taken from the command"
    return replace(
        log,
        gains=(found.kp, found.kd),
        # The differences that the gains were just found with.
        difference_ticks=log.difference_ticks or (0 if "velocity" in log else 1),
        notes=(*log.notes, note),
    )


def _differenced(log: Log) -> Log:
    """A log whose map states gains, with the difference that its command shows them to act on.

    A velocity that is differenced over a row is half a row late: damping that acts on it lessens
    the inertia that the joint seems to have.
    """
    kp, kd = log.gains
    shown_by = {"command", SETPOINT} <= set(log.signals)
    if log.difference_ticks or kp is None or not kd or not shown_by:
        return log
    late = replace(log, difference_ticks=1)
    left = 1.0 - inspection.explained_by(late, kp, kd)
    between = np.gradient(log["position"], log.time)
    seen = log if "velocity" in log else replace(log, signals={**log.signals, "velocity": between})
    if left > 1.0 - _ALL_OF_IT or left > _SURELY * (1.0 - inspection.explained_by(seen, kp, kd)):
        return log
    note = "its controller differences the position over a row, as its command shows"
    return replace(late, notes=(*log.notes, note))


def logs_of(
    given: Source | Sequence[Source],
    columns: ColumnMap | Mapping[str, Columns] | None,
    joint: str,
) -> list[Log]:
    """Logs of one joint each, read where they are files.

    Args:
        given: one, or several.
        columns: what the columns are.
        joint: of several in a file.

    Raises:
        UserError: a log cannot be used, or has several joints and none is chosen.
    """
    each = [given] if isinstance(given, Log | str | os.PathLike) else list(given)
    found: list[Log] = []
    for one in each:
        if isinstance(one, Log):
            check(one)
            found.append(one)
            continue
        own = read(Path(one), columns, (joint,) if joint else ())
        if len(own) > 1:
            names = ", ".join(log.joint for log in own[:8])
            raise UserError(f"{one}: has several joints ({names}); choose one with `joint`")
        found += own
    return found
