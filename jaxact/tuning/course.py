"""How a search goes on: told to whoever looks on, and kept for whoever interrupts it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

NOTHING = "interrupted; no gains were certified yet, nothing is kept"
"""Said where an interrupted search has nothing to show."""


class Told(Protocol):
    """Told what begins or goes on now, in one short text."""

    def __call__(self, text: str, done: int = 0, total: int = 0) -> None:
        """Parts of it that are done, and how many there are at most; 0 where that is not known."""


def silent(text: str, done: int = 0, total: int = 0) -> None:
    """Tell nobody."""


INTERRUPTED = "interrupted"
"""How a text begins that tells of the end of an interrupted search; nothing comes after it."""


def ahead(told: Told, phases: Sequence[str]) -> Told:
    """Tells also what is to come, as nobody knows beforehand how long a search will take.

    Args:
        told: told "descending, then polishing, certifying".
        phases: how the texts of the whole begin, in order; one that begins otherwise belongs to
            the phase before it.
    """
    place = -1

    def tell(text: str, done: int = 0, total: int = 0) -> None:
        nonlocal place
        here = [at for at, phase in enumerate(phases) if text.startswith(phase)]
        place = max(here, key=lambda at: len(phases[at]), default=place)
        coming = () if text.startswith(INTERRUPTED) else phases[place + 1 :]
        told(f"{text}, then {', '.join(coming)}" if coming else text, done, total)

    return tell


@dataclass
class Course:
    """Where a search is.

    Attributes:
        told: who looks on.
        doing: what is being done.
        case: what the gains are for, None before that is known.
        points: what has been found, as the search has it.
        best: the end of the search, None before it.
    """

    told: Told = silent
    doing: str = "starting"
    case: Any = None
    points: list[Any] = field(default_factory=list)
    best: Any = None

    def phase(self, text: str, done: int = 0, total: int = 0) -> None:
        """Tell what begins or goes on now."""
        self.doing = text
        self.told(text, done, total)

    def note(self, *, inside: bool) -> str:
        """What to say of a search that was interrupted.

        Args:
            inside: whether the worst interior point of the box was looked for, or there is none.
        """
        left = "" if inside else "; the worst interior point was not looked for"
        return f"interrupted while {self.doing}: the best gains that were found until then{left}"
