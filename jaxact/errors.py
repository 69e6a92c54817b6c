"""The one exception for mistakes a user can mend, and the words it uses for a misspelt name."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InexactWarning(UserWarning):
    """A result that is computed nevertheless, with something in it that is not exact.

    The command line prints it as `jaxact: warning: <message>`.
    """


class GainsWarning(UserWarning):
    """A file of gains names joints that the robot has not: a misspelt name, or another robot's.

    The command line says it with all else that is not taken from the file.
    """


class UserError(Exception):
    """A mistake in what the user gave: says in one line what, where, and what to do.

    The command line prints it as `jaxact: <message>` and ends with exit code 2; from Python it is
    raised like any other exception.
    """


def nearest(given: object, known: Iterable[str], also: Iterable[str] = ()) -> str:
    """`did you mean 'zeta'? allowed: kp, kd, ...`: what to write instead of an unknown name.

    Args:
        given: what was written.
        known: the names that are allowed.
        also: others that are allowed too, and named only where one of them is meant.
    """
    names = list(known)
    close = difflib.get_close_matches(str(given).casefold(), [*names, *also], n=1, cutoff=0.5)
    hint = f"did you mean '{close[0]}'? " if close else ""
    return f"{hint}allowed: {', '.join(names)}"


def shown(value: object, longest: int = 60) -> str:
    """A value as it is quoted in a message: on one line, printable, cut where it is long."""
    text = repr(value) if isinstance(value, str) else " ".join(str(value).split())
    text = "".join(letter if letter.isprintable() else "?" for letter in text)
    return text if len(text) <= longest else text[: longest - 3] + "..."
