"""`jaxact.tune`: the best gains of a joint, an ensemble of actuators or a robot, certified."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.errors import UserError, shown
from jaxact.loops import conversion, drives
from jaxact.loops.control_loop import ControlLoop, demand
from jaxact.loops.drives import IdentifiedDrive
from jaxact.parameters import (
    CONTROL_RATE,
    GAIN_SCALE,
    JOINT_STIFFNESS,
    KD,
    KP,
    MASS,
    base,
    canonical,
)
from jaxact.simulation.engines import tell_inexact
from jaxact.tuning.box import KNOWN, inside, read_box
from jaxact.tuning.course import Told, ahead
from jaxact.tuning.goal import MOST_PEAKS, Goal
from jaxact.tuning.groups import group
from jaxact.tuning.joint import search as _joint_search
from jaxact.tuning.joint.ensemble import FIELDS, joined, uncertain
from jaxact.tuning.joint.response import TIMED
from jaxact.tuning.optimise import Descent
from jaxact.tuning.result import Tuned
from jaxact.verbs import notebook, showing, unsure_gain
from jaxact.verbs.goals import check_options, check_uncertain, goal_of, ranges_of
from jaxact.verbs.plants import demand_at_once, drawn_of, nominal_of

if TYPE_CHECKING:
    from jaxact.loops.specification import Specification
    from jaxact.tuning.robot.loops import Situation

# A box of so many ranges has 256 corners, each of them a robot to linearise.
_MOST_OPEN = 8
# How results look is not their own layer's to know.
Tuned._repr_html_ = notebook.tuned  # type: ignore[attr-defined]
Range = tuple[float, float] | str
"""(low, high), or as it is written on the command line: "0.8x..1.2x"."""


def tune(
    loop: ControlLoop | Sequence[ControlLoop],
    goal: str | Goal = "stiffness",
    *,
    uncertainty: Mapping[str, Range] | str | ControlLoop | IdentifiedDrive = "",
    samples: int | None = None,
    sampled: bool | None = None,
    groups: Sequence[str] = (),
    starts: int = _joint_search.STARTS,
    steps: int | None = None,
    seed: int = 0,
    front: int = 0,
    verify: bool = False,
    tracking_weight: float = 0.0,
    derivative: str = "auto",
    progress: bool | Told = True,
    **bounds: Any,
) -> Tuned:
    """Find the best gains of a loop, and certify them.

        best = jaxact.tune(loop, max_peak=1.6, uncertainty={"wn": (0.8, 1.2), "delay": (0, 5e-3)})
        best.loop, best.certified

    Args:
        loop: of a joint, a single one; or of a robot, or one loop for each of its postures. Gains
            that it was given (or that the robot's model brings) are what the result is never worse
            than.
        goal: "stiffness" (largest kp), "bandwidth", "disk-margin", "settling", "tracking:FILE" (a
            CSV file of time [s], setpoint [m]), or a `jaxact.tuning.goal.Goal`.
        uncertainty: parameter -> (low, high), the ends of the range in which it lies (where
            `jaxact.sweep` takes a list of values): wn and zeta as factors, others as they are:
            mass [kg], delay [s] (the command's, beside the loop's other delays). What the loop was
            given must be within; a default that is not gives way to the middle. Of a robot also
            other delays, payload [kg], inertia_scale, ...; or as the command line writes it; or an
            identified drive, for the 95 % intervals of all that the loop has from it. Of a joint
            also a batch of loops, such as the `samples` of what was identified; their gains do not
            count.
        samples: of the uncertainty, beside its corners and its worst interior point (where the
            worst member counts; a mean is over the samples alone); None: 32, of a robot 8.
        sampled: of a joint, whether the margins are those of the sampled loop; None: where the loop
            was given a control rate. A robot's are always sampled.
        groups: of a robot, patterns found in the names of joints or actuators: the joints of one
            share their gains; none: every joint its own.
        starts, steps: of the descent; None for 80 steps, or 150 for a joint's simulated time.
        seed: of the samples.
        front: points of the front of stiffness against robustness, 0 for none.
        verify: compare with brute force.
        tracking_weight: of a robot, weight of simulated tracking in the objective.
        derivative: of simulated tracking, "auto", "forward" or "reverse".
        progress: show what is being done, and how much of it is left, on a terminal and in a
            notebook; or a function that is called with what is being done and what is to come, how
            much of the former is done, and how much there is at most (0 and 0 where that is not
            known).
        bounds: of the goal: max_peak (of the sensitivity and the complementary sensitivity alike,
            1.6 where nothing is given; of "disk-margin" none), min_kp, max_kp, min_disk_margin, of
            a joint also min_gain_margin, min_delay_margin, max_noise_gain, risk.

    Returns:
        The tuned loop; where the goal cannot be met, the closest that was found, not certified.
        Interrupted (Ctrl-C, or a notebook's stop button), the best certified gains until then, with
        `interrupted` saying during what, and what was left out.

    Raises:
        UserError: a loop, a goal or ranges that make no sense.
        KeyboardInterrupt: interrupted before any gains were certified, or a second time.
        TypeError: the loop is traced.
    """
    asked = goal_of(goal, bounds)
    one = isinstance(loop, ControlLoop) or not isinstance(loop, Iterable)
    loops: list[Any] = [loop] if one else list(loop)
    if one:
        demand(loop)
    counts = {"starts": (starts, 0), "steps": (steps, 1), "samples": (samples, 1)}
    check_options(sampled, seed, derivative, counts=counts)
    if not loops or not all(isinstance(one, ControlLoop) for one in loops):
        raise UserError("loop: give one loop, or a list of loops of a robot in its postures")
    if front and not (isinstance(front, int | np.integer) and 2 <= front <= MOST_PEAKS):
        raise UserError(f"`front` {shown(front)}: give between 2 and {MOST_PEAKS} points")
    if front and tracking_weight:
        raise UserError("`front`: cannot be combined with `tracking_weight`")
    if not isinstance(uncertainty, str | Mapping | ControlLoop):
        uncertainty = intervals(drives.taken(uncertainty), loops[0])
    check_uncertain(uncertainty, loops[0], samples, asked.risk)
    unsure = ranges_of(uncertainty) if isinstance(uncertainty, Mapping) else uncertainty
    common: dict[str, Any] = {"uncertainty": unsure, "samples": samples, "starts": starts,
                              "steps": steps, "seed": seed, "front": front,
                              "verify": verify}  # fmt: skip
    whole = any(one.kind.plant is not None for one in loops)
    if len(loops) > 1 and not whole:
        raise UserError("loop: several postures are for a robot; of a joint give one loop")
    for name, value in (("groups", groups), ("tracking_weight", tracking_weight)):
        if value and not whole:
            raise UserError(f"`{name}`: is for a robot; make one with jaxact.robot(model, ...)")
    boxed = not whole and isinstance(unsure, str) and bool(read_box(unsure, FIELDS).uncertain)
    with showing.steps(progress) as shown_to:
        told = ahead(shown_to, _phases(whole, boxed, verify, bool(tracking_weight), bool(front)))
        if not whole:
            return _of_joint(loops[0], asked, sampled, told=told, **common)
        return _of_robot(loops, asked, groups=groups, tracking_weight=tracking_weight,
                         derivative=derivative, told=told, **common)  # fmt: skip


def _phases(whole: bool, boxed: bool, verify: bool, weighed: bool, front: bool) -> list[str]:
    """What a tuning does, in order, as `jaxact.tuning.course.ahead` takes it."""
    every = [
        (whole, "settling and linearising"),
        (whole, "tabulating"),
        (whole, "screening"),
        (True, "descending"),
        (True, "polishing"),
        (boxed, "looking for the worst point of the box"),
        (True, "certifying"),
        (weighed, "weighing simulated tracking"),
        (whole and verify, "comparing with brute force"),
        (front, "walking along the front"),
        (whole and front, "certifying the front"),
    ]
    return [phase for done, phase in every if done]


def intervals(drive: IdentifiedDrive, loop: ControlLoop, ranges: str = "") -> str:
    """The 95 % intervals of what a loop has from its drive, as the command line writes them.

    Args:
        drive: identified.
        loop: what it says otherwise is known.
        ranges: that replace those of the drive, or are beside them.

    Raises:
        UserError: more numbers are open than a box can have.
    """
    given = {canonical(part.partition("=")[0].strip()) for part in ranges.split(",") if part}
    if loop.kind.plant is None:
        drive = drive.moving({MASS: loop.parameters[MASS]})
        if MASS not in given and "gain" in drive.intervals:
            unsure_gain.demand_force(drive)
    found = drive.uncertainty
    if loop.kind.plant is not None:
        found = {name: span for name, span in found.items() if name not in (MASS, JOINT_STIFFNESS)}
        unsure_gain.tell_left_out(drive)
    own = {
        name: span
        for name, span in found.items()
        if name not in given and (name not in drive.joint or _has(loop, name, drive.joint[name]))
    }
    if MASS in found and not {*own, *given} & {MASS} and (moved := unsure_gain.as_inertia(drive)):
        own[MASS] = moved  # the inertia is the loop's own
    if len(own) > _MOST_OPEN:
        raise UserError(
            f"`uncertainty`: {drive.name} leaves {len(own)} numbers open, and their box has too"
            " many corners; give ranges of your own, or identify fewer groups of joints"
        )
    return ",".join(part for part in (ranges_of(own), ranges) if part)


def _has(loop: ControlLoop, name: str, value: float) -> bool:
    """Whether a loop has this value of a parameter, by its key."""
    own = loop.parameters
    return name in own and bool(np.all(own[name] == value))


def _of_joint(
    loop: ControlLoop,
    goal: Goal,
    sampled: bool | None,
    *,
    uncertainty: str | ControlLoop,
    samples: int | None,
    starts: int,
    steps: int | None,
    seed: int,
    front: int,
    verify: bool,
    told: Told,
) -> Tuned:
    conversion.linear_specification(loop)  # what does not fit is said here
    if goal.metric in TIMED:
        demand_at_once(loop)
    sampled = CONTROL_RATE in loop.values if sampled is None else sampled
    nominal = nominal_of(loop, sampled)
    start = _start_of_joint(loop)
    how = None if steps is None else Descent(steps=steps)
    box = KNOWN
    middle: dict[str, float] = {}
    if isinstance(uncertainty, ControlLoop):
        drawn = drawn_of(uncertainty, loop, nominal.sampling, timed=goal.metric in TIMED)
        nominal = joined(nominal, drawn)
    else:
        box = read_box(uncertainty, FIELDS)
        middle, box = inside(box, loop.values, loop.parameters, loop.kind.unit)
        nominal = nominal_of(loop.replace(**middle), sampled)
        if not box.uncertain:
            check_uncertain("", loop, samples, goal.risk)
    tuned = _joint_search.tune(
        nominal, goal, box, number=samples or _joint_search.SAMPLES,
        seed=seed, start=start, starts=starts, how=how, verify=verify, told=told,
    )  # fmt: skip
    members: Any = tuned.members
    plants = uncertain(nominal, box) if box.uncertain else None
    tuned = _with_front(tuned, front, told, lambda: _joint_search.front(
        members, goal, front, plants=plants, seed=seed, starts=starts, how=how
    ))  # fmt: skip
    gains = {KP: tuned.kp, KD: tuned.kd}
    scale = {GAIN_SCALE: 1.0} if GAIN_SCALE in loop.values else {}
    there = loop.replace(**gains, **scale, **middle)
    along = tuple(
        dataclasses.replace(one, loop=there.replace(kp=one.kp, kd=one.kd)) for one in tuned.front
    )
    return dataclasses.replace(tuned, loop=there, front=along)


def _with_front(
    tuned: Tuned, front: int, told: Told, walked: Callable[[], Sequence[Tuned]]
) -> Tuned:
    """The result with its front, where one is wanted; without, where it is interrupted."""
    if not front or tuned.interrupted:
        return tuned
    try:
        told("walking along the front")
        return dataclasses.replace(tuned, front=tuple(walked()))
    except KeyboardInterrupt:
        return tuned.stopped("interrupted while walking along the front, which is left out")


def _start_of_joint(loop: ControlLoop) -> tuple[float, float] | None:
    """The gains to be no worse than: both, or none."""
    given = [name for name in (KP, KD) if name in loop.values]
    if len(given) == 1:
        raise UserError(f"`{given[0]}`: give both `kp` and `kd` to start from, or none")
    if not given:
        return None
    own = conversion.one(loop)
    for name in given:
        if not 0.0 < own[name] < math.inf:
            raise UserError(f"`{name}` {own[name]:g}: a start must be positive and finite")
    return own[GAIN_SCALE] * own[KP], own[GAIN_SCALE] * own[KD]


def _named(loops: Sequence[ControlLoop]) -> list[tuple[str, Specification]]:
    """A name and a specification for every posture of a robot."""
    named: list[tuple[str, Specification]] = []
    for one in loops:
        if one.kind.plant is None or one.shape:
            raise UserError("loop: give single loops of a robot, one for each posture")
        name = one.kind.plant.keyframe or one.kind.plant.model.stem
        name = one.kind.names[0] if one.kind.names else name
        known = sum(other.partition(" (")[0] == name for other, _ in named)
        own = conversion.linear_specification(one, engine="mujoco")
        named.append((f"{name} ({known + 1})" if known else name, own))
    return named


def _of_robot(
    loops: Sequence[ControlLoop],
    goal: Goal,
    *,
    uncertainty: str | ControlLoop = "",
    samples: int | None = None,
    groups: Sequence[str] = (),
    starts: int = _joint_search.STARTS,
    steps: int | None = None,
    seed: int = 0,
    front: int = 0,
    verify: bool = False,
    tracking_weight: float = 0.0,
    derivative: str = "auto",
    told: Told,
) -> Tuned:
    """Find the best gains of a robot, and certify them.

    Args:
        loops: one for every posture.
        uncertainty: as the command line writes it; the others as for `tune`.
    """
    from jaxact.tuning.robot import front as _front
    from jaxact.tuning.robot import search
    from jaxact.tuning.robot.amid import amid
    from jaxact.tuning.robot.loops import VARIED, situation
    from jaxact.tuning.rollouts import exposure, tracking

    named = _named(loops)
    if isinstance(uncertainty, ControlLoop):
        raise UserError("`uncertainty`: of a robot give ranges, or an identified drive")
    box = read_box(uncertainty, VARIED, patterns=True)
    if not box.uncertain:
        check_uncertain("", loops[0], samples, goal.risk)
    for (_, one), loop in zip(named, loops, strict=True):
        if tracking_weight:  # simulated in MJX
            tell_inexact(one.plant)
            exposure.check_push(loop.kind.push, tracking.SECONDS)
    situations: list[Situation] = []
    middles: list[dict[str, float]] = []
    for place, (name, one) in enumerate(named):
        told(f"settling and linearising {name}", place, len(named))
        middle, around = amid(one, box)
        middles.append(middle)
        own = dataclasses.replace(one, parameters={**one.parameters, **middle})
        # A push counts in rollouts, and not for what is linear.
        situations.append(situation(own, name, around).pushed(loops[place].kind.push))
    chosen = group(tuple(groups), situations[0].names)
    tuned = search.tune(
        situations, goal, chosen, number=samples or search.SAMPLES, seed=seed,
        start=_start(situations[0], named[0][1]), starts=starts, steps=steps or search.STEPS,
        verify=verify, tracking_weight=tracking_weight, derivative=derivative, told=told,
    )  # fmt: skip
    there = dataclasses.replace(loops[0], values={**loops[0].values, **middles[0]})
    tuned = dataclasses.replace(tuned, loop=_with_gains(there, tuned))
    return _with_front(tuned, front, told, lambda: _front.front(tuned, front, seed=seed, told=told))


def _start(first: Situation, given: Specification) -> tuple[np.ndarray, np.ndarray] | None:
    """The gains to be no worse than: those given, or that the model brings; None for none."""
    if first.kp is None or first.kd is None:
        alone = [name for name in (KP, KD) if name in map(base, given.parameters)]
        if alone:
            raise UserError(
                f"`{alone[0]}`: the model brings no gains to start from; give both `kp` and `kd`, "
                "or none"
            )
        return None
    plant = given.plant
    if not first.kd.all() and plant is not None and plant.damping != "drive":
        joint = first.names[int(np.argmin(first.kd != 0.0))][0]
        raise UserError(
            f"{joint}: kd is 0, and there is no start from it; give `kd`, or `damping` drive where "
            "the model has the drive's D gain in <joint damping>"
        )
    return first.kp, first.kd


def _with_gains(loop: ControlLoop, tuned: Tuned) -> ControlLoop:
    """The loop with the gains of every joint, in place of all that it was given."""
    kept = {
        name: value for name, value in loop.values.items() if base(name) not in (KP, KD, GAIN_SCALE)
    }
    assert tuned.robot is not None
    joints = tuned.robot.case.groups.joints
    for name, gains in ((KP, tuned.kp), (KD, tuned.kd)):
        for joint, value in zip(joints, gains, strict=True):
            kept[f"{name}@{re.escape(joint)}"] = float(value)
    return dataclasses.replace(loop, values=kept)
