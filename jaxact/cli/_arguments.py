"""Options that several verbs have: each is declared here once."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import UseAppendAction, arg

from jaxact.errors import UserError, nearest, shown
from jaxact.loops.drives import DRIVE
from jaxact.parameters import CONTROL_RATE, INERTIA, MASS, PARAMETERS, PRESETS, of

# Default of a number that was not given; told from any number by being this very object. A type
# with None in it would make tyro's complaint about a mistyped number unreadable.
UNSET = float("nan")
UNSET_NUMBER = -(10**30)
_UNSET_NAME = "\0"
_ROTARY = dataclasses.replace(
    of(MASS, "rad"), description="Inertia that a rotary joint moves, instead of a mass."
)


def option(metavar: str, words: str, default: str = "") -> Any:
    """How an option with a value is shown.

    Args:
        metavar: what stands for the value, in capitals.
        words: what the option is, with its unit.
        default: in words, where it is not the default of the argument.
    """
    hint: Any = {"help_behavior_hint": f"(default: {default})"} if default else {}
    return arg(metavar=metavar, help=words, **hint)


LoopsFile = Annotated[
    Path | None,
    option(
        "FILE",
        "TOML file of loops: [[loop]] tables, or the axes of a sweep's specification.",
        "none",
    ),
]
DriveFile = Annotated[
    Path | None,
    option(
        "FILE",
        "Drive from `jaxact identify`: its dynamics, delay, limit, resolution, rate, and the joint"
        " that it was identified on (of a robot: its friction) where nothing else is said.",
        "none",
    ),
]
Velocity = Annotated[
    str | None,
    option(
        "sampled|differenced",
        "Velocity that the controller sees: sensed, or positions differenced, which"
        " --velocity-filter filters.",
        "sampled, or that of --drive or of a file",
    ),
]
Title = Annotated[str, option("TEXT", "Above the picture.", "none")]
Picture = Annotated[
    Path,
    option("FILE", "Picture to write: .png, .svg or .pdf; one that is there is replaced."),
]
Csv = Annotated[Path | None, option("FILE", "Write a CSV file, units in the first line.", "no")]
NoCache = Annotated[bool, arg(help="Compile anew, and keep no compiled programs from run to run.")]
Model = Annotated[Path | None, option("FILE", "MJCF or URDF file of a robot.", "a single joint")]
Keyframe = Annotated[
    str | None, option("NAME", "Keyframe of the model: its posture.", "the model's default posture")
]
Joints = Annotated[
    tuple[str, ...],
    option(
        "PATTERN",
        "Regular expressions; the joints or actuators that match in full are driven.",
        "all",
    ),
]
Posture = Annotated[
    str | None,
    option("settled|keyframe", "Bring the posture to rest first, or take it as it is.", "settled"),
]
Base = Annotated[
    str | None,
    option(
        "free|fixed|held",
        "Robots only: its base as the model has it; fixed on a stand, where nothing touches the"
        " robot; or held where the robot stands, in contact.",
        "free",
    ),
]
Damping = Annotated[
    str | None,
    option(
        "joint|drive",
        "Robots only: the joints' viscous damping as the model has it, in the joint; or as part of"
        " the kd that the model brings, sampled and delayed.",
        "joint",
    ),
]

Gains = Annotated[
    str | None,
    option(
        "FILE",
        "Robots only: file of gains instead of the model's: jaxact's TOML, MJCF, a deployment's"
        " YAML, a configuration of legged_gym, Isaac Lab or mjlab (.py, env.yaml), an ONNX policy"
        " of mjlab; joints are matched by name. FILE.py:NAME where it has several.",
        "the model's own",
    ),
]


@dataclass(frozen=True)
class Mounting:
    """How a robot is mounted, how it is damped and how it rubs, and what is changed of it."""

    joints: Joints = ()
    posture: Posture = None
    base: Base = None
    damping: Damping = None
    gains: Gains = None
    friction: Annotated[
        str | None,
        option(
            "moving|stuck",
            "Robots only: margins and growth rates of joints that move, which dry friction does not"
            " damp; or as MuJoCo linearises it at rest, as very strong damping.",
            "moving",
        ),
    ] = None
    set: Annotated[
        UseAppendAction[tuple[str, ...]],
        option("KEY=VALUE", "Change anything, of a specification or of a robot: see `sweep`."),
    ] = ()

    @property
    def plant(self) -> dict[str, Any]:
        """The keys of a specification's [plant] that were given.

        Raises:
            UserError: a value that is not known.
        """
        chosen = {name: getattr(self, name) for name in ("posture", *CHOICES)}
        more = {"joints": list(self.joints)} if self.joints else {}
        return mounted(**chosen) | more | ({} if self.gains is None else {"gains": self.gains})


@dataclass(frozen=True)
class Robot(Mounting):
    """Which robot is meant, how it is mounted, how it is damped and how it rubs."""

    model: Model = None
    keyframe: Keyframe = None
    spec: Annotated[
        Path | None,
        option(
            "FILE", "Specification of a sweep to start from: its fixed values are taken.", "none"
        ),
    ] = None

    @property
    def plant(self) -> dict[str, Any]:
        """As for `Mounting`, and which robot."""
        which = {"model": self.model, "keyframe": self.keyframe}
        return super().plant | {name: str(one) for name, one in which.items() if one is not None}


# Keys of a [plant] that take one of a few words.
CHOICES = {
    "base": ("free", "fixed", "held"),
    "damping": ("joint", "drive"),
    "friction": ("moving", "stuck"),
    "posture": ("settled", "keyframe"),
}


def mounted(**chosen: str | None) -> dict[str, str]:
    """The keys of a [plant] among these options that were given.

    Raises:
        UserError: a value that is not known.
    """
    given = {name: value for name, value in chosen.items() if value is not None}
    for name, value in given.items():
        one_of(name, value, CHOICES[name])
    return given


def one_of(name: str, value: str, known: Iterable[str]) -> None:
    """Raise UserError for a value that an option does not take."""
    if value not in known:
        raise UserError(f"{typed(name)} {shown(value)}; {nearest(value, known)}")


def demand_robot(options: Any, *, given: bool) -> bool:
    """Whether a robot is meant.

    Args:
        options: a dataclass of options that are of a robot.
        given: a robot was named.

    Raises:
        UserError: options of a robot without one.
    """
    for field in () if given else fields(options):
        if getattr(options, field.name) != field.default:
            raise UserError(f"{typed(field.name)}: is for a robot; give one with --model")
    return given


def parameters(names: Iterable[str], *, several: bool, drive: bool = True) -> type:
    """A dataclass with one option for each parameter named, and `actuator`, `unit` and `drive`.

    Args:
        names: of parameters of the table.
        several: each takes several values, none where it is not given; else one, or UNSET.
        drive: with `drive`, which is one file in any case.
    """
    more = " ..." if several else ""
    preset = option(f"NAME{more}", f"Preset that sets wn and zeta: {', '.join(PRESETS)}.", "none")
    unit = option(
        "m|rad",
        "Unit of the joint's position; rad: it is rotary, and all numbers are in N m, rad, kg m^2.",
        "m; rad with --inertia",
    )
    own: list[tuple[str, Any, Any]] = []
    for name, shown_as in (("actuator", preset), ("unit", unit)):
        kind: Any = Annotated[tuple[str, ...] if several else str, shown_as]
        unset = dataclasses.field(default=(_UNSET_NAME,) if several else _UNSET_NAME)
        own.append((name, kind, unset))
    if drive:
        own.append((DRIVE, DriveFile, dataclasses.field(default=None)))
    for name in (*names, INERTIA):
        parameter = _ROTARY if name == INERTIA else PARAMETERS[name]
        units = "" if parameter.unit == "1" else f" [{parameter.unit}]"
        default = f"{parameter.default:g}"
        if several and name == CONTROL_RATE:
            default = "continuous time only"
        if name == INERTIA:
            default = "none"
        shown_as = option(f"VALUE{more}", f"{parameter.description[:-1]}{units}.", default)
        kind = Annotated[tuple[float, ...] if several else float, shown_as]
        own.append((name, kind, dataclasses.field(default=(UNSET,) if several else UNSET)))
    return dataclasses.make_dataclass("Options", own, frozen=True)


def given(chosen: Any) -> dict[str, Any]:
    """The options of such a dataclass that were given, by name.

    Raises:
        UserError: one without any value.
    """
    values = {field.name: getattr(chosen, field.name) for field in fields(chosen)}
    for name, value in values.items():
        if value == ():
            raise UserError(f"{typed(name)}: give at least one value")
    return {name: value for name, value in values.items() if is_given(value)}


def is_given(value: Any) -> bool:
    """Whether an option was given."""
    first = value[0] if isinstance(value, tuple) and value else value
    return first is not None and first is not UNSET and first not in (UNSET_NUMBER, _UNSET_NAME)


def typed(name: str) -> str:
    """The option of a parameter, as it is typed."""
    return "--" + name.replace("_", "-")
