"""The robots, what they do, and the drives that carry it out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from jaxact.loops import reading
from jaxact.loops.samples import Samples, explicit
from jaxact.loops.specification import Specification
from jaxact.plants.mjx import plant as mjx

HERE = Path(__file__).resolve().parent
_QUADRUPED = HERE.parent / "quadruped"
_HUMANOID = Path(mujoco.__file__).parent / "mjx" / "test_data" / "humanoid"

MODELS = {
    "slide": mjx.SLIDE.parent,
    "pendulum": HERE,
    "quadruped_hung": _QUADRUPED,
    "humanoid_air": _HUMANOID,
    "quadruped_stand": _QUADRUPED,
    "humanoid_squat": _HUMANOID,
}
"""Folder of each specification's model."""

FREE = ("slide", "pendulum", "quadruped_hung", "humanoid_air")
"""Those that touch nothing; their positions are compared."""

STANDING = ("quadruped_stand", "humanoid_squat")
"""Those with contacts; maps of their verdicts are compared."""

DRIVES = (("ideal", 0.005), ("hyq", 0.001), ("hyq", 0.005))
"""Actuators and the delays of their commands [s]."""


def load(name: str, *settings: str) -> Specification:
    """A specification of this folder.

    settings: `key=value` each, over the file
    """
    text = (HERE / f"{name}.toml").read_text(encoding="utf-8")
    return reading.parse(text, MODELS[name], settings)


def loops(specification: Specification, **columns: np.ndarray) -> Samples:
    """Every drive with these values, drive after drive; what the file varies is not varied.

    columns: values of a parameter, shape (n,) each
    """
    count = max((len(values) for values in columns.values()), default=1)
    actuators, delays = zip(*DRIVES, strict=True)
    drives = {"actuator": np.repeat(actuators, count), "delay": np.repeat(delays, count)}
    spread = {name: np.tile(values, len(DRIVES)) for name, values in columns.items()}
    return explicit(replace(specification, axes=()), drives | spread)
