"""A tuned joint or robot as a report, and as tables for people."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.parameters import KD, KP, PAYLOAD
from jaxact.plotting.wording import quantity
from jaxact.tuning.report import report
from jaxact.tuning.result import UNSAMPLED
from jaxact.verbs import naming, rendering, tuning_front
from jaxact.verbs.margin_tables import ALWAYS, MARGINS, UNITS, plain
from jaxact.verbs.margins import margins

if TYPE_CHECKING:
    from jaxact.loops.control_loop import ControlLoop
    from jaxact.tuning.result import Tuned
    from jaxact.tuning.rollouts.validation import Rollouts

_SHOWN = ("gain_margin", "phase_margin", "delay_margin", "sensitivity_peak", "complementary_peak",
          "disk_margin")  # fmt: skip
_OF_ROBOT = {"sensitivity_peak": "Ms", "complementary_peak": "Mt", "disk_margin": "disk margin",
             "growth_rate": "growth [1/s]"}  # fmt: skip
_WIDTH = 110
# Members that bind which are named.
_BINDING = 8


@dataclass(frozen=True)
class Joint:
    """What is shown of a single joint's gains, or of an ensemble's.

    Attributes:
        tuned: the result.
        nominal: the loop of the result, whose values lie within the ranges.
        name: of the joint in the MJCF snippet.
    """

    tuned: Tuned
    nominal: ControlLoop
    name: str

    def report(self) -> dict[str, Any]:
        """The result as plain values, with the nominal loop's margins before and after."""
        loops = with_gains(self.tuned, self.nominal)
        found = margins(loops, sampled=not self.tuned.continuous).written
        names = (*ALWAYS[:2], *MARGINS, *ALWAYS[2:])
        rows = [{name: plain(name, found, i) for name in names} for i in range(len(loops))]
        before = rows[0] if self.tuned.before is not None else None
        found = report(self.tuned, margins={"before": before, "after": rows[-1]})
        return _with_front(found, self.tuned)

    def text(self, document: Mapping[str, Any]) -> str:
        """The report for people: gains, margins before and after, and what is guaranteed."""
        columns = _columns(document)

        def cell(value: Any, units: str) -> str:
            if value is None:
                return "-"
            return value.replace("inf", "∞") if isinstance(value, str) else quantity(value, units)

        kp, kd, unit = self.tuned.units
        units = "" if unit == "1" else unit
        # The objective is one of all members.
        values = [document["objective_before" if "before" in label else "objective"]
                  if "nominal" not in label else None for label in columns]  # fmt: skip
        rows = [[document["objective_name"], *(cell(value, units) for value in values)]]
        for name in _SHOWN:
            cells = (cell(metrics.get(name), UNITS[name]) for metrics in columns.values())
            rows.append([name.replace("_", " "), *cells])
        gains = f"kp {document[KP]:.6g} {kp}, kd {document[KD]:.6g} {kd}"
        table = _table(["", *columns], rows)
        assumed = [UNSAMPLED] if self.tuned.continuous else []
        said = "\n".join([gains, table, "", *_words(document, document["members"], assumed)])
        return said + _front_table(self.tuned)


@dataclass(frozen=True)
class Robot:
    """What is shown of a robot's gains.

    Attributes:
        tuned: the result.
        rollouts: that the gains were held against, None if they were not.
    """

    tuned: Tuned
    rollouts: Rollouts | None

    def report(self) -> dict[str, Any]:
        """The result as plain values."""
        return _with_front(report(self.tuned, rollouts=self.rollouts), self.tuned)

    def text(self, document: Mapping[str, Any]) -> str:
        """The report for people."""
        simulated = _tracking_lines(document) + _rollout_lines(document["rollouts"])
        words = _words(document, document["loops"], _box_lines(document["assumed"]), simulated)
        said = "\n\n".join([self._gains(document), _margins(document), "\n".join(words)])
        return said + _front_table(self.tuned)

    def _gains(self, document: Mapping[str, Any]) -> str:
        tuned = self.tuned
        assert tuned.robot is not None
        groups, before = tuned.robot.case.groups, tuned.before
        heads = ["group" if len(groups) < len(tuned.kp) else "joint"]
        heads += ["kp before", "kd before"] if before else []
        heads += [f"{k} [{unit}]" for k, unit in zip((KP, KD), document["units"], strict=True)]
        rows = []
        for number, row in enumerate(document["groups"]):
            own = groups.members == number
            known = [_span(k[own]) for k in before or ()]
            rows.append([row["name"], *known, f"{row[KP]:.6g}", f"{row[KD]:.6g}"])
        return _table(heads, rows)


def with_gains(tuned: Tuned, loop: ControlLoop) -> ControlLoop:
    """A joint's loop with the gains before (where there is a start) and after, named so."""
    pairs = [pair for pair in (tuned.before, (tuned.kp, tuned.kd)) if pair is not None]
    kp, kd = np.array(pairs).T
    name = naming.named(loop).labels[0]
    sides = ("before", "after")[-len(pairs) :]
    return loop.replace(kp=kp, kd=kd, names=tuple(f"{side}: {name}" for side in sides))


def as_json(document: Any) -> str:
    """One line of JSON."""
    return json.dumps(document, allow_nan=False)


def _with_front(document: dict[str, Any], tuned: Tuned) -> dict[str, Any]:
    """The report with the front in it, where there is one."""
    if not tuned.front:
        return document
    return document | {"pareto": tuning_front.report(tuning_front.front(tuned.front))}


def _front_table(tuned: Tuned) -> str:
    if not tuned.front:
        return ""
    return "\n\n" + tuning_front.table(tuning_front.front(tuned.front))


def _words(
    document: Mapping[str, Any],
    members: int,
    assumed: list[str] | None = None,
    simulated: list[str] | None = None,
) -> list[str]:
    """What is guaranteed, of how many members, under which assumptions, and how it was found."""
    words = [("certified: " if document["certified"] else "NOT certified: ") + document["verdict"]]
    words += [document["interrupted"]] if document["interrupted"] else []
    words += assumed or []
    binding = document["binding"]
    if members > 1 and binding:
        more = ", ..." if len(binding) > _BINDING else ""
        words.append("binding: " + ", ".join(binding[:_BINDING]) + more)
    words += [*document["notes"], *(simulated or [])]
    gap = document["gap_to_brute_force"]
    if gap is not None:
        words.append(f"brute force finds no better by more than {gap:.2g}")
    share = f"{100 * document['agreeing_starts']:.0f} % of the starts agree within 1 %"
    words.append(
        f"{share}; {document['evaluations']:,} loops evaluated, {document['seconds']:.1f} s"
    )
    return words


def _columns(document: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Metrics by the title of their column: of the nominal loop, and of the worst member."""
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


def _box_lines(box: Mapping[str, Any]) -> list[str]:
    """What was assumed not to be known, and what ranges without a width gave."""
    ends = [
        f"{key} {' to '.join(f'{end:.4g}' for end in np.ravel(value))}"
        + (f" (on '{box['payload_body']}')" if key == PAYLOAD else "")
        for key, value in box.items()
        if isinstance(value, list | float)
    ]
    if not ends:
        return []
    told = "setpoint_and_feedforward"
    told = f"; setpoint and feedforward {box[told]}" if told in box else ""
    all_of = " all of:" if any(isinstance(value, list) for value in box.values()) else ""
    return [f"for{all_of} {', '.join(ends)}{told}"]


def _tracking_lines(document: Mapping[str, Any]) -> list[str]:
    tracked = document["tracking"]
    if tracked is None:
        return []
    return [
        f"simulated rms error {tracked['rms']:.3g}, by the margins alone "
        f"{tracked['rms_by_margins_alone']:.3g} (weight {tracked['weight']:g})"
    ]


def _rollout_lines(rollouts: Mapping[str, Any] | None) -> list[str]:
    if rollouts is None:
        return []
    lines = []
    for side, words in (("before", "the start"), ("after", "the tuned gains")):
        rows = rollouts[side]
        if rows is None:
            continue
        stable, of = (sum(row[key] for row in rows.values()) for key in ("stable", "rollouts"))
        line = (
            f"nonlinear rollouts of {rollouts['duration']:g} s with noise, quantisation, limits "
            f"and a push: with {words} {stable} of {of} stable"
        )
        lost = [
            f"{n}: {row['worst']}" for n, row in rows.items() if row["stable"] < row["rollouts"]
        ]
        lines.append(line + (f" ({lost[0]})" if lost else ""))
    return lines


def _span(values: np.ndarray) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.4g}" if high - low <= 1e-9 * high else f"{low:.4g} to {high:.4g}"


def _margins(document: Mapping[str, Any]) -> str:
    """The worst loop of each situation, before and after."""
    before, after = document["margins"]["before"], document["margins"]["after"]
    kept = [name for name in _OF_ROBOT if name in next(iter(after.values()))]
    heads = ["worst loop of"]
    for name in kept:
        heads += [f"{_OF_ROBOT[name]} before"] if before is not None else []
        heads.append(_OF_ROBOT[name])
    rows = []
    for situation, row in after.items():
        sides = [row] if before is None else [before[situation], row]
        values = [side[name] for name in kept for side in sides]
        rows.append([situation, *("-" if v is None else f"{v:.4g}" for v in values)])
    return _table(heads, rows)


def _table(heads: list[str], rows: list[list[str]]) -> str:
    made = rendering.table(*heads)
    for row in rows:
        made.add_row(*row)
    return rendering.rendered(made, width=_WIDTH)
