"""The least squares along growing parts of the logs of a joint that turns over.

A pendulum that turns over goes another way after a small error in any number: of a long log the sum
of squares has many minima, of a short one few. What fits a part begins the search along the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from jaxact.identification.fitting import Fit, solve
from jaxact.identification.log import Log
from jaxact.identification.model import Family, Rung, of_rung

_SHARES = (1.0 / 16.0, 1.0 / 8.0, 1.0 / 4.0, 1.0 / 2.0)
# Of a part so short the numbers of a joint are not known.
_LEAST_ROWS = 100


def grown(family: Family, rung: Rung, logs: Sequence[Log], loss: str) -> Fit:
    """A rung's fit of whole logs, begun from those of their first parts.

    Args:
        family: of the rung.
        rung: the model.
        logs: to fit.
        loss: of the least squares.
    """
    whole = of_rung(family, rung, logs)
    values: Mapping[str, float] = {}
    for share in _SHARES:
        rows = [max(int(share * len(log)), min(_LEAST_ROWS, len(log))) for log in logs]
        parts = [log.part(0, number) for log, number in zip(logs, rows, strict=True)]
        sought = replace(of_rung(family, rung, parts), unknowns=whole.unknowns, scale=whole.scale)
        values = solve(sought, loss=loss, start=values).values
    return solve(whole, loss=loss, start=values)
