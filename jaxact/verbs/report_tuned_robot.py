"""What the report of a robot's tuned gains has: certificate, gains before and after, motions."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxact.errors import UserError
from jaxact.loops import toml
from jaxact.parameters import KD, KP
from jaxact.reports.page import Content
from jaxact.tuning.result import Tuned
from jaxact.tuning.rollouts import motion
from jaxact.verbs import report_run, tuning_front

# In a folder of `jaxact tune`.
FRONT, MOTION = "front.csv", "motion.csv"
_NO_MAP = (
    "The map over delay and gains, with all margins, needs the robot's model, which is not in the"
    " folder: jaxact report MODEL --gains gains.toml."
)


def part(document: Mapping[str, Any], front: str = "", note: str = "") -> dict[str, Any]:
    """The certificate and the gains, as the page needs them.

    Args:
        document: of the tuning, as its TOML says.
        front: its points as CSV, "" for none.
        note: what is said below the certificate.
    """
    guaranteed, before = document["guaranteed"], document.get("before", {})
    groups = document.get("groups") or {joint: [joint] for joint in document[KP]}
    rows = [
        {
            "name": name,
            KP: document[KP][joints[0]],
            KD: document[KD][joints[0]],
            "before": [_common(before[gain], joints) for gain in (KP, KD)] if before else [],
        }
        for name, joints in groups.items()
    ]
    head, *points = csv.reader(front.splitlines()) if front else ([],)
    return {
        "sentence": guaranteed.get("verdict", ""),
        "certified": bool(guaranteed.get("certified", False)),
        "members": document.get("assumed", {}).get("loops", 1),
        "checks": checks(document),
        "gains": rows,
        "units": _units(document),
        "front": {"head": [name.replace("_", " ") for name in head], "points": points},
        "note": note,
    }


# Units of kp and kd, where the document says what the joints do.
_UNITS = {"N m/rad": ["N m/rad", "N m s/rad"], "N/m": ["N/m", "N s/m"]}


def _units(document: Mapping[str, Any]) -> list[str]:
    stiffness = {"rad": "N m/rad", "m": "N/m"}.get(document.get("motion", {}).get("unit", ""))
    return _UNITS.get(stiffness or document.get("objective", {}).get("unit", ""), [])


def checks(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The constraints of a tuning, each whole: a KeyError names what one lacks."""
    names = ("metric", "bound", "value", "member", "met")
    return [{name: one[name] for name in names} for one in document.get("checks", [])]


def _common(gains: Mapping[str, float], joints: Sequence[str]) -> float | None:
    """What joints have in common, None where they differ."""
    values = {gains[joint] for joint in joints}
    return values.pop() if len(values) == 1 else None


def of_result(tuned: Tuned, document: Mapping[str, Any]) -> dict[str, Any]:
    """The same of a result, with its front."""
    points = tuning_front.csv_text(tuning_front.front(tuned.front)) if tuned.front else ""
    return part(document, points)


def of_file(path: Path, document: Mapping[str, Any]) -> Content:
    """The page of gains that `jaxact tune --model --out` wrote, with what lies beside them.

    Args:
        path: of the TOML file.
        document: what it says.

    Raises:
        UserError: a file beside it is damaged.
    """
    front, moved = (_beside(path.parent / name) for name in (FRONT, MOTION))
    own = part(document, front, _NO_MAP)
    parts: dict[str, Any] = {"tuned_robot": own}
    about = document.get("motion", {})
    if moved and about:
        try:
            sides = motion.read(moved)
        except ValueError:
            raise UserError(f"{path.parent / MOTION}: is damaged; tune anew") from None
        parts["run"] = _compared(sides, about)
    models = ", ".join(dict.fromkeys(document.get("assumed", {}).get("models", [])))
    return Content(
        title=f"Tuned: {own['sentence']}",
        description=f"{models}; {len(document[KP])} joints" if models else "",
        parts=parts,
        made={"Specification": toml.dumps(document)},
    )


def _beside(path: Path) -> str:
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def _compared(sides: motion.Sides, about: Mapping[str, str]) -> dict[str, Any]:
    """The rollout that went worst, the tuned gains first and those before beside them."""
    unit = about["unit"]
    order = sorted(sides, key=lambda side: side != "tuned")
    names = list(sides[order[0]])
    loops = []
    for side in order:
        verdict, _, reason = about[side].partition(": ")
        joints = [report_run.drawn(vars(sides[side][name])) for name in names]
        loops.append({"name": side, "verdict": verdict, "says": reason, "joints": joints})
    force = {"rad": "N m", "m": "N"}.get(unit, "N m or N")
    return {
        "units": {"setpoint": unit, "position": unit, "force": force},
        "loops": loops,
        "joints": names,
        "beside": 1 if len(loops) > 1 else None,
        "head": f"The rollout that goes worst: {about['member']}",
    }
