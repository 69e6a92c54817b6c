"""What a simple model of the drive takes for granted.

A drive that was chosen as a mere delay is a loop of second order with a delay that is infinitely
fast, and one of first order is such a loop whose other pole is. Its intervals are those of numbers
of which that is known. The same logs chose it, though, because they cannot tell it from the whole
one, which may have quite another delay: what they leave open is asked of the whole model. Its
delay is moved to the ends of its 95 % interval by profile likelihood, the others are fitted anew,
and where a number goes then, its interval reaches. A delay that is one remains so: with a slower
loop behind it the sum of squares would rise.

Source: Leeb, Poetscher, "Model selection and inference: facts and fiction", Econometric Theory 21
(2005); Raue et al., "Structural and practical identifiability analysis of partially observed
dynamical models by exploiting the profile likelihood", Bioinformatics 25 (2009).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from jaxact.identification import knowledge, misfit, uncertainty
from jaxact.identification.choice import Candidate
from jaxact.identification.fitting import Fit, solve
from jaxact.identification.knowledge import Estimate
from jaxact.identification.ladder import Ladder
from jaxact.identification.log import LINKS
from jaxact.identification.model import DYNAMICS, of_rung
from jaxact.identification.problem import effective_lag
from jaxact.parameters import DELAY, WN, ZETA

_WHOLE = "second order with delay"
# A search that ended by so little above that of a model it contains has found it, but for a bound.
_AS_FAR = 1e-3


def allowed(ladder: Ladder, *, loss: str = "linear") -> Ladder:
    """A ladder whose chosen model knows no more than the whole drive's model leaves it.

    Args:
        ladder: any.
        loss: of its least squares.
    """
    chosen = ladder.chosen
    fit = _whole(ladder, loss)
    if fit is None:
        return ladder
    rho = misfit.share(fit)
    known = knowledge.of_fit(fit, profile=False, rho=rho)
    late = known[DELAY]
    half = knowledge.half_width(fit, late.wider, late.bias)
    moved = [
        solve(fit.problem, loss=loss, fixed={DELAY: delay}, start=fit.values)
        for delay in knowledge.ends_of_delay(fit, half)
    ]
    at = [one.problem.model_values(one.point) for one in (fit, *moved)]
    each = [{**values, "lag": 2.0 * values[ZETA] / values[WN]} for values in at]
    estimates = tuple(
        _reaching(e, chosen, each, known.estimates) for e in chosen.knowledge.estimates
    )
    lag = chosen.knowledge.lag
    if lag is not None:
        apart = max(abs(effective_lag(values) - lag[0]) for values in at)
        lag = lag[0], max(lag[1], apart / uncertainty.critical(fit, 1.0))
    refined = replace(chosen, knowledge=replace(chosen.knowledge, estimates=estimates, lag=lag))
    return replace(
        ladder,
        chosen=refined,
        candidates=tuple(refined if one is chosen else one for one in ladder.candidates),
    )


def _whole(ladder: Ladder, loss: str) -> Fit | None:
    """The whole drive's model of the chosen friction.

    None where the chosen one has no drive, and on a robot, whose links' forces are those of a
    smoothed motion: that is most of the error, and the delay is judged beside other frictions.
    """
    chosen = ladder.chosen
    if set(LINKS) <= set(ladder.fitted[0].signals):
        return None
    if chosen.rung.dynamics == _WHOLE or not DYNAMICS[chosen.rung.dynamics][0]:
        return None
    beside = [
        one
        for one in ladder.candidates
        if one.rung.dynamics == _WHOLE and one.rung.friction == chosen.rung.friction
    ]
    if not beside:
        return None
    rung = beside[0].rung
    more = tuple(name for name in chosen.rung.free if name in ladder.family.beside)
    rung = replace(rung, free=(*rung.free, *(name for name in more if name not in rung.free)))
    problem = of_rung(ladder.family, rung, ladder.fitted)
    fit = solve(problem, loss=loss, start={**chosen.fit.values, **beside[0].fit.values})
    return fit if fit.square_sum <= (1.0 + _AS_FAR) * chosen.fit.square_sum else None


def _reaching(
    one: Estimate,
    chosen: Candidate,
    each: Sequence[Mapping[str, float]],
    whole: Sequence[Estimate],
) -> Estimate:
    """An estimate whose interval reaches to where the whole model places the number.

    Args:
        one: of the chosen model.
        chosen: it.
        each: numbers of the whole model, at the ends of its delay's interval too.
        whole: its estimates.
    """
    low, high = one.low, one.high
    if one.name in (DELAY, WN, ZETA, "lag"):
        said = [values[one.name] for values in each]
        low, high = min(low, *said), max(high, *said)
    else:
        said = [end for e in whole if e.name == one.name for end in (e.low, e.high)]
        low, high = min(low, *said), max(high, *said)
    reason = one.reason
    index = chosen.fit.problem.names.index(one.name)
    if not reason and knowledge.is_wide(chosen.fit, index, low, high):
        reason = _why(one.name, chosen)
    return replace(one, low=low, high=high, reason=reason, identified=not reason)


def _why(name: str, chosen: Candidate) -> str:
    """Why a number is not known that the whole model places elsewhere."""
    if name == DELAY:
        return "cannot be told from the lag of a loop"
    if name in (WN, ZETA, "lag") and DELAY not in chosen.rung.free:
        return "cannot be told from a delay"
    return "depends on the order of the drive's loop, which the logs do not show"
