"""Reports that verbs write beside their results."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Any


def check_output(path: Path) -> None:
    """Raise UserError if a report cannot be written there."""
    from jaxact.verbs.report import check_output

    check_output(path)


def write(subject: Any, path: Path, title: str = "") -> None:
    """Write the report of a result, with the command that made it, and say so."""
    from jaxact.verbs.report import report

    report(subject, path, title=title, command=shlex.join(["jaxact", *sys.argv[1:]]))
    print(f"wrote {path}")
