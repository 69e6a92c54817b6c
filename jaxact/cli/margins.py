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
from jaxact.verbs.margin_tables import ALWAYS, MARGINS, UNITS, Figures, masked, plain, tables

# Parameters of the linear loop that identify it in files.
_PARAMETERS = (*_loops.LINEAR, "control_rate")


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

    from jaxact.sweeping import atomic_store

    _files.check_output(csv, ".csv", overwrite=overwrite)
    asked = chosen_loops(parameters, loops, velocity)
    chosen = asked.loops

    from jaxact.verbs import responses as _responses

    found = {"": _responses.margins(chosen)}
    if asked.sampled:
        found["sampled_"] = _responses.sampled_margins(chosen, asked.velocity)
    if csv is not None:
        _files.write(csv, lambda file: file.write(_csv_text(chosen, found).encode()))
    if store is not None:
        with atomic_store.destination(store, overwrite=overwrite) as partial:
            grid = loops is not None and chosen.source is not None
            atomic_store.write((_grid if grid else _dataset)(chosen, found), partial)
    print(
        _json_lines(chosen, found)
        if json
        else tables(chosen.labels, chosen.values["control_rate"], found)
    )
    if not json and (csv or store):
        print("wrote " + ", ".join(str(path) for path in (csv, store) if path is not None))


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
        f"{prefix}{name}": ("loop", masked(name, figures), {"units": UNITS[name]})
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
        f"{prefix}{name}": (masked(name, figures), UNITS[name])
        for prefix, figures in found.items()
        for name in (*ALWAYS, *MARGINS)
    }
    return margins_store.dataset(
        *chosen.source, figures,
        kind=margins_store.SAMPLED if sampled else margins_store.CONTINUOUS,
        growth_rate=last["spectral_abscissa"], stable=last["stable"],
    )  # fmt: skip
