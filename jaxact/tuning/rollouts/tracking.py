"""Simulated tracking as a term of a robot's objective, beside the margins.

    value - weight ln(rms),    rms = sqrt(mean of (q - r)^2)

over ticks, joints, members and situations, in nonlinear rollouts after a push
(`jaxact.tuning.rollouts.term`). The weight says how many per cent of the objective one per cent
less of the error is worth. The constraints stay what they are. One evaluation costs 1 + 2 g
rollouts of every situation forwards, for g groups, or about ten backwards; and its compilation.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jaxact.errors import UserError
from jaxact.tuning.groups import Groups
from jaxact.tuning.robot.loops import Situation
from jaxact.tuning.rollouts import term as simulated
from jaxact.tuning.rollouts.exposure import exposed
from jaxact.tuning.rollouts.gradient import chosen, value_and_gradient
from jaxact.tuning.rollouts.term import Term

# Length of the rollouts, whose first tenth ends with the push [s], and actuators in each situation.
SECONDS, MEMBERS = 0.4, 2


@dataclass(frozen=True)
class Tracked:
    """Simulated tracking errors, rms over ticks, joints, members and situations [rad or m].

    Attributes:
        weight: of the term in the objective.
        mode: of its derivatives.
        rms: of the gains.
        aside: of the gains that the margins alone lead to.
        before: of the start; NaN where it is unstable, None where none was given.
    """

    weight: float
    mode: str
    rms: float
    aside: float
    before: float | None


@dataclass(frozen=True, eq=False)
class Tracking:
    """Tracking in several situations, in rollouts that are set up.

    terms: of the situations
    weight: of ln(rms) in the objective
    mode: of the derivatives, "forward" or "reverse"
    """

    terms: tuple[Term, ...]
    weight: float
    mode: str

    def log_rms(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """ln of the rms error at log-gains x, and its slope, shape (2 g,); inf if it diverges."""
        return _log_rms(self, np.asarray(x, float).tobytes())

    def tracked(
        self,
        stable: Callable[[np.ndarray], bool],
        x: np.ndarray,
        aside: np.ndarray,
        before: np.ndarray | None,
    ) -> Tracked:
        """The errors at some log-gains, as `Tracked` names them."""

        def rms(x: np.ndarray) -> float:
            return float(np.exp(self.log_rms(x)[0])) if stable(x) else math.nan

        start = None if before is None else rms(before)
        return Tracked(self.weight, self.mode, rms(x), rms(aside), start)


def check(weight: float, derivative: str, groups: int) -> str:
    """The mode of the derivatives.

    Raises:
        UserError: a weight or a mode that makes no sense.
    """
    if not (weight >= 0.0 and math.isfinite(weight)):
        raise UserError(f"`tracking_weight` {weight:g}: give a positive number, 0 for none")
    try:
        return chosen(derivative, 2 * groups)
    except UserError as mistake:
        raise UserError(f"`derivative`: {mistake}") from None


def tracking(
    situations: Sequence[Situation],
    fractions: Sequence[np.ndarray],
    groups: Groups,
    weight: float,
    mode: str,
) -> Tracking:
    """Rollouts of every situation, with some of its actuators.

    Args:
        fractions: of the ranges of the box for each situation, shape (n, ranges); the first are
            taken.
        weight: of ln(rms) in the objective.
        mode: of the derivatives, "forward" or "reverse".
    """
    terms = tuple(
        simulated.term(
            exposed(one.specification, duration=SECONDS), groups.members,
            one.columns(fraction[:MEMBERS]),
        )
        for one, fraction in zip(situations, fractions, strict=True)
    )  # fmt: skip
    return Tracking(terms, weight, mode)


@functools.lru_cache(maxsize=64)
def _log_rms(tracking: Tracking, at: bytes) -> tuple[float, np.ndarray]:
    found = [value_and_gradient(one, np.frombuffer(at), tracking.mode) for one in tracking.terms]
    mean = float(np.mean([one.tracking for one in found]))
    slope = np.mean([one.gradient for one in found], axis=0)
    if not (np.isfinite(mean) and np.isfinite(slope).all()):
        return math.inf, np.zeros_like(slope)
    return 0.5 * math.log(mean), 0.5 * slope / mean
