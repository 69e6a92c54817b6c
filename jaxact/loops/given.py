"""Parameters as they are given in Python, checked before they become a loop."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.gains.table import tell_shadowed
from jaxact.loops.checks import JOINT_ONLY
from jaxact.parameters import (
    ALIASES,
    INERTIA,
    PARAMETERS,
    PRESETS,
    ROBOT_ONLY,
    SETPOINT,
    SHARED,
    WN,
    ZETA,
    as_number,
    base,
    canonical,
    check,
    check_actuator,
    known,
)

ACTUATOR = "actuator"
"""The name under which a preset sets wn and zeta."""
_PRESET_SETS = (WN, ZETA)
# Of a physics step [s], as a specification has them.
_SHORTEST, _LONGEST = 1e-7, 1.0


def read(given: Mapping[str, Any], *, robot: bool, unit: str | None = None) -> dict[str, Any]:
    """Parameters by their short names, checked where they are known numbers.

    Args:
        given: parameter by either name, or `actuator` -> number, array or name; of a robot also
            a table of patterns of joints -> number.
        robot: whether the loop is a robot's.
        unit: of a joint's position, "m" or "rad"; None: m.

    Raises:
        UserError: an unknown name, a parameter given by both of its names, a value out of bounds,
            what only a robot has, or arrays whose named dimensions differ.
    """
    values: dict[str, Any] = {}
    _check_dimensions(given)
    for name, value in given.items():
        short = canonical(name)
        twice = [other for other in given if other != name and canonical(other) == short]
        if twice:
            raise UserError(f"`{name}` and `{twice[0]}` are the same parameter; remove one")
        if short == ACTUATOR:
            both = [other for other in given if canonical(other) in _PRESET_SETS]
            if both and value is not None:
                raise UserError(
                    f"`{both[0]}`: the actuator preset sets it already; give one of them"
                )
            values |= {} if value is None else _preset(value)
        elif isinstance(value, Mapping):
            if "min" in value:
                raise UserError(
                    f"`{name}`: a range is for an axis of jaxact.sweep; give numbers, e.g. those of"
                    " numpy.geomspace"
                )
            for pattern, own in value.items():
                key = f"{short}@{pattern}"
                values |= {key: _checked(key, own, key, robot=robot, unit=unit)}
            tell_shadowed(short, value)
        else:
            said = INERTIA if name == INERTIA else short
            values[short] = _checked(short, value, said, robot=robot, unit=unit)
    return values


def unknown(name: str, taken: Iterable[str]) -> str:
    """What is said of an unknown parameter.

    Args:
        name: that was given.
        taken: short names of the parameters that are taken there, beside `actuator`.
    """
    short = tuple(taken)
    also = (alias for alias, own in ALIASES.items() if own in short)
    return f"`{name}`: unknown parameter; {nearest(name, (*short, ACTUATOR), also)}"


def _check_dimensions(given: Mapping[str, Any]) -> None:
    """Raise UserError where xarray or pandas would pair values otherwise than arrays, by place."""
    named = {name: tuple(value.dims) for name, value in given.items() if getattr(value, "dims", ())}
    first = max(named.values(), key=len, default=())
    if any(dims != first[len(first) - len(dims) :] for dims in named.values()):
        shapes = ", ".join(f"{name} ({', '.join(map(str, dims))})" for name, dims in named.items())
        raise UserError(
            f"values are paired by place, not by the names of dimensions: {shapes}; give arrays"
            " that broadcast, or the axes of jaxact.sweep"
        )
    for name, dims in named.items():
        if canonical(name) == SETPOINT and "time" in dims:
            raise UserError(
                f"`{name}`: values over time would be steps of as many loops; give the height of a "
                "step, or a setpoint for every period to jaxact.drive_around"
            )
    of_pandas = {name: value.index for name, value in given.items() if hasattr(value, "iloc")}
    for name, index in of_pandas.items():
        other = next(iter(of_pandas))
        if not index.equals(of_pandas[other]):
            raise UserError(
                f"values are paired by place, but `{other}` and `{name}` have different indexes; "
                "align them, or give arrays"
            )


def _preset(value: Any) -> dict[str, Any]:
    """Wn and zeta of a preset, or of an array of them."""
    names = np.asarray(value, dtype=object)
    pairs = np.array(
        [PRESETS[check_actuator(name, "`actuator`")] for name in names.ravel().tolist()], float
    )
    if not names.ndim:
        return {WN: float(pairs[0, 0]), ZETA: float(pairs[0, 1])}
    return {WN: pairs[:, 0].reshape(names.shape), ZETA: pairs[:, 1].reshape(names.shape)}


def _checked(name: str, value: Any, said: str, *, robot: bool, unit: str | None) -> Any:
    """A value within the parameter's bounds; what JAX traces is taken as it is.

    Args:
        name: key of the parameter.
        value: what was given.
        said: how messages name it.
        robot, unit: as for `read`.
    """
    if not known(name):
        if base(name) in SHARED:
            raise UserError(f"`{name}`: {base(name)} is one number for all joints; give it alone")
        if "@" in name and base(name) in PARAMETERS:
            raise UserError(
                f"`{name}`: what follows the @ is not a pattern of joints, e.g. kp@.*_knee"
            )
        refused = JOINT_ONLY if robot else ROBOT_ONLY
        raise UserError(unknown(name, (one for one in PARAMETERS if one not in refused)))
    if not robot and ("@" in name or name in ROBOT_ONLY):
        raise UserError(f"`{name}`: only a robot has it; make one with jaxact.robot(model, ...)")
    if robot and base(name) in JOINT_ONLY:
        raise UserError(f"`{said}`: only for a single joint; {JOINT_ONLY[base(name)]}")
    if isinstance(value, jax.core.Tracer):
        return value
    if value is None:
        raise UserError(f"`{said}` = None is not a number or array of numbers; leave it out")
    if np.ma.is_masked(value):
        raise UserError(f"`{said}`: some of its values are masked; fill them or leave them out")
    try:
        # NumPy would take 1 ms for the number 1, and "400" for 400.
        if np.asarray(value).dtype.kind in "mMSU":
            raise TypeError
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise UserError(f"`{said}` = {shown(value)} is not a number or array of numbers") from None
    if not array.size:
        raise UserError(f"`{said}` = {shown(value)} is empty; give at least one value")
    if np.asarray(value).dtype.kind == "b":
        check(name, True, f"`{said}`", unit)
    worst = (
        array[np.isnan(array)] if np.isnan(array).any() else np.array([array.min(), array.max()])
    )
    for number in worst[:2]:
        check(name, float(number), f"`{said}`", unit)
    if not array.ndim:
        return float(array)
    return value if isinstance(value, jax.Array) else array


def names_of(names: Any) -> tuple[str, ...]:
    """The names of loops as a tuple.

    Raises:
        UserError: a single text, whose letters nobody means, or no list at all.
    """
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise UserError(f"`names` = {shown(names)}; allowed: a list with a name for each loop")
    return tuple(map(str, names))


def patterns_of(joints: Any) -> tuple[str, ...]:
    """The patterns of joints as a tuple, one or several in a list.

    Raises:
        UserError: they are no patterns, or none.
    """
    several = isinstance(joints, Sequence) and all(isinstance(one, str) for one in joints)
    if not several:
        raise UserError(f"joints = {shown(joints)}; allowed: a pattern, or several in a list")
    if not joints:
        raise UserError(f"joints = {shown(joints)} drives none; leave it out to drive all of them")
    return (joints,) if isinstance(joints, str) else tuple(joints)


def check_step(step: Any) -> None:
    """Raise UserError for what is not a physics step [s], nor None."""
    plain = step if step is None or np.ndim(step) or isinstance(step, str) else np.asarray(step)
    number = as_number(plain.item() if isinstance(plain, np.ndarray) else plain)
    if step is not None and not (number is not None and _SHORTEST <= number <= _LONGEST):
        raise UserError(
            f"`physics_step` = {shown(step)}; allowed: {_SHORTEST:g} to {_LONGEST:g} [s]"
        )
