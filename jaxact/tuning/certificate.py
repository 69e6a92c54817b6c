"""What is guaranteed of tuned gains: every constraint, every member, exact, in float64.

Nothing here is smoothed or sampled in frequency. An optimum cannot be proven for a problem that is
not convex: what is said of it is how the starts agree, and, on request, the gap to brute force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from jaxact.tuning.goal import Goal, tail_weights
from jaxact.tuning.joint import problem as joint
from jaxact.tuning.joint.metrics import Exact
from jaxact.tuning.joint.problem import Case
from jaxact.tuning.polish import MET

# Constraints this near to their bound (relative) are called binding.
_BINDING = 1e-5


@dataclass(frozen=True)
class Check:
    """One constraint on one figure, over all members.

    constraint: its name in `Goal`
    figure: by the names of `jaxact margins`
    bound: that was asked for
    value: the risk's value over the members; that of the worst one where the worst counts
    member: the one that is worst
    excess: ln of how far beyond the bound, at most 0 where it is met
    """

    constraint: str
    figure: str
    bound: float
    value: float
    member: str
    excess: float

    @property
    def met(self) -> bool:
        """Whether the constraint holds."""
        return self.excess <= MET


@dataclass(frozen=True)
class Certificate:
    """What holds for the gains that were returned.

    stable: every member is
    checks: every constraint on a figure
    bounds_met: kp lies within its bounds
    binding: members at which a constraint binds
    members: how many were checked
    corners: how many of them are corners of the uncertainty
    interior: largest excess that ascent on the uncertainty found, None where there is none
    agreeing: share of the starts that ended within 1 % of the best one's objective
    gap: how much better brute force did, relative, None if not asked for
    """

    stable: bool
    checks: tuple[Check, ...]
    bounds_met: bool
    binding: tuple[str, ...]
    members: int
    corners: int = 0
    interior: float | None = None
    agreeing: float = 1.0
    gap: float | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def met(self) -> bool:
        """Whether everything asked for holds, for every member, corner and interior point."""
        inside = self.interior is None or self.interior <= MET
        return self.stable and self.bounds_met and inside and all(c.met for c in self.checks)


def certify(case: Case, x: np.ndarray, found: Exact | None = None) -> Certificate:
    """Check gains against everything asked of them.

    x: log-gains, shape (2,)
    found: exact figures of the members at x, shape (1, members); computed where not given
    """
    goal, members = case.goal, case.members
    found = joint.exact([case], x[None]) if found is None else found
    stable = bool(found.stable.all())
    checks, binding = [], []
    for name, figure, sign, bound in goal.rows:
        over = sign * (found.log[figure][0] - np.log(bound))
        over = np.where(np.isnan(over), np.inf, over)
        worst = int(np.argmax(over))
        excess = over_all(over, goal)
        checks.append(
            Check(name, figure, bound, float(bound * np.exp(sign * excess)),
                  members.name(worst), excess)
        )  # fmt: skip
        binding += [members.name(int(i)) for i in np.flatnonzero(over > -_BINDING)]
    kp = float(np.exp(x[0]))
    inside = goal.min_kp * (1.0 - 1e-12) <= kp <= goal.max_kp * (1.0 + 1e-12)
    return Certificate(stable, tuple(checks), inside, tuple(dict.fromkeys(binding)), len(members))


def over_all(over: np.ndarray, goal: Goal) -> float:
    """The risk of how far each member is beyond a bound."""
    if goal.tail == 0.0 or not np.all(np.isfinite(over)):
        return float(over.max())
    return float(np.sum(tail_weights(over, goal.tail) * over))


@dataclass(frozen=True)
class Effort:
    """How far a search has looked, so that what it did not find can be judged.

    starts: from which it descended
    screened: gains that were looked at beside them, over orders of magnitude
    """

    starts: int
    screened: int

    def __str__(self) -> str:
        starts = f"{self.starts} start{'' if self.starts == 1 else 's'}"
        return f"from {starts} and {self.screened:,} gains over orders of magnitude"


def sentence(
    certificate: Certificate,
    goal: Goal,
    closest: Sequence[Check] = (),
    effort: Effort | None = None,
) -> str:
    """What is guaranteed, or why not, in one sentence.

    closest: the checks where the constraints are missed by as little as possible
    effort: of the search; what it did not find is not proven not to be there
    """
    if certificate.met:
        of = "the loop" if certificate.members == 1 else f"all {certificate.members} members"
        words = [f"every constraint holds for {of}, computed exactly"]
        if certificate.corners:
            words.append(f"{certificate.corners} corners and the worst interior point included")
        return ", ".join(words)
    inside = -np.inf if certificate.interior is None else certificate.interior
    if certificate.stable and inside > MET and all(check.met for check in certificate.checks):
        return f"a point inside the box exceeds its bounds by {_percent(inside)}"
    missed = [check for check in closest if not check.met]
    far = "" if effort is None else f", {effort}"
    kp = f" with kp >= {goal.min_kp:g}" if goal.min_kp > 0 else ""
    if not certificate.stable:
        return (
            f"found infeasible: no gains{kp} that make every member stable{far}; "
            f"{_NO_PROOF} are none"
        )
    if not missed:
        return f"found infeasible: no gains{kp} that meet the constraints together{far}"
    worst = max(missed, key=lambda check: check.excess)
    sign = "<=" if worst.constraint.startswith("max") else ">="
    figure = worst.figure.replace("_", " ")
    # Of all bounds together: one figure alone may well come nearer at the cost of the others.
    return (
        f"found infeasible: of all gains{kp} that were tried those nearest to the bounds have a "
        f"{figure} of {worst.value:.6g}, asked for {sign} {worst.bound:g} ({worst.constraint}), at "
        f"{worst.member}{far}; {_NO_PROOF} are none nearer"
    )


_NO_PROOF = "this does not prove that there"


def _percent(excess: float) -> str:
    return f"{100.0 * np.expm1(excess):.3g} %"


def beyond(excess: float) -> str:
    """In words, how far a member is beyond its bounds.

    excess: ln of the ratio to the bound
    """
    return "meets all bounds" if excess <= MET else f"exceeds its bounds by {_percent(excess)}"
