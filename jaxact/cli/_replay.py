"""`jaxact simulate --replay`: an identified drive over the log of a real one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from jaxact.cli import _arguments, _files
from jaxact.cli._arguments import option, typed
from jaxact.errors import UserError
from jaxact.loops.drives import DRIVE


@dataclass(frozen=True)
class Recorded:
    """A log that an identified drive is held against."""

    replay: Annotated[
        Path | None,
        option(
            "LOG",
            "CSV or NPZ: with --drive, simulate that drive on the log's own time stamps and compare"
            " with what was measured.",
            "none",
        ),
    ] = None
    map: Annotated[
        Path | None, option("TOML", "What the columns of the log are, as for `identify`.", "none")
    ] = None


def check(recorded: Recorded, given: Mapping[str, Any], unfit: Mapping[str, Any]) -> None:
    """That nothing was given that a replay would ignore, and a drive was.

    Args:
        recorded: options of the log.
        given: parameters that were given.
        unfit: other options by name, that a replay does not have.

    Raises:
        UserError: otherwise, naming the option.
    """
    if recorded.replay is None:
        if recorded.map is not None:
            raise UserError("--map: says what the columns of a log are; give one with --replay")
        return
    if DRIVE not in given:
        raise UserError("--replay: needs an identified drive; give one with --drive")
    for name, value in unfit.items():
        if _arguments.is_given(value) and value != ():
            raise UserError(
                f"{typed(name)}: is not for --replay, where the log says it; leave it out"
            )


def run(
    recorded: Recorded, given: Mapping[str, Any], joint: str, model: Path | None, out: Path,
    csv: Path | None, *, as_json: bool,
) -> None:  # fmt: skip
    """Simulate, write the picture and the columns, and print the errors.

    Args:
        recorded: options of the log.
        given: parameters that were given, the drive among them.
        joint: of several in the log, "" for the only one.
        model: of the robot whose drives they are, None for a single joint.
        out: picture.
        csv: file of the columns, None for none.
        as_json: print one JSON object.
    """
    from jaxact.plotting import theme
    from jaxact.verbs.identify import replay, replay_sheet

    assert recorded.replay is not None
    changes = {name: value for name, value in given.items() if name not in (DRIVE, "unit")}
    found = replay(given[DRIVE], recorded.replay, columns=recorded.map, joint=joint, model=model,
                   **changes)  # fmt: skip
    theme.write(replay_sheet(found), out, title="jaxact: a drive over a log")
    if csv is not None:
        import numpy as np

        columns = found.columns()
        table, header = np.column_stack(list(columns.values())), ",".join(columns)
        text = {"fmt": "%.9g", "delimiter": ",", "header": header, "comments": ""}
        _files.write(csv, lambda file: np.savetxt(file, table, **text))
    if as_json:
        print(json.dumps(found.document()))
        return
    print(found)
    print("wrote " + ", ".join(str(path) for path in (out, csv) if path is not None))
