"""An identified drive over a log: what it would have done on the log's own time stamps."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxact.errors import UserError, nearest
from jaxact.identification import forces, motion
from jaxact.identification.alike import stated
from jaxact.identification.identify import Source, logs_of, prepared
from jaxact.identification.links import constant_forces, joint_of, levelled, with_links
from jaxact.identification.log import LINKS, Log
from jaxact.identification.model import Family, predicted
from jaxact.identification.motion import Simulate
from jaxact.identification.reading import ColumnMap, Columns, read, read_columns
from jaxact.identification.supply import USUAL
from jaxact.loops import drives
from jaxact.loops import given as _given
from jaxact.loops.drives import ROBOT, IdentifiedDrive
from jaxact.parameters import (
    DELAY,
    FORCE_LIMIT,
    GAIN_SCALE,
    JOINT_DAMPING,
    KD,
    KP,
    MASS,
    SETPOINT,
    WN,
    ZETA,
)
from jaxact.robots.model import read as read_robot
from jaxact.robots.mounting import FIXED

# Parameters of a loop -> numbers of a drive's model that they replace in a replay.
_CHANGED = {
    WN: WN, ZETA: ZETA, DELAY: DELAY, FORCE_LIMIT: FORCE_LIMIT, MASS: "inertia",
    JOINT_DAMPING: "viscous",
}  # fmt: skip
# What a drive whose force was measured has not: the log's command moves it.
_OF_MOTION = (MASS, JOINT_DAMPING, KP, KD)
# Forces, and the inertia, which mean nothing to a drive that is known per unit of it.
_PER_INERTIA = (*_OF_MOTION, FORCE_LIMIT)
# Details of a log that say what its joint moves.
_OF_THE_JOINT = ("inertia", MASS, "length")


@dataclass(frozen=True, eq=False)
class Replay:
    """What a drive makes of a log; printed, the errors.

    Attributes:
        drive: name of its file.
        log: that is replayed, as it was prepared: what was done to it is in its notes.
        stimulus, measured, simulated: shape (rows,); what moved it is in the unit of its signal.
        driven_by: name of the stimulus, "setpoint" or "command".
        signal, unit: what is measured and simulated, "position" or "force", and in which unit.
    """

    drive: str
    log: Log
    stimulus: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    driven_by: str
    signal: str
    unit: str

    @property
    def rest(self) -> np.ndarray:
        """Measured minus simulated, shape (rows,)."""
        return self.measured - self.simulated

    @property
    def rms(self) -> float:
        """Root of the mean square of the rest, in `unit`."""
        return float(np.sqrt(np.mean(np.square(self.rest))))

    @property
    def largest(self) -> float:
        """Largest absolute rest, in `unit`."""
        return float(np.max(np.abs(self.rest)))

    @property
    def nrmse(self) -> float:
        """`rms` over the standard deviation of what was measured [-]."""
        return self.rms / max(float(np.std(self.measured)), 1e-300)

    def document(self) -> dict[str, Any]:
        """Names and errors as plain words and numbers."""
        return {
            "drive": self.drive, "log": self.log.title, "rows": len(self.log),
            "duration": self.log.duration, "driven_by": self.driven_by, "signal": self.signal,
            "unit": self.unit, "rms": self.rms, "max": self.largest, "nrmse": self.nrmse,
            "notes": list(self.log.notes),
        }  # fmt: skip

    def columns(self) -> dict[str, np.ndarray]:
        """Time [s] and signals by name and unit, shape (rows,) each."""
        moved = self.log.unit if self.driven_by == SETPOINT else self._force_unit
        return {
            "time [s]": self.log.time,
            f"{self.driven_by} [{moved}]": self.stimulus,
            f"measured {self.signal} [{self.unit}]": self.measured,
            f"simulated {self.signal} [{self.unit}]": self.simulated,
            f"residual [{self.unit}]": self.rest,
        }

    @property
    def _force_unit(self) -> str:
        return "N m" if self.log.unit == "rad" else "N"

    def __str__(self) -> str:
        """What was done to the log, and the errors, a line each."""
        unit = self.unit
        return "\n".join([
            f"{self.log.title} by {self.drive}: {self.signal} for the log's {self.driven_by},"
            f" {len(self.log):,} rows, {self.log.duration:.3g} s",
            *(f"  {note}" for note in self.log.notes),
            f"rms error    {self.rms:.4g} {unit}",
            f"largest      {self.largest:.4g} {unit}",
            f"rms error    {100.0 * self.nrmse:.3g} % of the standard deviation",
        ])  # fmt: skip


def replay(
    drive: Any,
    log: Source,
    *,
    columns: ColumnMap | Mapping[str, Columns] | str | os.PathLike[str] | None = None,
    joint: str = "",
    model: str | os.PathLike[str] | None = None,
    **changes: Any,
) -> Replay:
    """Simulate an identified drive on a log's own time stamps, over what was measured.

        print(jaxact.replay("drive.toml", "log.csv", columns="map.toml"))

    A drive whose force was measured is given the log's command; one that moves a joint the log's
    setpoint, under the gains of the map (or else those that its command is made of, or of the
    drive's own log), or else its command. The log is prepared as `jaxact.identify` does it: cut
    where time is missing, say. Where a joint begins, its first position and velocity, is fitted to
    each of its parts, and nothing else.

    Args:
        drive: a file of `jaxact identify`, or what `jaxact.identify` gave.
        log: file (CSV or NPZ) or `Log` of one joint.
        columns: what the columns are, as for `jaxact.identify`.
        joint: of several in the file.
        model: of a robot on whose joints the drives were identified, its MJCF or URDF file; the log
            is then one of its joints together.
        changes: other numbers than the drive's: wn [rad/s], zeta, delay [s], force_limit [N or
            N m], mass [kg or kg m^2], joint_damping, or `actuator`; kp and kd of the controller.

    Returns:
        Measured and simulated, and the errors.

    Raises:
        UserError: a log or drive that cannot be read, or that do not fit each other.
    """
    known = drives.taken(drive)
    if isinstance(columns, str | os.PathLike):
        columns = read_columns(Path(columns))
    if known.plant == ROBOT:
        known, own = _of_robot(known, log, columns, joint, model)
    elif model is not None:
        raise UserError(f"`model`: {known.name} is the drive of a single joint; leave it out")
    else:
        (own,) = logs_of(log, columns, joint)
    if own.unit != known.unit:
        raise UserError(f"{own.title}: is in {own.unit}, and {known.name} in {known.unit}")
    asked = _given.read(changes, robot=False)
    of_links: tuple[str, ...] = (MASS,) if LINKS[0] in own else ()
    not_here = {"none": _OF_MOTION}.get(known.plant, of_links)
    not_here = _PER_INERTIA if known.per_inertia else not_here
    possible = [name for name in (*_CHANGED, KP, KD) if name not in not_here]
    for name in asked:
        if name not in possible:
            raise UserError(f"`{name}`: changes nothing in this replay; {nearest(name, possible)}")
    parts = prepared([own], moves=known.plant != "none")
    return _joined(own, [_replayed(known, _with_gains(known, part, asked), asked)
                         for part in parts])  # fmt: skip


def _replayed(drive: IdentifiedDrive, log: Log, asked: Mapping[str, Any]) -> Replay:
    """What a drive makes of a log in which no time is missing."""
    with jax.enable_x64(True):
        family, numbers = _model(drive, log, asked)
        simulated = predicted(family, log, numbers)
        stimulus, measured = family.stimulus(log), family.measured(log)
    closed = family.signal == "position" and stimulus is log.signals.get(SETPOINT)
    return Replay(
        drive.name, log, stimulus, measured, simulated, SETPOINT if closed else "command",
        family.signal, family.unit,
    )  # fmt: skip


def _joined(log: Log, parts: Sequence[Replay]) -> Replay:
    """The replays of a log's parts, between which time is missing, one after the other."""
    first = parts[0]
    if len(parts) == 1:
        return first
    own = [part.log for part in parts]
    rows = "; ".join(f"{one.row} to {one.row + len(one) - 1}" for one in own)
    notes = dict.fromkeys(note for one in own for note in one.notes)
    whole = replace(
        first.log,
        name=log.name,
        time=np.concatenate([one.time for one in own]),
        signals={name: np.concatenate([one[name] for one in own]) for name in first.log.signals},
        notes=(f"time is missing: its rows {rows} are replayed each by themselves", *notes),
    )
    stimulus, measured, simulated = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("stimulus", "measured", "simulated")
    )
    return replace(first, log=whole, stimulus=stimulus, measured=measured, simulated=simulated)


def _of_robot(
    drive: IdentifiedDrive,
    log: Source,
    columns: ColumnMap | Mapping[str, Columns] | None,
    joint: str,
    model: str | os.PathLike[str] | None,
) -> tuple[IdentifiedDrive, Log]:
    """The drive of one joint of a robot, and that joint's log with what the links do to it."""
    parts = drive.document["joints"].values()
    names = [name for part in parts for name in part["joints"]]
    if model is None or isinstance(log, Log):
        raise UserError(
            f"{drive.name}: has the drives of a robot's joints; give its `model`, and a file"
        )
    if not joint:
        raise UserError(f"{drive.name}: has several drives; choose a `joint`: {', '.join(names)}")
    robot = read_robot(Path(model), base=FIXED)
    chosen = joint_of(robot, joint)
    own = next((part for part in parts if chosen.name in part["joints"]), None)
    recorded = [one for one in with_links(read(Path(log), columns), robot)
                if joint_of(robot, one.joint) == chosen]  # fmt: skip
    if own is None or not recorded:
        where = drive.name if own is None else Path(log).name
        raise UserError(f"joint {chosen.name}: is not in {where}")
    if len(own["joints"]) > 1:
        recorded = levelled(recorded, constant_forces(recorded))
    return drives.of_document(drive.name, own), recorded[0]


def _with_gains(drive: IdentifiedDrive, log: Log, asked: Mapping[str, Any]) -> Log:
    """The log with the controller's gains, and with the supply that the drive was used to."""
    usual = drive.document.get(USUAL)
    details = {**log.details, **({} if usual is None else {USUAL: float(usual)})}
    if drive.per_inertia:  # a load in kg m^2 says nothing then
        details = {name: value for name, value in details.items() if name not in _OF_THE_JOINT}
    log = replace(log, details=details)
    if drive.plant == "none":
        return log
    if KP in drive.numbers:  # the log of the drive had no force either
        signals = {name: rows for name, rows in log.signals.items() if name != "command"}
        return replace(_differencing(drive, log), gains=(None, None), signals=signals)
    kp, kd = log.gains
    if kp is None and KP in drive.joint and SETPOINT in log:
        gain = abs(drive.numbers.get("gain", 1.0)) / drive.joint.get(GAIN_SCALE, 1.0)
        kp, kd = drive.joint[KP] / gain, drive.joint.get(KD, 0.0) / gain
        log = _differencing(drive, log)
    kp, kd = asked.get(KP, kp), asked.get(KD, kd)
    if kp is None and "command" not in log:
        raise UserError(
            f"{log.title}: the gains are not known and there is no command; give `kp` and `kd`, or"
            " state them in the map"
        )
    return replace(log, gains=(kp, kd))


def _differencing(drive: IdentifiedDrive, log: Log) -> Log:
    """A log under the drive's own controller, which saw the velocity as where it was identified."""
    own = int(drive.document.get(drives.DIFFERENCE_TICKS, 0))
    return replace(log, difference_ticks=log.difference_ticks or own)


def _model(
    drive: IdentifiedDrive, log: Log, asked: Mapping[str, Any]
) -> tuple[Family, dict[str, float]]:
    """The model of the drive for this log, and its numbers."""
    if drive.plant == "none":
        family = forces.family([log])
    else:
        family = motion.family([log], drive.plant, drive.document.get("control_rate"))
    replaced = {**_CHANGED, **({KP: KP, KD: KD} if KP in drive.numbers else {})}
    changed = {replaced[name]: value for name, value in asked.items() if name in replaced}
    # What the log states of its joint, another load say, is of this recording.
    own_load = stated(log, drive.plant == "pendulum").items()
    said = {name: value for name, value in own_load if name in family.neutral}
    own = {name: value for name, value in drive.numbers.items() if name in family.neutral}
    numbers = {**family.neutral, **own, **said, **changed}
    if isinstance(family.simulate, Simulate):
        structure = family.simulate.structure
        ticks, _ = motion.cut(log, drive.document.get("control_rate"))
        shortest = float(np.min(np.diff(log.time))) / ticks
        longest = max(structure.history, math.ceil(numbers[DELAY] / shortest) + 2)
        longer = replace(family.simulate, structure=replace(structure, history=longest))
        family = replace(family, simulate=longer)
    return family, numbers
