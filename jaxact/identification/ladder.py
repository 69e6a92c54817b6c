"""Climbing the ladder: every rung fitted, every rung tried on what it has not seen, one chosen."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxact.identification import knowledge as _knowledge
from jaxact.identification import misfit
from jaxact.identification.choice import (
    AS_GOOD,
    Candidate,
    Scale,
    choose,
    encoder_error,
    error_by_chance,
)
from jaxact.identification.fitting import LEAST_SQUARES, Fit, solve
from jaxact.identification.growing import grown
from jaxact.identification.knowledge import Estimate, Knowledge
from jaxact.identification.log import Log
from jaxact.identification.model import Family, Rung, of_rung, predicted
from jaxact.identification.settling import settled
from jaxact.parameters import DELAY, WN, ZETA

# Share by which a simpler friction may be worse before the dynamics of the drive are known.
_NEARLY_AS_GOOD = 0.05
# Of a log that is followed so well [%], no limit was reached that matters.
_FOLLOWED = 97.0
# A joint that turns over goes another way after a small error [rad].
_A_TURN = 2.0 * math.pi
# A model has gone astray that fits so much worse than one it contains; friction that is as faint as
# this share of what it usually begins with leaves the other's motion almost as it is.
_ASTRAY, _FAINT, _FRICTION = 1.2, 0.03, ("viscous", "coulomb")
# Of a log that is alone, the last part is kept for validation.
_HELD_OUT = 0.3

FAR_FROM_A_DELAY = 0.9
"""Dynamics with so small a share of a mere delay's error may have been taken for friction."""


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


def too_long(ladder: Ladder) -> Estimate | None:
    """The delay that ended at the longest that was tried, of the best models; None where none did.

    With too short a delay the model that has one is no longer identified, and may not be chosen.
    """
    return next(
        (
            each
            for one in (ladder.chosen, *ladder.candidates)
            if one.error <= ladder.chosen.error
            for each in one.knowledge.estimates
            if each.name == DELAY and each.at_bound
        ),
        None,
    )


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
    chances: dict[int, float] = {}

    def by_chance(one: Candidate) -> float:
        if id(one.fit) not in chances:
            chances[id(one.fit)] = error_by_chance(family, held, one)
        return chances[id(one.fit)]

    scale = Scale(encoder_error(family, held, fitted), by_chance)
    found: list[Candidate] = []

    def fit(rung: Rung, before: Sequence[Candidate]) -> Candidate:
        if report is not None:
            report(rung.name)
        return _candidate(family, rung, fitted, held, (loss, method), before)

    def mend() -> None:
        if method == LEAST_SQUARES:
            found[:] = leaner(family, found, scale, fitted, held, loss)

    for rung in stages(family, found, scale, mend):
        found.append(fit(rung, found))
    found += limited(family, found, scale, fit)
    mend()
    found = [without_delay(one, found) for one in found]
    chosen = choose(found, scale)
    rung, best = chosen.rung, chosen.fit
    if family.beside:
        rung = replace(rung, free=(*rung.free, *family.beside))
        best = solve(of_rung(family, rung, fitted), loss=loss, method=method, start=best.values)
    best = settled(best, loss=loss) if method == LEAST_SQUARES else best
    known = _knowledge.of_fit(best, bootstrap=bootstrap, rho=misfit.share(best))
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
    family: Family, found: list[Candidate], scale: Scale, mend: Callable[[], None]
) -> Iterator[Rung]:
    """The rungs one after another: frictions with a delay first, then dynamics with the best one.

    Where the dynamics are far from a mere delay, which was taken for friction, frictions again,
    and so on until the best one has been tried with all of both.

    Args:
        family: of the rungs.
        found: candidates so far, which grows while this is iterated over.
        scale: see `choose`.
        mend: looks for better fits of those that were found.
    """
    if len({rung.friction for rung in family.rungs}) == 1:
        yield from family.rungs
        return
    yield from (rung for rung in family.rungs if rung.dynamics == DELAY)
    mend()
    first = choose(found, scale, _NEARLY_AS_GOOD)
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
        best = choose(found, scale)
        if best.rung.dynamics == DELAY:
            return


def limited(
    family: Family,
    found: Sequence[Candidate],
    scale: Scale,
    fit: Callable[[Rung, Sequence[Candidate]], Candidate],
) -> list[Candidate]:
    """Every model with what logs may hide, where the chosen one predicts better with it.

    A drive at its limit answers a larger command with no more, which others take for a smaller gain
    and another delay; in a noisy log no two rows at the limit are alike.

    Args:
        family: of the models.
        found: candidates without it.
        scale: see `choose`.
        fit: (model, candidates to begin from) -> candidate.
    """
    chosen = choose(found, scale)
    if not family.perhaps or min(chosen.scores) > _FOLLOWED:
        return []

    def richer(rung: Rung) -> Rung:
        name = f"{rung.name}, limited"
        friction = f"{rung.friction}, limited" if rung.friction else "limited"
        return replace(rung, name=name, friction=friction, free=(*family.perhaps, *rung.free))

    first = fit(richer(chosen.rung), found)
    if choose([*found, first], scale) is not first:
        return []
    more = [first]
    for one in found:
        if one is not chosen:
            more.append(fit(richer(one.rung), [*found, *more]))
    return more


def leaner(
    family: Family,
    found: Sequence[Candidate],
    scale: Scale,
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
        scale: see `choose`.
        fitted, held: logs.
        loss: of the least squares.
    """
    chosen = choose(found, scale)
    spare = {e.name for e in chosen.knowledge.estimates if not e.identified}

    def again(one: Candidate) -> Candidate:
        less, whole = set(one.rung.free), set(chosen.rung.free)
        values = chosen.fit.values
        if "lag" in less and {WN, ZETA} <= whole:
            less, values = less - {"lag"}, _first_order(values)
        if not less < whole or not whole - less <= spare:
            return one
        sought = of_rung(family, one.rung, fitted)
        fit = solve(sought, loss=loss, start=values)
        if fit.square_sum >= one.fit.square_sum:
            return one
        return _tried(family, one.rung, fit, _knowledge.of_fit(fit, profile=False), held)

    return [again(one) for one in found]


def _first_order(values: dict[str, float]) -> dict[str, float]:
    """Numbers of a second-order drive as those of a first-order one, the faster pole a delay."""
    wn, zeta = values[WN], values[ZETA]
    apart = math.sqrt(max(zeta**2 - 1.0, 0.0))
    slow = (zeta + apart) / wn
    return {**values, "lag": slow, DELAY: values.get(DELAY, 0.0) + 2.0 * zeta / wn - slow}


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
    if beside.fit.square_sum > (1.0 + AS_GOOD) * one.fit.square_sum:
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
    simpler = min(contained, key=lambda one: one.square_sum, default=None)
    others = [one for one in before if one.joint <= set(rung.free)]
    least = min((one.fit.square_sum for one in others), default=0.0)
    # Of those that fit as well the one that leaves the fewest unknowns to begin anywhere.
    alike = [one for one in others if one.fit.square_sum <= _ASTRAY * least]
    near = min(alike, key=lambda one: (-len(one.joint), one.fit.square_sum), default=None)
    fit = solve(
        sought,
        loss=way[0],
        method=way[1],
        near=None if near is None else near.fit,
        enough=0.0 if simpler is None else simpler.square_sum,
    )
    if simpler is not None and fit.square_sum > _ASTRAY * simpler.square_sum:
        faint = {u.name: _FAINT * u.starts[0] for u in sought.unknowns if u.name in _FRICTION}
        begun = solve(sought, loss=way[0], method=way[1], start={**faint, **simpler.values})
        fit = min(fit, begun, key=lambda one: one.square_sum)
    if way[1] == LEAST_SQUARES and family.signal == "position" and family.unit == "rad":
        if any(np.ptp(log["position"]) > _A_TURN for log in fitted):
            fit = min(fit, grown(family, rung, fitted, way[0]), key=lambda one: one.square_sum)
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
