"""`jaxact check`: what will be driven in a robot, and what its model has that engines ignore."""

from __future__ import annotations

import json as _json
import math
import shlex
import sys
import textwrap
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from jaxact.cli import _check_loop, _mounting

if TYPE_CHECKING:
    from jaxact.loops.specification import Plant
    from jaxact.robot_margins.on_stand import OnStand
    from jaxact.robots.findings import Finding
    from jaxact.robots.model import Robot

REFUSED = 1
_WIDTH = 100
_NONE = "-"


def main(
    model: Annotated[Positional[Path], arg(metavar="MODEL", help="MJCF or URDF file of a robot.")],
    *,
    keyframe: Annotated[
        str | None,
        arg(
            metavar="NAME",
            help="Posture at which inertias are taken: a keyframe's name or number.",
            help_behavior_hint="(default: the model's own, qpos0)",
        ),
    ] = None,
    joints: Annotated[
        tuple[str, ...],
        arg(
            metavar="PATTERN",
            help="Regular expressions; the joints or actuators that match in full are driven.",
            help_behavior_hint="(default: all)",
        ),
    ] = (".*",),
    base: _mounting.Base = None,
    damping: _mounting.Damping = None,
    control_rate: Annotated[
        float,
        arg(
            metavar="HZ",
            help="Of the controllers, at which the gains have to bear delay [Hz].",
        ),
    ] = 1000.0,
    json: Annotated[bool, arg(help="Print one JSON object.")] = False,
) -> None:
    r"""Show what will be driven in a robot and how, and every field that engines would ignore.

    First, where the model brings gains: how much delay they bear on a stand, and which joints shake
    then; where the joints' damping stands for a kd, the same with it in the drives and as the model
    has it; with dry friction as MuJoCo linearises it; and whether the robot stands with its base
    free. `jaxact margins` says more, with --set integrator_correction=true the same: MuJoCo's
    integrator, half a physics step ahead, is corrected for here, since no robot has it.

    For each joint: what the model has there, its gains and limits at the joint (gear applied), the
    inertia that the joint moves at the posture with all else free, the bandwidth of the PD loop
    (where its gain is 1, on that inertia), and delays. Then what needs a word: what MJX would do
    with it, and what jaxact does: lifted into the drive, emulated, ignored harmlessly, or refused.

    The file is never changed. Exit code 1 if anything is refused, 2 if there is no such model or
    keyframe, else 0.

    JSON: model, keyframe, digest, physics_step [s], degrees_of_freedom; engines that can simulate
    it (warp where it is installed); on_stand with control_rate [Hz], outside (joints beyond
    their ranges), hidden_gains (joints), friction, falls (why), and as_it_is, in_drive, stuck,
    free, of each joint, participation (shares of all), stable, shakes, topples, growth_rate [1/s],
    delay [s] and frequency [rad/s]; on_stand_not_known (why); joints with name, actuator, kind,
    kp, kd, force_limits, setpoint_limits, setpoint, setpoint_velocity, delay and setpoint_delay
    [s], natural_frequency [rad/s], damping_ratio, inertia, inertia_others_held, joint_damping,
    joint_friction, armature (what the joint itself has), bandwidth [rad/s]; findings with where,
    field, value, mjx, action, advice, engines. SI units; null: none.

    examples:
      jaxact check robot.xml --keyframe home
      jaxact check robot.xml --keyframe home --control-rate 500
      jaxact check robot.xml --joints '.*_hip' '.*_knee'
      jaxact check robot.urdf --json
    """
    from jaxact import parameters
    from jaxact.robots import model as _model

    mounted = _mounting.chosen(base, damping)
    robot = _model.read(model, keyframe=keyframe, joints=joints, **mounted)
    rate = parameters.check("control_rate", control_rate, "--control-rate")
    known = _check_loop.found(_plant(model, keyframe, joints, mounted), robot, rate)
    robot = replace(robot, findings=(*robot.findings, *_of_mjx(robot), *_of_warp(robot)))
    print(_as_json(robot, keyframe, known) if json else _as_text(robot, keyframe, known))
    if any(item.engines for item in robot.findings):
        raise SystemExit(REFUSED)


def _plant(model: Path, keyframe: str | None, joints: tuple[str, ...], mounted: Any) -> Plant:
    from jaxact.loops.specification import Plant

    return Plant(model=model, keyframe=keyframe, joints=joints, **mounted)


def _of_mjx(robot: Robot) -> list[Finding]:
    from jaxact.plants.mjx import refusals as mjx_refusals

    return mjx_refusals.find(robot.model)


def _of_warp(robot: Robot) -> list[Finding]:
    """What MJX-Warp refuses by itself, where it is there to be asked."""
    from jaxact.plants import warp
    from jaxact.robots.findings import WARP, refused

    known = any(WARP in item.engines for item in robot.findings)
    reason = "" if known or warp.lacking() else warp.refusal(robot.model)
    if not reason:
        return []
    advice = "MJX-Warp refuses it; choose another engine"
    return [refused("model", "MJX-Warp", reason, "is not asked", advice, (WARP,))]


def engines(robot: Robot) -> list[str]:
    """The engines that can simulate the robot; `warp` only where MJX-Warp is installed."""
    from jaxact.plants import warp
    from jaxact.robots.findings import ENGINES, WARP

    stopped = {engine for item in robot.findings for engine in item.engines}
    if warp.lacking():
        stopped.add(WARP)
    return [name for name in ENGINES if name not in stopped and robot.joints]


def _rows(robot: Robot) -> list[dict[str, Any]]:
    """One joint a row, as JSON has it."""
    from jaxact.robots import inertia as _inertia

    free, held = _inertia.inertias(robot)
    model = robot.model
    return [
        {
            "name": joint.name,
            "actuator": joint.actuator,
            "kind": joint.kind,
            "kp": _number(joint.kp),
            "kd": _number(joint.kd),
            "force_limits": [_number(joint.force_low), _number(joint.force_high)],
            "setpoint_limits": [_number(joint.setpoint_low), _number(joint.setpoint_high)],
            "setpoint": _number(joint.setpoint),
            "setpoint_velocity": joint.setpoint_velocity,
            "delay": joint.delay,
            "setpoint_delay": joint.setpoint_delay,
            "natural_frequency": _number(joint.natural_frequency),
            "damping_ratio": _number(joint.damping_ratio),
            "inertia": float(free[row]),
            "inertia_others_held": float(held[row]),
            "joint_damping": float(model.dof_damping[joint.dof]),
            "joint_friction": float(model.dof_frictionloss[joint.dof]),
            "armature": float(model.dof_armature[joint.dof]),
            "bandwidth": _number(_inertia.bandwidth(joint.kp, joint.kd, float(free[row]))),
        }
        for row, joint in enumerate(robot.joints)
    ]


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _as_json(robot: Robot, keyframe: str | None, known: OnStand | str) -> str:
    return _json.dumps(
        {
            "model": str(robot.path),
            "keyframe": keyframe,
            "digest": robot.digest,
            "physics_step": robot.model.opt.timestep,
            "degrees_of_freedom": int(robot.model.nv),
            "engines": engines(robot),
            "on_stand": _check_loop.as_json(known),
            "on_stand_not_known": known if isinstance(known, str) and known else None,
            "joints": _rows(robot),
            "findings": [asdict(item) for item in robot.findings],
        },
        indent=2,
        allow_nan=False,
    )


def _as_text(robot: Robot, keyframe: str | None, known: OnStand | str) -> str:
    of_gains = _check_loop.as_text(known) or _check_loop.friction_alone(robot)
    said = [_wrapped(paragraph) for paragraph in of_gains]
    parts = [_head(robot, keyframe), *(["\n".join(said)] if said else [])]
    if robot.joints:
        parts.append(_joint_table(robot))
    if robot.findings:
        parts.append(_finding_list(robot.findings))
    parts.append(_foot(robot))
    return "\n\n".join(parts)


def _head(robot: Robot, keyframe: str | None) -> str:
    model = robot.model
    lines = [
        str(robot.path),
        f"{_count(len(robot.joints), 'driven joint')}, nv = {model.nv}, "
        f"{_count(model.nactuator, 'actuator')}, physics step {model.opt.timestep * 1e3:g} ms",
    ]
    names = [model.key(index).name or str(index) for index in range(model.nkey)]
    posture = f"keyframe {keyframe}" if keyframe is not None else "default posture"
    others = [name for name in names if name != keyframe]
    if others:
        posture += f"; --keyframe takes {', '.join(others)}"
    return "\n".join([*lines, posture])


def _foot(robot: Robot) -> str:
    able = engines(robot)
    lines = [] if robot.findings else ["No field of the model is ignored."]
    lines.append(f"engines: {', '.join(able) if able else 'none can simulate it as it is'}")
    patterns = _way_out(robot)
    if patterns:
        chosen = " ".join(map(shlex.quote, patterns))
        lines.append(f"to leave undriven what cannot be driven: --joints {chosen}")
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


def _joint_table(robot: Robot) -> str:
    from rich import box
    from rich.table import Table

    rows = _rows(robot)
    named = any(row["actuator"] != row["name"] for row in rows)
    delayed = any(row["delay"] or row["setpoint_delay"] for row in rows)
    lagged = any(row["natural_frequency"] for row in rows)
    damped = any(row["joint_damping"] for row in rows)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("joint", overflow="fold")
    if named:
        table.add_column("actuator", overflow="fold")
    units = ("found", "kp", "kd", "force", "setpoint", "inertia", "bandwidth")
    for name in units:
        table.add_column(name, justify="left" if name == "found" else "right", no_wrap=True)
    if damped:
        table.add_column("damping", justify="right", no_wrap=True)
    if delayed:
        table.add_column("delay", justify="right", no_wrap=True)
    if lagged:
        table.add_column("force loop", justify="right", no_wrap=True)
    for row in rows:
        cells = [row["name"], *([row["actuator"]] if named else []), row["kind"]]
        cells += [_short(row["kp"]), _short(row["kd"])]
        cells += [_range(row["force_limits"]), _range(row["setpoint_limits"])]
        cells += [_short(row["inertia"]), _short(row["bandwidth"])]
        cells += [_short(row["joint_damping"])] if damped else []
        cells += [_delay(row)] if delayed else []
        cells += [_loop(row)] if lagged else []
        table.add_row(*cells)
    note = (
        "SI units and rad, at the joint; inertia with all else free and no contact; bandwidth in "
        "rad/s,\nwhere the gain of kp + kd s on this inertia is 1."
    )
    if damped:
        note += " damping: the joint's own."
    if not any(row["kp"] or row["kd"] for row in rows):
        note += " No gains in the model: give kp and kd."
    return _rendered(table) + "\n" + note


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
    if row["delay"]:
        return f"{row['delay'] * 1e3:.3g} ms"
    return f"{row['setpoint_delay'] * 1e3:.3g} ms (setpoint)" if row["setpoint_delay"] else _NONE


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


def _rendered(table: Any) -> str:
    from rich.console import Console

    console = Console(width=_width(), highlight=False)
    with console.capture() as captured:
        console.print(table)
    return "\n".join(line.rstrip() for line in captured.get().splitlines()).strip("\n")
