"""Gains in configurations of simulators: legged_gym's, Isaac Lab's, mjlab's."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxact.errors import UserError, shown
from jaxact.gains.deployment import number
from jaxact.gains.table import Entry, GainFile
from jaxact.parameters import FORCE_LIMIT, KD, KP

# What a group of joints calls its patterns: whose configuration it is.
PATTERNS = {"joint_names_expr": "isaaclab", "target_names_expr": "mjlab"}
# Names of the drive's parameters; of several for one the first that is given counts.
LIMITS = ("actuator_effort_limit", "effort_limit", "effort_limit_sim", "joint_effort_limit")
_FIELDS = {KP: ("stiffness",), KD: ("damping",), FORCE_LIMIT: LIMITS}
OF_CONTROL = ("action_scale", "decimation", "control_type")
AT_REST = "init_state.joint_pos"
# Isaac Lab's default where there is no limit.
_UNLIMITED = 1e9
# What is not a parameter of the drive, or is the model's own.
NOT_TAKEN = (
    "armature", "friction", "frictionloss", "viscous_damping", "velocity_limit",
    "velocity_limit_sim", "saturation_effort", "min_delay", "max_delay", "delay_min_lag",
    "delay_max_lag", "joint_parameter_lookup", AT_REST, *OF_CONTROL,
)  # fmt: skip
# Stands for a value that only running the file would tell.
WORKED_OUT = "worked out"


def legged_gym(path: Path, document: Mapping[str, Any]) -> GainFile | None:
    """Of `control: stiffness, damping`, parts of names -> number; None where there is none.

    As legged_gym reads it, a joint gets the numbers of the last key of stiffness that is part of
    its name, and keys that damping alone has are not used.
    """
    control = document.get("control", document)
    if not isinstance(control, Mapping):
        return None
    tables = [control.get("stiffness"), control.get("damping")]
    if not all(isinstance(one, Mapping) and one for one in tables):
        return None
    stiffness, damping = tables
    for key in stiffness:  # type: ignore[union-attr]
        if key not in damping:  # type: ignore[operator]
            raise UserError(f"{path}: {shown(key)} is in stiffness and not in damping; add it")
    entries = [  # in the order of stiffness, which is the one that legged_gym goes by
        Entry(parameter, str(key), number(path, f"{name}[{key!r}]", table[key]))  # type: ignore[index]
        for parameter, name, table in ((KP, "stiffness", stiffness), (KD, "damping", damping))
        for key in stiffness  # type: ignore[union-attr]
    ]
    known = control if "control" in document else OF_CONTROL  # a document has much else
    left = [
        str(key) for key in known
        if key not in ("stiffness", "damping") and control.get(key) not in (None, {}, 0, "P")
    ]  # fmt: skip
    if control is not document:
        left += beside(document)
    left += [f"damping of {shown(key)}" for key in damping if key not in stiffness]  # type: ignore
    notes = (f"not taken from it: {', '.join(left)}",) if left else ()
    return GainFile(path, "legged-gym", tuple(entries), "part", notes)


def beside(document: Mapping[str, Any]) -> list[str]:
    """What a document has for the whole robot that gains do not carry: periods, scales, a pose."""
    places = [("decimation",), ("action_scale",), ("sim", "dt"), ("sim", "mujoco", "timestep"),
              ("init_state", "default_joint_angles")]  # fmt: skip
    actions = document.get("actions")
    for name in actions if isinstance(actions, Mapping) else ():
        places.append(("actions", name, "scale"))
    found = []
    for place in places:
        part: Any = document
        for key in place:
            part = part.get(key) if isinstance(part, Mapping) else None
        if part not in (None, {}):
            found.append(".".join(map(str, place)))
    return found


def groups(
    path: Path,
    found: Sequence[tuple[str, Mapping[str, Any]]],
    robots: Sequence[str] = (),
    more: Sequence[str] = (),
) -> GainFile:
    """Of groups of actuators, each with patterns of joints.

    Args:
        path: of the file.
        found: name and fields of each group.
        robots: as many names of the robots that they belong to, where there may be several.
        more: what else the file has that gains do not carry.

    Raises:
        UserError: a field is not what it should be.
    """
    kinds = {PATTERNS[key] for _, fields in found for key in PATTERNS if key in fields}
    entries = tuple(
        replace(entry, robot=robot)
        for (name, fields), robot in zip(found, robots or [""] * len(found), strict=True)
        for entry in _entries(path, name, fields)
    )
    left = dict.fromkeys(
        key for key in NOT_TAKEN for _, fields in found if fields.get(key) not in (None, {}, 0)
    )
    left |= dict.fromkeys(
        f"{key} ({WORKED_OUT} when the file runs)"
        for _, fields in found for key in LIMITS if fields.get(key) == WORKED_OUT
    )  # fmt: skip
    left |= dict.fromkeys(more)
    notes = (f"not taken from it: {', '.join(left)}",) if left else ()
    return GainFile(
        path, "mjlab" if kinds == {"mjlab"} else "isaaclab", entries, "pattern", notes,
        later_wins=False,
    )  # fmt: skip


def _entries(path: Path, group: str, fields: Mapping[str, Any]) -> Iterator[Entry]:
    key = next(key for key in PATTERNS if key in fields)
    within = fields[key]
    within = [within] if isinstance(within, str) else within
    if not isinstance(within, list | tuple) or not all(isinstance(one, str) for one in within):
        raise UserError(f"{path}: {group}: {key} = {shown(within)}; give a list of patterns")
    for parameter, names in _FIELDS.items():
        given = [name for name in names if fields.get(name) not in (None, WORKED_OUT)]
        if not given:
            if parameter == FORCE_LIMIT:
                continue
            raise UserError(f"{path}: {group}: has no {names[0]}, so its gains are not known")
        value = fields[given[0]]
        if isinstance(value, Mapping):
            rows = list(value.items())
        else:
            rows = [(one, value) for one in within]
        for pattern, one in rows:
            read = number(path, f"{group}: {given[0]}", one)
            if parameter == FORCE_LIMIT and read >= _UNLIMITED:
                read = math.inf
            yield Entry(parameter, str(pattern), read, tuple(within))
