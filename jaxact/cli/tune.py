"""`jaxact tune`: the best gains of a joint, an ensemble of actuators or a robot, certified."""

from __future__ import annotations

import math
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from jaxact.cli import _arguments, _cache, _folders, _loops, _progress, _signals, _unsure, _warnings
from jaxact.cli._arguments import UNSET, UNSET_NUMBER, option
from jaxact.errors import UserError
from jaxact.loops.drives import DRIVE, load_drive
from jaxact.parameters import CONTROL_RATE, GAIN_SCALE, LINEAR

if TYPE_CHECKING:
    from jaxact.loops.control_loop import ControlLoop
    from jaxact.tuning.course import Told
    from jaxact.tuning.result import Tuned
    from jaxact.tuning.rollouts.validation import Rollouts

# Exit code of a result that does not meet what was asked.
NOT_MET = 1
# At a second signal, once gains are certified.
_AT_ONCE = "interrupted; nothing is kept"

Parameters = _arguments.parameters((*LINEAR, CONTROL_RATE), several=False)


@dataclass(frozen=True)
class Goal:
    """What is asked for."""

    objective: Annotated[
        str,
        option(
            "NAME",
            "stiffness: largest kp. bandwidth: largest. disk-margin: largest, with --min-kp. "
            "settling: shortest time to 2 %. tracking:FILE: smallest rms error along a CSV file of "
            "time [s], setpoint [m].",
        ),
    ] = "stiffness"
    max_peak: Annotated[
        float,
        option(
            "RATIO",
            "Largest Ms and Mt, against any modelling error; inf: none.",
            "1.6, none for disk-margin",
        ),
    ] = UNSET
    min_gain_margin: Annotated[
        float, option("FACTOR", "Smallest gain margin, against a lighter load; 1: none.")
    ] = 1.0
    min_delay_margin: Annotated[
        float, option("SECONDS", "Smallest delay margin [s], against a later bus; 0: none.")
    ] = 0.0
    min_disk_margin: Annotated[
        float,
        option(
            "VALUE",
            "Smallest disk margin, against gain and phase off, in each joint separately; 0: none.",
        ),
    ] = 0.0
    min_kp: Annotated[
        float,
        option("VALUE", "Softest kp [N/m; N m/rad of a hinge], against a joint too soft; 0: none."),
    ] = 0.0
    max_kp: Annotated[
        float,
        option("VALUE", "Stiffest kp [N/m; N m/rad of a hinge], against hard contact; inf: none."),
    ] = math.inf
    max_noise_gain: Annotated[
        float,
        option(
            "VALUE",
            "Largest rms force per encoder count [N/m], against noise and heat: rounding read at "
            "the control rate, 1 kHz without one; inf: none.",
        ),
    ] = math.inf
    risk: Annotated[
        str,
        option("worst|mean|cvar:A", "Which members count; all are stable in any case."),
    ] = "worst"


@dataclass(frozen=True)
class Search:
    """What is not known, and how gains are looked for."""

    uncertainty: Annotated[
        str,
        option(
            "RANGES",
            "What is not known, e.g. wn=0.8..1.2,zeta=0.7..1.1,delay=0..5e-3,mass=0.5..1.0: wn and "
            "zeta as factors on the actuator's, mass [kg] and delay [s], the command's beside "
            "--measurement-delay and --output-delay, as they are; an x makes them factors too: "
            "mass=0.8x..1.2x. Of a robot, for mass: payload [kg], the factors "
            "inertia_scale and contact_friction, and joint_damping [N m s/rad] and joint_armature "
            "[kg m^2] added to the model's; of some joints: wn@.*_knee=0.8..1.2. With --drive "
            "also: intervals, the box of its 95 % intervals, which ranges behind it replace; "
            "samples, drives drawn from its covariance; none.",
            "none; intervals with --drive",
        ),
    ] = ""
    ensemble: Annotated[
        int,
        option("NUMBER", "Samples of the uncertainty, corners beside them.", "32, of a robot 8"),
    ] = UNSET_NUMBER
    starts: Annotated[int, option("NUMBER", "Default starts of the descent.")] = 8
    steps: Annotated[
        int, option("NUMBER", "Steps of the descent.", "80, of simulated time 150")
    ] = UNSET_NUMBER
    seed: Annotated[int, option("NUMBER", "Of the sampled uncertainty.")] = 0
    pareto: Annotated[
        int, option("NUMBER", "Points of the front over the peak allowed; 0: none.")
    ] = 0
    verify: Annotated[bool, arg(help="Compare with a brute-force grid over all gains.")] = False

    def check(self) -> None:
        """Raise UserError for numbers that make no sense."""
        for name in ("starts", "steps", "ensemble"):
            number = getattr(self, name)
            if number != UNSET_NUMBER and not 1 <= number <= 10_000:
                raise UserError(f"--{name} {number}: give between 1 and 10000")
        if not 0 <= self.seed < 2**63:
            raise UserError(f"--seed {self.seed}: give between 0 and 2^63 - 1")


@dataclass(frozen=True)
class Robot(_arguments.Mounting):
    """Which robot is meant, at which postures, and what is done with its gains."""

    model: _arguments.Model = None
    keyframe: Annotated[
        tuple[str, ...],
        option(
            "NAME ...",
            "Keyframes of the model; the gains hold at all of them.",
            "the model's default posture",
        ),
    ] = ()
    groups: Annotated[
        str,
        option(
            "PATTERN,...",
            "Regular expressions found anywhere in the names of joints or actuators; the joints of "
            "a pattern share their gains.",
            "every joint its own",
        ),
    ] = ""
    spec: Annotated[
        tuple[Path, ...],
        option(
            "FILE ...",
            "Specifications with a [plant], one for each posture, instead of --model.",
            "none",
        ),
    ] = ()
    validate: Annotated[
        float,
        option(
            "SECONDS",
            "Length of the nonlinear rollouts that a robot's gains are held against; 0: none.",
        ),
    ] = 2.0
    tracking_weight: Annotated[
        float,
        option(
            "W",
            "Robots only: 1 % less rms error in simulated rollouts after a push counts like W % "
            "more of the objective; the bounds stay as they are. Takes minutes; 0: none.",
        ),
    ] = 0.0
    derivative: Annotated[
        str,
        option(
            "auto|forward|reverse",
            "Of the rollouts of --tracking-weight: forward costs 1 + 2 GROUPS rollouts, reverse "
            "about 10; auto takes the cheaper.",
        ),
    ] = "auto"

    def check(self, joint: str) -> None:
        """Raise UserError for a name of a single joint, and for rollouts of no length."""
        if joint != "joint":
            raise UserError("--joint: is for a single joint; a robot's are named by its model")
        if not (self.validate >= 0.0 and math.isfinite(self.validate)):
            raise UserError(f"--validate {self.validate:g}: give seconds, 0 for none")

    def one(self, **which: Any) -> _arguments.Robot:
        """At one posture: a model and its keyframe, or a specification."""
        shared = {name: getattr(self, name) for name in vars(_arguments.Mounting())}
        return _arguments.Robot(**shared, **which)


def main(
    parameters: Parameters,  # type: ignore[valid-type]
    goal: Goal,
    search: Search,
    robot: Robot,
    *,
    velocity: _arguments.Velocity = None,
    out: Annotated[
        Path | None,
        option("FOLDER", "Write gains.toml, gains.xml (MJCF), pictures, motion.csv there.", "no"),
    ] = None,
    joint: Annotated[str, option("NAME", "Joint in the MJCF file.")] = "joint",
    overwrite: Annotated[bool, arg(help="Replace the folder if it is there.")] = False,
    json: Annotated[bool, arg(help="Print the result as one line of JSON.")] = False,
    no_cache: _arguments.NoCache = False,
) -> None:
    """Find the best gains of a joint behind its actuator, and certify them.

    By default the stiffest gains whose Ms and Mt stay at or below 1.6, found by gradient descent
    on the exact margins from several starts. With --uncertainty they hold for every actuator in
    the box: samples, corners and its worst interior point. With --control-rate the margins are
    those of the sampled loop. Gains are never worse than --kp and --kd, where they are given. What
    cannot be met is said, with the closest value that was found, and the exit code is 1; it is the
    best of all starts and of a grid, and no proof. All units are SI, delays in seconds.

    With --model: gains of a robot's joints, or of --groups of them, against the peaks of the
    largest singular values of S and T (and the multi-loop disk margin) of the robot linearised at
    every --keyframe, with every actuator of the box, sampled at its control rate; then held against
    nonlinear rollouts with noise, quantisation, limits, contacts and a push. Stiffness is the
    geometric mean of the joints'. --tracking-weight trades it for smaller errors in simulation.
    What is uncertain of the robot itself, a payload say, is not told to the drives: setpoint and
    feedforward stay those of the robot without, and it sags. What is certified is of each member
    linearised where it rests with the tuned gains. --pareto begins at the smallest peak within
    reach.

    With --drive the gains hold for all that the logs leave open; "drive_gain" of the JSON is the
    force that the drive gives over the one that it is told, by which gains are divided to be told.

    examples:
      jaxact tune --mass 0.7 --actuator starleth --delay 1e-3 --max-peak 1.6
      jaxact tune --actuator starleth --delay 1e-3 --uncertainty delay=0..5e-3,mass=0.5..1 --json
      jaxact tune --actuator hyq --delay 1e-3 --kp 400 --kd 20 --pareto 20 --out tuned
      jaxact tune --drive drive.toml --inertia 0.05 --uncertainty samples
      jaxact tune --model robot.xml --keyframe home --actuator hyq --groups hip,knee --max-peak 3
      jaxact tune --model robot.xml --uncertainty payload=0..3,delay=0..2e-3 --pareto 10 --out tuned
    """
    _folders.check_folder(out, overwrite=overwrite)
    whole = _arguments.demand_robot(robot, given=robot.model is not None or bool(robot.spec))
    search.check()
    given = _arguments.given(parameters)
    if whole:
        robot.check(joint)
    _cache.prepare(wanted=not no_cache)
    drive = None if whole else _loops.identified(given.get(DRIVE), given)
    loops = _loops.postures(robot, given, velocity) if whole else [_joint(given, velocity)]
    if whole and DRIVE in given:  # what a robot cannot take of it was said for each posture
        drive = load_drive(given[DRIVE])
    unsure = _unsure.uncertainty(search, drive, loops[0], given)

    from jaxact.loops import conversion
    from jaxact.tuning.course import NOTHING, ahead
    from jaxact.verbs import tuning_tables

    _signals.keep(NOTHING)
    with _progress.phases(quiet=json) as phase:
        best = _tuned(loops, goal, search, robot, unsure, ahead(phase, _phases(robot, whole)))
        best, rollouts = _held_against(best, robot.validate if whole else 0.0, phase)

        def reported() -> tuple[Any, dict[str, Any]]:
            phase("reporting")
            of_joint = tuning_tables.Joint(best, best.loop, joint)
            result = tuning_tables.Robot(best, rollouts) if whole else of_joint
            document = result.report()
            if search.pareto:
                document.setdefault("pareto", [])
            if out is not None:
                _write(result, document, out)
            return result, document

        result, document = _signals.to_the_end(reported)
    for one in loops:
        _warnings.posture(conversion.linear_specification(one))
    strength = float(loops[0].values.get(GAIN_SCALE, 1.0)) if drive is not None else 1.0
    if strength != 1.0:
        document["drive_gain"] = strength
    print(tuning_tables.as_json(document) if json else result.text(document))
    if not json:
        _say_more(strength, out)
    _warn_of(rollouts)
    _leave(best)


def _leave(best: Tuned) -> None:
    """Raise what gives the exit code of a result that is not all that was asked for."""
    if best.interrupted or _signals.code():
        raise KeyboardInterrupt(best.interrupted or "interrupted; everything is there")
    if not best.certified:
        raise SystemExit(NOT_MET)


def _phases(robot: Robot, whole: bool) -> list[str]:
    """Beginnings of what is said of each phase of tuning, see `jaxact.tuning.course.ahead`."""
    return ["", "simulating"] if whole and robot.validate else [""]


def _held_against(best: Tuned, seconds: float, phase: Told) -> tuple[Tuned, Rollouts | None]:
    """The gains, and rollouts with them; none where they are not wanted, or interrupted."""
    if seconds:  # before a signal ends what is done at once, and the gains with it
        from jaxact.tuning.rollouts import validation
    left_out = "the rollouts are left out"
    _signals.keep(_AT_ONCE)
    if best.interrupted:
        _signals.accept()
        return best.stopped(left_out) if seconds else best, None
    try:
        return best, validation.rollouts(best, seconds, phase) if seconds else None
    except KeyboardInterrupt:
        _signals.accept()
        return best.stopped(f"interrupted while simulating: {left_out}"), None


def _write(result: Any, document: dict[str, Any], out: Path) -> None:
    """The folder of a result; pictures are imported only for it."""
    from jaxact.verbs import tuning_folder

    with _folders.whole_folder(out) as folder:
        tuning_folder.write(result, folder, document, shlex.join(["jaxact", *sys.argv[1:]]))


def _say_more(strength: float, out: Path | None) -> None:
    """What the force of the drive is of its command, and where files are."""
    if strength != 1.0:
        print(f"the drive gives {strength:.4g} of its command: divide the gains by that to tell it")
    if out is not None:
        print(f"wrote {out}")


def _warn_of(rollouts: Rollouts | None) -> None:
    """Say so where rollouts contradict the certificate."""
    stable, of = (0, 0) if rollouts is None else rollouts.stable
    if stable < of:
        _warnings.warn(
            f"{of - stable} of {of} rollouts with these gains are not stable, whatever "
            "is certified at rest: add the postures that the robot comes to, or lower --max-peak"
        )


def _tuned(
    loops: list[ControlLoop], goal: Goal, search: Search, robot: Robot, unsure: Any, phase: Told
) -> Tuned:
    from jaxact.verbs.tune import tune

    if loops[0].kind.plant is not None and robot.validate:
        from jaxact.tuning.rollouts.exposure import check_push

        for one in loops:  # before a long search for gains that could not be held against it
            check_push(one.kind.push, robot.validate)
    bounds = {name: value for name, value in vars(goal).items() if value is not UNSET}
    name = bounds.pop("objective")
    samples, steps = (
        None if number == UNSET_NUMBER else number for number in (search.ensemble, search.steps)
    )
    if not isinstance(unsure, str):  # drawn already, as many as were asked for
        samples = None
    own = {} if loops[0].kind.plant is None else {
        "groups": robot.groups.split(",") if robot.groups else (),
        "tracking_weight": robot.tracking_weight, "derivative": robot.derivative,
    }  # fmt: skip
    return tune(
        loops, name, uncertainty=unsure, samples=samples, starts=search.starts,
        steps=steps, seed=search.seed, front=search.pareto, verify=search.verify,
        progress=phase, **own, **bounds,
    )  # fmt: skip


def _joint(given: dict[str, Any], velocity: str | None) -> ControlLoop:
    from jaxact.loops.building import joint

    loop = joint(velocity=velocity, **given)  # type: ignore[arg-type]
    if CONTROL_RATE not in loop.values:
        _loops.check_continuous(loop)
    return loop
