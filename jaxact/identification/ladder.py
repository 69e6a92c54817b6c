"""Climbing the ladder: every rung fitted, every rung tried on what it has not seen, one chosen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxact.identification import knowledge as _knowledge
from jaxact.identification.fitting import LEAST_SQUARES, Fit, solve
from jaxact.identification.inspection import quantum
from jaxact.identification.knowledge import Knowledge
from jaxact.identification.log import Log
from jaxact.identification.model import DYNAMICS, Family, Rung, of_rung, predicted
from jaxact.identification.settling import settled
from jaxact.parameters import DELAY, WN, ZETA

# A simpler model is preferred where its error is within this share of the best one's.
_AS_GOOD = 0.01
# The same for frictions before the drive's dynamics are known.
_NEARLY_AS_GOOD = 0.05
# A model that is not wholly identified is taken where those that are have so many times its error.
_FAR_WORSE = 1.5
# Of a log that is followed so well [%], no limit was reached that matters.
_FOLLOWED = 97.0
# Share of the encoder's own error that is left out when errors are compared.
_OF_THE_FLOOR = 0.95
# Of a log that is alone, the last part is kept for validation.
_HELD_OUT = 0.3

FAR_FROM_A_DELAY = 0.9
"""Dynamics with so small a share of a mere delay's error may have been taken for friction."""


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
class Ladder:
    """All rungs, and the one that is chosen.

    Attributes:
        family: what was identified.
        candidates: fitted, in the order of their size.
        chosen: the simplest one as good as the best, all of whose numbers are identified.
        fitted: logs that were fitted.
        validation: logs that were not.
        kept_apart: whether validation is the end of the fitted logs, for want of others.
        shown: frequency up to which rows show what a faster loop did [Hz]; None where all is shown.
    """

    family: Family
    candidates: tuple[Candidate, ...]
    chosen: Candidate
    fitted: tuple[Log, ...]
    validation: tuple[Log, ...]
    kept_apart: bool
    shown: float | None = None


def split(logs: Sequence[Log], validation: Sequence[Log]) -> tuple[list[Log], list[Log], bool]:
    """(logs to fit, logs to validate, whether the latter are parts of the former)."""
    if validation:
        return list(logs), list(validation), False
    cuts = [int((1.0 - _HELD_OUT) * len(log)) for log in logs]
    first = [log.part(0, at) for log, at in zip(logs, cuts, strict=True)]
    last = [log.part(at, len(log)) for log, at in zip(logs, cuts, strict=True)]
    return first, last, True


def climb(
    family: Family,
    logs: Sequence[Log],
    validation: Sequence[Log],
    *,
    loss: str = "linear",
    method: str = LEAST_SQUARES,
    bootstrap: bool = False,
    report: Callable[[str], None] | None = None,
) -> Ladder:
    """Fit every rung, and choose.

    Args:
        family: of the logs.
        logs: to fit.
        validation: to try the models on; where there are none, the last 30 % of each log.
        loss: of the least squares, "linear", "soft_l1" or "huber".
        method: of `METHODS`.
        bootstrap: intervals by resampling.
        report: is told each rung's name as its turn comes.

    Returns:
        The ladder.
    """
    fitted, held, apart = split(logs, validation)
    floor = encoder_error(family, held)
    found: list[Candidate] = []

    def fit(rung: Rung, before: Sequence[Candidate]) -> Candidate:
        if report is not None:
            report(rung.name)
        return _candidate(family, rung, fitted, held, (loss, method), before)

    def mend() -> None:
        if method == LEAST_SQUARES:
            found[:] = leaner(family, found, floor, fitted, held, loss)

    for rung in stages(family, found, floor, mend):
        found.append(fit(rung, found))
    found += limited(family, found, floor, fit)
    mend()
    found = [without_delay(one, found) for one in found]
    chosen = choose(found, floor)
    rung, best = chosen.rung, chosen.fit
    if family.beside:
        rung = replace(rung, free=(*rung.free, *family.beside))
        best = solve(of_rung(family, rung, fitted), loss=loss, method=method, start=best.values)
    best = settled(best, loss=loss) if method == LEAST_SQUARES else best
    known = _knowledge.of_fit(best, bootstrap=bootstrap)
    refined = without_delay(_tried(family, rung, best, known, held), found)
    ordered = sorted(found, key=lambda one: (one.size, one.rung.name))
    return Ladder(
        family,
        tuple(refined if one is chosen else one for one in ordered),
        refined,
        tuple(fitted),
        tuple(held),
        apart,
    )


def stages(
    family: Family, found: list[Candidate], floor: float, mend: Callable[[], None]
) -> Iterator[Rung]:
    """The rungs one after another: frictions with a delay first, then dynamics with the best one.

    Where the dynamics are far from a mere delay, which was taken for friction, frictions again,
    and so on until the best one has been tried with all of both.

    Args:
        family: of the rungs.
        found: candidates so far, which grows while this is iterated over.
        floor: see `choose`.
        mend: looks for better fits of those that were found.
    """
    if len({rung.friction for rung in family.rungs}) == 1:
        yield from family.rungs
        return
    yield from (rung for rung in family.rungs if rung.dynamics == DELAY)
    mend()
    first = choose(found, floor, _NEARLY_AS_GOOD)
    best = first
    while True:
        left = [rung for rung in family.rungs if all(rung is not one.rung for one in found)]
        beside = [rung for rung in left if rung.friction == best.rung.friction]
        if not beside and best.error < FAR_FROM_A_DELAY * first.error:
            beside = [rung for rung in left if rung.dynamics == best.rung.dynamics]
        if not beside:
            return
        yield from beside
        mend()
        best = choose(found, floor)
        if best.rung.dynamics == DELAY:
            return


def limited(
    family: Family,
    found: Sequence[Candidate],
    floor: float,
    fit: Callable[[Rung, Sequence[Candidate]], Candidate],
) -> list[Candidate]:
    """Every model with what logs may hide, where the chosen one predicts better with it.

    A drive at its limit answers a larger command with no more, which others take for a smaller gain
    and another delay; in a noisy log no two rows at the limit are alike.

    Args:
        family: of the models.
        found: candidates without it.
        floor: see `choose`.
        fit: (model, candidates to begin from) -> candidate.
    """
    chosen = choose(found, floor)
    if not family.perhaps or min(chosen.scores) > _FOLLOWED:
        return []

    def richer(rung: Rung) -> Rung:
        name = f"{rung.name}, limited"
        friction = f"{rung.friction}, limited" if rung.friction else "limited"
        return replace(rung, name=name, friction=friction, free=(*family.perhaps, *rung.free))

    first = fit(richer(chosen.rung), found)
    if choose([*found, first], floor) is not first:
        return []
    more = [first]
    for one in found:
        if one is not chosen:
            more.append(fit(richer(one.rung), [*found, *more]))
    return more


def leaner(
    family: Family,
    found: Sequence[Candidate],
    floor: float,
    fitted: Sequence[Log],
    held: Sequence[Log],
    loss: str,
) -> list[Candidate]:
    """Every model, those that are part of a chosen one with an unknown too many begun from it.

    A search that creeps along a crease, such as that of a delay at a control tick, ends too early;
    the model with more unknowns has then come farther, and would be chosen for that alone.

    Args:
        family: of the models.
        found: candidates.
        floor: see `choose`.
        fitted, held: logs.
        loss: of the least squares.
    """
    chosen = choose(found, floor)
    spare = {e.name for e in chosen.knowledge.estimates if not e.identified}

    def again(one: Candidate) -> Candidate:
        less, whole = set(one.rung.free), set(chosen.rung.free)
        if not less < whole or not whole - less <= spare:
            return one
        sought = of_rung(family, one.rung, fitted)
        fit = solve(sought, loss=loss, start=chosen.fit.values)
        if fit.square_sum >= one.fit.square_sum:
            return one
        return _tried(family, one.rung, fit, _knowledge.of_fit(fit, profile=False), held)

    return [again(one) for one in found]


def encoder_error(family: Family, logs: Sequence[Log]) -> float:
    """Mean square of what rounding to the encoder's counts does to the measured signal."""
    steps = [quantum(family.measured(log)) or 0.0 for log in logs]
    return float(np.mean(np.square(steps))) / 12.0


def without_delay(one: Candidate, every: Sequence[Candidate]) -> Candidate:
    """A model without delay, whose drive is known only where a delay beside it could be told.

    A loop that is second order by itself fits a slow excitation as closely as one with a delay and
    less lag of its own; its narrow intervals hold only if there is no delay.
    """
    beside = next(
        (
            other
            for other in every
            if other.rung.friction == one.rung.friction
            and other.rung.dynamics == f"{one.rung.dynamics} with delay"
        ),
        None,
    )
    if beside is None or not any(DELAY in names for names in beside.knowledge.combinations):
        return one
    if beside.fit.square_sum > (1.0 + _AS_GOOD) * one.fit.square_sum:
        return one
    estimates = tuple(
        replace(e, identified=False, reason=e.reason or "cannot be told from a delay")
        if e.name in (WN, ZETA, "lag")
        else e
        for e in one.knowledge.estimates
    )
    lag = one.knowledge.lag
    if lag is not None and beside.knowledge.lag is not None:
        # Their sum is known no better than the model with a delay knows it.
        value, deviation = beside.knowledge.lag
        lag = lag[0], max(lag[1], abs(value - lag[0]) + deviation)
    return replace(one, knowledge=replace(one.knowledge, estimates=estimates, lag=lag))


def _candidate(
    family: Family,
    rung: Rung,
    fitted: Sequence[Log],
    held: Sequence[Log],
    way: tuple[str, str],
    before: Sequence[Candidate],
) -> Candidate:
    sought = of_rung(family, rung, fitted)
    contained = [one.fit for one in before if set(one.rung.free) <= set(rung.free)]
    others = [one.fit for one in before if one.joint <= set(rung.free)]
    fit = solve(
        sought,
        loss=way[0],
        method=way[1],
        near=min(others, key=lambda one: one.square_sum, default=None),
        enough=min((one.square_sum for one in contained), default=0.0),
    )
    return _tried(family, rung, fit, _knowledge.of_fit(fit, profile=False), held)


def _tried(
    family: Family, rung: Rung, fit: Fit, known: Knowledge, held: Sequence[Log]
) -> Candidate:
    """A fit, and its errors on logs that it has not seen."""
    numbers = fit.problem.model_values(fit.point)
    errors, scores = [], []
    for log in held:
        measured = family.measured(log)
        rest = predicted(family, log, numbers) - measured
        errors.append(float(np.sqrt(np.mean(rest**2))))
        spread = float(np.std(measured))
        scores.append(100.0 * (1.0 - errors[-1] / max(spread, 1e-300)))
    return Candidate(rung, fit, known, tuple(errors), tuple(scores), numbers)


def choose(
    candidates: Sequence[Candidate], floor: float = 0.0, share: float = _AS_GOOD
) -> Candidate:
    """The simplest that is as good as the best and all of whose numbers are identified.

    Where none of those is, the simplest that is as good as the best whose numbers are; but where
    that is far worse than the best, or there is none, the simplest as good as the best.

    Args:
        candidates: fitted and tried.
        floor: mean square error that the encoder alone makes, most of which is left out of the
            comparison, as no model can mend it.
        share: by which a simpler model's error may be larger.
    """

    def error(one: Candidate) -> float:
        own = one.error**2
        return float(np.sqrt(own - min(_OF_THE_FLOOR * floor, 0.999 * own)))

    usable = [one for one in candidates if np.isfinite(one.error)] or list(candidates)
    best = min(error(one) for one in usable)
    identified = [one for one in usable if one.knowledge.identified]
    least = min((error(one) for one in identified), default=np.inf)
    chosen, bound = (identified, least) if least <= _FAR_WORSE * best else (usable, best)
    as_good = [one for one in chosen if error(one) <= (1.0 + share) * bound]
    return min(as_good, key=lambda one: (one.size, one.error))
