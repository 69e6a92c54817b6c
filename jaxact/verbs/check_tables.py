"""What is known of a robot's model as a report for people."""

from __future__ import annotations

import shlex
import sys
import textwrap
from typing import TYPE_CHECKING, Any

from jaxact.parameters import DELAY, JOINT_DAMPING, KD, KP, SETPOINT, SETPOINT_DELAY
from jaxact.plotting.wording import physics_step
from jaxact.verbs import check_gains
from jaxact.verbs.rendering import rendered

if TYPE_CHECKING:
    from jaxact.robots.findings import Finding
    from jaxact.robots.robot import Robot
    from jaxact.verbs.check import RobotCheck

_WIDTH = 100
_NONE = "-"


def text(check: RobotCheck) -> str:
    """The whole report: the gains in sentences, the joints as a table, and the findings."""
    of_gains = check_gains.as_text(check.on_stand) or check_gains.friction_alone(check.robot)
    said = [_wrapped(paragraph) for paragraph in of_gains]
    parts = [_head(check), *(["\n".join(said)] if said else [])]
    if check.joints:
        parts.append(_joint_table(check.joints))
    if check.findings:
        parts.append(_finding_list(check.findings))
    parts.append(_foot(check))
    return "\n\n".join(parts)


def _head(check: RobotCheck) -> str:
    robot, plant = check.robot, check.loop.kind.plant
    model, keyframe = robot.model, None if plant is None else plant.keyframe
    asked = check.loop.kind.physics_step is not None
    own = float(model.opt.timestep)
    step = physics_step(check.physics_step, own, check.control_period, asked=asked)
    lines = [
        str(robot.path),
        _wrapped(
            f"{_count(len(robot.joints), 'driven joint')}, nv = {model.nv}, "
            f"{_count(model.nactuator, 'actuator')}, {step}"
        ),
    ]
    names = [model.key(index).name or str(index) for index in range(model.nkey)]
    posture = f"keyframe {keyframe}" if keyframe is not None else "default posture"
    others = [name for name in names if name != keyframe]
    if others:
        posture += f"; `keyframe` takes {', '.join(others)}"
    return "\n".join([*lines, posture])


def _foot(check: RobotCheck) -> str:
    able = check.engines
    lines = [] if check.findings else ["No field of the model is ignored."]
    lines.append(f"engines: {', '.join(able) if able else 'none can simulate it as it is'}")
    patterns = _way_out(check.robot)
    if patterns:
        chosen = " ".join(map(shlex.quote, patterns))
        lines.append(f"to leave undriven what cannot be driven: `joints` {chosen}")
    return "\n".join(lines)


def _way_out(robot: Robot) -> list[str]:
    """Patterns that leave out the actuators that no drive can replace; [] if there are none."""
    from jaxact.robots import selection
    from jaxact.robots.actuators import label
    from jaxact.robots.findings import MUJOCO

    model = robot.model
    stopped = {item.where for item in robot.findings if MUJOCO in item.engines}
    undrivable = [i for i in range(model.nactuator) if label(model, i) in stopped]
    if not undrivable or not robot.joints:
        return []
    return selection.patterns_without(model, undrivable)


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _joint_table(rows: list[dict[str, Any]]) -> str:
    from rich import box
    from rich.table import Table

    named = any(row["actuator"] != row["name"] for row in rows)
    delayed = any(row[DELAY] or row[SETPOINT_DELAY] for row in rows)
    lagged = any(row["natural_frequency"] for row in rows)
    damped = any(row[JOINT_DAMPING] for row in rows)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("joint", overflow="fold")
    if named:
        table.add_column("actuator", overflow="fold")
    units = ("found", KP, KD, "force", SETPOINT, "inertia", "bandwidth")
    for name in units:
        table.add_column(name, justify="left" if name == "found" else "right", no_wrap=True)
    if damped:
        table.add_column("damping", justify="right", no_wrap=True)
    if delayed:
        table.add_column(DELAY, justify="right", no_wrap=True)
    if lagged:
        table.add_column("force loop", justify="right", no_wrap=True)
    for row in rows:
        cells = [row["name"], *([row["actuator"]] if named else []), row["kind"]]
        cells += [_short(row[KP]), _short(row[KD])]
        cells += [_range(row["force_limits"]), _range(row["setpoint_limits"])]
        cells += [_short(row["inertia"]), _short(row["bandwidth"])]
        cells += [_short(row[JOINT_DAMPING])] if damped else []
        cells += [_delay(row)] if delayed else []
        cells += [_loop(row)] if lagged else []
        table.add_row(*cells)
    note = (
        "SI units and rad, at the joint; inertia with all else free and no contact; bandwidth in "
        "rad/s,\nwhere the gain of kp + kd s on this inertia is 1."
    )
    if damped:
        note += " damping: the joint's own."
    if not any(row[KP] or row[KD] for row in rows):
        note += " No gains in the model: give kp and kd."
    return rendered(table, width=_width()).lstrip("\n") + "\n" + note


def _short(value: float | None) -> str:
    return _NONE if value is None else f"{value:.3g}"


def _range(bounds: list[float | None]) -> str:
    low, high = bounds
    if low is None and high is None:
        return _NONE
    if low is not None and high is not None and low == -high:
        return f"±{high:.3g}"
    return f"{'-inf' if low is None else f'{low:.3g}'}..{'inf' if high is None else f'{high:.3g}'}"


def _delay(row: dict[str, Any]) -> str:
    if row[DELAY]:
        return f"{row[DELAY] * 1e3:.3g} ms"
    return f"{row[SETPOINT_DELAY] * 1e3:.3g} ms (setpoint)" if row[SETPOINT_DELAY] else _NONE


def _loop(row: dict[str, Any]) -> str:
    wn, zeta = row["natural_frequency"], row["damping_ratio"]
    return f"wn {wn:.3g}, zeta {zeta:.3g}" if wn else _NONE


def _finding_list(findings: tuple[Finding, ...]) -> str:
    groups = _grouped(findings)
    indent = 2 + max(len(action) for action, _, _ in groups)
    lines = []
    for action, what, does in groups:
        for number, paragraph in enumerate((what, does)):
            first = action.ljust(indent) if number == 0 else " " * indent
            lines += textwrap.wrap(
                paragraph, _width(), initial_indent=first, subsequent_indent=" " * indent,
                break_long_words=False, break_on_hyphens=False,
            )  # fmt: skip
    return "\n".join(lines)


def _wrapped(paragraph: str) -> str:
    return textwrap.fill(
        paragraph, _width(), break_long_words=False, break_on_hyphens=False
    )  # fmt: skip


def _grouped(findings: tuple[Finding, ...]) -> list[tuple[str, str, str]]:
    """What is done, about what, and why; the same of several elements at once; refusals first."""
    groups: dict[tuple[Any, ...], list[Finding]] = {}
    for item in sorted(findings, key=lambda item: not item.engines):
        key = (item.field, item.value, item.mjx, item.action, item.advice, item.engines)
        groups.setdefault(key, []).append(item)
    lines = []
    for same in groups.values():
        first = same[0]
        where = first.where if len(same) == 1 else f"{first.where} and {len(same) - 1} more"
        stopped = f" by {', '.join(first.engines)}" if first.engines else ""
        lines.append(
            (
                f"{first.action}{stopped}",
                f"{where}: {first.field} = {first.value}",
                f"MJX {first.mjx}; {first.advice}",
            )
        )
    return lines


def _width() -> int:
    from rich.console import Console

    return max(Console().width, 60) if sys.stdout.isatty() else _WIDTH
