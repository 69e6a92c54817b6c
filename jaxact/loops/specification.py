"""The specification of a sweep: what a TOML file says.

    engine = "mjx"                                 # top level: how every loop is simulated
    drive = "drive.toml"                           # identified; says what is not said below
    [plant]                                        # a robot in place of a single joint
    model = "robot.xml"
    [parameters]                                   # fixed values, see jaxact.parameters
    wn = 800.0
    "kp@.*_knee" = 300.0                           # of the joints whose names match
    [axes]                                         # what is varied: a list, or a range
    actuator = ["ideal", "hyq", "starleth"]
    kp = { min = 10, max = 1e5, num = 64, spacing = "log" }
    [sampling]                                     # ranges are sampled instead of gridded
    method = "sobol"
    samples = 1024

A parameter that is both fixed and an axis is varied; its fixed value is the nominal one, which
pictures mark. `jaxact.loops.reading` reads and checks it.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from jaxact.engines import MASS, Asked, Engine, known
from jaxact.loops import toml
from jaxact.loops.axes import MOST_SAMPLES, Axis
from jaxact.parameters import OF_MODEL, OF_ROBOTS, PARAMETERS, PRESETS, WN, ZETA

_STRICT = ConfigDict(extra="forbid", strict=True)
TABLES = ("plant", "motion", "push")
SECTIONS = ("parameters", "axes", "sampling", *TABLES)


@dataclass(frozen=True, config=_STRICT)
class Sampling:
    """How many points of the ranges are drawn, and how.

    Attributes:
        method: "latin-hypercube" or "sobol", both from scipy.stats.qmc.
        samples: number of points.
    """

    method: Literal["latin-hypercube", "sobol"]
    samples: Annotated[int, Field(ge=1, le=MOST_SAMPLES)]


@dataclass(frozen=True, config=_STRICT)
class Plant:
    """A MuJoCo model in place of the built-in single joint.

    Attributes:
        model: MJCF or URDF file.
        keyframe: name of the start posture in the model; None: the model's default posture.
        posture: "settled" brings the keyframe to rest first, "keyframe" starts from it as it is.
        joints: patterns of the names of the joints (or actuators) that are driven.
        payload_body: name of the body that carries the payload; None: the heaviest one.
        base: "free" as the model has it, "fixed" on a stand without contact, or "held" where it
            stands.
        damping: of the driven joints, in the "joint" as the model has it, or in the "drive": part
            of kd.
        friction: dry friction of the linearised robot: "moving", none, as for joints that slide, or
            "stuck", as MuJoCo linearises it at rest, as very strong damping.
        gains: file of gains that the joints have instead of the model's, see
            `jaxact.gains.reading`.
    """

    model: Path
    keyframe: Annotated[str, Field(max_length=200)] | None = None
    posture: Literal["settled", "keyframe"] = "settled"
    joints: tuple[str, ...] = (".*",)
    payload_body: Annotated[str, Field(max_length=200)] | None = None
    base: Literal["free", "fixed", "held"] = "free"
    damping: Literal["joint", "drive"] = "joint"
    friction: Literal["moving", "stuck"] = "moving"
    gains: Annotated[str, Field(max_length=4000)] | None = None


@dataclass(frozen=True, config=_STRICT)
class Motion:
    """How the setpoint moves; its amplitude is the parameter `setpoint`.

    Attributes:
        kind: "step" at time 0, "sine", "chirp" from one frequency to another, or "file".
        frequency: of the sine, at the start of the chirp [Hz].
        end_frequency: at the end of the chirp [Hz].
        file: CSV or NPZ with a column `time` [s] and one for each joint that moves, named like it;
            positions as they are [m or rad], linear in between.
    """

    kind: Literal["step", "sine", "chirp", "file"]
    frequency: Annotated[float, Field(gt=0.0, le=1e5, allow_inf_nan=False)] | None = None
    end_frequency: Annotated[float, Field(gt=0.0, le=1e5, allow_inf_nan=False)] | None = None
    file: Path | None = None


@dataclass(frozen=True, config=_STRICT)
class Push:
    """An impulse on a body of a robot, given as a constant force for a short while.

    Attributes:
        body: name of the body; the force acts on its centre of mass.
        impulse: in the world's axes [N s].
        time: when it begins [s].
        duration: how long it lasts [s].
    """

    body: Annotated[str, Field(max_length=200)]
    impulse: tuple[float, float, float]
    time: Annotated[float, Field(ge=0.0, le=1e5, allow_inf_nan=False)] = 0.1
    duration: Annotated[float, Field(gt=0.0, le=1e5, allow_inf_nan=False)] = 0.05

    @property
    def force(self) -> tuple[float, ...]:
        """While it lasts, in the world's axes [N]."""
        return tuple(part / self.duration for part in self.impulse)


@dataclass(frozen=True, config=_STRICT)
class Setting:
    """What a robot's loops have in common beside their parameters; for keys of caches.

    Attributes:
        plant, motion, push: as in the specification.
        keys: of parameters for some joints, in order.
        corrected: whether MuJoCo's integrator is corrected for.
    """

    plant: Plant | None
    motion: Motion | None
    push: Push | None
    keys: tuple[str, ...]
    corrected: bool


@dataclass(frozen=True, config=_STRICT)
class Specification:
    """A sweep, checked and complete.

    Attributes:
        description: a sentence for people, shown with the results.
        engine: plant, "mass" (exact), "mjx" (MuJoCo in JAX), for robots also "mujoco" (MuJoCo in
            C), "warp" (MJX-Warp) or "auto", the fastest of the three; "linear" computes the
            margins of the linearised robot instead of simulating it.
        plant: the robot of the MuJoCo engines, None for the built-in slide joint.
        motion: of the setpoint, None for a step.
        push: on a robot, None for none.
        physics_step: step of the plant [s]; None: the control period for mass, 0.25 ms for mjx,
            cut finer for limits, see `jaxact.simulation.limited_steps`.
        integrator_correction: take back the half physics step by which MuJoCo's integrator has its
            positions ahead of its velocities; the mass is exact without it.
        velocity: of the controller, "sampled" by a sensor or the "differenced" position.
        duration: simulated time [s].
        precision: "float32" or "float64".
        unit: of a single joint's position, "rad" of a rotary one; None: m, or as a robot's joints
            are.
        seed: of noise and of sampling.
        tile: loops simulated at once; None: chosen by the engine.
        devices: number of local devices used; None: all.
        parameters: fixed values given, by short name; `actuator` names a preset.
        axes: what is varied, in order.
        sampling: None for a grid of all axes.
    """

    description: Annotated[str, Field(max_length=1000)] = ""
    engine: Asked = MASS.name
    physics_step: Annotated[float, Field(ge=1e-7, le=1.0, allow_inf_nan=False)] | None = None
    integrator_correction: bool = False
    velocity: Literal["sampled", "differenced"] = "sampled"
    duration: Annotated[float, Field(gt=0.0, le=1e5, allow_inf_nan=False)] = 2.0
    precision: Literal["float32", "float64"] = "float32"
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    tile: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    devices: Annotated[int, Field(ge=1, le=1024)] | None = None
    parameters: dict[str, float | str] = dataclasses.field(default_factory=dict)
    axes: tuple[Axis, ...] = ()
    sampling: Sampling | None = None
    plant: Plant | None = None
    motion: Motion | None = None
    push: Push | None = None
    unit: Literal["m", "rad"] | None = None

    @property
    def robot(self) -> bool:
        """Whether the plant is a robot instead of the built-in joint."""
        return self.plant is not None

    @property
    def simulator(self) -> Engine | None:
        """The engine that is asked for; None where that is open, or it cannot have this plant."""
        return known(self.engine, robot=self.robot)

    @property
    def model(self) -> Path | None:
        """The model file of the robot, None for the built-in plants."""
        return None if self.plant is None else self.plant.model

    @property
    def setting(self) -> Setting:
        """What all loops have in common beside their parameters."""
        keys = tuple(key for key in self.nominal if "@" in key)
        return Setting(self.plant, self.motion, self.push, keys, self.integrator_correction)

    @property
    def nominal(self) -> dict[str, float]:
        """Value of every parameter where no axis varies it.

        Of a robot, what its model may bring is not a number (NaN) where nothing is given; values of
        some joints only follow those of all, and axes of some joints what is fixed, unless they
        have a value among the parameters, whose place they keep.
        """
        values = {name: parameter.default for name, parameter in PARAMETERS.items()}
        if self.robot:
            values |= {name: math.nan for name in OF_MODEL} | OF_ROBOTS
        for name, value in self.parameters.items():
            if isinstance(value, str):
                values[WN], values[ZETA] = PRESETS[value]
            else:
                values[name] = value
        # A key of an axis is a parameter of some joints, which has no value of its own elsewhere.
        own = (axis.name for axis in self.axes if "@" in axis.name)
        return values | {name: math.nan for name in own if name not in values}

    @property
    def document(self) -> dict[str, Any]:
        """The specification as plain strings, numbers, lists and tables."""
        options = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in SECTIONS and getattr(self, field.name) is not None
        }
        tables = {
            name: {key: _plain(value) for key, value in vars(table).items() if value is not None}
            for name in TABLES
            if (table := getattr(self, name)) is not None and dataclasses.is_dataclass(table)
        }
        sections: dict[str, Any] = tables | {
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


def _plain(value: Any) -> Any:
    """A value as TOML has it."""
    if isinstance(value, Path):
        return str(value)
    return list(value) if isinstance(value, tuple) else value


OPTIONS = tuple(
    field.name for field in dataclasses.fields(Specification) if field.name not in SECTIONS
)
