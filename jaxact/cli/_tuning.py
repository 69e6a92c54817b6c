"""What `jaxact tune` shows of a result: JSON, table, and the files of its folder."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.cli import _loops
from jaxact.verbs.margin_tables import ALWAYS, MARGINS, plain

if TYPE_CHECKING:
    from jaxact.tuning.joint.search import Tuned

_SHOWN = ("gain_margin", "phase_margin", "delay_margin", "sensitivity_peak", "complementary_peak",
          "disk_margin")  # fmt: skip


def report(tuned: Tuned, loops: _loops.Loops, sampled: bool, velocity: str) -> dict[str, Any]:
    """The result as plain values, for JSON.

    loops: the nominal loop before (if there is a start) and after
    sampled: margins of the sampled loop
    """
    from jaxact.verbs import responses as _responses

    find = _responses.sampled_margins if sampled else None
    found = _responses.margins(loops) if find is None else find(loops, velocity)
    names = (*ALWAYS[:2], *MARGINS, *ALWAYS[2:])
    rows = [{name: plain(name, found, i) for name in names} for i in range(len(loops))]
    certificate = tuned.certificate
    return {
        "kp": tuned.kp,
        "kd": tuned.kd,
        "objective": _plain(tuned.value),
        "objective_name": tuned.goal.objective,
        "objective_before": _plain(tuned.value_before),
        "margins": {"before": rows[0] if tuned.before is not None else None, "after": rows[-1]},
        "worst": _worst(tuned),
        "certified": tuned.certified,
        "feasible": tuned.feasible,
        "improved": tuned.improved,
        "verdict": tuned.verdict,
        "constraints": [
            {"constraint": c.constraint, "figure": c.figure, "bound": c.bound,
             "value": _plain(c.value), "member": c.member, "met": c.met}
            for c in certificate.checks
        ],
        "binding": list(certificate.binding),
        "members": certificate.members,
        "corners": certificate.corners,
        "worst_interior_excess": _plain(certificate.interior),
        "agreeing_starts": certificate.agreeing,
        "gap_to_brute_force": _plain(certificate.gap),
        "notes": list(certificate.notes),
        "iterations": tuned.iterations,
        "evaluations": tuned.evaluations,
        "seconds": tuned.seconds,
    }  # fmt: skip


def _worst(tuned: Tuned) -> dict[str, Any] | None:
    """Figures at their worst over an ensemble, before and after; None for a single loop."""
    from jaxact.tuning.result import worst

    if len(tuned.members) == 1:
        return None
    sides = {"before": tuned.before is not None, "after": True}
    return {
        side: {n: _plain(v) for n, v in worst(tuned, before=side == "before").items()}
        if there
        else None
        for side, there in sides.items()
    }


def _plain(value: float | None) -> Any:
    if value is None or math.isnan(value):
        return None
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return value


def as_json(document: Any) -> str:
    """One line of JSON."""
    return json.dumps(document, allow_nan=False)


def table(document: dict[str, Any], unit: str) -> str:
    """The same for people: gains, margins before and after, and what is guaranteed."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from jaxact.plotting.wording import quantity
    from jaxact.verbs.margin_tables import UNITS

    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    shown.add_column("")
    columns = _columns(document)
    for label in columns:
        shown.add_column(label, justify="right")

    def cell(value: Any, units: str) -> str:
        if value is None:
            return "-"
        return value.replace("inf", "∞") if isinstance(value, str) else quantity(value, units)

    name, units = document["objective_name"], "" if unit == "1" else unit
    # The objective is one of all members.
    values = [document["objective_before" if "before" in label else "objective"]
              if "nominal" not in label else None for label in columns]  # fmt: skip
    shown.add_row(name, *(cell(value, units) for value in values))
    for name in _SHOWN:
        cells = (cell(figures.get(name), UNITS[name]) for figures in columns.values())
        shown.add_row(name.replace("_", " "), *cells)
    console = Console(width=100, highlight=False)
    with console.capture() as captured:
        console.print(shown)
    gains = f"kp {document['kp']:.6g} N/m, kd {document['kd']:.6g} N s/m"
    lines = [line.rstrip() for line in captured.get().rstrip().splitlines()]
    guaranteed = "certified: " if document["certified"] else "NOT certified: "
    words = [gains, *lines, "", guaranteed + document["verdict"]]
    if document["members"] > 1 and document["binding"]:
        words.append("binding: " + ", ".join(document["binding"][:8]))
    words += document["notes"]
    if document["gap_to_brute_force"] is not None:
        words.append(
            f"brute force finds no better by more than {document['gap_to_brute_force']:.2g}"
        )
    share = f"{100 * document['agreeing_starts']:.0f} % of the starts agree within 1 %"
    words.append(
        f"{share}; {document['evaluations']:,} loops evaluated, {document['seconds']:.1f} s"
    )
    return "\n".join(words)


def _columns(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Figures by the title of their column: of the nominal loop, and of the worst member."""
    columns = {}
    for side in ("before", "after"):
        nominal = document["margins"][side]
        if nominal is None:
            continue
        if document["worst"] is None:
            columns[side] = nominal
            continue
        columns[f"{side}, nominal"] = nominal
        columns[f"{side}, worst of {document['members']}"] = document["worst"][side]
    return columns


def write_folder(
    folder: Path, tuned: Tuned, loops: _loops.Loops, sampled: bool, velocity: str, joint: str,
    command: str, nominal: dict[str, Any],
) -> None:  # fmt: skip
    """Gains as TOML and MJCF, and the pictures, into a folder that is there.

    nominal: figures of the nominal loop with the gains, as `report` has them
    """
    from jaxact.cli import _tuning_pictures
    from jaxact.plotting import theme
    from jaxact.plotting.sensitivity import sensitivity
    from jaxact.tuning.result import mjcf_text, toml_text
    from jaxact.verbs import responses as _responses

    (folder / "gains.toml").write_text(toml_text(tuned, command, nominal), encoding="utf-8")
    (folder / "gains.xml").write_text(mjcf_text(tuned, joint), encoding="utf-8")
    pictures = _tuning_pictures.of_joint(tuned, loops)
    drawn = _responses.responses(loops, sampled=sampled, velocity=velocity)
    # As in the other pictures, blue is after.
    drawn.sort(key=lambda response: -(response.loop or 0))
    pictures["sensitivity"] = sensitivity(drawn, footer=tuned.verdict)
    for name, figure in pictures.items():
        theme.write(figure, folder / f"{name}.png", title=f"jaxact tune: {name.replace('_', ' ')}")


def loops_of(loops: _loops.Loops, tuned: Tuned) -> _loops.Loops:
    """The nominal loop with the gains before (where there is a start) and after.

    loops: the nominal loop, one
    """
    pairs = [pair for pair in (tuned.before, (tuned.kp, tuned.kd)) if pair is not None]
    labels = ("before", "after")[-len(pairs) :]
    values = {name: np.repeat(array, len(pairs)) for name, array in loops.values.items()}
    values["kp"] = np.array([kp for kp, _ in pairs])
    values["kd"] = np.array([kd for _, kd in pairs])
    named = tuple(f"{label}: {loops.labels[0]}" for label in labels)
    return replace(loops, values=values, labels=named)
