"""What the report of an identification has: logs over their simulation, the ladder, intervals."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxact.identification import knowledge
from jaxact.identification import report as words
from jaxact.identification.inspection import Inspection
from jaxact.identification.log import Log
from jaxact.identification.model import predicted
from jaxact.identification.result import Identified
from jaxact.identification.robot import IdentifiedRobot
from jaxact.identification.verdict import Level
from jaxact.loops import toml
from jaxact.loops.building import joint
from jaxact.loops.drives import ROBOT, IdentifiedDrive, load_drive
from jaxact.parameters import DELAY, KD, KP, WN, ZETA
from jaxact.plotting import identification as pictures
from jaxact.reports.page import Content
from jaxact.simulation.thinning import thinned
from jaxact.verbs import report_joint

# Rows of all logs together, some 25 bytes each; a log's are thinned out to its share.
MOST_ROWS = 16_000
_DIGITS = 6
OF_THE_DRIVE = (DELAY, "lag", WN, ZETA)
"""Names of the unknowns that are the drive's dynamics."""
_NOT_THERE = (
    "The logs are not in the drive's file: jaxact identify ... --report FILE has them over the"
    " simulation, with the frequency response and the profile likelihoods."
)
_NO_LOOP = (
    "There is no map of the gains, as {why}: jaxact report --drive FILE with --kp, --kd and"
    " --mass or --inertia has one."
)
# What the page has of every model that was compared.
_IN_LADDER = ("name", "unknowns", "error", "score", "identified", "chosen")


def content(found: Identified | IdentifiedRobot) -> Content:
    """The page of an identification.

    Args:
        found: by `jaxact.identify`.
    """
    if isinstance(found, IdentifiedRobot):
        share = MOST_ROWS // len(found.parts)
        each = [_drive(part.name, part.found, share, OF_THE_DRIVE) for part in found.parts]
        return _content(found.document(), each, found.drive)
    return _content(found.document(), [_drive("", found, MOST_ROWS)], found.drive)


def of_file(path: Path) -> Content:
    """The page of a drive that `jaxact identify` wrote, without its logs.

    Args:
        path: of the TOML file.

    Raises:
        UserError: it cannot be read, or is not such a file.
    """
    drive = load_drive(path)
    document = drive.document
    joints = document.get("joints", {}) if drive.plant == ROBOT else {"": document}
    each = [_read(name, own) | {"notes": [_NOT_THERE]} for name, own in joints.items()]
    return _content(document, each, drive)


def _content(
    document: Mapping[str, Any], each: list[dict[str, Any]], drive: IdentifiedDrive
) -> Content:
    """The page of drives as the page needs them, and of the loop of a single joint."""
    verdict = document["verdict"]
    parts: dict[str, Any] = {"identified": {"drives": each}}
    values = drive.joint
    if drive.plant == "none":
        why = "no joint moved"
    elif drive.plant == ROBOT:
        why = "the drives are those of a robot's joints"
    elif verdict["level"] == Level.NOT_ENOUGH.value:
        why = "the model does not explain the logs well enough"
    elif not (values.get(KP, 0.0) > 0.0 and values.get(KD, 0.0) > 0.0):
        why = "the gains behind the logs are not known"
    else:
        why = ""
        parts |= report_joint.of_subject(report_joint.Subject(joint(drive=drive))).parts
    if why and drive.plant != ROBOT:
        each[0]["notes"] = [*each[0]["notes"], _NO_LOOP.format(why=why)]
    return Content(
        title=f"Identified: {verdict['level']}",
        # Of a single drive it stands at the top of the page anyway.
        description=verdict["sentence"] if len(each) > 1 else "",
        parts=parts,
        made={"The drive, as its file has it": toml.dumps(document)},
    )


def _read(name: str, document: Mapping[str, Any]) -> dict[str, Any]:
    """What a drive's file says of it."""
    estimates = document.get("estimates", {})
    known = document.get("covariance", {"names": [], "rows": []})
    rows = np.array(known["rows"], float).reshape((len(known["names"]),) * 2)
    size = np.sqrt(np.maximum(np.diag(rows), 1e-300))
    # A time constant is reported of a frequency that is sought, and falls where that rises.
    reported = {one.get("number", own): own for own, one in estimates.items()}
    names = [reported.get(own, own) for own in known["names"]]
    signs = [
        1.0 if own == sought else -1.0 for own, sought in zip(names, known["names"], strict=True)
    ]
    correlation = rows / np.outer(size, size) * np.outer(signs, signs)
    return {
        "name": name,
        "model": document.get("model", ""),
        "level": document["verdict"]["level"],
        "sentence": document["verdict"]["sentence"],
        "estimates": [_estimate(own, one) for own, one in estimates.items()],
        "correlation": {"names": names, "rows": correlation.tolist()},
        "ladder": [{key: one[key] for key in _IN_LADDER} for one in document.get("ladder", [])],
        "signal": document.get("signal", ""),
        "error_unit": document.get("signal_unit", ""),
        "logs": [],
        "profiles": [],
        "response": None,
        "autocorrelation": None,
        "notes": [],
    }


def _estimate(name: str, one: Mapping[str, Any]) -> dict[str, Any]:
    """A number of the model with its interval, times in milliseconds."""
    factor, unit = (1e3, "ms") if one["unit"] == "s" else (1.0, one["unit"])
    ends = {end: factor * one[end] for end in ("value", "low", "high")}
    return {"name": name, **one, **ends, "unit": unit}


def _drive(
    name: str, found: Identified, rows: int, profiled: Collection[str] | None = None
) -> dict[str, Any]:
    """All that was found of one drive, with its logs thinned out to so many rows together.

    Profile likelihoods, each of them some fits, of all numbers, or of those that are named.
    """
    ladder, chosen = found.ladder, found.chosen
    logs = [*ladder.fitted, *ladder.validation]
    roles = ["fitted"] * len(ladder.fitted) + ["not fitted"] * len(ladder.validation)
    each = [
        _log(found, log, role, about, rows // len(logs))
        for log, role, about in zip(logs, roles, found.inspections, strict=True)
    ]
    unseen = compared(found)
    response = pictures.response(unseen)
    said = [*words.combined(found.ladder), *words.left_out(found), *words.unstable_delay(found)]
    return _read(name, found.document()) | {
        "logs": each,
        "profiles": [
            _profile(found, one.name)
            for one in chosen.knowledge.estimates
            if profiled is None or one.name in profiled
        ],
        "response": None if response is None else _rounded(dataclasses.asdict(response)),
        "autocorrelation": _rounded(pictures.correlations(unseen)),
        "notes": [*said, *words.alignment(chosen, logs[0])],
    }


def compared(found: Identified, log: int = 0) -> pictures.Compared:
    """One validation log and what the chosen model makes of it."""
    chosen = found.ladder.validation[log]
    return _over(found, chosen, f"{chosen.title}, which was not fitted")


def _over(found: Identified, log: Log, title: str) -> pictures.Compared:
    family = found.ladder.family
    return pictures.Compared(
        title=title,
        time=log.time,
        stimulus=family.stimulus(log),
        measured=family.measured(log),
        simulated=predicted(family, log, found.chosen.numbers),
        signal=family.signal,
        unit=family.unit,
    )


def _log(found: Identified, log: Log, role: str, about: Inspection, rows: int) -> dict[str, Any]:
    whole = _over(found, log, log.title)
    kept = thinned(whole.measured, whole.rest, rows)
    start, rest = float(log.time[0]), whole.rest
    return {
        "title": log.title,
        "role": role,
        "says": [words.summary(log, about), *words.notes(log, about)],
        "rows": len(log),
        "rms": float(np.sqrt(np.mean(rest**2))),
        "largest": float(np.abs(rest).max()),
        **_rounded({"time": (whole.time - start)[kept], "measured": whole.measured[kept],
                    "simulated": whole.simulated[kept]}),
    }  # fmt: skip


def _profile(found: Identified, name: str) -> dict[str, Any]:
    """How well the other unknowns make up for each value of one."""
    chosen = found.chosen
    drawn = knowledge.profile(chosen.fit, chosen.knowledge[name])
    factor = 1e3 if drawn.estimate.unit == "s" else 1.0
    return {"name": name, **_rounded({"values": factor * drawn.values, "rises": drawn.rises})}


def _rounded(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays as lists of numbers with the digits that a picture can show."""
    return {
        name: [float(f"{x:.{_DIGITS}g}") for x in np.asarray(array, float).tolist()]
        if np.ndim(array)
        else array
        for name, array in arrays.items()
    }
