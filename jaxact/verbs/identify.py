"""Identifying a drive from logs, and drawing what came out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxact.identification.identify import identify
from jaxact.identification.model import predicted
from jaxact.identification.replay import Replay, replay
from jaxact.identification.result import Identified
from jaxact.plotting import identification as _pictures
from jaxact.plotting.identification import Compared, Step

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["identification_sheet", "identify", "replay", "replay_sheet"]


def identification_sheet(identified: Identified, *, title: str = "", log: int = 0) -> Figure:
    """Measured and simulated, residual, frequency response, ladder and autocorrelation.

    Args:
        identified: from `jaxact.identify`.
        title: above; the verdict by default.
        log: number of the validation log that is drawn.

    Returns:
        The figure.
    """
    ladder = identified.ladder
    footer = "; ".join(log.title for log in ladder.fitted)
    return _pictures.sheet(
        compared(identified, log),
        steps(identified),
        title=title or f"{identified.verdict.level.value}: {ladder.chosen.rung.name}",
        footer=f"{identified.verdict.sentence}. Fitted: {footer}",
    )


def compared(identified: Identified, log: int = 0) -> Compared:
    """One validation log and what the chosen model makes of it."""
    ladder = identified.ladder
    chosen = ladder.validation[log]
    return Compared(
        title=f"{chosen.title}, which was not fitted",
        time=chosen.time,
        stimulus=ladder.family.stimulus(chosen),
        measured=ladder.family.measured(chosen),
        simulated=predicted(ladder.family, chosen, ladder.chosen.numbers),
        signal=ladder.family.signal,
        unit=ladder.family.unit,
    )


def replay_sheet(replayed: Replay, *, title: str = "") -> Figure:
    """Measured and simulated over each other, and the residual.

    Args:
        replayed: from `jaxact.replay`.
        title: above; drive and log by default.

    Returns:
        The figure.
    """
    log = replayed.log
    drawn = Compared(
        title="", time=log.time, stimulus=replayed.stimulus, measured=replayed.measured,
        simulated=replayed.simulated, signal=replayed.signal, unit=replayed.unit,
    )  # fmt: skip
    return _pictures.replay(
        drawn,
        title=title or f"{log.title} by {replayed.drive}",
        footer=f"rms error {replayed.rms:.3g} {replayed.unit}, {100.0 * replayed.nrmse:.3g} % of"
        f" the standard deviation; largest {replayed.largest:.3g} {replayed.unit}",
    )


def steps(identified: Identified) -> list[Step]:
    """The ladder as it is drawn."""
    ladder = identified.ladder
    return [
        Step(
            name=one.rung.name,
            size=one.size,
            error=one.error,
            identified=one.knowledge.identified,
            chosen=one is ladder.chosen,
        )
        for one in ladder.candidates
    ]
