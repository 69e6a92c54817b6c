"""Reading logs: CSV or NPZ, with a small TOML that says what its columns are.

    time = "t_s"
    unit = "rad"                 # of the joint: "rad" or "m"
    stamp = "end"                # what of a control tick a row's time is: "start" or "end"
    position = "pos_meas1"
    command = { column = "command_V", scale = 35.15, offset = 0.0 }   # scaled to N or N m
    kp = 400.0                   # of the controller, or "unknown"
    kd = "unknown"

Several joints in one file each have a table `[joints.NAME]`; what stands outside is for all. Where
only names differ, `joints = ["hip", "knee"]` and `position = "q_{joint}"` say the same. What
differs between files stands in tables `[files."PATTERN"]`, such as the gain of each recording.
"""

from __future__ import annotations

import csv
import fnmatch
import math
import re
import tomllib
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any, Literal, TextIO

import numpy as np
from pydantic import ConfigDict, ValidationError
from pydantic.dataclasses import dataclass

from jaxact.errors import UserError, nearest, shown
from jaxact.identification.log import SIGNALS, Log, check
from jaxact.parameters import MASS

_STRICT = ConfigDict(extra="forbid")
_TIMES = ("time", "t", "t_s", "time_s", "timestamp")
_UNITS_OF_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# Details of a joint that are more than zero.
_POSITIVE = (MASS, "length", "inertia", "command_limit", "usual_supply")
_UNREADABLE = {
    ".pkl": "a pickle can run code when it is read; write its arrays with numpy.savez",
    ".pickle": "a pickle can run code when it is read; write its arrays with numpy.savez",
    ".pt": "a PyTorch file can run code when it is read; write its arrays with numpy.savez",
    ".pth": "a PyTorch file can run code when it is read; write its arrays with numpy.savez",
    ".npy": "a single array has no names of columns; write it with numpy.savez, name by name",
    ".mat": "write its arrays with scipy.io.loadmat and numpy.savez",
    ".bag": "write its topics as CSV",
    ".mcap": "write its topics as CSV",
    ".parquet": "write it as CSV with pandas",
}


@dataclass(frozen=True, config=_STRICT)
class Column:
    """A column, and how its numbers become SI units: ``scale * number + offset``."""

    column: str
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, config=_STRICT)
class Columns:
    """What the columns of a file are for one joint; a TOML table."""

    time: str | None = None
    time_unit: Literal["s", "ms", "us", "ns"] = "s"
    unit: Literal["rad", "m"] = "rad"
    stamp: Literal["start", "end"] = "start"
    setpoint: str | Column | None = None
    position: str | Column | None = None
    velocity: str | Column | None = None
    command: str | Column | None = None
    force: str | Column | None = None
    feedforward: str | Column | None = None
    supply: str | Column | None = None
    powered: str | Column | None = None
    kp: float | Literal["unknown"] = "unknown"
    kd: float | Literal["unknown"] = "unknown"
    difference_ticks: int = 0
    details: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ColumnMap:
    """What the columns of files are.

    Attributes:
        joints: by the joint's name, "" where there is one without a name.
        files: patterns of file names -> what is different in them.
    """

    joints: dict[str, dict[str, Any]]
    files: dict[str, dict[str, Any]] = field(default_factory=dict)

    def of(self, path: Path) -> dict[str, Columns]:
        """The columns of one file, by joint.

        Raises:
            UserError: something in them is not known.
        """
        own: dict[str, Any] = {}
        for pattern, table in self.files.items():
            if fnmatch.fnmatch(path.name, pattern):
                own = _with(own, table)
        return {name: _columns(_with(table, own)) for name, table in self.joints.items()}


def read_columns(path: Path) -> ColumnMap:
    """What the columns are, from a TOML file.

    Raises:
        UserError: it cannot be read, or names something unknown.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UserError(f"{path}: is not TOML ({error})") from None
    joints, files = document.pop("joints", {"": {}}), document.pop("files", {})
    if isinstance(joints, list) and all(isinstance(name, str) for name in joints) and joints:
        joints = {name: _spelt(document, name) for name in joints}
    for name, tables in (("joints", joints), ("files", files)):
        if not isinstance(tables, dict) or not all(isinstance(t, dict) for t in tables.values()):
            raise UserError(f"{path}: {name} must be tables [{name}.NAME]")
    found = ColumnMap({name: _with(document, own) for name, own in joints.items()}, files)
    try:
        for pattern in ("", *files):
            found.of(Path(pattern))
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    return found


def _with(table: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """A table of a map with what is different, detail by detail."""
    both = [each.get("details", {}) for each in (table, own)]
    merged = all(isinstance(one, dict) for one in both) and any(both)
    return {**table, **own, **({"details": both[0] | both[1]} if merged else {})}


def _spelt(table: Mapping[str, Any], joint: str) -> dict[str, Any]:
    """What stands for all joints, with the name of one for {joint} in the names of columns."""

    def one(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: one(inner) for key, inner in value.items()}
        return value.replace("{joint}", joint) if isinstance(value, str) else value

    return {key: one(value) for key, value in table.items()}


def _columns(table: Mapping[str, Any]) -> Columns:
    known = tuple(Columns.__dataclass_fields__)
    for name in table:
        if name not in known:
            raise UserError(f"{name} is not known; {nearest(name, known)}")
    try:
        found = Columns(**table)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"] if isinstance(part, str))
        raise UserError(f"{where}: {first['msg'].lower()}") from None
    _check_numbers(found)
    return found


def _check_numbers(columns: Columns) -> None:
    """That the numbers of a map can be what they are said to be.

    Raises:
        UserError: one cannot.
    """
    for name in ("kp", "kd", "difference_ticks"):
        value = getattr(columns, name)
        if value != "unknown" and not 0.0 <= value < math.inf:
            raise UserError(f"{name} = {value:g} must be 0 or more, and finite")
    for name, value in columns.details.items():
        if not math.isfinite(value) or (name in _POSITIVE and value <= 0.0):
            more = ", and more than 0" if name in _POSITIVE else ""
            raise UserError(f"details: {name} = {value:g} must be finite{more}")


def read(
    path: Path, columns: ColumnMap | Mapping[str, Columns] | None = None, joints: Sequence[str] = ()
) -> list[Log]:
    """The logs in a file, one for each joint.

    Args:
        path: CSV with a head, or NPZ of arrays by name.
        columns: from `read_columns`; None where the columns have the names of the signals.
        joints: those to take; all where none is named.

    Raises:
        UserError: the file cannot be read, a column is missing, or the log cannot be used.
    """
    table = _table(path)
    if columns is None:
        columns = {"": _guessed(path, table)}
    elif isinstance(columns, ColumnMap):
        columns = columns.of(path)
    for name in joints:
        if name not in columns:
            raise UserError(f"joint {shown(name)} is not in the map; {nearest(name, columns)}")
    chosen = {name: own for name, own in columns.items() if not joints or name in joints}
    return [_log(path, table, name, own) for name, own in chosen.items()]


def _table(path: Path) -> dict[str, np.ndarray]:
    if not path.is_file():
        raise UserError(f"{path}: no such file; give a CSV or NPZ log")
    suffix = path.suffix.lower()
    if suffix in _UNREADABLE:
        raise UserError(f"{path}: {suffix} cannot be read safely or simply: {_UNREADABLE[suffix]}")
    if suffix == ".npz":
        return _npz(path)
    return _csv(path)


def _npz(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as arrays:
            found = {name: np.asarray(arrays[name]) for name in arrays.files}
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise UserError(
            f"{path}: cannot be read ({error}); write plain arrays with numpy.savez"
        ) from None
    columns: dict[str, np.ndarray] = {}
    for name, array in found.items():
        if array.dtype.kind not in "fiub":
            raise UserError(f"{path}: {name} is not an array of numbers")
        if array.ndim == 1:
            columns[name] = array.astype(float)
        elif array.ndim == 2:
            columns |= {f"{name}[{at}]": array[:, at].astype(float) for at in range(array.shape[1])}
    lengths = {len(array) for array in columns.values()}
    if len(lengths) > 1:
        said = ", ".join(f"{name} {len(array)}" for name, array in list(columns.items())[:6])
        raise UserError(f"{path}: its arrays have different lengths: {said}")
    if not columns:
        raise UserError(f"{path}: has no arrays of one or two dimensions")
    return columns


def _csv(path: Path) -> dict[str, np.ndarray]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            first, more = _head(file)
            separator = max(",;\t", key=first.count)
            head = [name.strip() for name in next(csv.reader([first], delimiter=separator), [])]
            rows = [row for row in csv.reader([*more, *file], delimiter=separator) if row]
    except (UnicodeDecodeError, csv.Error):
        raise UserError(f"{path}: is not text; give a CSV or NPZ log") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from None
    if len(head) == 1 and len(first.split()) > 1:
        raise UserError(f"{path}: columns are separated by ',', ';' or a tab; its head has none")
    twice = next((name for name in head if name and head.count(name) > 1), None)
    if twice:
        raise UserError(f"{path}: has several columns {shown(twice)}; give each a name of its own")
    if not head or not rows:
        raise UserError(f"{path}: is empty; give a CSV with a head and a row for each instant")
    for number, row in enumerate(rows):
        if len(row) != len(head):
            raise UserError(
                f"{path}: row {number + 2} has {len(row)} values, the head {len(head)} names"
            )
    texts = dict(zip(head, zip(*rows, strict=True), strict=True))
    return {name: _numbers(values, separator != ",") for name, values in texts.items()}


def _head(file: TextIO) -> tuple[str, list[str]]:
    """The line of names, behind lines of comment, and a line of numbers that was read with it.

    Where no names follow the comment, its last line has them, as numpy.savetxt writes them.
    """
    comment, first = "", file.readline()
    while first.lstrip().startswith("#"):
        comment, first = first.lstrip(" \t#"), file.readline()
    texts = [text.strip() for text in re.split(r"[,;\t]", first)]
    numbers = (
        bool(comment.strip()) and not np.isnan([_number(t.replace(",", ".")) for t in texts]).all()
    )
    return (comment, [first]) if numbers else (first, [])


def _numbers(texts: Sequence[str], comma: bool) -> np.ndarray:
    """The numbers in a column, NaN where there is none; `comma`: of decimals."""
    if comma:
        texts = [text.replace(",", ".") for text in texts]
    try:
        return np.array(texts, float)
    except ValueError:
        return np.array([_number(text) for text in texts])


def _number(text: str) -> float:
    words = {"true": 1.0, "false": 0.0}
    try:
        return float(text)
    except ValueError:
        return words.get(text.strip().lower(), float("nan"))


def _guessed(path: Path, table: Mapping[str, np.ndarray]) -> Columns:
    """The columns where they have the names of the signals already."""
    time = next((name for name in _TIMES if name in table), None)
    own: dict[str, Any] = {name: name for name in SIGNALS if name in table}
    if time is None or not own:
        raise UserError(
            f"{path}: its columns {', '.join(list(table)[:8])} are not known by these names; give"
            " `columns`, a TOML file that says which is which"
        )
    return Columns(time=time, **own)


def _log(path: Path, table: Mapping[str, np.ndarray], joint: str, columns: Columns) -> Log:
    """The log of one joint, checked."""

    def taken(said: str | Column, role: str) -> np.ndarray:
        own = Column(said) if isinstance(said, str) else said
        if own.column not in table:
            raise UserError(
                f"{path}: {role}: there is no column {shown(own.column)};"
                f" {nearest(own.column, list(table)[:30])}"
            )
        return own.scale * table[own.column] + own.offset

    named = columns.time or next((name for name in _TIMES if name in table), "time")
    time = _UNITS_OF_TIME[columns.time_unit] * taken(named, "time")
    signals = {
        name: taken(said, name) for name in SIGNALS if (said := getattr(columns, name)) is not None
    }
    gains = tuple(None if g == "unknown" else float(g) for g in (columns.kp, columns.kd))
    log = Log(
        name=path.name, time=time, signals=signals, joint=joint, unit=columns.unit,
        stamp=columns.stamp, gains=(gains[0], gains[1]),
        difference_ticks=columns.difference_ticks, details=columns.details,
    )  # fmt: skip
    check(log)
    return log
