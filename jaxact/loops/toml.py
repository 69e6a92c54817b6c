"""TOML: reading it as a user's file, and writing just what a specification can hold."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxact.errors import UserError

_LARGEST_FILE = 500_000
_BARE = re.compile(r"[A-Za-z0-9_-]+")


def read(path: Path) -> dict[str, Any]:
    """The document in a file of a specification.

    Raises:
        UserError: there is no such file, or it is not TOML.
    """
    try:
        if not path.exists():
            raise UserError("no such file; give the path of a TOML specification")
        if not path.is_file():
            raise UserError("is not a file; give the path of a TOML specification")
        if path.stat().st_size > _LARGEST_FILE:
            raise UserError(f"is larger than {_LARGEST_FILE:,} bytes; is it a TOML specification?")
        # Some editors begin a file with a byte order mark.
        return loads(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError:
        raise UserError("is not UTF-8 text; give the path of a TOML specification") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"cannot be read ({reason})") from None


def loads(text: str) -> dict[str, Any]:
    """The document that TOML text is; raises UserError where it is none."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        # ValueError: TOMLDecodeError, and integers of more digits than Python converts
        reason = str(error) if isinstance(error, ValueError) else "nested too deeply"
        raise UserError(f"is not valid TOML: {reason[:200]}") from None


def dumps(document: Mapping[str, Any]) -> str:
    """A document as TOML text, its top-level tables as sections.

    Args:
        document: strings, numbers, booleans, lists and tables by name.
    """
    plain = [
        f"{_key(name)} = {_value(value)}"
        for name, value in document.items()
        if not isinstance(value, Mapping)
    ]
    sections = [
        "\n".join([f"[{_key(name)}]", *(f"{_key(k)} = {_value(v)}" for k, v in table.items())])
        for name, table in document.items()
        if isinstance(table, Mapping)
    ]
    return "\n\n".join(["\n".join(plain), *sections] if plain else sections) + "\n"


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else _string(name)


def _string(text: str) -> str:
    # JSON's escapes are TOML's, but for the delete character, which TOML wants escaped as well
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_key(name)} = {_value(item)}" for name, item in value.items())
        return f"{{ {inside} }}" if inside else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(item) for item in value)}]"
    return repr(value)
