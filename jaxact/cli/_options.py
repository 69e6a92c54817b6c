"""Reading options with tyro: a verb's function in, one call of it out, mistakes as one line."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import functools
import importlib
import inspect
import io
import re
import typing
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from jaxact.errors import UserError, nearest, shown

_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_SIDES = "│┃|"
# Options that are called otherwise than the library's parameter.
_OTHERWISE = {
    "front": "pareto", "columns": "map", "goal": "objective", "samples": "ensemble",
}  # fmt: skip
_RULE = re.compile(r"[─━═_-]{8,}")


def choose(what: str, given: str, known: Iterable[str]) -> str:
    """The name given, if it is a known one; raises UserError with the nearest otherwise."""
    names = list(known)
    if given not in names:
        raise UserError(f"unknown {what} {shown(given)}; {nearest(given, names)}")
    return given


def main_of(verb: str) -> Callable[..., None]:
    """The function of a verb."""
    found: Callable[..., None] = importlib.import_module(f"jaxact.cli.{verb}").main
    return found


def typed(text: str, verb: str) -> str:
    """Parameters in backquotes, as the library names them, as options of a verb.

    A `name` becomes --name, a `name="value"` --name value; of what is not an option, the second
    becomes --set name=value, or --set plant.name=value, as TOML writes it.
    """
    from jaxact.cli._arguments import CHOICES

    names = _names(verb)

    def replaced(found: re.Match[str]) -> str:
        name, value = found.groups()
        option = name if name in names else _OTHERWISE.get(name, name)
        value = value.lower() if value in ("True", "False") else value
        if option in names:
            return "--" + option.replace("_", "-") + (f" {value}" if value else "")
        table = "plant." if name in CHOICES else ""
        return f"--set {table}{name}={value}" if value else found[0]

    return re.sub(r"`([a-z_]+)(?:=\"?([\w.-]+)\"?)?`", replaced, text)


@functools.cache
def _names(verb: str) -> set[str]:
    """Names of a verb's options; nothing of a verb that there is not."""
    try:
        hints = typing.get_type_hints(main_of(verb))
    except (ModuleNotFoundError, ValueError):
        return set()
    names = set()
    for name, kind in hints.items():
        grouped = dataclasses.is_dataclass(kind)
        names |= {field.name for field in dataclasses.fields(kind)} if grouped else {name}
    return names


def read(
    function: Callable[..., None], program: str, arguments: Sequence[str]
) -> Callable[[], None]:
    """A verb's function with the options given on the command line, ready to be called.

    Args:
        function: typed arguments are the options, the docstring is the help.
        program: shown in the help, e.g. `jaxact sweep`.
        arguments: what follows the verb.

    Raises:
        UserError: options that cannot be read, SystemExit(0) after `--help`.
    """
    import tyro

    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            ready: Callable[[], None] = tyro.cli(
                _deferred(function),
                prog=program,
                description=inspect.getdoc(function),
                args=list(arguments),
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes),
            )
    except SystemExit as leaving:
        if leaving.code in (None, 0):
            raise
        raise UserError(f"{_condensed(complaint.getvalue())}; see `{program} --help`") from None
    return ready


def _deferred(function: Callable[..., None]) -> Callable[..., Callable[[], None]]:
    # tyro calls what it parses for; the verb itself must run outside the capture of its messages
    @functools.wraps(function)
    def collect(*positional: Any, **named: Any) -> Callable[[], None]:
        return functools.partial(function, *positional, **named)

    return collect


def _condensed(boxed: str) -> str:
    """What tyro's box says, without the box, the help text and the pointer to `--help`."""
    sections: list[list[str]] = [[]]
    lines = _COLOUR.sub("", boxed).splitlines()
    # Where the output is not UTF-8 the box has no sides, and a title above a rule.
    inside = [line for line in lines if line.lstrip()[:1] in tuple(_SIDES)] or lines[2:]
    for line in inside:
        text = line.strip().strip(_SIDES).strip()
        if _RULE.fullmatch(text):
            sections.append([])
        elif text:
            sections[-1].append(text)
    said = " ".join(sections[0]) or "options that cannot be read"
    said = said[0].lower() + said[1:]
    hint = sections[1] if len(sections) > 1 else []
    if hint and hint[0].startswith("Perhaps you meant") and len(hint) > 1:
        said += f"; did you mean `{_of_long_name(said) or hint[1]}`?"
    return said


def _of_long_name(said: str) -> str:
    """The option of a parameter whose long name was written as one, "" where none was."""
    from jaxact.parameters import ALIASES, PARAMETERS

    written = re.search(r"--([a-z-]+)", said)
    word = written[1].replace("-", "_") if written else ""
    close = difflib.get_close_matches(word, [*PARAMETERS, *ALIASES], n=1, cutoff=0.8)
    return f"--{ALIASES[close[0]].replace('_', '-')}" if close and close[0] in ALIASES else ""
