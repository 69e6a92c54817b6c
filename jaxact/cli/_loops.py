"""The options that say which loops are meant, shared by every verb that works on single loops."""

from __future__ import annotations

import dataclasses
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from jaxact.cli import _warnings
from jaxact.errors import UserError, nearest, shown
from jaxact.loops import reading, toml
from jaxact.loops.axes import MOST_SAMPLES
from jaxact.loops.checks import check_history, shortest_duration
from jaxact.loops.samples import expand
from jaxact.loops.specification import Specification
from jaxact.parameters import PARAMETERS, PRESETS, canonical, check, check_actuator
from jaxact.verbs import naming
from jaxact.verbs.naming import Loops, loop_name

# What the stability of a linear loop depends on.
LINEAR = (
    "kp", "kd", "mass", "wn", "zeta", "delay", "measurement_delay", "output_delay",
    "velocity_filter",
)  # fmt: skip
# Default of a number that was not given; told from any number by being this very object. A type
# with None in it would make tyro's complaint about a mistyped number unreadable.
UNSET = float("nan")
UNSET_NUMBER = -(10**30)
UNSET_NAME = "\0"
# An axis that varies nothing: a specification must have one.
_NO_AXIS = {"feedforward": [0.0]}


def _option(name: str, *, several: bool) -> tuple[str, Any, Any]:
    parameter = PARAMETERS[name]
    unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
    default = f"(default: {parameter.default:g})"
    if several and name == "control_rate":
        default = "(default: continuous time only)"
    conf = arg(
        name=name.replace("_", "-"),
        metavar="VALUE ..." if several else "VALUE",
        help=f"{parameter.description[:-1]}{unit}.",
        help_behavior_hint=default,
    )
    if several:
        return name, Annotated[tuple[float, ...], conf], dataclasses.field(default=(UNSET,))
    return name, Annotated[float, conf], dataclasses.field(default=UNSET)


def _actuator(*, several: bool) -> tuple[str, Any, Any]:
    conf = arg(
        metavar="NAME ..." if several else "NAME",
        help=f"Preset that sets wn and zeta: {', '.join(PRESETS)}.",
        help_behavior_hint="(default: none)",
    )
    if several:
        return (
            "actuator",
            Annotated[tuple[str, ...], conf],
            dataclasses.field(default=(UNSET_NAME,)),
        )
    return "actuator", Annotated[str | None, conf], dataclasses.field(default=None)


def options(names: Iterable[str], *, several: bool) -> type:
    """A dataclass with one option for each parameter named, and `actuator`.

    names: of parameters of the table
    several: each takes several values, none where it is not given; else one, or UNSET
    """
    fields = [_actuator(several=several), *(_option(name, several=several) for name in names)]
    return dataclasses.make_dataclass("Options", fields, frozen=True)


def given(chosen: Any) -> dict[str, Any]:
    """The options of such a dataclass that were given, by name.

    Raises UserError for one without any value.
    """
    values = {field.name: getattr(chosen, field.name) for field in dataclasses.fields(chosen)}
    for name, value in values.items():
        if value == ():
            raise UserError(f"{_typed(name)}: give at least one value")
    return {name: value for name, value in values.items() if is_given(value)}


def is_given(value: Any) -> bool:
    """Whether an option was given."""
    first = value[0] if isinstance(value, tuple) and value else value
    return first is not None and first is not UNSET and first not in (UNSET_NUMBER, UNSET_NAME)


def specified(document: Mapping[str, Any], overrides: Sequence[str] = ()) -> Specification:
    """The checked specification of options on the command line: their messages name the option.

    document: as in a file; what is None is left out
    overrides: `key=value` each, applied over it
    """
    axes = dict(document.get("axes", {})) or _NO_AXIS
    present = {name: value for name, value in document.items() if value is not None}
    try:
        return reading.parse(toml.dumps({**present, "axes": axes}), overrides=overrides)
    except UserError as error:
        said = re.sub(r"\b(?:parameters|axes)\.(\w+)", lambda found: _typed(found[1]), str(error))
        raise UserError(said) from None


def _typed(name: str) -> str:
    """The option of a parameter, as it is typed."""
    return "--" + name.replace("_", "-")


def nominal_of(path: Path, overrides: Sequence[str] = ()) -> Specification:
    """A specification file with its fixed values; what it varies is left at its nominal value.

    path: TOML file, as for `jaxact sweep`
    overrides: `key=value` each
    """
    return reading.load(path, [*overrides, "axes.feedforward=[0.0]"])


def combinations(chosen: Mapping[str, Any], **document: Any) -> Loops:
    """Every combination of the values of the options.

    chosen: parameter (or actuator) -> its values
    document: further keys of a specification
    """
    fixed = {name: values[0] for name, values in chosen.items() if len(values) == 1}
    varied = {name: list(values) for name, values in chosen.items() if len(values) > 1}
    return expanded(specified({**document, "parameters": fixed, "axes": varied}))


def linear_combinations(chosen: Mapping[str, Any], **document: Any) -> Loops:
    """As `combinations`, of loops that are not going to be simulated: for any control rate."""
    rates = [rate for rate in chosen.get("control_rate", ()) if rate > 0.0]
    lasting = {"duration": shortest_duration(min(rates))} if rates else {}
    return combinations(chosen, **lasting, **document)


def from_file(path: Path, chosen: Mapping[str, Any]) -> Loops:
    """Loops listed in a TOML file: `[[loop]]` tables, or the axes of a sweep's specification.

    path: of the file
    chosen: parameter -> single value, for what a `[[loop]]` does not say itself
    """
    document = _read(path)
    if "loop" not in document:
        if chosen:
            name = next(iter(chosen))
            raise UserError(f"{_typed(name)}: {path} has axes of its own; change them there")
        return expanded(reading.load(path))
    return _listed(path, document["loop"], chosen)


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is not UTF-8 text"
        raise UserError(f"{path}: cannot be read ({reason}); give a TOML file of loops") from None
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: is not valid TOML: {str(error)[:200]}") from None


def _listed(path: Path, rows: Any, chosen: Mapping[str, Any]) -> Loops:
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise UserError(
            f"{path}: loop is not a list of tables; write [[loop]] above each loop's keys"
        )
    base = {name: parameter.default for name, parameter in PARAMETERS.items()}
    for name, values in chosen.items():
        if len(values) > 1:
            raise UserError(f"{_typed(name)}: give one value, {path} lists the loops")
        base |= _resolved({name: values[0]}, _typed(name), base)
    filled, labels = [], []
    for index, row in enumerate(rows):
        key = f"{path}: loop[{index}]"
        label = row.get("name", f"loop {index}")
        if not isinstance(label, str):
            raise UserError(f"{key}.name = {shown(label)} is not text")
        own = base | _resolved({k: v for k, v in row.items() if k != "name"}, key, base)
        if "control_rate" in chosen or any(canonical(name) == "control_rate" for name in row):
            check_history(own, own["control_rate"], f"{key}: ")
        filled.append(own)
        labels.append(label)
    values = {name: np.array([row[name] for row in filled]) for name in PARAMETERS}
    said = frozenset(canonical(name) for row in rows for name in row) | frozenset(chosen)
    return Loops(values, tuple(labels), said)


def _resolved(row: Mapping[str, Any], key: str, base: Mapping[str, float]) -> dict[str, float]:
    """Values of one table of parameters, the actuator as wn and zeta."""
    found: dict[str, float] = {}
    for given_name, value in row.items():
        name = canonical(given_name)
        where = key if key.startswith("--") else f"{key}.{given_name}"
        if name == "actuator":
            if {"wn", "zeta"} & {canonical(other) for other in row}:
                raise UserError(f"{where}: the preset sets wn and zeta already; remove one")
            found["wn"], found["zeta"] = PRESETS[check_actuator(value, where)]
        elif name in PARAMETERS:
            found[name] = check(name, value, where)
        else:
            known = (*PARAMETERS, "actuator")
            raise UserError(f"{where}: unknown key; {nearest(given_name, known)}")
    return found


def expanded(specification: Specification) -> Loops:
    """The loops of a specification, named by what tells them apart."""
    samples = expand(specification)
    if len(samples) > MOST_SAMPLES:
        raise UserError(f"axes: make {len(samples):,} loops; allowed here: up to {MOST_SAMPLES:,}")
    values = {name: np.asarray(array, dtype=float) for name, array in samples.values.items()}
    said = frozenset((*specification.parameters, *samples.coords))
    labels = naming.labels(samples) or (loop_name(specification),) * len(samples)
    return Loops(values, labels, said, specification.velocity, (specification, samples))


# Parameters that a picture of linear loops, or their margins, need not mention: what the loop
# starts from, how far it goes, and what shifts it without changing how it responds.
_NO_MATTER = (
    "actuator", "sample", "gain_scale", "setpoint", "initial_position", "initial_velocity",
    "rest_amplitude", "name",
)  # fmt: skip


def say_what_is_left_out(loops: Loops) -> None:
    """Warn of parameters that a file gives and that linear loops do not have."""
    extra = loops.said - {*LINEAR, "control_rate", *_NO_MATTER}
    left_out = sorted(
        name for name in extra
        if name in PARAMETERS and np.any(loops.values[name] != PARAMETERS[name].default)
    )  # fmt: skip
    if left_out:
        _warnings.warn(f"linear loops are without {', '.join(left_out)}: left out here")


def without_preset(preset: Any) -> dict[str, float]:
    """wn and zeta of a preset, nothing for None: so that one of the two can be given otherwise."""
    return {} if preset is None else dict(zip(("wn", "zeta"), PRESETS[preset], strict=True))
