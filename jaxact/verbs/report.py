"""`jaxact.report`: a loop, a robot, a sweep or a tuning as one HTML file that one can click."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import platform
import tomllib
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jaxact import __version__, files
from jaxact.errors import UserError
from jaxact.loops import drives
from jaxact.loops.control_loop import ControlLoop
from jaxact.parameters import KD, KP
from jaxact.reportable import Report
from jaxact.reports import page
from jaxact.verbs import report_joint

# In a folder of `jaxact tune`.
GAINS = "gains.toml"


def report(
    subject: Any, out: str | os.PathLike[str] = "report.html", *, title: str = "",
    command: str = "",
) -> Report:  # fmt: skip
    """Write a report of a loop: a stability map that one can click, and all that follows from it.

        jaxact.report(jaxact.joint(actuator="starleth", delay=5e-3), "joint.html")

    The file needs nothing else, and no network: the exact boundary, margins, growth rates,
    frequency and step responses are computed in the page, for any gains, actuator, delay and rate.
    Of a robot, linearised: margins of all joints for any factor on gains, of groups of joints too,
    delay, actuators and several control rates, and the joints that shake first.

    Args:
        subject: a joint's or a robot's loop or loops, their margins, a sweep, what
            `jaxact.simulate` gave, a tuned result or what `jaxact.identify` found; or the path of a
            robot's model, of the results of a sweep or a tuning, of an identified drive, or of a
            TOML file that describes or lists loops.
        out: HTML file to write; one that is there is replaced.
        title: above the page, "" for what the specification says.
        command: that made it, to be shown.

    Returns:
        Where it is; as the last line of a notebook's cell, the page itself.

    Raises:
        UserError: too many loops, a robot that cannot be used, or a place that cannot be read or
            written.
    """
    path = Path(out)
    check_output(path)
    found = _content(subject)
    made = {"Command": command} if command else {}
    made |= {"Versions": _versions(), **found.made}
    text = page.document(dataclasses.replace(found, title=title or found.title, made=made))
    with files.output(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return Report(path, text)


def check_output(path: Path) -> None:
    """Raise UserError if a report cannot be written there."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"output {path}: a report is an .html file")
    files.check_output(path)


# Files that are of a robot.
_MODELS = (".xml", ".urdf", ".mjcf")


def _is_robot(subject: Any) -> bool:
    """Whether it is a robot, its margins, its tuning, or what describes it."""
    if isinstance(subject, ControlLoop):
        return subject.kind.plant is not None
    if isinstance(subject, str | os.PathLike):
        path = Path(subject)
        described = path.suffix == ".toml" and path.is_file()
        text = path.read_text(encoding="utf-8-sig", errors="replace") if described else ""
        return path.suffix.lower() in _MODELS or _has_plant(text)
    text = getattr(subject, "attrs", {}).get("specification_toml", "")
    own = hasattr(subject, "of_joints") or getattr(subject, "robot", None) is not None
    return own or _has_plant(text)


def _has_plant(text: str) -> bool:
    """Whether a specification is of a robot; what is not TOML is refused by who reads it."""
    try:
        return "plant" in tomllib.loads(text)
    except (ValueError, RecursionError):
        return False


def _content(subject: Any) -> page.Content:
    """The page of whatever a report can be of; only what it is of is imported."""
    made_by = type(subject).__module__.split(".")[1:2]
    tuned = drive = None
    if isinstance(subject, str | os.PathLike):
        path = Path(subject)
        drive = path if drives.is_drive(path) else None
        tuned = None if drive else tuned_file(path)
    if made_by == ["identification"] or drive is not None:
        from jaxact.verbs import report_identified as identified

        if drive is None:
            return identified.content(subject)
        with _whole(drive):
            return identified.of_file(drive)
    if hasattr(subject, "data_vars") and "time" in subject.dims:
        from jaxact.verbs import report_run

        return report_run.content(subject)
    if tuned is None and _is_robot(subject):
        from jaxact.verbs import report_robot

        return report_robot.content(*report_robot.robot_of(subject))
    if made_by == ["tuning"] or tuned is not None:
        from jaxact.verbs import report_tuned

        if tuned is None:
            return report_tuned.content(subject)
        with _whole(tuned[0]):
            return report_tuned.of_file(*tuned)
    return report_joint.content(subject)


@contextlib.contextmanager
def _whole(path: Path) -> Iterator[None]:
    """Raise UserError where a file that a person may have changed lacks what it should have."""
    try:
        yield
    except UserError:
        raise
    except KeyError as error:
        raise UserError(
            f"{path}: lacks {error}: it is damaged, or of another version; make it anew"
        ) from None
    except (AttributeError, TypeError, ValueError) as error:
        kind = type(error).__name__
        raise UserError(f"{path}: is damaged ({kind}: {error}); make it anew") from None


def tuned_file(path: Path) -> tuple[Path, Mapping[str, Any]] | None:
    """The file of tuned gains that a path means and what it says; None where it means none.

    Raises:
        UserError: that of a folder cannot be read, or is no TOML.
    """
    own = path / GAINS if path.is_dir() else path
    if own.suffix != ".toml" or not own.is_file():
        return None
    try:
        document = tomllib.loads(own.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        if own != path:
            raise UserError(f"{own}: is damaged ({error}); make it anew") from None
        return None
    meant = own != path or {"gains", "assumed"} <= document.keys() or {KP, KD} <= document.keys()
    return (own, document) if meant else None


def _versions() -> str:
    known = {"jaxact": __version__, "jax": version("jax"), "Python": platform.python_version()}
    return ", ".join(f"{name} {number}" for name, number in known.items())
