"""The specification of a sweep: what a TOML file says.

    engine = "mjx"                                 # top level: how every loop is simulated
    [parameters]                                   # fixed values, see jaxact.sweep.parameters
    mass = 0.7
    [axes]                                         # what is varied: a list, or a range
    actuator = ["ideal", "hyq", "starleth"]
    kp = { min = 10, max = 1e5, num = 64, spacing = "log" }
    [sampling]                                     # ranges are sampled instead of gridded
    method = "sobol"
    samples = 1024

A parameter that is both fixed and an axis is varied; its fixed value is the nominal one, which
pictures mark. `jaxact.sweep.reading` reads and checks it.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from jaxact.sweep import toml
from jaxact.sweep.axes import MOST_SAMPLES, Axis
from jaxact.sweep.parameters import PARAMETERS, PRESETS

_STRICT = ConfigDict(extra="forbid", strict=True)
SECTIONS = ("parameters", "axes", "sampling")


@dataclass(frozen=True, config=_STRICT)
class Sampling:
    """How many points of the ranges are drawn, and how.

    method: "latin-hypercube" or "sobol", both from scipy.stats.qmc
    samples: number of points
    """

    method: Literal["latin-hypercube", "sobol"]
    samples: Annotated[int, Field(ge=1, le=MOST_SAMPLES)]


@dataclass(frozen=True, config=_STRICT)
class Specification:
    """A sweep, checked and complete.

    description: a sentence for people, shown with the results
    engine: plant, "mass" (exact) or "mjx" (MuJoCo in JAX)
    model: MJCF file of the MJX plant, None for the built-in slide joint
    physics_step: step of the plant [s]; None: the control period for mass, 0.25 ms for mjx
    velocity: of the controller, "sampled" by a sensor or the "differenced" position
    duration: simulated time [s]
    precision: "float32" or "float64"
    seed: of noise and of sampling
    tile: loops simulated at once; None: chosen by the engine
    devices: number of local devices used; None: all
    parameters: fixed values given, by short name; `actuator` names a preset
    axes: what is varied, in order
    sampling: None for a grid of all axes
    """

    description: Annotated[str, Field(max_length=1000)] = ""
    engine: Literal["mass", "mjx"] = "mass"
    model: Path | None = None
    physics_step: Annotated[float, Field(ge=1e-7, le=1.0, allow_inf_nan=False)] | None = None
    velocity: Literal["sampled", "differenced"] = "sampled"
    duration: Annotated[float, Field(gt=0.0, le=1e5, allow_inf_nan=False)] = 2.0
    precision: Literal["float32", "float64"] = "float32"
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    tile: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    devices: Annotated[int, Field(ge=1, le=1024)] | None = None
    parameters: dict[str, float | str] = dataclasses.field(default_factory=dict)
    axes: tuple[Axis, ...] = ()
    sampling: Sampling | None = None

    @property
    def nominal(self) -> dict[str, float]:
        """Value of every parameter where no axis varies it."""
        values = {name: parameter.default for name, parameter in PARAMETERS.items()}
        for name, value in self.parameters.items():
            if isinstance(value, str):
                values["wn"], values["zeta"] = PRESETS[value]
            else:
                values[name] = value
        return values

    @property
    def document(self) -> dict[str, Any]:
        """The specification as plain strings, numbers, lists and tables."""
        options = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in SECTIONS and getattr(self, field.name) is not None
        }
        if self.model is not None:
            options["model"] = str(self.model)
        sections: dict[str, Any] = {
            "parameters": dict(self.parameters),
            "axes": {axis.name: axis.document for axis in self.axes},
        }
        if self.sampling is not None:
            sections["sampling"] = dataclasses.asdict(self.sampling)
        return options | sections

    @property
    def text(self) -> str:
        """The specification as TOML, which reads back as the same specification."""
        return toml.dumps(self.document)


OPTIONS = tuple(
    field.name for field in dataclasses.fields(Specification) if field.name not in SECTIONS
)
