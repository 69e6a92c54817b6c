"""`jaxact tune --model`: which robot, postures and groups are meant, and what is done with them."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from tyro.conf import UseAppendAction, arg

from jaxact.cli import (
    _folders,
    _front,
    _mounting,
    _progress,
    _robot_margins,
    _robot_report,
    _warnings,
)
from jaxact.errors import UserError

if TYPE_CHECKING:
    from jaxact.loops.specification import Specification
    from jaxact.tuning.goal import Goal
    from jaxact.tuning.robot.loops import Situation

# Samples of the uncertainty where no number is given.
SAMPLES = 8


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


def run(
    options: Options,
    given: dict[str, Any],
    goal: Goal,
    *,
    velocity: str,
    uncertainty: str,
    number: int,
    seed: int,
    starts: int,
    steps: int,
    pareto: int,
    verify: bool,
    out: Path | None,
    json: bool,
) -> bool:
    """Tune a robot, hold the gains against rollouts, print, and write a folder.

    options: of a robot
    given: values of parameters
    goal: what is asked
    velocity: "sampled" or "differenced"
    uncertainty: ranges, "" for none
    number, seed: of the samples of it
    starts, steps: of the descent
    pareto: points of the front over the peak allowed, 0 for none
    verify: compare with brute force
    out: folder to write, None for none
    json: print an object instead of tables

    Returns whether everything that was asked for is certified. Raises UserError for anything that
    does not fit.
    """
    if not (options.validate >= 0.0 and math.isfinite(options.validate)):
        raise UserError(f"--validate {options.validate:g}: give seconds, 0 for none")
    if pareto and options.tracking_weight:
        raise UserError("--pareto: cannot be combined with --tracking-weight")

    from jaxact.tuning import pareto as _pareto
    from jaxact.tuning.groups import group
    from jaxact.tuning.robot import front as robot_front
    from jaxact.tuning.robot import search as robot
    from jaxact.tuning.robot.loops import situation
    from jaxact.tuning.robot.uncertainty import read_spans
    from jaxact.tuning.rollouts.tracking import Wish

    if pareto:
        _pareto.peaks(pareto)
    spans = read_spans(uncertainty) if uncertainty else ()
    named = _specifications(options, given, velocity)
    with _progress.phases(quiet=json) as phase:
        situations = []
        for place, (name, one) in enumerate(named, 1):
            phase(f"settling and linearising {name} ({place} of {len(named)})")
            situations.append(situation(one, name, spans))
        for each in situations:
            _warnings.posture(each.specification)
        first = situations[0]
        groups = group(options.groups.split(",") if options.groups else (), first.names)
        tuned = robot.tune(
            situations, goal, groups, number=number, seed=seed, start=_start(first, given),
            starts=starts, steps=steps, verify=verify,
            wish=Wish(options.tracking_weight, options.derivative), phase=phase,
        )  # fmt: skip
        phase("walking along the front")
        points = robot_front.front(tuned, pareto, seed=seed) if pareto else []
        phase("simulating")
        held = _robot_report.validated(tuned, options.validate)
    document = _robot_report.report(tuned, held)
    front = _front.of_robot(points) if points else None
    if pareto:
        document["pareto"] = [] if front is None else _front.report(front)
    if out is not None:
        with _folders.whole_folder(out) as folder:
            command = shlex.join(["jaxact", *sys.argv[1:]])
            _robot_report.write_folder(folder, tuned, held, command)
            if front is not None:
                _front.write(folder, front, goal.max_peak)
    if json:
        print(_robot_report.as_json(document))
    else:
        print(_robot_report.as_text(tuned, document))
        if front is not None:
            print("\n" + _front.table(front))
        if out is not None:
            print(f"wrote {out}")
    if held is not None:
        _warn_of(*held.stable)
    return tuned.certified


def _warn_of(stable: int, rollouts: int) -> None:
    """Say so where rollouts contradict the certificate."""
    if stable < rollouts:
        _warnings.warn(
            f"{rollouts - stable} of {rollouts} rollouts with these gains are not stable, whatever "
            "is certified at rest: add the postures that the robot comes to, or lower --max-peak"
        )


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


def _demand_kd(first: Situation) -> None:
    """Refuse to start without a D gain, and say where it may be."""
    plant, without = first.specification.plant, np.flatnonzero(first.kd == 0.0)
    if plant is None or not without.size or plant.damping == "drive":
        return
    joint = first.names[int(without[0])][0]
    raise UserError(
        f"{joint}: kd is 0, and there is no start from it; give --kd, or --damping drive where the "
        "model has the drive's D gain in <joint damping>"
    )


def _start(first: Situation, given: dict[str, Any]) -> Any:
    """The gains to be no worse than: those given, or that the model brings; None for none."""
    if first.kp is not None and first.kd is not None:
        _demand_kd(first)
        return first.kp, first.kd
    alone: Sequence[str] = [name for name in ("kp", "kd") if name in given]
    if alone:
        raise UserError(
            f"--{alone[0]}: the model brings no gains to start from; give both --kp and --kd, or "
            "none"
        )
    return None
