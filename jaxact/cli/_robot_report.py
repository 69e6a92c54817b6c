"""What `jaxact tune --model` shows of a result: JSON, tables, and the files of its folder."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from jaxact.tuning.robot.result import Held
    from jaxact.tuning.robot.tuned import RobotTuned
    from jaxact.tuning.rollouts.validation import Validation

_WIDTH = 110


def report(tuned: RobotTuned, held: Held | None) -> dict[str, Any]:
    """The result as plain values, for JSON.

    held: against rollouts, None if it was not
    """
    from jaxact.tuning.robot import result as robot_result

    certificate, groups = tuned.certificate, tuned.groups
    before = tuned.exact_before is not None
    return {
        "situations": [one.name for one in tuned.situations],
        "groups": [
            {"name": name, "kp": float(tuned.kp[place]), "kd": float(tuned.kd[place])}
            for name, place in zip(groups.names, groups.first, strict=True)
        ],
        "joints": [
            {"name": name, "kp": float(kp), "kd": float(kd)}
            for name, kp, kd in zip(groups.joints, tuned.kp, tuned.kd, strict=True)
        ],
        "objective": _plain(tuned.value),
        "objective_name": tuned.goal.objective,
        "objective_before": _plain(tuned.value_before),
        "units": list(robot_result.units(tuned)),
        "margins": {
            "before": _all(robot_result.worst(tuned, before=True)) if before else None,
            "after": _all(robot_result.worst(tuned)),
        },
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
        "assumed": robot_result.box(tuned),
        "loops": certificate.members,
        "corners": certificate.corners,
        "worst_interior_excess": _plain(certificate.interior),
        "agreeing_starts": certificate.agreeing,
        "gap_to_brute_force": _plain(certificate.gap),
        "rollouts": None if held is None else {
            "duration": held.duration,
            "before": verdicts(held.before) if held.before else None,
            "after": verdicts(held.after),
        },
        "tracking": None if tuned.tracked is None else {
            "weight": tuned.tracked.weight,
            "derivative": tuned.tracked.mode,
            "rms": _plain(tuned.tracked.rms),
            "rms_by_margins_alone": _plain(tuned.tracked.aside),
            "rms_before": _plain(tuned.tracked.before),
        },
        "iterations": tuned.iterations,
        "evaluations": tuned.evaluations,
        "seconds": tuned.seconds,
    }  # fmt: skip


def _all(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    return {name: {key: _plain(value) for key, value in row.items()} for name, row in rows.items()}


def verdicts(rollouts: Mapping[str, Validation]) -> dict[str, dict[str, Any]]:
    """How many rollouts of each situation were stable, and the worst one's reason."""
    return {
        name: {
            "stable": int(one.stable.sum()),
            "rollouts": int(one.stable.size),
            "largest_excursion": _plain(float(np.nanmax(one.excursion))),
            "worst": one.worst[2],
        }
        for name, one in rollouts.items()
    }


def _plain(value: Any) -> Any:
    if isinstance(value, bool | int) or value is None:
        return value
    if math.isnan(value):
        return None
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return float(value)


def as_json(document: Mapping[str, Any]) -> str:
    """One line of JSON."""
    return json.dumps(document, allow_nan=False)


def as_text(tuned: RobotTuned, document: Mapping[str, Any]) -> str:
    """The same for people."""
    parts = [_rendered(_gains(tuned, document)), _rendered(_margins(document))]
    sure = "certified: " if document["certified"] else "NOT certified: "
    words = [sure + document["verdict"]]
    words += _box_lines(document["assumed"])
    if document["binding"]:
        shown = ", ".join(document["binding"][:6])
        words.append(f"binding: {shown}{', ...' if len(document['binding']) > 6 else ''}")
    if tuned.tracked is not None:
        words.append(
            f"simulated rms error {tuned.tracked.rms:.3g}, by the margins alone "
            f"{tuned.tracked.aside:.3g} (weight {tuned.tracked.weight:g})"
        )
    words += _rollout_lines(document["rollouts"])
    gap = document["gap_to_brute_force"]
    if gap is not None:
        words.append(f"brute force finds no better by more than {gap:.2g}")
    words.append(
        f"{100 * document['agreeing_starts']:.0f} % of the starts agree within 1 %; "
        f"{document['evaluations']:,} loops evaluated, {document['seconds']:.1f} s"
    )
    return "\n\n".join([*parts, "\n".join(words)])


def _box_lines(box: Mapping[str, Any]) -> list[str]:
    """What was assumed not to be known."""
    ends = [
        f"{key} {value[0]:.4g} to {value[1]:.4g}"
        + (f" (on '{box['payload_body']}')" if key == "payload" else "")
        for key, value in box.items()
        if isinstance(value, list)
    ]
    if not ends:
        return []
    told = "setpoint_and_feedforward"
    told = f"; setpoint and feedforward {box[told]}" if told in box else ""
    return [f"for all of: {', '.join(ends)}{told}"]


def _gains(tuned: RobotTuned, document: Mapping[str, Any]) -> Any:
    from rich import box
    from rich.table import Table

    kp, kd = document["units"]
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("group" if len(tuned.groups) < len(tuned.kp) else "joint")
    heads = [f"kp [{kp}]", f"kd [{kd}]"]
    for head in (["kp before", "kd before"] if tuned.before else []) + heads:
        table.add_column(head, justify="right")
    for number, row in enumerate(document["groups"]):
        cells = [f"{row['kp']:.6g}", f"{row['kd']:.6g}"]
        if tuned.before:
            own = tuned.groups.members == number
            cells = [_span(k[own]) for k in tuned.before] + cells
        table.add_row(row["name"], *cells)
    return table


def _span(values: np.ndarray) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.4g}" if high - low <= 1e-9 * high else f"{low:.4g} to {high:.4g}"


def _margins(document: Mapping[str, Any]) -> Any:
    """The worst loop of each situation, before and after."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("worst loop of")
    before, after = document["margins"]["before"], document["margins"]["after"]
    names = {"sensitivity_peak": "Ms", "complementary_peak": "Mt", "disk_margin": "disk margin",
             "growth_rate": "growth [1/s]"}  # fmt: skip
    kept = [name for name in names if name in next(iter(after.values()))]
    for name in kept:
        if before is not None:
            table.add_column(f"{names[name]} before", justify="right")
        table.add_column(names[name], justify="right")
    for situation, row in after.items():
        cells = []
        for name in kept:
            sides = [row] if before is None else [before[situation], row]
            cells += ["-" if side[name] is None else f"{side[name]:.4g}" for side in sides]
        table.add_row(situation, *cells)
    return table


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


def _rendered(table: Any) -> str:
    from rich.console import Console

    console = Console(width=_WIDTH, highlight=False)
    with console.capture() as captured:
        console.print(table)
    return "\n".join(line.rstrip() for line in captured.get().strip("\n").splitlines())


def validated(tuned: RobotTuned, duration: float) -> Held | None:
    """The gains held against nonlinear rollouts; None for a duration of 0 s."""
    from jaxact.tuning.robot import result as robot_result

    return robot_result.hold(tuned, duration) if duration > 0.0 else None


def write_folder(folder: Path, tuned: RobotTuned, held: Held | None, command: str) -> None:
    """gains.toml, gains.xml and the pictures, into a folder that is there.

    command: that made it
    """
    from jaxact.cli import _tuning_pictures
    from jaxact.plotting import robot_tuning as pictures
    from jaxact.plotting import theme
    from jaxact.plotting.convergence import convergence
    from jaxact.plotting.robot_gains import gains
    from jaxact.tuning.robot import result as robot_result

    text = robot_result.toml_text(tuned, held, command)
    (folder / "gains.toml").write_text(text, encoding="utf-8")
    (folder / "gains.xml").write_text(robot_result.mjcf_text(tuned), encoding="utf-8")
    paths, goal, groups = tuned.paths, tuned.goal, tuned.groups
    unit = robot_result.objective_unit(tuned)
    with np.errstate(over="ignore"):
        values, ratio = np.exp(goal.sense * paths.path_value[0]), np.exp(paths.path_violation[0])
        ends = np.exp(np.asarray(paths.gains[0], float)).reshape(-1, 2, len(groups))
    label = goal.objective if unit == "1" else f"{goal.objective} [{unit}]"
    pair = (tuned.kp, tuned.kd)
    grouped = (
        groups.log_gains(*pair),
        None if tuned.before is None else groups.log_gains(*tuned.before),
    )
    after, before = (None if x is None else tuple(np.exp(x).reshape(2, -1)) for x in grouped)
    drawn = {
        "sensitivity": pictures.sensitivities(
            [] if tuned.before is None else _bands(tuned, tuned.before), _bands(tuned, pair),
            max_peak=goal.max_peak, footer=tuned.verdict,
        ),
        "convergence": convergence(
            values, ratio, label=label, given=False,
            stable=np.isfinite(paths.violation[0]), missed=_tuning_pictures.missed(tuned),
        ),
        "gains": gains(groups.names, before, after, ends, units=robot_result.units(tuned)),
    }  # fmt: skip
    for name, figure in drawn.items():
        theme.write(figure, folder / f"{name}.png", title=f"jaxact tune: {name}")


def _bands(tuned: RobotTuned, gains: tuple[np.ndarray, np.ndarray]) -> list[Any]:
    """Singular values of every situation's loops with gains of the joints."""
    from jaxact.plotting.robot_tuning import Band
    from jaxact.tuning.robot.peaks import sensitivity

    bands = []
    for place, one in enumerate(tuned.situations):
        own = tuned.table.take(np.flatnonzero(tuned.loops.situation == place))
        S = sensitivity(own.response, *gains)
        T = np.eye(S.shape[-1]) - S
        # Loops have frequencies of their own: on those of the first.
        angle = own.angle[0]
        size = [np.linalg.svd(X, compute_uv=False)[..., 0] for X in (S, T)]
        rows = [
            np.stack([np.interp(angle, a, v) for a, v in zip(own.angle, values, strict=True)])
            for values in size
        ]
        bands.append(Band(one.name, angle / one.period, *rows))
    return bands
