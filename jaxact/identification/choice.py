"""Which of the models tried on logs is chosen: as simple as their errors allow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jaxact.identification.fitting import Fit
from jaxact.identification.inspection import quantum
from jaxact.identification.knowledge import Knowledge
from jaxact.identification.log import Log
from jaxact.identification.model import DYNAMICS, Family, Rung, predicted

AS_GOOD = 0.01
"""A simpler model is preferred where its error is within this share of the best one's."""
# A model that is not wholly identified is taken where those that are have so many times its error.
_FAR_WORSE = 1.5
_FITS_FAR_WORSE = 1.2  # in its sum of squares
# An error of so many times what the intervals of a model's numbers stand for may be one by chance.
_BY_CHANCE = 2.0
# A model predicts almost all where it has this score on logs that it has not seen [%].
_ALMOST_ALL = 99.5
# Share of the encoder's own error that is left out when errors are compared.
_OF_THE_FLOOR = 0.95


@dataclass(frozen=True)
class Candidate:
    """A rung, fitted and tried.

    Attributes:
        rung: the model.
        fit: its least squares.
        knowledge: intervals and combinations.
        errors: root of the mean square error on each validation log, in the signal's unit.
        scores: 100 (1 - error / spread) of each validation log [%].
        numbers: all numbers of the model by name.
    """

    rung: Rung
    fit: Fit
    knowledge: Knowledge
    errors: tuple[float, ...]
    scores: tuple[float, ...]
    numbers: dict[str, float]

    @property
    def error(self) -> float:
        """Root of the mean square error over all validation logs."""
        return float(np.sqrt(np.mean(np.square(self.errors))))

    @property
    def joint(self) -> set[str]:
        """Names of the unknowns that are not the drive's dynamics."""
        return set(self.rung.free) - set(DYNAMICS[self.rung.dynamics][0])

    @property
    def size(self) -> int:
        """Number of unknowns, those of single logs apart."""
        return len(self.rung.free)


@dataclass(frozen=True)
class Scale:
    """What errors on logs that were not fitted are to be held against.

    Attributes:
        floor: mean square error that the encoder alone makes, most of which is left out of the
            comparison, as no model can mend it.
        by_chance: a candidate's error if its model is right and its numbers are within their
            intervals; asked for where it decides.
    """

    floor: float
    by_chance: Callable[[Candidate], float]


def encoder_error(family: Family, logs: Sequence[Log], others: Sequence[Log]) -> float:
    """Mean square of what rounding to the encoder's counts does to the measured signal.

    Args:
        family: says which signal it is.
        logs: whose error is asked for.
        others: of the same encoder, whose counts show where those of a faster motion do not.
    """
    own = [quantum(family.measured(log)) for log in logs]
    shown = [step for step in (quantum(family.measured(log)) for log in others) if step]
    instead = min(shown, default=0.0)
    return float(np.mean([(step or instead) ** 2 for step in own])) / 12.0


def error_by_chance(family: Family, logs: Sequence[Log], one: Candidate) -> float:
    """Root of the mean square error on logs that the intervals of a model's numbers stand for.

    The prediction is moved along each direction in which the numbers are known to a standard
    deviation, that of the residuals' autocorrelation included.

    Args:
        family: of the model.
        logs: it was not fitted to.
        one: fitted.
    """
    problem, known = one.fit.problem, one.knowledge
    kept = np.array([not unknown.nuisance for unknown in problem.unknowns])
    variances, directions = np.linalg.eigh(known.covariance[np.ix_(kept, kept)])
    low = np.array([unknown.inner(unknown.low) for unknown in problem.unknowns])
    high = np.array([unknown.inner(unknown.high) for unknown in problem.unknowns])
    low, high = np.minimum(low, high), np.maximum(low, high)
    square = np.zeros(len(logs))
    for number, log in enumerate(logs):
        before = predicted(family, log, one.numbers)
        for variance, direction in zip(np.maximum(variances, 0.0), directions.T, strict=True):
            point = one.fit.point.copy()
            point[kept] += np.sqrt(variance) * direction
            moved = problem.model_values(np.clip(point, low, high))
            square[number] += np.mean(np.square(predicted(family, log, moved) - before))
    return float(np.sqrt(np.mean(square)))


def choose(candidates: Sequence[Candidate], scale: Scale, share: float = AS_GOOD) -> Candidate:
    """The simplest that is as good as the best and all of whose numbers are identified.

    As good is what has as small an error where it was not fitted, and also what fits as well and
    predicts almost all there, not far worse, or has an error there that its intervals stand for:
    which of two such models is ahead is chance. It is chance, too, that what fits far worse is
    ahead of such a model: motion that hardly passes the top, or sticks, enlarges anything.

    Where none of those is, the simplest that is as good as the best whose numbers are; but where
    that is far worse than the best, or there is none, the simplest as good as the best. What fits
    as well, and predicts almost all that it has not seen, is not far worse.

    Args:
        candidates: fitted and tried.
        scale: of their errors.
        share: by which a simpler model's error may be larger.
    """

    def error(one: Candidate) -> float:
        own = one.error**2
        return float(np.sqrt(own - min(_OF_THE_FLOOR * scale.floor, 0.999 * own)))

    def fits(one: Candidate, among: Sequence[Candidate]) -> bool:
        least = min(other.fit.square_sum for other in among)
        return one.fit.square_sum <= (1.0 + share) ** 2 * least

    def by_chance(one: Candidate, among: Sequence[Candidate]) -> bool:
        return fits(one, among) and error(one) <= _BY_CHANCE * scale.by_chance(one)

    usable = [one for one in candidates if np.isfinite(one.error)] or list(candidates)
    best = min(map(error, usable))
    identified = [one for one in usable if one.knowledge.identified]
    least = min(map(error, identified), default=np.inf)
    near = least <= _FAR_WORSE * best or any(
        (min(one.scores) > _ALMOST_ALL and fits(one, usable)) or by_chance(one, usable)
        for one in identified
    )
    chosen, bound = (identified, least) if near else (usable, best)
    ordered = sorted(chosen, key=lambda one: (one.size, one.error))

    def as_good(one: Candidate) -> bool:
        almost = min(one.scores) > _ALMOST_ALL and error(one) <= _FAR_WORSE * bound
        return (
            error(one) <= (1.0 + share) * bound
            or (almost and near and fits(one, chosen))
            or by_chance(one, chosen)
        )

    found = next(one for one in ordered if as_good(one))
    if not near or fits(found, chosen):
        return found

    def ahead(one: Candidate) -> bool:
        far = found.fit.square_sum > _FITS_FAR_WORSE * one.fit.square_sum
        almost = min(one.scores) > _ALMOST_ALL
        return far and fits(one, chosen) and (almost or by_chance(one, chosen))

    return next((one for one in ordered if ahead(one)), found)
