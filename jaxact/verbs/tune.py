"""`jaxact.tune`: the best gains of a joint, an ensemble of actuators or a robot, certified."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.loops import conversion
from jaxact.loops.control_loop import ControlLoop
from jaxact.parameters import base, canonical
from jaxact.tuning import pareto
from jaxact.tuning.certificate import Certificate
from jaxact.tuning.goal import Goal, check
from jaxact.tuning.groups import group
from jaxact.tuning.joint import robust
from jaxact.tuning.joint import search as _run
from jaxact.tuning.joint.ensemble import Ensemble, Sampling, ensemble
from jaxact.tuning.optimise import Descent
from jaxact.tuning.phases import Phase, silent
from jaxact.tuning.robot import front as robot_front
from jaxact.tuning.robot import search as robot
from jaxact.tuning.robot.uncertainty import read_spans
from jaxact.tuning.rollouts.tracking import Wish
from jaxact.tuning.uncertainty import read_box
from jaxact.verbs import naming

if TYPE_CHECKING:
    from jaxact.tuning.joint.search import Tuned
    from jaxact.tuning.robot.loops import Situation
    from jaxact.tuning.robot.tuned import RobotTuned

Range = tuple[float, float] | str
"""(low, high), or as it is written on the command line: "0.8x..1.2x"."""


@dataclass(frozen=True, repr=False)
class TunedLoop:
    """Tuned gains, and what is known of them.

    Attributes:
        loop: the loop with the gains in it; of a robot the first of its postures.
        result: everything that was found, see `jaxact.tuning.joint.search.Tuned` and
            `jaxact.tuning.robot.tuned.RobotTuned`.
        front: results along the front of stiffness against robustness, () where none was asked for.
    """

    loop: ControlLoop
    result: Tuned | RobotTuned
    front: tuple[Tuned | RobotTuned, ...] = ()

    @property
    def kp(self) -> float | np.ndarray:
        """Stiffness [N/m, of hinges N m/rad]; of a robot shape (joints,)."""
        return self.result.kp

    @property
    def kd(self) -> float | np.ndarray:
        """Damping [N s/m, of hinges N m s/rad]; of a robot shape (joints,)."""
        return self.result.kd

    @property
    def certified(self) -> bool:
        """Whether everything that was asked for holds, exactly, for every member."""
        return self.result.certified

    @property
    def certificate(self) -> Certificate:
        """What is guaranteed: every constraint, with its worst member."""
        return self.result.certificate

    @property
    def verdict(self) -> str:
        """What came of it, in one sentence."""
        return self.result.verdict

    def __repr__(self) -> str:
        """The loop with its gains, the verdict, and every constraint."""
        lines = [repr(self.loop), ("" if self.certified else "NOT ") + f"certified: {self.verdict}"]
        lines += [
            f"  {one.figure} {one.value:.6g} (asked: {one.bound:g}), {one.member}"
            for one in self.certificate.checks
        ]
        lines += [f"  front of {len(self.front)} points"] if self.front else []
        return "\n".join(lines)


def tune(
    loop: ControlLoop | Sequence[ControlLoop],
    goal: str | Goal = "stiffness",
    *,
    uncertainty: Mapping[str, Range] | None = None,
    samples: int | None = None,
    sampled: bool | None = None,
    groups: Sequence[str] = (),
    starts: int = _run.STARTS,
    steps: int | None = None,
    seed: int = 0,
    front: int = 0,
    verify: bool = False,
    tracking_weight: float = 0.0,
    phase: Callable[[str], None] = silent,
    **bounds: Any,
) -> TunedLoop:
    """Find the best gains of a loop, and certify them.

        best = jaxact.tune(loop, max_peak=1.6, uncertainty={"wn": (0.8, 1.2), "delay": (0, 5e-3)})
        best.loop, best.certified

    Args:
        loop: of a joint, a single one; or of a robot, or one loop for each of its postures. Gains
            that it was given (or that the robot's model brings) are what the result is never worse
            than.
        goal: "stiffness" (largest kp), "bandwidth", "disk-margin", "settling", or a
            `jaxact.tuning.goal.Goal`.
        uncertainty: parameter -> (low, high) of what is not known: wn and zeta as factors, mass
            [kg] and delays [s] as they are; of a robot also payload [kg], inertia_scale, ...
        samples: of the uncertainty, beside its corners and its worst interior point; None: 32, of a
            robot 8.
        sampled: of a joint, whether the margins are those of the sampled loop; None: where the loop
            was given a control rate. A robot's are always sampled.
        groups: of a robot, patterns found in the names of joints or actuators: the joints of one
            share their gains; none: every joint its own.
        starts, steps: of the descent.
        seed: of the samples.
        front: points of the front of stiffness against robustness, 0 for none.
        verify: compare with brute force.
        tracking_weight: of a robot, weight of simulated tracking in the objective.
        phase: called with what is being done.
        bounds: of the goal: max_peak (1.6 where nothing is given; of "disk-margin" none), min_kp,
            max_kp, min_disk_margin, of a joint also min_gain_margin, min_delay_margin,
            max_noise_gain, risk.

    Returns:
        The tuned loop; where the goal cannot be met, the closest that was found, not certified.

    Raises:
        UserError: a loop, a goal or ranges that make no sense.
        TypeError: the loop is traced.
    """
    asked = _goal(goal, bounds)
    loops = [loop] if isinstance(loop, ControlLoop) else list(loop)
    if not loops or not all(isinstance(one, ControlLoop) for one in loops):
        raise UserError("loop: give one loop, or a list of loops of a robot in its postures")
    text = _ranges(uncertainty or {})
    if any(one.kind.plant is not None for one in loops):
        return _robot(loops, asked, text, samples or 8, groups, starts, steps or robot.STEPS, seed,
                      front, verify, tracking_weight, phase)  # fmt: skip
    if len(loops) > 1:
        raise UserError("loop: several postures are for a robot; of a joint give one loop")
    for name, value in (("groups", groups), ("tracking_weight", tracking_weight)):
        if value:
            raise UserError(f"`{name}`: is for a robot; make one with jaxact.robot(model, ...)")
    return _joint(loops[0], asked, text, samples or 32, sampled, starts, steps or 150, seed, front,
                  verify, phase)  # fmt: skip


def _goal(goal: str | Goal, bounds: dict[str, Any]) -> Goal:
    known = {f.name for f in dataclasses.fields(Goal)}
    for name in bounds:
        if name not in known:
            raise UserError(f"{name}: unknown bound of a goal; {nearest(name, known)}")
    if isinstance(goal, Goal):
        return check(dataclasses.replace(goal, **bounds))
    if goal == "disk-margin":
        bounds.setdefault("max_peak", math.inf)
    return check(Goal(objective=goal, **bounds))


def _ranges(uncertainty: Mapping[str, Range]) -> str:
    """Ranges as the command line writes them."""
    parts = []
    for name, span in uncertainty.items():
        ends = [span] if isinstance(span, str) else [repr(float(end)) for end in np.ravel(span)]
        if len(ends) != 2 and ".." not in ends[0]:
            raise UserError(f"`uncertainty` {name} = {shown(span)}: give (low, high)")
        parts.append(f"{canonical(name)}={'..'.join(ends)}")
    return ",".join(parts)


def _joint(
    loop: ControlLoop, goal: Goal, text: str, samples: int, sampled: bool | None, starts: int,
    steps: int, seed: int, front: int, verify: bool, phase: Phase,
) -> TunedLoop:  # fmt: skip
    conversion.linear_specification(loop)  # what does not fit is said here
    nominal = _nominal(loop, "control_rate" in loop.values if sampled is None else sampled)
    start = None
    if {"kp", "kd"} <= set(loop.values):
        own = conversion.one(loop)
        start = own["gain_scale"] * own["kp"], own["gain_scale"] * own["kd"]
    how = Descent(steps=steps)
    given: dict[str, Any] = {"start": start, "starts": starts, "how": how, "verify": verify,
                             "phase": phase}  # fmt: skip
    if text:
        box = read_box(text, nominal)
        tuned = robust.tune_box(box, goal, number=samples, seed=seed, **given)
    else:
        tuned = _run.tune(nominal, goal, **given)
    points = pareto.front(tuned.members, goal, front, starts=starts, how=how) if front else []
    gains = {"kp": tuned.kp, "kd": tuned.kd}
    scale = {"gain_scale": 1.0} if "gain_scale" in loop.values else {}
    return TunedLoop(loop.replace(**gains, **scale), tuned, tuple(points))


def _nominal(loop: ControlLoop, sampled: bool) -> Ensemble:
    """The plant of a joint, as an ensemble of one."""
    own = conversion.one(loop)
    period = 1.0 / own["control_rate"] if sampled else None
    sampling = Sampling(period, loop.kind.velocity, own["velocity_filter"])
    label = naming.loop_name(conversion.linear_specification(loop))
    return ensemble(own["mass"], own["wn"], own["zeta"], conversion.total_delay(own),
                    sampling=sampling, names=(label,))  # fmt: skip


def _robot(
    loops: list[ControlLoop], goal: Goal, text: str, samples: int, groups: Sequence[str],
    starts: int, steps: int, seed: int, front: int, verify: bool, weight: float, phase: Phase,
) -> TunedLoop:  # fmt: skip
    from jaxact.tuning.robot.loops import situation

    spans = read_spans(text) if text else ()
    situations: list[Situation] = []
    for place, one in enumerate(loops, 1):
        if one.kind.plant is None or one.shape:
            raise UserError("loop: give single loops of a robot, one for each posture")
        phase(f"settling and linearising ({place} of {len(loops)})")
        own = conversion.linear_specification(one, engine="mujoco")
        name = one.kind.plant.keyframe or one.kind.plant.model.stem
        known = sum(other.name.partition(" (")[0] == name for other in situations)
        situations.append(situation(own, f"{name} ({known + 1})" if known else name, spans))
    chosen = group(tuple(groups), situations[0].names)
    tuned = robot.tune(
        situations, goal, chosen, number=samples, seed=seed, start=_start(situations[0]),
        starts=starts, steps=steps, verify=verify, wish=Wish(weight, "auto"), phase=phase,
    )  # fmt: skip
    points = robot_front.front(tuned, front, seed=seed) if front else []
    return TunedLoop(_with_gains(loops[0], tuned), tuned, tuple(points))


def _start(first: Situation) -> tuple[np.ndarray, np.ndarray] | None:
    """The gains to be no worse than: those given, or that the model brings."""
    if first.kp is None or first.kd is None:
        return None
    if not (first.kd > 0.0).all():
        joint = first.names[int(np.argmin(first.kd))][0]
        raise UserError(
            f"{joint}: kd is 0, and there is no start from it; give `kd`, or damping = 'drive'"
            " where the model has the drive's D gain in <joint damping>"
        )
    return first.kp, first.kd


def _with_gains(loop: ControlLoop, tuned: RobotTuned) -> ControlLoop:
    """The loop with the gains of every joint, in place of all that it was given."""
    kept = {
        name: value
        for name, value in loop.values.items()
        if base(name) not in ("kp", "kd", "gain_scale")
    }
    for name, gains in (("kp", tuned.kp), ("kd", tuned.kd)):
        for joint, value in zip(tuned.groups.joints, gains, strict=True):
            kept[f"{name}@{re.escape(joint)}"] = float(value)
    return dataclasses.replace(loop, values=kept)
