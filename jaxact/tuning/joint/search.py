"""Tuning of joints from end to end: starts, descent, polish, certificate.

tuned = tune(ensemble(0.7, 110.0, 0.9, 1e-3), Goal(max_peak=1.6))

Over a box of what is not known, members are samples and corners, and the worst points that climbing
on the uncertain parameters finds; where these exceed their bounds the gains are polished for them
and searched for again: a lucky sample cannot pass.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import jax
import numpy as np

from jaxact.errors import UserError
from jaxact.tuning.box import KNOWN, Box
from jaxact.tuning.certificate import Effort, Metrics, beyond, certify
from jaxact.tuning.course import INTERRUPTED, NOTHING, Course, Told, silent
from jaxact.tuning.goal import Goal, check, peaks
from jaxact.tuning.joint import brute, descent, standstill
from jaxact.tuning.joint import problem as joint
from jaxact.tuning.joint.clouds import in_clouds
from jaxact.tuning.joint.ensemble import Ensemble, Uncertain, uncertain
from jaxact.tuning.joint.exchange import exchanged, worst_inside
from jaxact.tuning.joint.problem import Case, metrics_at
from jaxact.tuning.joint.rescue import SLOWER
from jaxact.tuning.joint.response import Timed
from jaxact.tuning.joint.response import timed as timed_of
from jaxact.tuning.optimise import Descent, descend, no_path
from jaxact.tuning.polish import MET, Polished, polish
from jaxact.tuning.result import Outcome, Tuned, judged, objective_value

STARTS, SAMPLES, STEPS = 8, 32, 80
# A metric of simulated time is rougher.
_SIMULATED_STEPS = 150


def tune(
    members: Ensemble,
    goal: Goal,
    box: Box = KNOWN,
    *,
    number: int = SAMPLES,
    seed: int = 0,
    start: tuple[float, float] | None = None,
    starts: int = STARTS,
    how: Descent | None = None,
    verify: bool = False,
    told: Told = silent,
) -> Tuned:
    """The best gains for one joint, one ensemble, or everything in a box around one joint.

    Interrupted, it gives the best gains until then that are certified.

    Args:
        members: one, or many that share the gains; of a box the nominal one.
        goal: objective and constraints.
        box: what is not known; where the worst member counts its corners are members too.
        number: of samples of the box.
        seed: of the samples.
        start: (kp, kd) to be no worse than [N/m], [N s/m]; may be unstable.
        starts: number of default starts, 0 for the given one alone.
        how: of the descent.
        verify: compare with brute force.
        told: what is being done.

    Raises:
        UserError: a goal, a box or a start that makes no sense.
        KeyboardInterrupt: interrupted before any gains were certified.
    """
    begun = time.perf_counter()
    given = None if start is None else [start]
    if box.known:
        members = uncertain(members, box).nominal
    plants, case, box = None, Case(members, goal), box.uncertain
    if box:
        plants = uncertain(members, box)
        points = box.sample(number, seed) if goal.tail else box.members(number, seed)
        case = Case(plants.at(points), goal)
    course = Course(told, case=case)
    try:
        (found,) = _searched([case], given, starts, how, course)
        if plants is not None:
            again = partial(_again, given=given, starts=starts, how=how, course=course)
            case, found = exchanged(plants, case, found, again, seed, course)
            if goal.tail:
                found = replace(found, interior=None, notes=(_outside(plants, goal, found),))
        course.case, course.best = case, found
        course.phase("certifying")
        return _judged(case, found, start, verify, plants, seed)
    except KeyboardInterrupt:
        return _until_then(course, start, plants, begun)


def _until_then(
    course: Course, start: tuple[float, float] | None, plants: Uncertain | None, begun: float
) -> Tuned:
    """The best certified gains of an interrupted search; KeyboardInterrupt where there are none."""
    doing, case = course.doing, course.case
    course.phase(f"{INTERRUPTED}, certifying the best gains so far")
    found = course.best or _so_far(case, course.points, begun)
    if found is not None:
        unsure = plants is not None and not case.goal.tail
        inside = found.interior is not None or not unsure
        found = replace(found, interrupted=replace(course, doing=doing).note(inside=inside))
        tuned = _judged(case, found, start, verify=False)
        if tuned.certified:
            return tuned
    raise KeyboardInterrupt(NOTHING) from None


def _so_far(case: Case, points: Sequence[np.ndarray], begun: float) -> Outcome | None:
    """The best certified gains among log-gains, None where there are none."""
    goal, members = case.goal, case.members
    best, least = None, -np.inf
    for x in points:
        found, gains = metrics_at(case, x), joint.gains(x)
        if not certify(goal, members, found, gains[0]).met:
            continue
        value = goal.sense * objective_value(goal, gains[0], found)
        if value > least:
            number = len(points) * len(members)
            least, best = value, Outcome(gains, True, found, no_path(x), number, 0, begun)
    return best


def tune_all(
    cases: Sequence[Case],
    given: Sequence[tuple[float, float]] | None = None,
    *,
    starts: int = STARTS,
    how: Descent | None = None,
    verify: bool = False,
) -> list[Tuned]:
    """The best gains of several cases, side by side in one compiled descent.

    Args:
        cases: with as many members each, and goals that differ in their bounds only.
        given: a start for each.
        starts, how, verify: as for `tune`.
    """
    found = _searched(cases, given, starts, how)
    return [
        _judged(case, one, None if given is None else given[i], verify)
        for i, (case, one) in enumerate(zip(cases, found, strict=True))
    ]


def front(
    members: Ensemble,
    goal: Goal,
    number: int,
    *,
    plants: Uncertain | None = None,
    seed: int = 0,
    starts: int = STARTS,
    how: Descent | None = None,
) -> list[Tuned]:
    """The best gains for every peak of `jaxact.tuning.goal.peaks`, in one compiled descent.

    Args:
        members, goal, starts, how: as for `tune`; the goal's own peak does not count.
        number: of points.
        plants: the box that the members are of, whose worst points join them; None for none.
        seed: of where in the box is looked.
    """
    cases = [Case(members, replace(goal, max_peak=float(peak))) for peak in peaks(number)]
    found = _searched(cases, None, starts, how)
    course = Course()
    again = partial(_again, given=None, starts=starts, how=how, course=course)
    points: list[Tuned] = []
    for case, one in zip(cases, found, strict=True):
        if plants is not None and not goal.tail:
            case, one = exchanged(plants, case, one, again, seed, course)
        points.append(_judged(case, one, None, verify=False))
        if len(points) > 1 and points[-2].certified and _behind(points[-1], points[-2], goal):
            # What keeps a tighter bound keeps this one.
            case = replace(case, members=points[-2].members)
            points[-1] = _judged(case, _with_gains_of(points[-2], case, one), None, verify=False)
    return points


def _with_gains_of(tighter: Tuned, case: Case, one: Outcome) -> Outcome:
    """The outcome of a case, with the gains of a tighter bound, which keep its own."""
    gains = tighter.kp, tighter.kd
    known, interior = metrics_at(case, np.log(gains)), tighter.certificate.interior
    return replace(one, gains=gains, met=True, metrics=known, interior=interior)


def _behind(one: Tuned, tighter: Tuned, goal: Goal) -> bool:
    """Whether gains are worse than those of a tighter bound."""
    return not one.certified or goal.sense * one.value < goal.sense * tighter.value


def _searched(
    cases: Sequence[Case],
    given: Sequence[tuple[float, float]] | None,
    starts: int,
    how: Descent | None,
    course: Course | None = None,
    first: np.ndarray | None = None,
) -> list[Outcome]:
    """Where the search for each case leads; the course is that of the first one.

    Args:
        first: log-gains to start from in place of the default ones, shape (cases, starts, 2).
    """
    begun = time.perf_counter()
    course = course or Course()
    _check(cases, given, starts)
    plants = [case.members for case in cases]
    rough, timed = (timed_of(cases[0].goal, plants, use=use) for use in ("descent", "polish"))
    how = how or Descent(steps=STEPS if timed is None else _SIMULATED_STEPS)
    bounds = np.array([joint.log_bounds(case.goal) for case in cases])
    own = (
        None
        if given is None
        else np.clip(np.log(np.asarray(given, float)), bounds[:, 0], bounds[:, 1])
    )
    back, rescues = (None, 0) if own is None else descent.rescued(cases, own, bounds)
    if first is None:
        first = np.stack([joint.starts(case, starts) for case in cases])
    if back is not None:
        first = np.concatenate([first, back[:, None]], axis=1)
    smooth = joint.JointSurrogate(joint.family(cases[0].goal), rough)
    slower = np.asarray(SLOWER, np.float32)
    course.points += list(first[0])
    course.phase(f"descending from {first.shape[1]} starts")
    paths = descend(smooth, joint.table(cases), np.asarray(first, np.float32), slower, how)
    paths = jax.tree.map(np.asarray, paths)
    course.phase("polishing")
    found, polishing = descent.polished(cases, paths, bounds, timed)
    found, more = _looked_around(cases, found, bounds, timed)
    polishing += more
    lost = ~found.feasible
    if lost.any():
        course.phase("looking for the closest gains")
    closest = descent.closest(cases, paths, bounds, timed, found) if lost.any() else found
    if np.any(lost & closest.feasible):
        # Gains that keep all bounds are there after all: on to the best ones near them.
        closest = polish(joint.problem(cases, timed), closest.x, bounds[:, 0], bounds[:, 1])
        polishing += closest.evaluations
    steps = how.steps + how.polish + polishing + rescues
    number = first.shape[1] * (how.steps + how.polish) + polishing + rescues
    effort = Effort(first.shape[1], brute.GRID**2)
    ends = np.where(lost[:, None], closest.x, found.x)
    lost &= ~closest.feasible
    course.points.append(ends[0])
    metrics = _metrics_of_all(cases, ends)
    outcomes = []
    for i, case in enumerate(cases):
        x, met = ends[i], not lost[i] and metrics[i].has(case.goal.metric)
        own_paths = jax.tree.map(lambda a, i=i: a[i], paths)
        tried = number * len(case.members)
        outcomes.append(
            Outcome(joint.gains(x), met, metrics[i], own_paths, tried, steps, begun, effort)
        )
    return outcomes


def _looked_around(
    cases: Sequence[Case], found: Polished, bounds: np.ndarray, timed: Timed | None
) -> tuple[Polished, int]:
    """Better points where slopes do not lead to them, and how many were tried for a case."""
    objective = cases[0].goal.objective
    if objective == "settling":
        return in_clouds(cases, found, bounds, timed)
    if objective == "tracking":
        return standstill.moved(cases, found, bounds, timed)
    return found, 0


def _again(
    case: Case,
    x: np.ndarray,
    given: Sequence[tuple[float, float]] | None,
    starts: int,
    how: Descent | None,
    course: Course,
) -> Outcome:
    """Where a search leads that starts at log-gains x and from all over the plane."""
    first = joint.starts_all_over(case, max(starts, 1), x)[None, :starts]
    (found,) = _searched([case], given, starts, how, course, first)
    return found


def _metrics_of_all(cases: Sequence[Case], x: np.ndarray) -> list[Metrics]:
    """Exact metrics of all members of every case at its log-gains, shape (cases, 2)."""
    if timed_of(cases[0].goal, [cases[0].members]) is not None:
        # How long is simulated differs.
        return [metrics_at(case, own) for case, own in zip(cases, x, strict=True)]
    found = joint.exact(cases, x)
    return [
        Metrics(found.stable[i], {name: log[i] for name, log in found.log.items()})
        for i in range(len(cases))
    ]


def _judged(
    case: Case,
    found: Outcome,
    start: tuple[float, float] | None,
    verify: bool,
    plants: Uncertain | None = None,
    seed: int = 0,
) -> Tuned:
    """What a search has led to, against brute force where that is asked for, and judged."""
    goal, members = case.goal, case.members
    if goal.objective == "tracking" and found.met and found.metrics is not None:
        error = objective_value(goal, found.gains[0], found.metrics)
        if standstill.stands_still(goal, error):
            found = replace(found, notes=(*found.notes, standstill.NOTE))

    def inside(gains: tuple[float, float]) -> float | None:
        if plants is None or goal.tail:
            return None
        return worst_inside(plants, case, np.log(gains), seed).largest

    if verify and found.met:
        timed = timed_of(goal, [members], use="polish")
        tried = brute.brute_force(case)
        ours = float(joint.problem([case], timed)(np.log([found.gains])).worst_value[0])
        found = replace(
            found, gap=float(np.expm1(max(tried.value - ours, 0.0))),
            evaluations=found.evaluations + tried.evaluations * len(members),
        )  # fmt: skip
        if tried.value > ours + 1e-3:
            # Brute force knows of the members only.
            gains = joint.gains(tried.x)
            interior = inside(gains)
            if interior is None or interior <= MET:
                known = metrics_at(case, tried.x)
                found = replace(found, gains=gains, metrics=known, interior=interior)

    return judged(
        goal, members, found, lambda gains: metrics_at(case, np.log(gains)), start=start,
        inside=inside,
    )  # fmt: skip


def _outside(plants: Uncertain, goal: Goal, found: Outcome) -> str:
    """What the worst corner and interior point are like, where they are not what counts."""
    corners = plants.at(plants.box.corners())
    stable = metrics_at(Case(corners, goal), np.log(found.gains)).stable
    if not stable.all():
        return f"unstable at {corners.name(int(np.argmin(stable)))}"
    assert found.interior is not None
    return f"the worst point of the box {beyond(found.interior)}"


def _check(cases: Sequence[Case], given: Sequence[tuple[float, float]] | None, starts: int) -> None:
    for case in cases:
        check(case.goal)
        bounded = case.goal.objective == "disk-margin" or np.isfinite(case.goal.max_kp)
        unlimited = not case.goal.active and not bounded
        if unlimited or not np.all(joint.time_scale(case) > 0.0):
            raise UserError(
                "nothing limits the gains; give an actuator, a delay, a control rate, a constraint "
                "or `max_kp`"
            )
    if starts < 0 or (starts == 0 and given is None):
        raise UserError(f"{starts} starts: give at least one, or gains to start from")
    for kp, kd in given or ():
        if not (0 < kp < np.inf and 0 < kd < np.inf):
            raise UserError(f"start kp {kp:g}, kd {kd:g}: both must be positive and finite")
