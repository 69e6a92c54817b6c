"""`jaxact tune --model`: which robot, postures and groups are meant, and what is done with them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import UseAppendAction, arg

from jaxact.cli import _mounting, _robot_margins, _warnings
from jaxact.errors import UserError

if TYPE_CHECKING:
    from jaxact.loops.specification import Specification
    from jaxact.tuning.goal import Goal
    from jaxact.tuning.result import Tuned
    from jaxact.tuning.rollouts.validation import Rollouts


@dataclass(frozen=True)
class Options:
    """The options that make it a whole robot's gains."""

    model: Annotated[
        Path | None,
        arg(
            metavar="FILE",
            help="MJCF or URDF file of a robot: gains of all its joints.",
            help_behavior_hint="(default: a single joint)",
        ),
    ] = None
    keyframe: Annotated[
        tuple[str, ...],
        arg(
            metavar="NAME ...",
            help="Keyframes of the model; the gains hold at all of them.",
            help_behavior_hint="(default: the model's default posture)",
        ),
    ] = ()
    groups: Annotated[
        str,
        arg(
            metavar="PATTERN,...",
            help="Regular expressions found anywhere in the names of joints or actuators; the "
            "joints of a pattern share their gains.",
            help_behavior_hint="(default: every joint its own)",
        ),
    ] = ""
    joints: Annotated[
        tuple[str, ...],
        arg(
            metavar="PATTERN",
            help="Regular expressions; the joints or actuators that match in full are driven.",
            help_behavior_hint="(default: all)",
        ),
    ] = ()
    base: _mounting.Base = None
    damping: _mounting.Damping = None
    friction: _mounting.Friction = None
    posture: Annotated[
        str | None,
        arg(
            metavar="settled|keyframe",
            help="Bring the keyframes to rest first, or linearise at them as they are.",
            help_behavior_hint="(default: settled)",
        ),
    ] = None
    spec: Annotated[
        tuple[Path, ...],
        arg(
            metavar="FILE ...",
            help="Specifications with a [plant], one for each posture, instead of --model.",
            help_behavior_hint="(default: none)",
        ),
    ] = ()
    set: Annotated[
        UseAppendAction[tuple[str, ...]],
        arg(metavar="KEY=VALUE", help="Of a robot: change anything, e.g. 'kp@.*_knee=300'."),
    ] = ()
    validate: Annotated[
        float,
        arg(
            metavar="SECONDS",
            help="Length of the nonlinear rollouts that a robot's gains are held against; 0: none.",
        ),
    ] = 2.0
    tracking_weight: Annotated[
        float,
        arg(
            metavar="W",
            help="Of a robot: 1 % less rms error in simulated rollouts after a push counts like W "
            "% more of the objective; the bounds stay as they are. Takes minutes; 0: none.",
        ),
    ] = 0.0
    derivative: Annotated[
        str,
        arg(
            metavar="auto|forward|reverse",
            help="Of the rollouts of --tracking-weight: forward costs 1 + 2 GROUPS rollouts, "
            "reverse about 10; auto takes the cheaper.",
        ),
    ] = "auto"


def asked(options: Options) -> bool:
    """Whether a robot is meant.

    Raises UserError for options of a robot without one.
    """
    if options.model is not None or options.spec:
        return True
    for field in fields(options):
        if getattr(options, field.name) != field.default:
            option = field.name.replace("_", "-")
            raise UserError(f"--{option}: is for a robot; give one with --model")
    return False


def tuned(
    options: Options,
    given: dict[str, Any],
    goal: Goal,
    velocity: str,
    phase: Callable[[str], None],
    asked: dict[str, Any],
) -> tuple[Tuned, Rollouts | None]:
    """The robot's tuned gains, held against rollouts.

    Args:
        options: of a robot.
        given: values of parameters.
        goal: what is asked.
        velocity: "sampled" or "differenced".
        phase: told what is being done.
        asked: how it is searched, see `jaxact.verbs.tune.of_robot`.

    Raises:
        UserError: anything that does not fit.
    """
    from jaxact.tuning.rollouts import validation
    from jaxact.verbs.tune import of_robot

    if not (options.validate >= 0.0 and math.isfinite(options.validate)):
        raise UserError(f"--validate {options.validate:g}: give seconds, 0 for none")
    named = _specifications(options, given, velocity)
    groups = options.groups.split(",") if options.groups else ()
    for _, one in named:
        _warnings.posture(one)
    found = of_robot(
        named, goal, groups=groups, tracking_weight=options.tracking_weight,
        derivative=options.derivative, phase=phase, **asked,
    )  # fmt: skip
    if options.validate == 0.0:
        return found, None
    phase("simulating")
    return found, validation.rollouts(found, options.validate)


def _specifications(
    options: Options, given: dict[str, Any], velocity: str
) -> list[tuple[str, Specification]]:
    """A name and a specification for every posture."""
    values = {name: (value,) for name, value in given.items()}

    def one(**own: Any) -> Specification:
        chosen = _robot_margins.Options(
            joints=options.joints,
            posture=options.posture,
            base=options.base,
            damping=options.damping,
            friction=options.friction,
            set=options.set,
            **own,
        )
        return _robot_margins.specified(chosen, values, velocity)

    if len(set(options.keyframe)) < len(options.keyframe):
        raise UserError("--keyframe: the same one is given twice")
    if options.spec:
        for name in ("model", "keyframe"):
            if getattr(options, name):
                raise UserError(f"--{name}: is in the specifications of --spec")
        rows = [(path.stem, one(spec=path)) for path in options.spec]
        return _distinct(rows)
    if not options.keyframe:
        assert options.model is not None
        return [(options.model.stem, one(model=options.model))]
    return [(key, one(model=options.model, keyframe=key)) for key in options.keyframe]


def _distinct(rows: list[tuple[str, Specification]]) -> list[tuple[str, Specification]]:
    names = [name for name, _ in rows]
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"--spec: two files are called {name}; name them differently")
    return rows
