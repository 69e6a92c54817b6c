"""What is guaranteed of tuned gains: every constraint, every member, exact, in float64.

Nothing here is smoothed or sampled in frequency. An optimum cannot be proven for a problem that is
not convex: the certificate says how many starts agree, and, on request, the gap to brute force.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from jaxact.tuning.goal import UNVALUED, Goal, tail_weights
from jaxact.tuning.polish import MET

# Constraints this near to their bound (relative) are called binding.
_BINDING = 1e-5


@dataclass(frozen=True)
class Check:
    """One constraint on one metric, over all members.

    Attributes:
        constraint: its name in `Goal`.
        metric: by the names of `jaxact margins`.
        bound: that was asked for.
        value: the risk's value over the members; that of the worst one where the worst counts.
        member: the one that is worst.
        excess: ln of how far beyond the bound, at most 0 where it is met.
    """

    constraint: str
    metric: str
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

    Attributes:
        stable: every member is.
        checks: every constraint on a metric.
        bounds_met: kp lies within its bounds.
        binding: members at which a constraint binds.
        members: how many were checked.
        corners, samples: how many of them are corners of the uncertainty, and samples of it.
        interior: largest excess in the box that was found, None where there is none.
        agreeing: share of the starts that ended within 1 % of the best one's objective.
        gap: how much better brute force did, relative, None if not asked for.
        notes: what else is worth knowing, in sentences.
        valued: the objective has a value for every member.
        unheld: a member of a robot that does not rest with the gains, and why; "" for none.
    """

    stable: bool
    checks: tuple[Check, ...]
    bounds_met: bool
    binding: tuple[str, ...]
    members: int
    corners: int = 0
    samples: int = 0
    interior: float | None = None
    agreeing: float = 1.0
    gap: float | None = None
    notes: tuple[str, ...] = field(default=())
    valued: bool = True
    unheld: str = ""

    @property
    def met(self) -> bool:
        """Whether everything asked for holds, for every member, corner and interior point."""
        inside = self.interior is None or self.interior <= MET
        held = self.stable and self.bounds_met and inside and self.valued and not self.unheld
        return held and all(check.met for check in self.checks)


class Members(Protocol):
    """The loops that gains are judged with."""

    def __len__(self) -> int:
        """Number of members."""

    def name(self, index: int) -> str:
        """What a member is called."""


@dataclass(frozen=True)
class Metrics:
    """Exact metrics of n loops with some gains, NumPy float64.

    Attributes:
        stable: whether each loop is, shape (n,).
        log: ln of each metric by name, NaN where it means nothing, shape (n,).
    """

    stable: np.ndarray
    log: Mapping[str, np.ndarray]

    def has(self, metric: str) -> bool:
        """Whether a metric is a number for every loop; one that is not among them is always."""
        return bool(np.isfinite(self.log.get(metric, np.zeros(1))).all())

    def over(self, metric: str, sign: float, bound: float) -> np.ndarray:
        """How far each loop is beyond a bound, ln of the ratio, inf where unstable; shape (n,)."""
        over = sign * (self.log[metric] - np.log(bound))
        return np.where(np.isnan(over), np.inf, over)

    def excess(self, goal: Goal) -> np.ndarray:
        """How far each loop is beyond its bounds, ln of the ratio, inf where unstable; (n,)."""
        over = np.full(len(self.stable), -np.inf)
        for _, metric, sign, bound in goal.rows:
            over = np.maximum(over, self.over(metric, sign, bound))
        return np.where(self.stable, over, np.inf)

    def worst(self, own: np.ndarray | slice = slice(None)) -> dict[str, float | None]:
        """Each metric at its worst over some of the loops; None where one of them is unstable."""
        if not self.stable[own].all():
            return dict.fromkeys(self.log)
        return {
            name: float(np.exp((np.min if name in _LARGE else np.max)(log[own])))
            for name, log in self.log.items()
        }


# Metrics that are worst where they are smallest.
_LARGE = ("gain_margin", "delay_margin", "disk_margin", "bandwidth")


def certify(
    goal: Goal, members: Members, found: Metrics, kp: np.ndarray, interior: float | None = None
) -> Certificate:
    """Judge gains against everything asked of them.

    Args:
        goal: what was asked.
        members: every loop that counts.
        found: their exact metrics with these gains.
        kp: stiffness of every joint [N/m or N m/rad].
        interior: largest excess in the box that was found, None where there was none.
    """
    checks, binding = [], []
    for name, metric, sign, bound in goal.rows:
        over = found.over(metric, sign, bound)
        excess = over_all(over, goal)
        value, worst = float(bound * np.exp(sign * excess)), members.name(int(np.argmax(over)))
        checks.append(Check(name, metric, bound, value, worst, excess))
        binding += [members.name(int(i)) for i in np.flatnonzero(over > -_BINDING)]
    inside = goal.min_kp * (1.0 - 1e-12) <= np.min(kp)
    inside = inside and np.max(kp) <= goal.max_kp * (1.0 + 1e-12)
    # Of a robot the name of a posture comes first.
    names = [members.name(i).rpartition(", ")[2] for i in range(len(members))]
    corners, samples = (
        sum(name.startswith(kind) for name in names) for kind in ("corner ", "sample ")
    )
    return Certificate(
        bool(found.stable.all()), tuple(checks), bool(inside), tuple(dict.fromkeys(binding)),
        len(members), corners, samples, interior, valued=found.has(goal.metric),
    )  # fmt: skip


def over_all(over: np.ndarray, goal: Goal) -> float:
    """The risk of how far each member is beyond a bound."""
    if goal.tail == 0.0 or not np.all(np.isfinite(over)):
        return float(over.max())
    return float(np.sum(tail_weights(over, goal.tail) * over))


@dataclass(frozen=True)
class Effort:
    """How far a search has looked, so that what it did not find can be judged.

    Attributes:
        starts: from which it descended.
        screened: gains that were looked at beside them, over orders of magnitude.
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
    *,
    continuous: bool = False,
) -> str:
    """What is guaranteed, or why not, in one sentence.

    Args:
        certificate: of the gains.
        goal: what was asked.
        closest: the checks where the constraints are missed by as little as possible.
        effort: of the search; what it did not find is not proven not to be there.
        continuous: it is of loops in continuous time, which no controller is.
    """
    if certificate.met:
        of = "the loop" if certificate.members == 1 else f"all {certificate.members} members"
        if goal.tail and certificate.members > 1:
            of = f"{_counted(goal.tail)} of the {certificate.members} members, which are all stable"
        how = " in continuous time" if continuous else ""
        found = certificate.members - certificate.corners - certificate.samples
        which = f"{certificate.samples} samples, {certificate.corners} corners"
        which += f", {found} interior point{'s' if found > 1 else ''}" if found else ""
        which = f" ({which})" if certificate.corners else ""
        point = "" if certificate.interior is None else ", the worst interior point included"
        return f"every constraint holds for {of}{which}, computed exactly{how}{point}"
    inside = -np.inf if certificate.interior is None else certificate.interior
    if inside > MET and not closest:
        return _inside(certificate, inside)
    missed = [check for check in closest if not check.met]
    far = "" if effort is None else f", {effort}"
    kp = f" with kp >= {goal.min_kp:g}" if goal.min_kp > 0 else ""
    if not certificate.stable:
        return (
            f"found infeasible: no gains{kp} that make every member stable{far}; "
            f"{_NO_PROOF} are none"
        )
    if not missed and not certificate.valued:
        none = UNVALUED.get(goal.objective, _WORTHLESS)
        return f"found infeasible: {none}{far}; {_NO_PROOF} are none"
    if not missed:
        return f"found infeasible: no gains{kp} that meet the constraints together{far}"
    worst = max(missed, key=lambda check: check.excess)
    sign = "<=" if worst.constraint.startswith("max") else ">="
    metric = worst.metric.replace("_", " ")
    # Of all bounds together: one metric alone may well come nearer at the cost of the others.
    return (
        f"found infeasible: of all gains{kp} that were tried those nearest to the bounds have a "
        f"{metric} of {worst.value:.6g}, asked for {sign} {worst.bound:g} ({worst.constraint}), at "
        f"{worst.member}{far}; {_NO_PROOF} are none nearer"
    )


def _counted(tail: float) -> str:
    """In words, what of the members a risk weighs; its means are those of the logarithms."""
    return "the mean" if tail == 1.0 else f"the mean of the worst {100.0 * tail:.4g} %"


def _inside(certificate: Certificate, inside: float) -> str:
    """In words, that the gains keep the bounds of some members, but not all over the box."""
    if not certificate.checks:
        return "a point inside the box exceeds its bounds"
    worst = max(certificate.checks, key=lambda check: check.excess)
    by = f"exceeds its bounds by {_percent(max(inside, worst.excess))}"
    if not np.isfinite(max(inside, worst.excess)):
        by = "is unstable"
    where = f"a point inside the box {by}"
    if not worst.met:
        where = f"the worst point of the box that was found {by}: {worst.member}"
    return (
        f"{where}; no better gains were found, which may be for want of members or starts: more "
        "samples of the box or more starts may lead to some, or make the box narrower"
    )


_WORTHLESS = "no gains that keep the bounds and give the objective a value"
_NO_PROOF = "this does not prove that there"


def _percent(excess: float) -> str:
    return f"{100.0 * np.expm1(excess):.3g} %"


def beyond(excess: float) -> str:
    """In words, how far a member is beyond its bounds.

    Args:
        excess: ln of the ratio to the bound.
    """
    return "meets all bounds" if excess <= MET else f"exceeds its bounds by {_percent(excess)}"
