"""`jaxact margins --model`: which robot and which loops are meant, and what is done with them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import UseAppendAction, arg

from jaxact.cli import _loops, _mounting, _progress, _warnings
from jaxact.errors import UserError, nearest, shown

if TYPE_CHECKING:
    from jaxact.loops.specification import Specification

ENGINES = ("mujoco", "mjx")
POSTURES = ("settled", "keyframe")


@dataclass(frozen=True)
class Options:
    """The options that make it a whole robot's margins."""

    model: Annotated[
        Path | None,
        arg(
            metavar="FILE",
            help="MJCF or URDF file of a robot: margins of all its joints together.",
            help_behavior_hint="(default: a single joint)",
        ),
    ] = None
    keyframe: Annotated[
        str | None,
        arg(
            metavar="NAME",
            help="Keyframe of the model to linearise at.",
            help_behavior_hint="(default: the model's default posture)",
        ),
    ] = None
    joints: Annotated[
        tuple[str, ...],
        arg(
            metavar="PATTERN",
            help="Regular expressions; the joints or actuators that match in full are driven.",
            help_behavior_hint="(default: all)",
        ),
    ] = ()
    posture: Annotated[
        str | None,
        arg(
            metavar="settled|keyframe",
            help="Bring the keyframe to rest first, or linearise at it as it is.",
            help_behavior_hint="(default: settled)",
        ),
    ] = None
    base: _mounting.Base = None
    damping: _mounting.Damping = None
    friction: _mounting.Friction = None
    engine: Annotated[
        str | None,
        arg(
            metavar="mujoco|mjx",
            help="Linearise C MuJoCo by differences, or differentiate MJX, which compiles first.",
            help_behavior_hint="(default: mujoco)",
        ),
    ] = None
    spec: Annotated[
        Path | None,
        arg(
            metavar="FILE",
            help="Specification with a [plant] to start from: its fixed values are taken.",
            help_behavior_hint="(default: none)",
        ),
    ] = None
    set: Annotated[
        UseAppendAction[tuple[str, ...]],
        arg(metavar="KEY=VALUE", help="Of a robot: change anything, e.g. 'kp@.*_knee=300'."),
    ] = ()
    out: Annotated[
        Path | None,
        arg(
            metavar="FILE",
            help="Of a robot: picture to write, .png, .svg or .pdf; one that is there is replaced.",
            help_behavior_hint="(default: none)",
        ),
    ] = None


def asked(options: Options) -> bool:
    """Whether a robot is meant.

    Raises UserError for options of a robot without one.
    """
    if options.model is not None or options.spec is not None:
        return True
    for field in fields(options):
        if getattr(options, field.name) != field.default:
            raise UserError(f"--{field.name}: is for a robot; give one with --model")
    return False


def show(options: Options, given: dict[str, Any], velocity: str, *, json: bool) -> None:
    """Compute the margins of the robot with all combinations of the values given, and print them.

    options: of a robot
    given: parameter (or actuator) -> its values
    velocity: "sampled" or "differenced"
    json: print an object for each combination instead of tables

    Raises UserError for anything that does not fit.
    """
    if options.out is not None:
        from jaxact.plotting.theme import check_output

        check_output(options.out)
    specification = specified(options, given, velocity)
    labels = _loops.expanded(specification).labels
    labels = labels if len(labels) > 1 else ("",)
    if options.out is not None and len(labels) > 1:
        raise UserError("--out: draws one loop; give one value for each option")

    from jaxact.loops.samples import expand
    from jaxact.robot_margins import stiction, whole_robot
    from jaxact.verbs import robot_tables

    samples = expand(specification)
    with _progress.phases(quiet=json) as phase:
        phase("settling, linearising and computing margins")
        found = whole_robot.evaluate(specification, samples)
        phase("looking for what dry friction holds")
        held = stiction.each(specification, samples, found)
    _warnings.overload(specification)
    printed = robot_tables.as_json if json else robot_tables.as_text
    rows = zip(labels, found, held, strict=True)
    print("\n".join(printed(specification, *row) for row in rows))
    if options.out is not None:
        from jaxact.plotting.robot import whole_robot as picture
        from jaxact.plotting.theme import write

        title = f"{robot_tables.title(specification)}: all joints at once"
        figure = picture(found[0].curves, found[0].margins, title=title)
        write(figure, options.out, title="jaxact: margins of a robot")
        if not json:
            print(f"wrote {options.out}")


def specified(options: Options, given: dict[str, Any], velocity: str) -> Specification:
    """The robot and its loops: the file, then the options, then --set; arguments as for `show`."""
    if "mass" in given:
        raise UserError("--mass: a robot's masses are its model's; change them with --set payload=")
    for name, known in (("engine", ENGINES), ("posture", POSTURES)):
        value = getattr(options, name)
        if value is not None and value not in known:
            raise UserError(f"--{name} {shown(value)}; {nearest(value, known)}")
    base: dict[str, Any] = {}
    if options.spec is not None:
        base = _loops.nominal_of(options.spec).document
    parameters = base.get("parameters", {})
    if "actuator" in given:
        parameters = {name: parameters[name] for name in parameters if name not in ("wn", "zeta")}
    elif {"wn", "zeta"} & set(given):
        parameters |= _loops.without_preset(parameters.pop("actuator", None))
    chosen = {
        "model": options.model, "keyframe": options.keyframe, "posture": options.posture,
        "joints": list(options.joints) or None,
        **_mounting.chosen(options.base, options.damping, options.friction),
    }  # fmt: skip
    plant = base.get("plant", {}) | {
        name: str(value) if isinstance(value, Path) else value
        for name, value in chosen.items()
        if value is not None
    }
    if "model" not in plant:
        raise UserError(f"{options.spec}: has no [plant] model; give a robot with --model")
    engine = options.engine or (base.get("engine") if base.get("engine") in ENGINES else ENGINES[0])
    if velocity == "sampled":
        velocity = base.get("velocity", velocity)
    fixed = {name: values[0] for name, values in given.items() if len(values) == 1}
    varied = {name: list(values) for name, values in given.items() if len(values) > 1}
    document = {
        **base, "engine": engine, "velocity": velocity, "plant": plant, "sampling": None,
        "parameters": {name: value for name, value in parameters.items() if name not in varied}
        | fixed,
        "axes": varied,
    }  # fmt: skip
    return _loops.specified(document, options.set)
