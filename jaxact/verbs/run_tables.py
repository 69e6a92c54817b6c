"""One simulated loop as a table, as JSON, and as the columns of a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.files import plain
from jaxact.parameters import SETPOINT
from jaxact.plotting.wording import quantity
from jaxact.status import Verdict
from jaxact.sweeping.variables import VARIABLES
from jaxact.units import joint_units
from jaxact.verbs import rendering, saturated, starts

if TYPE_CHECKING:
    from jaxact.robot_margins.stiction import Stiction
    from jaxact.simulation.single import Single

SIGNALS = {
    SETPOINT: ("m", "rad", SETPOINT),
    "position": ("m", "rad", "position"),
    "velocity": ("m/s", "rad/s", "velocity"),
    "command": ("N", "N m", "command of the controller"),
    "delayed_command": ("N", "N m", "command as it reaches the actuator"),
    "force": ("N", "N m", "force on the plant"),
}
"""Signals of a trajectory: the units of a slide and of a hinge, and their names in words."""

# What only a step that does not diverge has: else it is of the explosion, or of the fall.
_OF_A_STEP = ("overshoot", "rise_time", "settling_time")


def text(run: Single) -> str:
    """Verdict, advice, metrics, and what came of each start."""
    from rich.table import Table

    table = Table(box=None, show_header=False, pad_edge=False)
    verdict = Verdict(int(run.results["verdict"]))
    table.add_row("verdict", verdict.label)
    for name, about in VARIABLES.items():
        value = run.results.get(name, np.nan)
        if name == "verdict" or np.isnan(value):
            continue
        if name in _OF_A_STEP and not verdict.bounded:
            continue
        units = joint_units(about.units, run.rotary)
        shown = f"{100 * value:.3g} %" if name == "overshoot" else quantity(value, units)
        table.add_row(about.long_name, shown)
    said = rendering.rendered(table, starts.advice(run), width=100)
    return "\n".join([said, *starts.lines(run), *saturated.lines(run)])


def as_json(
    run: Single, stiction: Stiction | None = None, changed: Mapping[str, Any] | None = None
) -> str:
    """Everything but the trajectory as one object.

    Args:
        run: of one loop.
        stiction: of a robot, what dry friction holds of it.
        changed: of a robot, from `jaxact.verbs.changed_robot.of_nominal_as_object`.
    """
    from jaxact.verbs import robot_tables

    found: dict[str, Any] = plain(run.results)
    found["verdict"] = Verdict(int(run.results["verdict"])).label
    found["units"] = {
        name: joint_units(about.units, run.rotary)
        for name, about in VARIABLES.items()
        if name in run.results and name != "verdict"
    }
    if run.trajectory.configuration is not None:  # of a robot
        found["stiction"] = None if stiction is None else robot_tables.as_object(stiction)
        found["saturated"] = [run.joints[place].name for place in saturated.joints(run)]
        found |= changed or {}
    found |= {"starts": starts.document(run), "parameters": plain(run.values)}
    return json.dumps(found)


def columns(run: Single) -> dict[str, np.ndarray]:
    """The trajectory with units in the names, joints named where there are several."""
    found = {"time [s]": np.asarray(run.trajectory.time)}
    for joint, one in enumerate(run.joints):
        name = f" {one.name}" if len(run.joints) > 1 else ""
        for signal, (slide, hinge, _) in SIGNALS.items():
            label = f"{signal.replace('_', ' ')}{name} [{hinge if one.rotary else slide}]"
            found[label] = getattr(run.trajectory, signal)[:, joint]
    return found


def arrays(run: Single) -> dict[str, np.ndarray]:
    """The trajectory, and the parameters as JSON; of a robot `qpos` and the names of `joints`."""
    found = {name: value for name, value in vars(run.trajectory).items() if value is not None}
    if "configuration" in found:
        found["qpos"] = found.pop("configuration")
        found["joints"] = np.array([one.name for one in run.joints])
    return found | {"parameters": np.array(json.dumps(plain(run.values)))}
