"""`jaxact simulate`: one loop over time."""

from __future__ import annotations

import dataclasses
import json as _json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from tyro.conf import OmitArgPrefixes, UseAppendAction, arg

from jaxact.cli import _files, _loops, _mounting, _single, _starts, _warnings, _xla
from jaxact.errors import UserError
from jaxact.parameters import PARAMETERS
from jaxact.verbs import naming

if TYPE_CHECKING:
    from jaxact.loops.specification import Specification
    from jaxact.plotting.trajectory import Joint
    from jaxact.robot_margins.stiction import Stiction
    from jaxact.simulation.single import Single

Parameters = _loops.options(PARAMETERS, several=False)
# What only a step that comes to rest has.
_OF_A_STEP = ("overshoot", "rise_time", "settling_time")
_SIGNALS = {
    "setpoint": "{0}", "position": "{0}", "velocity": "{0}/s", "command": "{1}",
    "delayed_command": "{1}", "force": "{1}",
}  # fmt: skip


def main(
    parameters: Annotated[Parameters, OmitArgPrefixes] = Parameters(),  # type: ignore[valid-type] # noqa: B008
    *,
    spec: Annotated[
        Path | None,
        arg(
            metavar="FILE",
            help="Specification of a sweep to start from: its fixed values are taken.",
            help_behavior_hint="(default: none)",
        ),
    ] = None,
    set: Annotated[  # noqa: A002 - the option's name
        UseAppendAction[tuple[str, ...]],
        arg(metavar="KEY=VALUE", help="Change the specification; as for `jaxact sweep`."),
    ] = (),
    engine: Annotated[
        str | None,
        arg(
            metavar="mass|mjx|mujoco|warp|auto",
            help="Plant: an exact mass; MuJoCo in JAX, in C, or in Warp; or the fastest of these.",
            help_behavior_hint="(default: mass; auto for a model)",
        ),
    ] = None,
    model: Annotated[
        Path | None,
        arg(
            metavar="FILE",
            help="MJCF or URDF file of a robot in place of a single joint.",
            help_behavior_hint="(default: none)",
        ),
    ] = None,
    keyframe: Annotated[
        str | None,
        arg(
            metavar="NAME",
            help="Keyframe of the model to start from.",
            help_behavior_hint="(default: the model's default posture)",
        ),
    ] = None,
    base: _mounting.Base = None,
    damping: _mounting.Damping = None,
    friction: _mounting.Friction = None,
    velocity: Annotated[
        str | None,
        arg(
            metavar="sampled|differenced",
            help="Velocity that the controller sees: sensed, or positions differenced.",
            help_behavior_hint="(default: sampled)",
        ),
    ] = None,
    duration: Annotated[
        float,
        arg(metavar="SECONDS", help="Simulated time [s].", help_behavior_hint="(default: 1)"),
    ] = _loops.UNSET,
    physics_step: Annotated[
        float,
        arg(
            metavar="SECONDS",
            help="Step of the plant [s].",
            help_behavior_hint="(default: the control period for mass, 0.00025 for mjx)",
        ),
    ] = _loops.UNSET,
    precision: Annotated[
        str | None,
        arg(
            metavar="float32|float64",
            help="Of the simulation.",
            help_behavior_hint="(default: float64; with warp float32)",
        ),
    ] = None,
    seed: Annotated[
        int, arg(metavar="NUMBER", help="Of the noise.", help_behavior_hint="(default: 0)")
    ] = _loops.UNSET_NUMBER,
    joint: Annotated[
        str, arg(metavar="NAME", help="Which driven joint of a model is drawn: name, or number.")
    ] = "0",
    out: Annotated[
        Path,
        arg(
            metavar="FILE",
            help="Picture to write: .png, .svg or .pdf; one that is there is replaced.",
        ),
    ] = Path("simulation.png"),
    csv: Annotated[
        Path | None,
        arg(
            metavar="FILE",
            help="Write the trajectory as text, units in the first line.",
            help_behavior_hint="(default: no)",
        ),
    ] = None,
    npz: Annotated[
        Path | None,
        arg(
            metavar="FILE",
            help="Write the trajectory as NumPy arrays.",
            help_behavior_hint="(default: no)",
        ),
    ] = None,
    overwrite: Annotated[bool, arg(help="Replace CSV and NPZ files that are there.")] = False,
    json: Annotated[bool, arg(help="Print the figures as JSON instead of a table.")] = False,
) -> None:
    """Simulate one loop and keep its trajectory, as a picture and as numbers.

    The loop is that of the study where nothing is given: 0.7 kg, kp 400 N/m, kd 20 N s/m, ideal
    actuator, no delay, control at 1 kHz. All units are SI, delays in seconds; for a rotary joint
    read rad and N m. Where quantisation, friction, or a robot that nothing disturbs ask for it, the
    verdict is the worst of several starts, which are listed.

    examples:
      jaxact simulate --actuator starleth --delay 0.005
      jaxact simulate --actuator hyq --kp 4000 --kd 200 --force-limit 100 --csv run.csv
      jaxact simulate --spec experiments/paper_gain_map.toml --set engine=mjx --duration 2
      jaxact simulate --model robot.xml --keyframe home --actuator hyq --delay 0.001 --npz run.npz
    """
    from jaxact.plotting import theme

    theme.check_output(out)
    for path, ending in ((csv, ".csv"), (npz, ".npz")):
        _files.check_output(path, ending, overwrite=overwrite)
    static = {
        "engine": engine, "velocity": velocity, "duration": duration,
        "physics_step": physics_step, "precision": precision, "seed": seed,
    }  # fmt: skip
    asked = {name: value for name, value in static.items() if _loops.is_given(value)}
    plant = {"model": model, "keyframe": keyframe}
    plant = {name: str(value) for name, value in plant.items() if value is not None}
    robot = model is not None or spec is not None
    plant |= _mounting.chosen(base, damping, friction, robot=robot)
    specification = _single.specification(spec, set, asked, plant, _loops.given(parameters))

    _xla.call_at_once(specification)
    from jaxact.simulation import engines, single

    specification = engines.resolved(specification)
    place = _place(single.names(specification), joint)
    run = single.simulate(specification)
    _warnings.posture(specification)
    _write(run, specification, place, out, csv, npz)
    held = _stiction(run, specification)
    if json:
        said = {} if specification.plant is None else {"stiction": _as_object(held)}
        print(_json_text(run, said))
    else:
        print("\n".join([_table(run), *_starts.lines(run)]))
    if held is not None and not json:
        print(f"The robot {held.sentence}.")
    if not json:
        print("wrote " + ", ".join(str(path) for path in (out, csv, npz) if path is not None))


def _stiction(run: Single, specification: Specification) -> Stiction | None:
    """What dry friction holds of a robot that shakes once it moves; None of anything else."""
    if specification.plant is None or not run.results["growth_rate"] > 0.0:
        return None
    from jaxact.robot_margins import stiction

    return stiction.nominal(specification)


def _place(names: Sequence[str], joint: str) -> int:
    """Number of the joint that is asked for by name or number."""
    if joint in names:
        return list(names).index(joint)
    if joint.isdigit() and int(joint) < len(names):
        return int(joint)
    raise UserError(f"--joint {joint}: the driven joints are {', '.join(names)}, or their numbers")


def _write(
    run: Single,
    specification: Specification,
    joint: int,
    out: Path,
    csv: Path | None,
    npz: Path | None,
) -> None:
    from jaxact.plotting import caption, theme
    from jaxact.plotting.trajectory import trajectory

    columns = _columns(run)
    header = ",".join(columns)
    if csv is not None:
        table = np.column_stack(list(columns.values()))
        text = {"fmt": "%.9g", "delimiter": ",", "header": header, "comments": ""}
        _files.write(csv, lambda file: np.savetxt(file, table, **text))
    if npz is not None:
        arrays = {name: value for name, value in vars(run.trajectory).items() if value is not None}
        if "configuration" in arrays:
            arrays["qpos"] = arrays.pop("configuration")
            arrays["joints"] = np.array([one.name for one in run.joints])
        arrays["parameters"] = np.array(_json.dumps(_plain(run.values)))
        _files.write(npz, lambda file: np.savez_compressed(file, **arrays))
    name = f"{run.joints[joint].name}: " if len(run.joints) > 1 else ""
    units = ("rad", "N m") if run.rotary[joint] else ("m", "N")
    figure = trajectory(
        _joint(run, joint),
        title=name + naming.loop_name(specification, run.values),
        footer=caption.loop(run.values, run.results, dataclasses.asdict(specification), units[0]),
        units=units,
        resolution=run.values["position_resolution"],
    )
    theme.write(figure, out, title="jaxact: one loop over time")


def _joint(run: Single, joint: int) -> Joint:
    from jaxact.plotting.trajectory import Joint

    rows = {name: getattr(run.trajectory, name)[:, joint] for name in _SIGNALS}
    return Joint(time=run.trajectory.time, **rows)


def _columns(run: Single) -> dict[str, np.ndarray]:
    """The trajectory with units in the names, joints numbered where there are several."""
    columns = {"time [s]": np.asarray(run.trajectory.time)}
    for joint, one in enumerate(run.joints):
        number = f" {one.name}" if len(run.joints) > 1 else ""
        units = ("rad", "N m") if one.rotary else ("m", "N")
        for name, pattern in _SIGNALS.items():
            label = f"{name.replace('_', ' ')}{number} [{pattern.format(*units)}]"
            columns[label] = getattr(run.trajectory, name)[:, joint]
    return columns


def _plain(values: dict[str, float]) -> dict[str, float | str | None]:
    """Numbers as JSON has them: infinity as "inf", what is not a number as null."""

    def plain(value: float) -> float | str | None:
        if np.isnan(value):
            return None
        return str(value) if np.isinf(value) else value

    return {name: plain(value) for name, value in values.items()}


def _as_object(held: Stiction | None) -> dict[str, Any] | None:
    from jaxact.verbs.robot_tables import as_object

    return None if held is None else as_object(held)


def _json_text(run: Single, said: dict[str, Any]) -> str:
    from jaxact.status import Verdict
    from jaxact.sweeping.store import VARIABLES, joint_units

    figures: dict[str, Any] = dict(_plain(run.results))
    figures["verdict"] = Verdict(int(run.results["verdict"])).label
    figures["units"] = {
        name: joint_units(about.units, run.rotary)
        for name, about in VARIABLES.items()
        if name in run.results and name != "verdict"
    }
    figures |= {**said, "starts": _starts.document(run), "parameters": _plain(run.values)}
    return _json.dumps(figures)


def _table(run: Single) -> str:
    """Verdict, advice and figures as a small table."""
    from rich.console import Console
    from rich.table import Table

    from jaxact.plotting.wording import quantity
    from jaxact.status import Verdict
    from jaxact.sweeping.store import VARIABLES, joint_units

    verdict = Verdict(int(run.results["verdict"]))
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_row("verdict", f"[bold]{verdict.label}[/bold]")
    for name, about in VARIABLES.items():
        value = run.results.get(name, np.nan)
        if name == "verdict" or np.isnan(value):
            continue
        if name in _OF_A_STEP and verdict is Verdict.UNSTABLE:
            continue
        units = joint_units(about.units, run.rotary)
        shown = f"{100 * value:.3g} %" if name == "overshoot" else quantity(value, units)
        table.add_row(about.long_name, shown)
    console = Console(width=100, highlight=False)
    with console.capture() as captured:
        console.print(table)
        console.print(_starts.advice(run))
    return captured.get().rstrip()
