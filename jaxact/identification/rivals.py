"""What models that fit better say of the numbers of the one that is chosen.

The simplest model that predicts as well as the best is the one to use, but its intervals are those
of a model that is right. Where another fits the logs better than chance allows,

    (S - S') / (s'^2 w^2) > chi2(0.999, unknowns more, at least 1)

with S and S' their sums of squares, s'^2 the variance the other leaves and w^2 by how much less
its residuals say than independent ones, a number that both have and that both place outside of each
other's interval is known no better than they agree: its interval reaches from one to the other.
A term of friction that such a model does without is not known to be there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats

from jaxact.identification.choice import Candidate
from jaxact.identification.knowledge import Estimate, is_wide
from jaxact.identification.ladder import Ladder

# Of dozens of models one or another is ahead by chance; so small a share of the sum says nothing.
_LEVEL, _LEAST_SHARE = 0.999, 0.01
# Terms of friction, in whose place a better model has others.
_TERMS = ("viscous_asymmetry", "coulomb_asymmetry", "loaded", "stribeck", "stribeck_speed")


def heard(ladder: Ladder) -> Ladder:
    """A ladder whose chosen model knows no more than models that fit better agree to.

    Args:
        ladder: any.
    """
    chosen = ladder.chosen
    others = [one for one in ladder.candidates if _fits_better(one, chosen)]
    estimates = tuple(_agreed(e, chosen, others) for e in chosen.knowledge.estimates)
    if estimates == chosen.knowledge.estimates:
        return ladder
    refined = replace(chosen, knowledge=replace(chosen.knowledge, estimates=estimates))
    return replace(
        ladder,
        chosen=refined,
        candidates=tuple(refined if one is chosen else one for one in ladder.candidates),
    )


def _fits_better(one: Candidate, chosen: Candidate) -> bool:
    """Whether a model fits better than chance allows."""
    more = max(one.size - chosen.size, 1)
    if not np.isfinite(one.fit.square_sum):
        return False
    spare = max(len(one.fit.residuals) - len(one.fit.point), 1)
    wider = max(1.0, float(np.median([e.wider for e in chosen.knowledge.estimates])))
    gained = chosen.fit.square_sum / max(one.fit.square_sum, 1e-300) - 1.0
    chance = stats.chi2.ppf(_LEVEL, more) * wider**2 / spare
    return bool(gained > max(chance, _LEAST_SHARE))


def _agreed(estimate: Estimate, chosen: Candidate, others: list[Candidate]) -> Estimate:
    """An estimate whose interval reaches to where models that fit better place it."""
    low, high, reason = estimate.low, estimate.high, estimate.reason
    index = chosen.fit.problem.names.index(estimate.name)
    for other in others:
        said = next((e for e in other.knowledge.estimates if e.name == estimate.name), None)
        if said is None and estimate.name in _TERMS:
            reason = reason or f"is not in '{other.rung.name}', which fits better"
        if said is None or said.low <= estimate.value <= said.high:
            continue
        low, high = min(low, said.value), max(high, said.value)
        if not reason and is_wide(chosen.fit, index, low, high):
            reason = f"is {said.value:.3g} by '{other.rung.name}', which fits better"
    return replace(
        estimate, low=low, high=high, reason=reason, identified=estimate.identified and not reason
    )
