"""Gains for a whole robot, from end to end: situations and actuators, descent, polish, certificate.

    stand = situation(specification, "stand")
    tuned = tune([stand], Goal(max_peak=2.0), group(["hip", "knee"], stand.names))

The constraints are those of a joint, on the largest singular values of S and T and on the
multi-loop disk margin, of every situation with every actuator. Stiffness is the geometric mean of
the joints'.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jaxact.analysis.robot.one_thread import one_thread
from jaxact.errors import UserError
from jaxact.loops import robots
from jaxact.parameters import KD, KP
from jaxact.tuning.certificate import Effort
from jaxact.tuning.course import INTERRUPTED, NOTHING, Course, Told, silent
from jaxact.tuning.goal import WORST, Goal, check
from jaxact.tuning.groups import Groups
from jaxact.tuning.optimise import Descended, Descent, no_path
from jaxact.tuning.result import Gains, OfRobot, Outcome, Tuned, judged
from jaxact.tuning.robot import brute, cores, resting
from jaxact.tuning.robot.descent import (  # fmt: skip
    approached,
    best_of,
    bounds,
    descended,
    hardest,
    least_inertias,
    stabilised,
    usual,
)
from jaxact.tuning.robot.exact import Exact, exact, leading
from jaxact.tuning.robot.exchange import Candidate, exchanged, inside_worse
from jaxact.tuning.robot.loops import Situation, integrated
from jaxact.tuning.robot.open_loops import OpenLoops, open_loops
from jaxact.tuning.robot.peaks import tabulate
from jaxact.tuning.robot.polishing import polished
from jaxact.tuning.robot.rows import Found, RobotCase, more
from jaxact.tuning.robot.so_far import so_far
from jaxact.tuning.robot.starts import CLOUDS, apart, closer, screened
from jaxact.tuning.rollouts import tracking

STARTS, SAMPLES, STEPS = 8, 8, 80
OBJECTIVES = ("stiffness", "disk-margin")
# Clouds that lead away from where a rescue ends, the wide ones.
_WIDE = 4
# What of a goal a robot can be asked for.
BOUNDS = ("max_peak", "min_disk_margin", "min_kp", "max_kp")


@one_thread()
def tune(
    situations: Sequence[Situation],
    goal: Goal,
    groups: Groups,
    *,
    number: int = SAMPLES,
    seed: int = 0,
    start: Gains | None = None,
    starts: int = STARTS,
    steps: int = STEPS,
    verify: bool = False,
    tracking_weight: float = 0.0,
    derivative: str = "auto",
    told: Told = silent,
) -> Tuned:
    """The best gains of a robot's groups of joints.

    Interrupted, it gives the best gains until then that are certified.

    Args:
        situations: of one robot, with the same joints and the same box of what is uncertain; its
            corners and worst interior points are members too.
        goal: objective and constraints, of every situation with every member.
        groups: of the joints.
        number: of samples of the box.
        seed: of the samples.
        start: (kp, kd) of the joints to be no worse than, shape (joints,) each; may be unstable.
        starts, steps: of the descent.
        verify: compare with brute force.
        tracking_weight: of simulated tracking in the objective, 0 for margins alone.
        derivative: of simulated tracking, "auto", "forward" or "reverse".
        told: what is being done.

    Raises:
        UserError: a goal, situations or a start that make no sense.
        KeyboardInterrupt: interrupted before any gains were certified.
    """
    begun = time.perf_counter()
    _check(situations, goal, groups, start)
    mode = tracking.check(tracking_weight, derivative, len(groups))
    _check_verify(len(groups), verify=verify, weighed=tracking_weight > 0.0)
    course = Course(told)
    own: dict[str, Any] = {"begun": begun, "start": start}
    try:
        course.phase("tabulating responses")
        case, x, known, tried = _begun(situations, goal, groups, start, number, seed, course)
        with cores.helped(worthwhile=case.takes_long):
            if not case.stable(x):
                nowhere = Candidate(case, Found(x, -np.inf, np.inf, tried, 0), None, None)
                return judge(situations, nowhere, seed, effort=Effort(0, tried), **own)
            own |= {"effort": Effort(starts, tried)}
            own["paths"], found = _searched(case, x, known, starts, steps, course)
            own |= {"effort": Effort(len(own["paths"].gains), tried)}
            course.best = best = exchanged(case, situations, found, seed, course)
            own |= {"aside": best.found.x}
            if tracking_weight > 0.0 and best.found.met:
                course.phase("weighing simulated tracking")
                best = _traded(best, situations, tracking_weight, mode, seed)
            if verify and best.found.met:
                course.phase("comparing with brute force")
                best, own["gap"] = brute.verified(best, situations, seed)
            course.best = best = replace(best, found=more(best.found, tried, steps))
            return _judged_at_rest(situations, best, seed, course, own)
    except KeyboardInterrupt:
        return _until_then(situations, course, seed, own)


def _judged_at_rest(
    situations: Sequence[Situation], best: Candidate, seed: int, course: Course, own: dict[str, Any]
) -> Tuned:
    """What the search has led to, judged where every member rests with its gains."""
    there, moved = resting.settled(best, situations, seed, course)
    tuned = judge(moved, there, seed, **own)
    if not best.found.met or tuned.certified or tuned.certificate.unheld:
        return tuned
    why = (
        "gains were found that meet the constraints where stiff joints would hold the members, "
        f"not where they rest with these gains, after {resting.TURNS} turns of searching there"
    )
    return replace(tuned, verdict=f"{tuned.verdict}; {why}")


def _until_then(
    situations: Sequence[Situation], course: Course, seed: int, own: dict[str, Any]
) -> Tuned:
    """The best certified gains of an interrupted search; KeyboardInterrupt where there are none."""
    doing = course.doing
    course.phase(f"{INTERRUPTED}, certifying the best gains so far")
    best = course.best
    if best is None and course.case is not None:
        best = so_far(course.case, course.points)
    if best is not None:
        best, situations = resting.settled(best, situations, seed, turns=1)
        inside = best.interior is not None or not len(situations[0].box)
        note = replace(course, doing=doing).note(inside=inside)
        tuned = judge(situations, best, seed, note=note, **own)
        if tuned.certified:
            return tuned
    raise KeyboardInterrupt(NOTHING) from None


def judge(
    situations: Sequence[Situation],
    best: Candidate,
    seed: int,
    *,
    paths: Descended | None = None,
    begun: float | None = None,
    effort: Effort | None = None,
    start: Gains | None = None,
    gap: float | None = None,
    aside: np.ndarray | None = None,
    note: str = "",
) -> Tuned:
    """Judge what a search has led to against everything asked, and against the start.

    Args:
        situations: of the robot.
        best: what it has led to.
        seed: of the climbs in the box.
        paths: of the starts of the descent, None where there was none.
        begun: time of the beginning [s], None for now.
        effort: of the search, None where it only went on from some gains.
        start: gains of the joints to be no worse than.
        gap: to brute force, None where that was not asked for.
        aside: log-gains that the margins alone led to.
        note: how the search was interrupted, "" where it was not; the start is then not climbed.
    """
    case, found = best.case, best.found
    loops, term = case.table.loops, case.tracking
    tuned_to = case.groups.gains(found.x)
    wanted = tuple(sorted({*case.goal.wanted, "sensitivity_peak", "complementary_peak"}))

    def there(gains: Gains) -> tuple[RobotCase, Sequence[Situation]]:
        """With members where they rest with these gains, as those of the case do with its own."""
        if np.array_equal(gains[0], tuned_to[0]) or not resting.gives_way(situations):
            return case, situations
        return resting.at_rest(case, situations, gains[0])

    def look(gains: Gains) -> Exact:
        return exact(there(gains)[0].table.loops, *gains, wanted)

    def inside(gains: Gains) -> float | None:
        if note:
            return None
        at, members = there(gains)
        joints = at.groups.joints
        own = replace(at, groups=Groups(joints, np.arange(len(joints)), joints))
        found = inside_worse(own, members, own.groups.log_gains(*gains), look(gains), seed)
        return None if found is None else found.excess

    def score(gains: Gains, value: float) -> float:
        if term is None or np.isnan(value):
            return value
        rms, _ = term.log_rms(case.groups.log_gains(*gains))
        return float(value * np.exp(-term.weight * rms))

    known = best.known if best.known is not None and set(wanted) <= set(best.known.log) else None
    outcome = Outcome(
        case.groups.gains(found.x), found.met, known, paths or no_path(found.x), found.evaluations,
        found.steps, time.perf_counter() if begun is None else begun, effort, best.interior, gap,
        integrated(situations), interrupted=note,
    )  # fmt: skip
    robot = OfRobot(tuple(situations), case)
    tuned = judged(
        case.goal, loops, outcome, look, start=start, inside=inside, score=score, robot=robot
    )
    tuned = _held(_blamed(tuned, case.groups.joints), *there((tuned.kp, tuned.kd)))
    if term is None or aside is None:
        return tuned
    x = case.groups.log_gains(tuned.kp, tuned.kd)
    before = None if start is None else case.groups.log_gains(*start)
    tracked = term.tracked(case.stable, x, aside, before)
    return replace(tuned, robot=replace(robot, tracked=tracked))


def _held(tuned: Tuned, case: RobotCase, situations: Sequence[Situation]) -> Tuned:
    """The same; not certified where a member does not rest with the gains."""
    why = resting.unheld(case.table.loops, situations, tuned.kp)
    if not (why and tuned.certified):
        return tuned
    certificate = replace(tuned.certificate, unheld=why)
    words = f"not every member rests with these gains ({why})"
    return replace(tuned, certificate=certificate, verdict=words)


def _blamed(tuned: Tuned, joints: Sequence[str]) -> Tuned:
    """The same; of a bound that is not met, the verdict says at which joint it is missed most."""
    missed = [check for check in tuned.closest if not check.met]
    if not (missed and tuned.improved and tuned.certificate.stable):
        return tuned
    worst = max(missed, key=lambda check: check.excess)
    loops, known = tuned.members, tuned.metrics
    assert isinstance(loops, OpenLoops) and isinstance(known, Exact)
    index = loops.names.index(worst.member)
    joint = joints[leading(loops, known, tuned.kp, tuned.kd, worst.metric, index)]
    metric = worst.metric.replace("_", " ")
    return replace(tuned, verdict=f"{tuned.verdict}; most of that {metric} is at joint {joint}")


def _begun(
    situations: Sequence[Situation],
    goal: Goal,
    groups: Groups,
    start: Gains | None,
    number: int,
    seed: int,
    course: Course,
) -> tuple[RobotCase, np.ndarray, list[Found], int]:
    """All loops of the box, log-gains near the start, and those with which all loops are stable."""
    members = situations[0].box.members(number, seed)
    plain = usual(situations, groups)
    x = plain if start is None else groups.log_gains(*start)
    low, high = bounds(goal, groups, x, plain)
    case = RobotCase(tabulate(open_loops(situations, members)), groups, goal, low, high)
    x = np.clip(x, low, high)
    inertia = least_inertias(situations)
    course.case, course.points = case, [Found(x, -np.inf, 0.0, 0, 0)]
    course.phase("screening gains over orders of magnitude")
    lag = max(one.lag for one in situations)
    known, number = screened(case, x, inertia, lag, seed, course)
    there, tried = (x, 0) if case.stable(x) else stabilised(case, situations, x)
    if not case.stable(there):
        there = next((one.x for one in known if case.stable(one.x)), there)
    if not known and case.stable(there):
        # Beside the boundary of what is stable, as that is where a rescue ends.
        course.phase("screening gains beside the only ones that are stable")
        there = closer(case, there, course, seed, CLOUDS[:_WIDE])
    return case, there, known, number + tried


def _searched(
    case: RobotCase, x: np.ndarray, known: list[Found], starts: int, steps: int, course: Course
) -> tuple[Descended, Found]:
    """The paths of a descent from many gains, and the best of their ends, polished."""
    near = approached(case, x)
    course.points.append(near)
    first = np.stack([near.x, *apart(known, starts - 1, case.stable)])[:starts]
    small = hardest(case, near.x)
    course.phase(f"descending from {len(first)} start{'s' if len(first) > 1 else ''}")
    paths = descended(small, first, Descent(steps=steps, polish=0))
    found = best_of(case, near, paths, list(first[1:]), course)
    spent = len(first) * steps * len(small.table.loops)
    return paths, more(found, near.evaluations + spent, near.steps)


def _traded(
    best: Candidate, situations: Sequence[Situation], weight: float, mode: str, seed: int
) -> Candidate:
    """The same with simulated tracking in the objective; as it was where that leads nowhere."""
    loops = best.case.table.loops
    fractions = [loops.fraction[loops.situation == s] for s in range(len(situations))]
    term = tracking.tracking(situations, fractions, best.case.groups, weight, mode)
    case = replace(best.case, tracking=term)
    before = best.found
    traded = more(polished(case, before.x, fresh=False), before.evaluations, before.steps)
    after = exchanged(case, situations, traded, seed)
    if after.found.met:
        return after
    spent = {"evaluations": after.found.evaluations, "steps": after.found.steps}
    return Candidate(after.case, replace(before, **spent), after.interior, None)


def _instead(name: str, goal: Goal) -> str:
    """What to ask of a robot instead of a bound of a single joint."""
    if name == "min_gain_margin":
        factor = goal.min_gain_margin
        # (2 + a) / (2 - a) of a balanced disk margin a
        disk = 2.0 * (factor - 1.0) / (factor + 1.0)
        return (
            f"`min_disk_margin` {disk:.4g} leaves a factor of {factor:g} on the gains of every "
            "joint by itself"
        )
    if name == "min_delay_margin":
        return (
            f"`uncertainty` output_delay=0..{goal.min_delay_margin:g} makes all bounds hold with "
            "so much more delay"
        )
    return "`max_kp` and `max_peak` keep the noise down, and `validate` simulates it"


def _check_verify(groups: int, *, verify: bool, weighed: bool) -> None:
    if verify and weighed:
        raise UserError("`verify`: cannot be combined with `tracking_weight`")
    if verify and groups > brute.MOST_GROUPS:
        raise UserError(
            f"`verify`: tries {2 * groups} gains against each other, which takes too long; group "
            f"the joints, {brute.MOST_GROUPS} groups at most"
        )


def _check_posture(one: Situation) -> None:
    """Refuse a posture in which limits hold joints: what their drives do is not seen there."""
    assert one.specification.plant is not None
    scene = robots.scene(one.specification.plant)
    if stopped := robots.at_stops(scene.robot, scene.posture.qpos):
        advice = robots.keyframe_advice(robots.keyframes_within(scene.robot))
        raise UserError(f"{robots.held_by_limits(stopped)}; {advice}, or drive other `joints`")


def _check(
    situations: Sequence[Situation],
    goal: Goal,
    groups: Groups,
    start: Gains | None,
) -> None:
    check(goal)
    if goal.objective not in OBJECTIVES:
        raise UserError(f"objective '{goal.objective}': of a robot stiffness or disk-margin")
    for name in goal.active:
        if name not in BOUNDS:
            raise UserError(f"`{name}`: is for a single joint; of a robot {_instead(name, goal)}")
    if goal.risk != WORST:
        instead = "leave out what need not hold by a narrower `uncertainty`"
        raise UserError(f"`risk` {goal.risk}: of a robot every loop counts, worst; {instead}")
    if goal.objective == "stiffness" and not goal.active:
        raise UserError("nothing limits the gains; give `max_peak` or `min_disk_margin`")
    for one in situations:
        _check_posture(one)
        joints = tuple(name for name, _ in one.names)
        if one.box != situations[0].box:
            raise UserError(f"'{one.name}': what is uncertain is not as for the others")
        if joints != groups.joints:
            raise UserError(
                f"the joints of '{one.name}' are not those of '{situations[0].name}': "
                f"{', '.join(joints)}"
            )
    for name, k in zip((KP, KD), start or (), strict=False):
        if not np.all((k > 0) & np.isfinite(k)):
            raise UserError(f"`{name}` {np.min(k):g}: a start must be positive and finite")
