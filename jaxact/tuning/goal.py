"""What is asked of the gains: an objective, constraints, and how an ensemble is weighed.

Everything is in logarithms: an objective is ln of a metric that is to be large, a constraint is
ln(metric / bound) <= 0, so that one per cent counts the same everywhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.parameters import KP

# Objective -> (metric, +1 if it is to be large, -1 if small; unit).
OBJECTIVES = {
    "stiffness": (KP, 1.0, "N/m"),
    "bandwidth": ("bandwidth", 1.0, "rad/s"),
    "disk-margin": ("disk_margin", 1.0, "1"),
    "settling": ("settling_time", -1.0, "s"),
    "tracking": ("tracking_error", -1.0, "m"),
}

UNVALUED = {
    "bandwidth": "no gains that keep the bounds and make the position follow slow setpoints by "
    "1/sqrt(2) at least, so that there is a bandwidth",
    "settling": "no gains that keep the bounds and with which the joint settles within 2 % of a "
    "step, for as long as it was simulated",
}
"""What is said of an objective that has no value."""

# Constraint -> ((metric, +1 if it must not exceed the bound, -1 if it must not fall below), ...).
CONSTRAINTS = {
    "max_peak": (("sensitivity_peak", 1.0), ("complementary_peak", 1.0)),
    "min_gain_margin": (("gain_margin", -1.0),),
    "min_delay_margin": (("delay_margin", -1.0),),
    "min_disk_margin": (("disk_margin", -1.0),),
    "max_noise_gain": (("noise_gain", 1.0),),
}

WORST = "worst"
"""The risk of the worst member."""

DERIVATIVES = ("auto", "forward", "reverse")
"""How the gains' effect on simulated tracking may be computed."""

# Where the loop gain vanishes S = 1, so |S - 1/2| >= 1/2 there, and the disk margin is one over it.
_LARGEST_DISK = 2.0

LOWEST, HIGHEST = 1.15, 3.0
"""Ends of a front of peaks."""
MOST_PEAKS = 200


@dataclass(frozen=True)
class Goal:
    """An objective and its constraints, for a loop or an ensemble.

    Attributes:
        objective: a name of OBJECTIVES.
        max_peak: largest Ms and Mt [-], > 1, inf = none.
        min_gain_margin: [-], >= 1, 1 = none.
        min_delay_margin: [s], >= 0, 0 = none.
        min_disk_margin: balanced [-], >= 0, 0 = none.
        max_noise_gain: force rms per encoder count [N/m], > 0, inf = none; see
            `jaxact.tuning.joint.noise`.
        min_kp, max_kp: stiffness [N/m], 0 and inf = none.
        risk: "worst" member, "mean", or "cvar:A", the mean of the worst share 1 - A of the members;
            every member is stable, whichever is asked.
        reference: setpoints [m] at the control ticks for "tracking", shape (ticks,).
        reference_period: time between them [s].
    """

    objective: str = "stiffness"
    max_peak: float = 1.6
    min_gain_margin: float = 1.0
    min_delay_margin: float = 0.0
    min_disk_margin: float = 0.0
    max_noise_gain: float = math.inf
    min_kp: float = 0.0
    max_kp: float = math.inf
    risk: str = WORST
    reference: tuple[float, ...] = ()
    reference_period: float = 1e-3

    @property
    def metric(self) -> str:
        """Name of the metric that is optimised."""
        return OBJECTIVES[self.objective][0]

    @property
    def sense(self) -> float:
        """+1 if the metric is to be large, -1 if small."""
        return OBJECTIVES[self.objective][1]

    @property
    def active(self) -> tuple[str, ...]:
        """Constraints on metrics that ask anything, in the order of CONSTRAINTS."""
        idle = {"max_peak": math.inf, "min_gain_margin": 1.0, "min_delay_margin": 0.0,
                "min_disk_margin": 0.0, "max_noise_gain": math.inf}  # fmt: skip
        return tuple(name for name in CONSTRAINTS if getattr(self, name) != idle[name])

    @property
    def rows(self) -> tuple[tuple[str, str, float, float], ...]:
        """(constraint, metric, sign, bound) of every constraint on a metric."""
        return tuple(
            (name, metric, sign, float(getattr(self, name)))
            for name in self.active
            for metric, sign in CONSTRAINTS[name]
        )

    def tightened(self, by: float) -> Goal:
        """The same with every bound on a metric tighter.

        Args:
            by: ln of the factor.
        """
        sign = {name: metrics[0][1] for name, metrics in CONSTRAINTS.items()}
        return replace(self, **{n: getattr(self, n) * math.exp(-sign[n] * by) for n in self.active})

    @property
    def wanted(self) -> tuple[str, ...]:
        """Metrics that objective and constraints need, without the gains themselves."""
        names = {metric for _, metric, _, _ in self.rows} | ({self.metric} - {KP})
        return tuple(sorted(names))

    @property
    def tail(self) -> float:
        """Share of the members that count: 0 for the worst alone, 1 for all, 1 - A for cvar:A."""
        return risk_tail(self.risk)


def check(goal: Goal) -> Goal:
    """The same goal, if it can be asked for.

    Raises:
        UserError: a name or a bound that makes no sense.
    """
    if goal.objective not in OBJECTIVES:
        raise UserError(f"objective {shown(goal.objective)}; {nearest(goal.objective, OBJECTIVES)}")
    risk_tail(goal.risk)
    limits = {"max_peak": (1.0, "larger than 1"), "max_noise_gain": (0.0, "positive"),
              "max_kp": (0.0, "positive")}  # fmt: skip
    for name, (least, words) in limits.items():
        if not getattr(goal, name) > least:
            raise UserError(f"{_option(name)} {getattr(goal, name):g}: must be {words}")
    floors = {"min_gain_margin": (1.0, "at least 1"), "min_delay_margin": (0.0, "not negative"),
              "min_disk_margin": (0.0, "not negative"),
              "min_kp": (0.0, "not negative")}  # fmt: skip
    for name, (least, words) in floors.items():
        value = getattr(goal, name)
        if not least <= value < math.inf:
            raise UserError(f"{_option(name)} {value:g}: must be finite and {words}")
    if goal.min_disk_margin >= _LARGEST_DISK:
        raise UserError(
            f"`min_disk_margin` {goal.min_disk_margin:g}: must be below {_LARGEST_DISK:g}, that of "
            "gains that do nothing"
        )
    if goal.min_kp > goal.max_kp:
        raise UserError(f"`min_kp` {goal.min_kp:g} is above `max_kp` {goal.max_kp:g}")
    if goal.objective == "disk-margin" and goal.min_kp == 0.0:
        raise UserError(
            "the disk margin is largest for gains that do nothing; say how stiff the joint must be "
            "with `min_kp`"
        )
    if goal.objective == "tracking" and len(goal.reference) < 2:
        raise UserError("tracking needs a file of setpoints: `goal` tracking:FILE")
    return goal


def _option(name: str) -> str:
    return f"`{name}`"


def risk_tail(risk: str) -> float:
    """Share of the members that a risk weighs; see `Goal.tail`.

    Raises:
        UserError: any other word.
    """
    if risk == WORST:
        return 0.0
    if risk == "mean":
        return 1.0
    kind, colon, level = risk.partition(":")
    try:
        value = float(level)
    except ValueError:
        value = math.nan
    if kind != "cvar" or not colon or not 0.0 <= value < 1.0:
        raise UserError(f"risk {shown(risk)}: write worst, mean, or cvar:A with 0 <= A < 1")
    return 1.0 - value


def tail_weights(values: Any, tail: float) -> np.ndarray:
    """Weights of the members, largest values first, that make their risk; rows sum to 1.

    Args:
        values: what is bad when large, shape (..., n).
        tail: share that counts, > 0; of n members the worst tail * n, the last one in part.
    """
    values = np.asarray(values)
    number = values.shape[-1]
    share = np.clip(tail * number - np.arange(number), 0.0, 1.0)
    share = share / share.sum() if share.sum() > 0 else np.eye(number)[0]
    order = np.argsort(-values, axis=-1, kind="stable")
    weights = np.empty_like(values, dtype=float)
    np.put_along_axis(weights, order, np.broadcast_to(share, values.shape), axis=-1)
    return weights


def peaks(number: int, lowest: float = LOWEST, highest: float = HIGHEST) -> np.ndarray:
    """Peaks Ms and Mt along a front [-], shape (number,): even in the modulus margin, 1/M.

    Args:
        number: of them.
        lowest, highest: the ends.

    Raises:
        UserError: fewer than two.
    """
    if not 2 <= number <= MOST_PEAKS:
        raise UserError(f"`front` {number}: give between 2 and {MOST_PEAKS} points")
    return 1.0 / np.linspace(1.0 / lowest, 1.0 / highest, number)
