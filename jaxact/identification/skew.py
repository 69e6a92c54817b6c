"""What a position that was written at another instant than its setpoint is taken for.

A controller that sees ``q`` while the log has ``y(t) = q(t - late)`` acts, to first order, on ``y``
and ``kp late`` more damping: the log of a joint with more friction, inertia and delay. The fit does
not show it, so that only whoever wrote the log can vouch for the numbers that it moves.
"""

from __future__ import annotations

import numpy as np

from jaxact.identification.alignment import agree
from jaxact.identification.fitting import Fit
from jaxact.identification.ladder import Ladder
from jaxact.identification.log import Log
from jaxact.parameters import SETPOINT

# A number that moves less than its interval is wide, or than this share of it, is not named.
_NAMED = 0.01
# Numbers that are searched as logarithms are followed along their tangent, by such a share.
_SMALL = 1e-4


def taken_for(ladder: Ladder) -> str:
    """What one row of lateness would be taken for, in words; "" where it cannot be or is seen.

    Args:
        ladder: of any logs.
    """
    first, chosen = ladder.fitted[0], ladder.chosen
    if ladder.family.stimulus(first) is not first.signals.get(SETPOINT):
        return ""
    if all(agree(log) for log in ladder.fitted):
        return ""
    moved = moved_by(chosen.fit, ladder.fitted)
    named = []
    for estimate in chosen.knowledge.estimates:
        if not estimate.identified:
            continue  # what changes nothing that logs show is moved by anything
        more = moved[estimate.name]
        if abs(more) > max(0.5 * (estimate.high - estimate.low), _NAMED * abs(estimate.value)):
            unit = "" if estimate.unit == "1" else f" {estimate.unit}"
            side = "more" if more > 0.0 else "less"
            named.append(f"{abs(more):.2g}{unit} {side} {estimate.name}")
    if not named:
        return ""
    period = max(log.period for log in ladder.fitted)
    return (
        "if position and setpoint are written at the same instant, which these logs do not show: a"
        f" position written {1e3 * period:.3g} ms later would be taken for {', '.join(named)}"
    )


def moved_by(fit: Fit, logs: tuple[Log, ...]) -> dict[str, float]:
    """How far a position that is written a row later moves each unknown, to first order.

    Args:
        fit: solved.
        logs: that were fitted.

    Returns:
        By name, in the unknown's unit.
    """
    ends = np.cumsum(fit.problem.lengths)[:-1]
    simulated = fit.residuals + fit.problem.scale * np.concatenate(fit.problem.measured)
    each = zip(np.split(simulated, ends), logs, strict=True)
    # The residual of a position one row late is this much larger.
    later = np.concatenate([log.period * np.gradient(signal, log.time) for signal, log in each])
    size = np.maximum(np.linalg.norm(fit.slopes, axis=0), 1e-300)
    change = np.linalg.lstsq(fit.slopes / size, -later, rcond=1e-10)[0] / size
    before, after = fit.values, fit.problem.values(fit.point + _SMALL * change)
    return {name: (after[name] - before[name]) / _SMALL for name in before}
