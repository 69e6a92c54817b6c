"""`jaxact margins`: all stability margins of loops."""

from __future__ import annotations

import csv as _csv
import io
import json as _json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import OmitArgPrefixes, arg

from jaxact.cli import _files, _loops, _robot_margins
from jaxact.cli._pictures import Linear, LoopsFile, Velocity, chosen_loops
from jaxact.errors import UserError

# Names of the output, in order. Margins mean nothing for an unstable loop, the others always do.
ALWAYS = ("stable", "unstable_roots", "log_gain_to_boundary", "spectral_abscissa")
MARGINS = (
    "gain_margin", "gain_reduction_margin", "phase_crossover", "phase_margin", "gain_crossover",
    "delay_margin", "sensitivity_peak", "sensitivity_peak_frequency", "complementary_peak",
    "complementary_peak_frequency", "modulus_margin", "disk_margin",
)  # fmt: skip
UNITS = {
    "stable": "1", "unstable_roots": "1", "log_gain_to_boundary": "1", "spectral_abscissa": "1/s",
    "gain_margin": "1", "gain_reduction_margin": "1", "phase_crossover": "rad/s",
    "phase_margin": "degree", "gain_crossover": "rad/s", "delay_margin": "s",
    "sensitivity_peak": "1", "sensitivity_peak_frequency": "rad/s", "complementary_peak": "1",
    "complementary_peak_frequency": "rad/s", "modulus_margin": "1", "disk_margin": "1",
}  # fmt: skip
_MOST_COLUMNS = 4
# Parameters of the linear loop that identify it in files.
_PARAMETERS = (*_loops.LINEAR, "control_rate")

Figures = dict[str, np.ndarray]


def main(
    parameters: Annotated[Linear, OmitArgPrefixes] = Linear(),  # type: ignore[valid-type] # noqa: B008
    robot: Annotated[_robot_margins.Options, OmitArgPrefixes] = _robot_margins.Options(),  # noqa: B008
    *,
    loops: LoopsFile = None,
    velocity: Velocity = "sampled",
    json: Annotated[bool, arg(help="Print one JSON object a loop, one a line.")] = False,
    csv: Annotated[
        Path | None,
        arg(metavar="FILE", help="Write a CSV file.", help_behavior_hint="(default: no)"),
    ] = None,
    store: Annotated[
        Path | None,
        arg(metavar="DIR", help="Write a Zarr v3 store.", help_behavior_hint="(default: no)"),
    ] = None,
    overwrite: Annotated[bool, arg(help="Replace a CSV file or a store that is there.")] = False,
) -> None:
    """Compute all stability margins of one loop or thousands, with the exact delay, or of a robot.

    Every option of a loop takes several values; all combinations are computed. With
    --control-rate the margins of the sampled loop are given beside those in continuous time. Units
    are SI: frequencies rad/s, delays s; phase margins are in degrees.

    gain margin: smallest factor above 1 on all gains that destabilises. delay margin: smallest
    added delay that does. Ms, Mt: peaks of |S| and |T|. disk margin: 1/max|S - 1/2|, balanced.
    Margins of an unstable loop mean nothing and are left out; log_gain_to_boundary, the logarithm
    of the factor on all gains to the nearest boundary, is negative there.

    With --model: a robot, linearised at a posture, sampled at its control rate (1 kHz where none is
    given), gains and delays those the model brings where none are given. Of each joint with all
    others closed, the margins above; of all joints at once, peaks of the largest singular values of
    S and T, the multi-loop disk margin, a common factor on all gains (also downwards: at low gain
    gravity topples a robot), a common delay.

    JSON of a robot: model, keyframe, posture, base, damping, friction, loop, engine,
    dry_friction_left_out, stiction (joint, push, strongest, shaking, amplitude, frequency,
    sentence; null where friction holds nothing that shakes), residual, neutral_directions,
    control_period, physics_step, stable, unstable_roots, spectral_radius, growth_rate,
    gain_to_boundary, log_gain_to_boundary, verdict (stable, shakes, topples, shakes and topples),
    shaking_rate, toppling_rate; changes (more_gain, less_gain, more_delay, less_delay,
    topple_more_gain, topple_less_gain: value, frequency, participation of the nearest factor or
    delay at which it begins or ceases to shake or topple); all (null if unstable) with gain_margin,
    gain_reduction_margin, delay_margin, sensitivity_peak, complementary_peak, disk_margin and the
    frequency of each, modulus_margin, unscaled_disk_margin; joints with name, kp, kd and the
    margins above; ranking (names, the one that shakes first at the top); critical_mode,
    slowest_mode, response_at_peak with growth_rate, frequency, damping_ratio, participation by
    joint.

    examples:
      jaxact margins --mass 0.7 --kp 400 --kd 20 --actuator starleth --delay 5e-3
      jaxact margins --actuator hyq starleth --delay 0 0.001 0.005 --control-rate 1000
      jaxact margins --loops loops.toml --json
      jaxact margins --loops sweep.toml --store margins.zarr  # for plot --variable gain_margin
      jaxact margins --model robot.xml --keyframe home --actuator hyq --delay 0.001
      jaxact margins --model robot.xml --kp 300 --kd 15 --set 'kp@.*_knee=500' --out margins.png
    """
    if _robot_margins.asked(robot):
        for name, unfit in (("loops", loops), ("csv", csv), ("store", store)):
            if unfit is not None:
                raise UserError(f"--{name}: is for single joints; a robot's figures come as --json")
        _robot_margins.show(robot, _loops.given(parameters), velocity, json=json)
        return

    from jaxact.sweeping import at_once

    _files.check_output(csv, ".csv", overwrite=overwrite)
    asked = chosen_loops(parameters, loops, velocity)
    chosen = asked.loops

    from jaxact.cli import _responses

    found = {"": _responses.margins(chosen)}
    if asked.sampled:
        found["sampled_"] = _responses.sampled_margins(chosen, asked.velocity)
    if csv is not None:
        _files.write(csv, lambda file: file.write(_csv_text(chosen, found).encode()))
    if store is not None:
        with at_once.destination(store, overwrite=overwrite) as partial:
            grid = loops is not None and chosen.source is not None
            at_once.write((_grid if grid else _dataset)(chosen, found), partial)
    print(_json_lines(chosen, found) if json else _tables(chosen, found))
    if not json and (csv or store):
        print("wrote " + ", ".join(str(path) for path in (csv, store) if path is not None))


def plain(name: str, figures: Mapping[str, np.ndarray], index: int) -> Any:
    """One figure of one loop as JSON has it: null where it means nothing, "inf" for infinity."""
    value = figures[name][index].item()
    if name == "stable":
        return bool(value)
    if name == "unstable_roots":
        return int(value)
    meaningless = name in MARGINS and not figures["stable"][index]
    if meaningless or math.isnan(value):
        return None
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return value


def _json_lines(chosen: _loops.Loops, found: Mapping[str, Figures]) -> str:
    lines = []
    for index, label in enumerate(chosen.labels):
        names = (*ALWAYS[:2], *MARGINS, *ALWAYS[2:])
        row: dict[str, Any] = {name: plain(name, found[""], index) for name in names}
        if "sampled_" in found:
            row["sampled"] = {name: plain(name, found["sampled_"], index) for name in names}
            row["sampled"]["spectral_radius"] = plain("spectral_radius", found["sampled_"], index)
        row["loop"] = {"name": label} | {
            name: _number(float(chosen.values[name][index])) for name in _PARAMETERS
        }
        lines.append(_json.dumps(row, allow_nan=False))
    return "\n".join(lines)


def _number(value: float) -> float | str:
    return value if math.isfinite(value) else "inf"


def _csv_text(chosen: _loops.Loops, found: Mapping[str, Figures]) -> str:
    """A header, then one line a loop; empty where a figure means nothing."""
    text = io.StringIO()
    writer = _csv.writer(text, lineterminator="\n")
    names = (*ALWAYS, *MARGINS)
    writer.writerow(
        ["name", *_PARAMETERS, *(f"{prefix}{name}" for prefix in found for name in names)]
    )
    for index, label in enumerate(chosen.labels):
        cells = [plain(name, figures, index) for figures in found.values() for name in names]
        own = [_number(float(chosen.values[name][index])) for name in _PARAMETERS]
        writer.writerow([label, *own, *("" if cell is None else cell for cell in cells)])
    return text.getvalue()


def _dataset(chosen: _loops.Loops, found: Mapping[str, Figures]) -> Any:
    import xarray as xr

    from jaxact import __version__
    from jaxact.parameters import PARAMETERS

    arrays = {
        f"{prefix}{name}": ("loop", _masked(name, figures), {"units": UNITS[name]})
        for prefix, figures in found.items()
        for name in (*ALWAYS, *MARGINS)
    }
    coords: dict[str, Any] = {
        name: ("loop", chosen.values[name], dict(PARAMETERS[name].attributes))
        for name in _PARAMETERS
    }
    coords["name"] = ("loop", np.array(chosen.labels, dtype=object))
    title = "stability margins of a joint's closed loops"
    return xr.Dataset(arrays, coords, {"title": title, "jaxact_version": __version__})


def _grid(chosen: _loops.Loops, found: Mapping[str, Figures]) -> Any:
    """The same over the axes of a specification, for `jaxact plot`."""
    from jaxact.sweeping import margins_store

    assert chosen.source is not None
    sampled = "sampled_" in found
    last = found["sampled_" if sampled else ""]
    figures = {
        f"{prefix}{name}": (_masked(name, figures), UNITS[name])
        for prefix, figures in found.items()
        for name in (*ALWAYS, *MARGINS)
    }
    return margins_store.dataset(
        *chosen.source, figures,
        kind=margins_store.SAMPLED if sampled else margins_store.CONTINUOUS,
        growth_rate=last["spectral_abscissa"], stable=last["stable"],
    )  # fmt: skip


def _masked(name: str, figures: Figures) -> np.ndarray:
    values = np.asarray(figures[name])
    return np.where(figures["stable"], values, np.nan) if name in MARGINS else values


def _tables(chosen: _loops.Loops, found: Mapping[str, Figures]) -> str:
    """A column for each of a few loops, a line for each of many."""
    from rich.console import Console

    columns = len(chosen) * len(found)
    table = _tall(chosen, found) if columns <= _MOST_COLUMNS else _wide(chosen, found)
    console = Console(width=30 + 26 * max(columns, 4), highlight=False)
    with console.capture() as captured:
        console.print(table)
    return "\n".join(line.rstrip() for line in captured.get().rstrip().splitlines())


def _tall(chosen: _loops.Loops, found: Mapping[str, Figures]) -> Any:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    cells = []
    for index, label in enumerate(chosen.labels):
        for prefix, figures in found.items():
            kind = f"\n{'sampled' if prefix else 'continuous'}" if len(found) > 1 else ""
            table.add_column(f"{label}{kind}", justify="right")
            cells.append(_column(figures, index, float(chosen.values["control_rate"][index]),
                                 periods=len(found) > 1))  # fmt: skip
    for name in cells[0]:
        if any(cell[name] for cell in cells):
            table.add_row(name, *(cell[name] or "-" for cell in cells))
    return table


def _column(figures: Figures, index: int, rate: float, *, periods: bool) -> dict[str, str]:
    """One loop's figures in words, by what they are called; "" where one means nothing."""
    from jaxact.plotting.wording import quantity

    def value(name: str) -> float:
        meaningless = name in MARGINS and not figures["stable"][index]
        return math.nan if meaningless else float(figures[name][index])

    def text(name: str, units: str = "") -> str:
        return "" if math.isnan(value(name)) else quantity(value(name), units)

    def at(name: str) -> str:
        return f" at {text(name, 'rad/s')}" if math.isfinite(value(name)) else ""

    gain, reduction, disk = (
        value("gain_margin"),
        value("gain_reduction_margin"),
        value("disk_margin"),
    )
    decibel = f" ({20.0 * math.log10(gain):.1f} dB)" if math.isfinite(gain) else ""
    phase = value("phase_margin")
    delay = value("delay_margin")
    return {
        "stable": "yes" if figures["stable"][index] else "NO",
        "unstable roots": f"{int(figures['unstable_roots'][index])}",
        "gain margin": ""
        if math.isnan(gain)
        else text("gain_margin") + decibel + at("phase_crossover"),
        "gain reduction margin": text("gain_reduction_margin") if reduction > 0 else "",
        "phase margin": "" if math.isnan(phase) else f"{phase:.4g}°{at('gain_crossover')}",
        "delay margin": text("delay_margin", "s"),
        "  in control periods": f"{delay * rate:.4g}" if periods and not math.isnan(delay) else "",
        "Ms (peak of |S|)": text("sensitivity_peak") + at("sensitivity_peak_frequency"),
        "Mt (peak of |T|)": text("complementary_peak") + at("complementary_peak_frequency"),
        "modulus margin": text("modulus_margin"),
        "disk margin": text("disk_margin"),
        "  guarantees gains": _gain_range(disk),
        "  guarantees phase": "" if math.isnan(disk) else f"±{_phase_range(disk):.3g}°",
        "rightmost root": text("spectral_abscissa", "1/s"),
        "log gain to boundary": text("log_gain_to_boundary"),
    }


def _gain_range(disk: float) -> str:
    """Gains that a balanced disk margin guarantees: (2 - a)/(2 + a) to (2 + a)/(2 - a)."""
    if math.isnan(disk):
        return ""
    high = (2.0 + disk) / (2.0 - disk) if disk < 2.0 else math.inf
    return f"×{max((2.0 - disk) / (2.0 + disk), 0.0):.3g} to ×{high:.3g}"


def _phase_range(disk: float) -> float:
    """Phase that it guarantees: 2 arctan(a / 2) [deg]."""
    return 2.0 * math.degrees(math.atan(0.5 * disk))


def _wide(chosen: _loops.Loops, found: Mapping[str, Figures]) -> Any:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    heads = ("loop", "gain margin", "phase margin [°]", "delay margin [ms]", "Ms", "Mt",
             "disk margin", "unstable roots", "log gain to boundary")  # fmt: skip
    for head in heads:
        table.add_column(head, justify="left" if head == "loop" else "right")
    for index, label in enumerate(chosen.labels):
        for prefix, figures in found.items():
            name = f"{label}, sampled" if prefix else label
            scaled = figures | {"delay_margin": 1e3 * figures["delay_margin"]}
            names = ("gain_margin", "phase_margin", "delay_margin", "sensitivity_peak",
                     "complementary_peak", "disk_margin", "unstable_roots",
                     "log_gain_to_boundary")  # fmt: skip
            table.add_row(name, *(_short(plain(item, scaled, index)) for item in names))
    return table


def _short(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value).replace("inf", "∞")
