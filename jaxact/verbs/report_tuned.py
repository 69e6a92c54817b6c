"""What the report of a joint's tuned gains has: before and after, the certificate, the front."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxact.errors import UserError
from jaxact.loops import toml
from jaxact.loops.building import joint
from jaxact.loops.control_loop import ControlLoop
from jaxact.parameters import CONTROL_RATE, KD, KP, canonical
from jaxact.reports.page import Content
from jaxact.tuning.document import document as tuning_document
from jaxact.tuning.result import Tuned
from jaxact.verbs import naming, report_joint, report_tuned_robot, tuning_front

# In a folder of `jaxact tune`.
FRONT = "front.csv"


def content(tuned: Tuned) -> Content:
    """The page of a tuned joint.

    Raises:
        UserError: it is a robot's.
    """
    if tuned.robot is not None:
        raise UserError(report_joint.ROBOT)
    points = tuning_front.report(tuning_front.front(tuned.front)) if tuned.front else []
    return _content(tuning_document(tuned), points)


def of_file(path: Path, document: Mapping[str, Any]) -> Content:
    """The page of gains that `jaxact tune --out` wrote, with the front beside them.

    Args:
        path: of the TOML file.
        document: what it says.

    Raises:
        UserError: a robot's gains that no tuning wrote, or a damaged file.
    """
    if {KP, KD, "guaranteed"} <= document.keys():
        return report_tuned_robot.of_file(path, document)
    beside = path.parent / FRONT
    try:
        points = _front(beside.read_text(encoding="utf-8")) if beside.is_file() else []
    except (KeyError, ValueError, OSError):
        raise UserError(f"{beside}: is damaged; tune anew") from None
    return _content(document, points)


def _front(text: str) -> list[dict[str, Any]]:
    return [
        {name: float(row[name]) for name in ("max_peak", KP, KD, "objective")}
        | {"certified": row["certified"] == "true"}
        for row in csv.DictReader(text.splitlines())
    ]


def _content(document: Mapping[str, Any], front: Sequence[Mapping[str, Any]]) -> Content:
    gains, guaranteed = document.get("gains"), document.get("guaranteed", {})
    if not isinstance(gains, Mapping) or not {KP, KD} <= gains.keys():
        raise UserError(
            "these are not a joint's tuned gains: there is no [gains] with kp and kd; of a robot "
            "report the model with them: `jaxact report robot.xml --gains gains.toml`"
        )
    sides = {"before": document["before"]} if "before" in document else {}
    sides |= {"tuned": gains}
    points = {name: (float(one[KP]), float(one[KD])) for name, one in sides.items()}
    verdict = guaranteed.get("verdict", "")
    title = f"Tuned: {verdict}" if verdict else "Tuned gains"
    subject = report_joint.Subject(_loops(document), title, toml.dumps(document), points=points)
    page = report_joint.of_subject(subject)
    own = page.parts["joint"]
    part = {
        "sentence": verdict,
        "certified": bool(guaranteed.get("certified", False)),
        "objective": document.get("objective", {}),
        "checks": report_tuned_robot.checks(document),
        "members": document["assumed"].get("members", 1),
        "sides": [{"name": name, KP: kp, KD: kd} for name, (kp, kd) in points.items()],
        "front": [dict(one) for one in front],
        **{name: own[name] for name in ("loops", "unit", "sampled")},
    }
    return Content(page.title, page.description, {"tuned": part, **page.parts}, page.made)


def _loops(document: Mapping[str, Any]) -> ControlLoop:
    """The nominal loop and the worst members, and all ends of what was assumed.

    The gains are the tuned ones.
    """
    gains, assumed = document["gains"], document["assumed"]
    known = {
        canonical(name): value if isinstance(value, list) else [value]
        for name, value in assumed.items()
        if canonical(name) in report_joint.OF_LOOP
    }
    if "control_period" in assumed:
        known[CONTROL_RATE] = [1.0 / assumed["control_period"]]
    ends = [dict(zip(known, each, strict=True)) for each in itertools.product(*known.values())]
    named = [{canonical(n): v for n, v in one.items()} for one in document.get("loop", [])]
    # A single member is the nominal loop.
    rows = [*named, *ends] if len(ends) > 1 or not named else named
    kind: dict[str, Any] = {
        "unit": assumed.get("unit"), "velocity": assumed.get("velocity", "sampled"),
    }  # fmt: skip
    # What a joint does not have itself is not in the row of a member that has none.
    values = {name: [row.get(name, 0.0) for row in rows] for name in known}
    if not values:
        raise UserError("these gains do not say of which joint they are: [assumed] is empty")
    both = {KP: gains[KP], KD: gains[KD]}
    loop = joint(**both, **values, **kind)
    labels = [one.get("name", "") for one in named]
    labels += naming.named(loop).labels[len(named) :]
    return loop.named(*labels) if named else loop
