"""Drives as files for simulators in torch: one self-contained Python source.

It has the drive's recursion and the framework's actuator class, both from
`jaxact.environments.torch_sources`, and below them the configuration of these joints.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from jaxact.loops.joint_ranges import (
    HIGHEST_FORCE,
    HIGHEST_SETPOINT,
    LOWEST_FORCE,
    LOWEST_SETPOINT,
)
from jaxact.parameters import (
    CONTROL_RATE,
    DELAYS,
    ERRORS,
    FEEDFORWARD,
    FORCE_LIMIT,
    GAIN_SCALE,
    KD,
    KP,
    LIMITS,
    PARAMETERS,
    VELOCITY_FILTER,
    WN,
    ZETA,
)

RANGED = (
    WN, ZETA, *DELAYS, *LIMITS, GAIN_SCALE, FEEDFORWARD, *ERRORS, VELOCITY_FILTER,
)  # fmt: skip
"""The parameters of a drive that a range can be given of."""
TAKEN = (KP, KD, CONTROL_RATE, *RANGED)
"""The parameters that such a file has a place for."""
NO_RANGES = {
    LOWEST_FORCE: -math.inf, HIGHEST_FORCE: math.inf, LOWEST_SETPOINT: -math.inf,
    HIGHEST_SETPOINT: math.inf,
}  # fmt: skip
"""What a joint's ranges of force and setpoint are where it has none."""
_DEFAULTS = {name: PARAMETERS[name].default for name in TAKEN} | NO_RANGES
_GAINS = (KP, KD, FORCE_LIMIT)  # of the framework's own class
_PARTS = ("force_loop", "parameters", "recursion")
_PACKAGE = "jaxact.environments.torch_sources"


@dataclass(frozen=True)
class Framework:
    """Where an actuator class goes.

    Attributes:
        title: with the versions whose signatures are followed.
        patterns: what its configurations call the joints.
        use: what is done with the configuration.
    """

    title: str
    patterns: str
    use: str


FRAMEWORKS = {
    "mjlab": Framework(
        "mjlab 1.6", "target_names_expr", "EntityArticulationInfoCfg(actuators=ACTUATORS)"
    ),
    "isaaclab": Framework(
        "Isaac Lab 2.3 and 3.0 (explicit actuators)", "joint_names_expr",
        "ArticulationCfg(..., actuators=ACTUATORS)",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class JointDrives:
    """The drives of joints.

    Attributes:
        patterns: one for each joint, that matches its name in full.
        low, high: ends of each parameter's range by short name, and of the names of `NO_RANGES`
            the joints' own, alike in both; shape (joints,).
        velocity: that the controllers see, "sampled" or "differenced".
        left_out: what a drive in such a file has no place for, in words.
        rated: the control rate was given, and is not that of the physics steps whatever they are.
    """

    patterns: tuple[str, ...]
    low: Mapping[str, np.ndarray]
    high: Mapping[str, np.ndarray]
    velocity: str
    left_out: tuple[str, ...] = ()
    rated: bool = False

    @property
    def bare(self) -> bool:
        """Whether there is nothing beyond gains, a force limit, and ranges of the joints."""
        few = (*_GAINS, CONTROL_RATE, *NO_RANGES)
        own = (name for name in self.low if name not in few)
        plain = self.velocity == "sampled" and not self.rated
        return plain and all(
            np.all(side[name] == _DEFAULTS[name]) for name in own for side in (self.low, self.high)
        )

    @property
    def one_sided(self) -> bool:
        """Whether a force limit differs by direction, which gains have no place for."""
        return bool(np.isfinite([self.low[LOWEST_FORCE], self.low[HIGHEST_FORCE]]).any())


def text(drives: JointDrives, kind: str, comments: Sequence[str]) -> str:
    """The content of a file.

    Args:
        drives: of the joints.
        kind: of `FRAMEWORKS`.
        comments: at the top.
    """
    framework = FRAMEWORKS[kind]
    head = [*comments, f"For {framework.title}: {framework.use}"]
    imports, body = _sources((*_PARTS, kind))
    groups = list(_groups(drives, framework.patterns))
    if kind == "mjlab":
        rows = "".join(f"    {_call(group)},\n" for group in groups)
        configuration = f"ACTUATORS = (\n{rows})\n"
    else:
        rows = "".join(f'    "drive_{i}": {_call(group)},\n' for i, group in enumerate(groups))
        configuration = f"ACTUATORS = {{\n{rows}}}\n"
    lines = "".join(f"# {' '.join(one.split())}\n" for one in head)
    return f"{lines}\n{imports}\n\n{body}\n\n{configuration}"


def _sources(names: Sequence[str]) -> tuple[str, str]:
    """The imports of several sources, and what stands below them."""
    wanted: dict[str, set[str]] = {}
    bodies = []
    for name in names:
        source = resources.files(_PACKAGE).joinpath(f"{name}.py").read_text(encoding="utf-8")
        tree = ast.parse(source)
        first, *rest = tree.body  # the docstring
        count = sum(isinstance(node, ast.Import | ast.ImportFrom) for node in rest)
        for node in rest[:count]:
            if isinstance(node, ast.ImportFrom):
                wanted.setdefault(str(node.module), set()).update(one.name for one in node.names)
            elif isinstance(node, ast.Import):
                wanted |= {one.name: set() for one in node.names}
        words = "".join(f"# {line}".rstrip() + "\n" for line in _docstring(first).splitlines())
        below = source.splitlines()[rest[count - 1].end_lineno or 0 :]
        bodies.append(words + "\n\n" + "\n".join(below).strip("\n") + "\n")
    imports = ["from __future__ import annotations\n"]
    for module, own in sorted(wanted.items(), key=lambda item: (bool(item[1]), item[0])):
        if module != "__future__" and not module.startswith(_PACKAGE):
            named = f"from {module} import {', '.join(sorted(own))}"
            imports.append(named if own else f"import {module}")
    return "\n".join(imports), "\n\n".join(bodies)


def _docstring(node: Any) -> str:
    return str(node.value.value).strip()


def _groups(drives: JointDrives, patterns: str) -> list[dict[str, Any]]:
    """Fields of the configurations of joints that are alike."""
    found: dict[tuple[Any, ...], list[str]] = {}
    for i, pattern in enumerate(drives.patterns):
        ends = tuple(
            (float(drives.low[name][i]), float(drives.high[name][i])) for name in _DEFAULTS
        )
        found.setdefault(ends, []).append(pattern)
    groups = []
    for ends, own in found.items():
        low, high = (
            {name: e[side] for name, e in zip(_DEFAULTS, ends, strict=True)} for side in (0, 1)
        )
        parts = {
            name: _number(low[name], high[name])
            for name in (*RANGED, *NO_RANGES, CONTROL_RATE)
            if (low[name], high[name]) != (_DEFAULTS[name],) * 2 or name == CONTROL_RATE
        }
        limit = parts.pop(FORCE_LIMIT) if low[FORCE_LIMIT] == high[FORCE_LIMIT] < math.inf else ""
        if drives.velocity != "sampled":
            parts["velocity"] = repr(drives.velocity)
        groups.append({
            patterns: repr(tuple(own) if patterns == "target_names_expr" else own),
            "stiffness": repr(low[KP]),
            "damping": repr(low[KD]),
            **({"effort_limit": limit} if limit else {}),
            "drive": "DriveParameters(\n"
            + "".join(f"            {key}={value},\n" for key, value in parts.items())
            + "        )",
        })  # fmt: skip
    return groups


def _number(low: float, high: float) -> str:
    pair = [f"{one!r}".replace("inf", "math.inf") for one in (low, high)]
    return pair[0] if low == high else f"({', '.join(pair)})"


def _call(group: Mapping[str, Any]) -> str:
    rows = "".join(f"        {key}={value},\n" for key, value in group.items())
    return f"DriveActuatorCfg(\n{rows}    )"


def pattern(name: str) -> str:
    """What matches a joint's name in full, and nothing else."""
    return re.escape(name)
