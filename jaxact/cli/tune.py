"""`jaxact tune`: the best gains for a joint, certified."""

from __future__ import annotations

import dataclasses
import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import OmitArgPrefixes, arg

from jaxact.cli import _cache, _folders, _loops, _progress, _robot_tuning
from jaxact.cli._pictures import VELOCITIES, Velocity, check_continuous
from jaxact.errors import UserError, nearest, shown

if TYPE_CHECKING:
    from jaxact.tuning.goal import Goal
    from jaxact.tuning.result import Tuned

# Exit code of a result that does not meet what was asked.
NOT_MET = 1

Parameters = _loops.options((*_loops.LINEAR, "control_rate"), several=False)


# Bounds of a goal: what is written for the value, what it is against, and the default.
_BOUNDS = {
    "max_peak": (
        "RATIO", "Largest Ms and Mt, against any modelling error; inf: none.", _loops.UNSET
    ),
    "min_gain_margin": ("FACTOR", "Smallest gain margin, against a lighter load; 1: none.", 1.0),
    "min_delay_margin": (
        "SECONDS", "Smallest delay margin [s], against a later bus; 0: none.", 0.0
    ),
    "min_disk_margin": (
        "VALUE",
        "Smallest disk margin, against gain and phase off, in each joint separately; 0: none.", 0.0,
    ),
    "min_kp": (
        "VALUE", "Softest kp [N/m; N m/rad of a hinge], against a joint too soft; 0: none.", 0.0
    ),
    "max_kp": (
        "VALUE", "Stiffest kp [N/m; N m/rad of a hinge], against hard contact; inf: none.", math.inf
    ),
    "max_noise_gain": (
        "VALUE",
        "Largest rms force per encoder count [N/m], against noise and heat: rounding read at the "
        "control rate, 1 kHz without one; inf: none.", math.inf,
    ),
}  # fmt: skip


def _bound(name: str) -> tuple[str, Any, Any]:
    metavar, words, default = _BOUNDS[name]
    hint = "(default: 1.6, none for disk-margin)" if default is _loops.UNSET else None
    conf = arg(metavar=metavar, help=words, help_behavior_hint=hint)
    return name, Annotated[float, conf], dataclasses.field(default=default)


Bounds = dataclasses.make_dataclass("Bounds", [_bound(name) for name in _BOUNDS], frozen=True)


def main(
    parameters: Annotated[Parameters, OmitArgPrefixes] = Parameters(),  # type: ignore[valid-type] # noqa: B008
    bounds: Annotated[Bounds, OmitArgPrefixes] = Bounds(),  # type: ignore[valid-type] # noqa: B008
    robot: Annotated[_robot_tuning.Options, OmitArgPrefixes] = _robot_tuning.Options(),  # noqa: B008
    *,
    objective: Annotated[
        str,
        arg(
            metavar="NAME",
            help="stiffness: largest kp. bandwidth: largest. disk-margin: largest, with --min-kp. "
            "settling: shortest time to 2 %. tracking:FILE: smallest rms error along a CSV file of "
            "time [s], setpoint [m].",
        ),
    ] = "stiffness",
    uncertainty: Annotated[
        str,
        arg(
            metavar="RANGES",
            help="What is not known, e.g. wn=0.8..1.2,zeta=0.7..1.1,delay=0..5e-3,mass=0.5..1.0: "
            "wn and zeta as factors on the actuator's, mass [kg] and delay [s] as they are; an x "
            "makes them factors too: mass=0.8x..1.2x. Of a robot, for mass: payload [kg], the "
            "factors inertia_scale and contact_friction, and joint_damping [N m s/rad] and "
            "joint_armature [kg m^2] added to the model's.",
            help_behavior_hint="(default: none)",
        ),
    ] = "",
    ensemble: Annotated[
        int,
        arg(
            metavar="NUMBER",
            help="Samples of the uncertainty, beside its corners.",
            help_behavior_hint="(default: 32, of a robot 8)",
        ),
    ] = _loops.UNSET_NUMBER,
    risk: Annotated[
        str,
        arg(metavar="worst|mean|cvar:A", help="Which members count; all are stable in any case."),
    ] = "worst",
    velocity: Velocity = "sampled",
    starts: Annotated[int, arg(metavar="NUMBER", help="Default starts of the descent.")] = 8,
    steps: Annotated[int, arg(metavar="NUMBER", help="Steps of the descent.")] = 150,
    seed: Annotated[int, arg(metavar="NUMBER", help="Of the sampled uncertainty.")] = 0,
    pareto: Annotated[
        int, arg(metavar="NUMBER", help="Points of the front over the peak allowed; 0: none.")
    ] = 0,
    verify: Annotated[bool, arg(help="Compare with a brute-force grid over all gains.")] = False,
    out: Annotated[
        Path | None,
        arg(
            metavar="FOLDER",
            help="Write gains.toml, gains.xml (MJCF) and pictures there.",
            help_behavior_hint="(default: no)",
        ),
    ] = None,
    joint: Annotated[str, arg(metavar="NAME", help="Joint in the MJCF file.")] = "joint",
    overwrite: Annotated[bool, arg(help="Replace the folder if it is there.")] = False,
    json: Annotated[bool, arg(help="Print the result as one line of JSON.")] = False,
    no_cache: Annotated[
        bool, arg(help="Compile anew, and keep no compiled programs from run to run.")
    ] = False,
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
    feedforward stay those of the robot without, and each member is linearised where it rests under
    its own weight. --pareto begins at the smallest peak within reach.

    examples:
      jaxact tune --mass 0.7 --actuator starleth --delay 1e-3 --max-peak 1.6
      jaxact tune --actuator starleth --delay 1e-3 --uncertainty delay=0..5e-3,mass=0.5..1 --json
      jaxact tune --actuator hyq --delay 1e-3 --kp 400 --kd 20 --pareto 20 --out tuned
      jaxact tune --model robot.xml --keyframe home --actuator hyq --groups hip,knee --max-peak 3
      jaxact tune --model robot.xml --uncertainty payload=0..3,delay=0..2e-3 --pareto 10 --out tuned
    """
    _folders.check_folder(out, overwrite=overwrite)
    whole = _robot_tuning.asked(robot)
    samples = None if ensemble == _loops.UNSET_NUMBER else ensemble
    if velocity not in VELOCITIES:
        raise UserError(f"--velocity {shown(velocity)}; {nearest(velocity, VELOCITIES)}")
    for name, number in (("starts", starts), ("steps", steps), ("ensemble", samples)):
        if number is not None and not 1 <= number <= 10_000:
            raise UserError(f"--{name} {number}: give between 1 and 10000")
    if not 0 <= seed < 2**63:
        raise UserError(f"--seed {seed}: give between 0 and 2^63 - 1")
    given = _loops.given(parameters)
    goal = _goal(objective, risk, **vars(bounds))
    if pareto:
        _check_front(pareto, robot)
    if whole and joint != "joint":
        raise UserError("--joint: is for a single joint; a robot's are named by its model")
    asked = {"samples": samples, "seed": seed, "starts": starts, "steps": steps, "front": pareto,
             "verify": verify, "uncertainty": uncertainty}  # fmt: skip
    chosen = None if whole else _linear(given, velocity)
    _cache.prepare(wanted=not no_cache)

    from jaxact.cli import _front, _tuning

    result: _tuning.Joint | _tuning.Robot
    with _progress.phases(quiet=json) as phase:
        if chosen is None:
            tuned, rollouts = _robot_tuning.tuned(robot, given, goal, velocity, phase, asked)
            result = _tuning.Robot(tuned, rollouts)
        else:
            tuned = _tuned(given, goal, velocity, phase, asked)
            result = _tuning.Joint(tuned, chosen, joint, sampled="control_rate" in given)
        phase("reporting")
    document = result.report()
    front = _front.front(tuned.front) if tuned.front else None
    if pareto:
        document["pareto"] = [] if front is None else _front.report(front)
    if out is not None:
        with _folders.whole_folder(out) as folder:
            result.write(folder, document, shlex.join(["jaxact", *sys.argv[1:]]))
            if front is not None:
                _front.write(folder, front, goal.max_peak)
    if json:
        print(_tuning.as_json(document))
    else:
        print(result.text(document) + ("" if front is None else "\n\n" + _front.table(front)))
        if out is not None:
            print(f"wrote {out}")
    result.warn()
    if not tuned.certified:
        raise SystemExit(NOT_MET)


def _check_front(points: int, robot: _robot_tuning.Options) -> None:
    from jaxact.tuning.goal import MOST_PEAKS

    if not 2 <= points <= MOST_PEAKS:
        raise UserError(f"--pareto {points}: give between 2 and {MOST_PEAKS} points")
    if robot.tracking_weight:
        raise UserError("--pareto: cannot be combined with --tracking-weight")


def _linear(given: dict[str, Any], velocity: str) -> _loops.Loops:
    """The loop that is meant, checked."""
    own = [name for name in ("kp", "kd") if name in given]
    if len(own) == 1:
        raise UserError(f"--{own[0]}: give both --kp and --kd to start from, or none")
    for name in own:
        if not 0 < given[name] < math.inf:
            raise UserError(f"--{name} {given[name]:g}: a start must be positive and finite")
    chosen = _loops.linear_combinations({n: (v,) for n, v in given.items()}, velocity=velocity)
    if "control_rate" not in given:
        check_continuous(chosen, velocity)
    return chosen


def _tuned(
    given: dict[str, Any], goal: Goal, velocity: str, phase: Any, asked: dict[str, Any]
) -> Tuned:
    from jaxact.loops.building import joint
    from jaxact.verbs.tune import tune

    return tune(joint(**given, velocity=velocity), goal, phase=phase, **asked)


def _goal(objective: str, risk: str, *, max_peak: float, **bounds: float) -> Goal:
    from jaxact.tuning.goal import Goal, check

    name, colon, file = objective.partition(":")
    extra: dict[str, Any] = {}
    if name == "tracking" and colon:
        extra["reference"], extra["reference_period"] = _reference(Path(file))
    elif colon:
        raise UserError(f"--objective {shown(objective)}: only tracking takes a file")
    if max_peak is _loops.UNSET:
        max_peak = math.inf if name == "disk-margin" else 1.6
    if any(math.isnan(value) for value in (max_peak, *bounds.values())):
        raise UserError("nan is not a bound")
    return check(Goal(objective=name, risk=risk, max_peak=max_peak, **bounds, **extra))


def _reference(path: Path) -> tuple[tuple[float, ...], float]:
    """Setpoints and the time between them, from a CSV file of time and setpoint."""
    import numpy as np

    try:
        rows = np.loadtxt(path, delimiter=",", comments="#", ndmin=2, encoding="utf-8")
    except OSError as error:
        reason = error.strerror or "is missing"
        raise UserError(f"{path}: cannot be read ({reason}); give a CSV file") from None
    except (ValueError, UnicodeDecodeError):
        raise UserError(
            f"{path}: write lines of time [s], setpoint [m]; # begins a comment"
        ) from None
    if rows.shape[1] != 2 or len(rows) < 2 or not np.all(np.isfinite(rows)):
        raise UserError(f"{path}: write at least two lines of time [s], setpoint [m]")
    time, setpoint = rows.T
    if not np.all(np.diff(time) > 0):
        raise UserError(f"{path}: times must rise")
    if np.ptp(setpoint) == 0:
        raise UserError(f"{path}: the setpoint never moves, any gains track it")
    period = float(np.min(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * period, period)
    if len(even) > 100_000:
        raise UserError(f"{path}: its shortest interval divides it into {len(even):,} steps")
    return tuple(map(float, np.interp(even, time, setpoint))), period
