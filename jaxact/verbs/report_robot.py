"""What the report of a robot has: its loops before their controllers, and groups of its joints."""

from __future__ import annotations

import base64
import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jaxact.engines import MUJOCO
from jaxact.errors import UserError
from jaxact.loops import conversion, joint_units, reading, robots, toml
from jaxact.loops.axes import NO_AXIS
from jaxact.loops.building import loop_of, robot
from jaxact.loops.control_loop import ControlLoop
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Plant, Specification
from jaxact.parameters import KD, KP, OF_PLANT, PARAMETERS, base
from jaxact.reports.page import Content
from jaxact.robot_margins.open_loop import OpenPlant, open_loops
from jaxact.tuning.document import document as tuning_document
from jaxact.tuning.result import Tuned
from jaxact.verbs import (
    naming,
    report_run,
    report_specification,
    report_tuned_robot,
    robot_tables,
)
from jaxact.verbs.margins_of_robot import RobotLoopMargins

RATES = (50.0, 100.0, 200.0, 250.0, 500.0, 1000.0, 2000.0)
"""Control rates that one may choose beside a loop's own [Hz]."""
_MOST_LOOPS = 16
_OF_PLANT = (
    "keyframe",
    "posture",
    "joints",
    "payload_body",
    "base",
    "damping",
    "friction",
    "gains",
)
# What all loops have beside their parameters, and their margins depend on.
_OPTIONS = ("physics_step", "integrator_correction")
# What of a joint's name says which side it is on: FL_hip, left_hip, hip_l, r_sho_pitch.
_SIDE = re.compile(
    r"(?i)(?:^|(?<=[_\-. ]))(?:[fhrb]?[lr]|[lr][fhrb]|left|right|front|rear|hind|back)(?=$|[_\-. ])"
)


def groups(names: Sequence[str]) -> dict[str, list[int]]:
    """Joints that differ in their side only, by what they have in common; places of each."""
    found: dict[str, list[int]] = {}
    for place, name in enumerate(names):
        common = re.sub(r"[_\-. ]{2,}", "_", _SIDE.sub("", name)).strip("_-. ") or name
        found.setdefault(common, []).append(place)
    return found


def robot_of(subject: Any) -> tuple[ControlLoop, str, Tuned | None]:
    """The loop of a robot that a report is of, the text that described it, and its tuning.

    Args:
        subject: a loop, margins, a tuned result, the results of a sweep, or the path of a model or
            of a specification.

    Raises:
        UserError: a robot that cannot be used.
    """
    if isinstance(subject, Tuned):
        assert subject.loop is not None
        return subject.loop, "", subject
    if isinstance(subject, ControlLoop | RobotLoopMargins):
        return (subject if isinstance(subject, ControlLoop) else subject.loop), "", None
    if isinstance(subject, xr.Dataset):
        specification = reading.parse(subject.attrs["specification_toml"])
        return _specified(specification, specification.text)
    path = Path(subject)
    if path.suffix != ".toml":
        return robot(path), "", None
    return _specified(*report_specification.load(path))


def _specified(specification: Specification, text: str) -> tuple[ControlLoop, str, Tuned | None]:
    """The nominal loop of a specification with a robot, and its text as it is shown."""
    alone = dataclasses.replace(specification, axes=(NO_AXIS,), sampling=None)
    return loop_of(alone), text, None


def content(loop: ControlLoop, specified: str = "", tuned: Tuned | None = None) -> Content:
    """The page of a robot's loops.

    Args:
        loop: of a robot.
        specified: the specification that described it.
        tuned: what its gains come from, if they were tuned.

    Raises:
        UserError: too many loops, or a robot that cannot be used.
    """
    if loop.shape and np.prod(loop.shape) > _MOST_LOOPS:
        raise UserError(f"a robot's report is of at most {_MOST_LOOPS} loops; vary less")
    own = conversion.linear_specification(loop, engine=MUJOCO.name)
    plant = own.plant
    assert plant is not None
    names = robots.scene(plant).labels
    labels = naming.labels(conversion.samples(loop)) or (naming.loop_name(own),)
    data = _embedded(own, loop, labels, names)
    parts: dict[str, Any] = {}
    if tuned is not None:
        row, before = data["loops"][0], tuned.before
        row["name"] = "tuned"
        if before is not None:
            gains = {KP: np.asarray(before[0]).tolist(), KD: np.asarray(before[1]).tolist()}
            data["loops"].append(row | {"name": "before", "drives": row["drives"] | gains})
        document = tuning_document(tuned)
        parts["tuned_robot"] = report_tuned_robot.of_result(tuned, document)
    keys = {field: getattr(plant, field) for field in _OF_PLANT}
    defaults = Plant(model=plant.model)
    given = {name: value for name, value in keys.items() if value != getattr(defaults, name)}
    shown = {name: list(v) if isinstance(v, tuple) else str(v) for name, v in given.items()}
    mounting = [word for name, v in shown.items() for word in _options(name, v)]
    data |= {
        "rotary": joint_units.rotary(plant),
        "mounting": ["--model", str(plant.model), *mounting],
        "plant": toml.dumps({"plant": {"model": str(plant.model), **shown}}),
        "patterns": [re.escape(name) for name in names],
    }
    head = robot_tables.title(own)
    return Content(
        title=f"Tuned: {tuned.verdict}" if tuned is not None else f"Robot: {head}",
        description=f"{head}; linearised, {report_run.counted(len(names), 'joint')},"
        f" velocity {loop.kind.velocity}",
        parts=parts | {"robot": data},
        made={"Specification": specified} if specified else {},
    )


def _options(name: str, value: Any) -> list[str]:
    """A key of a [plant] as an option of the command line."""
    if name == "payload_body":
        return ["--set", f"plant.payload_body={value}"]
    return [f"--{name}", *([value] if isinstance(value, str) else value)]


def _embedded(
    specification: Specification, loop: ControlLoop, labels: Sequence[str], names: Sequence[str]
) -> dict[str, Any]:
    """Every loop of a batch, its plants stored once each."""
    plants: dict[str, int] = {}
    stored: list[dict[str, Any]] = []

    def number(plant: OpenPlant) -> int:
        made = _plant(plant)
        key = f"{plant.step} {plant.substeps} {made['triangular']} {made['inputs']}"
        if key not in plants:
            plants[key] = len(stored)
            stored.append(made)
        return plants[key]

    samples = conversion.samples(loop)
    opened = open_loops(specification, samples, RATES)
    changes = _changes(specification, samples)
    rows = [
        {
            "name": label,
            "drives": {name: array.tolist() for name, array in one.drives.items()},
            "rate": one.rate,
            "changes": changed,
            "plants": {f"{rate:.10g}": number(plant) for rate, plant in one.plants.items()},
        }
        for label, one, changed in zip(labels, opened, changes, strict=True)
    ]
    options = {name: getattr(loop.kind, name) for name in _OPTIONS}
    return {
        "joints": list(names),
        "groups": groups(names),
        "velocity": loop.kind.velocity,
        "options": {name: value for name, value in options.items() if value},
        "loops": rows,
        "plants": stored,
    }


def _changes(specification: Specification, samples: Samples) -> list[dict[str, float]]:
    """What each loop changes in its robot's model, by key, later ones over earlier ones."""
    keys = [key for key in specification.nominal if base(key) in OF_PLANT]
    columns = samples.take(np.arange(len(samples)), keys)
    # A key of some joints is not a number in a loop that does not have it.
    return [
        {
            key: float(columns[key][row])
            for key in keys
            if not np.isnan(columns[key][row])
            and ("@" in key or columns[key][row] != PARAMETERS[key].default)
        }
        for row in range(len(samples))
    ]


def _plant(plant: OpenPlant) -> dict[str, Any]:
    outputs = np.vstack([plant.positions, plant.velocities])
    return {
        "step": float(plant.step),
        "substeps": int(plant.substeps),
        "states": len(plant.triangular),
        "triangular": _text(plant.triangular),
        "inputs": _text(plant.inputs),
        "outputs": _text(outputs),
        "hidden": _text(plant.hidden),
        "inertias": plant.inertias.tolist(),
    }


def _text(values: np.ndarray) -> str:
    """Complex numbers as base64: float64, least significant byte first, real parts first."""
    parts = np.stack([values.real, values.imag]).astype("<f8")
    return base64.b64encode(parts.tobytes()).decode()
