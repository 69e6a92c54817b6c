"""The voltage behind a drive: its gain goes with it, and it gives nothing where it is off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxact.errors import UserError
from jaxact.identification.log import Log

SUPPLY, _POWERED, USUAL = "supply", "powered", "usual_supply"


def usual_supply(logs: Sequence[Log]) -> float:
    """The voltage at which a drive has its gain [V]: the logs' median, where none is stated.

    Args:
        logs: to be fitted, of which at least one has the supply's voltage.

    Raises:
        UserError: they state several.
    """
    stated = {log.details[USUAL]: log.title for log in logs if USUAL in log.details}
    if len(stated) > 1:
        said = " and ".join(f"{volts:g} V in {title}" for volts, title in stated.items())
        raise UserError(f"{USUAL}: {said}; a drive has its gain at one voltage, state that")
    recorded = [log[SUPPLY] for log in logs if SUPPLY in log]
    return next(iter(stated), None) or float(np.median(np.concatenate(recorded)))


def strength(log: Log, logs: Sequence[Log]) -> np.ndarray:
    """What a drive gives over what it gives at its usual voltage [-], shape (rows,); 0 where off.

    Args:
        log: any.
        logs: that are fitted, whose usual voltage counts.
    """
    found = np.ones(len(log))
    if SUPPLY in log:
        usual = usual_supply(logs if any(SUPPLY in one for one in logs) else [*logs, log])
        found = log[SUPPLY] / usual
    return found * log[_POWERED] if _POWERED in log else found


def document(logs: Sequence[Log]) -> dict[str, float]:
    """The usual voltage as a drive's file has it; nothing where no log has a supply's voltage."""
    return {USUAL: usual_supply(logs)} if any(SUPPLY in log for log in logs) else {}
