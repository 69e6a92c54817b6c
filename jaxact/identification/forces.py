"""The ladder of a drive whose force was measured: from commanded to given force."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.errors import UserError
from jaxact.identification import inspection, supply, torque_loop
from jaxact.identification.log import Log, filled
from jaxact.identification.model import (
    DYNAMICS,
    LONG_DELAYS,
    MOST_FREE_BEGINNINGS,
    NEUTRAL_DRIVE,
    Family,
    Rung,
    drive_unknowns,
)
from jaxact.identification.problem import Unknown
from jaxact.identification.torque_loop import EARLIER, INITIAL_FORCE, INITIAL_RATE
from jaxact.parameters import FORCE_LIMIT, WN, ZETA

_Told = Callable[[Log], np.ndarray]
_ALWAYS = ("gain", "offset")
_MOST_TICKS_OF_DELAY = 12
# Rows over which a rate is taken, and how far from its first row a force may have begun.
_ROWS_OF_A_RATE, _ROOM = 5, 0.05
_BEGINNING = {INITIAL_FORCE: math.nan, INITIAL_RATE: 0.0, EARLIER: math.nan}
_NEUTRAL = {"gain": 1.0, "offset": 0.0, FORCE_LIMIT: math.inf, **NEUTRAL_DRIVE, **_BEGINNING}


def family(logs: Sequence[Log], *, longest: float = LONG_DELAYS[0]) -> Family:
    """The ladder for logs of commanded and measured force.

    Args:
        logs: to be fitted.
        longest: delay that is tried [s].

    Raises:
        UserError: a log lacks one of the two.
    """
    demand(logs)
    told = partial(_told, fitted=tuple(logs))
    limited = any(inspection.saturation(log["force"]) is not None for log in logs)
    always = (*_ALWAYS, FORCE_LIMIT) if limited else _ALWAYS
    rungs = tuple(
        Rung(name, name, "", (*always, *free), fixed) for name, (free, fixed) in DYNAMICS.items()
    )
    return Family(
        rungs=rungs,
        unknowns=partial(_unknowns, longest=longest, told=told),
        neutral=_NEUTRAL,
        positive=frozenset((WN, ZETA, FORCE_LIMIT)),
        inputs=partial(_inputs, told=told),
        simulate=_simulate,
        measured=lambda log: log["force"],
        stimulus=lambda log: log["command"],
        nuisances=partial(_nuisances, told=told),
        signal="force",
        unit="N m" if logs[0].unit == "rad" else "N",
        perhaps=() if limited else (FORCE_LIMIT,),
    )


def demand(logs: Sequence[Log]) -> None:
    """That logs have what a force loop is held against.

    Raises:
        UserError: one lacks the commanded or the measured force.
    """
    for log in logs:
        missing = [name for name in ("command", "force") if name not in log]
        if missing:
            raise UserError(
                f"{log.title}: has no {missing[0]}; a force loop needs the commanded and the"
                " measured force; for what moved, give a `plant`"
            )


def _told(log: Log, fitted: Sequence[Log]) -> np.ndarray:
    """The command as strong as the supply makes it, [N or N m], shape (rows,)."""
    return log["command"] * supply.strength(log, fitted)


def _unknowns(logs: Sequence[Log], longest: float, told: _Told) -> dict[str, Unknown]:
    force = np.concatenate([log["force"] for log in logs])
    command = np.concatenate([told(log) for log in logs])
    unit = "N m" if logs[0].unit == "rad" else "N"
    size = float(np.max(np.abs(force))) + 1e-12
    ratio = float(np.std(force) / max(float(np.std(command)), 1e-12))
    sought = (
        Unknown("gain", "1", -100.0 * ratio, 100.0 * ratio, (ratio,)),
        Unknown("offset", unit, -size, size, (0.0,)),
        Unknown(FORCE_LIMIT, unit, 0.3 * size, 3.0 * size, (0.99 * size,), positive=True),
        *drive_unknowns(logs, _MOST_TICKS_OF_DELAY, longest),
    )
    return {unknown.name: unknown for unknown in sought}


def _nuisances(logs: Sequence[Log], tried: bool, told: _Told) -> tuple[Unknown, ...]:
    """What happened before each of a few logs, within what the log shows of its own signals."""
    del tried
    if len(logs) > MOST_FREE_BEGINNINGS:
        return ()
    found = []
    for number, log in enumerate(logs):
        force, command = log["force"], told(log)
        unit = "N m" if log.unit == "rad" else "N"
        apart = min(_ROWS_OF_A_RATE, len(force) - 1)
        fast = np.max(
            np.abs((force[apart:] - force[:-apart]) / (log.time[apart:] - log.time[:-apart]))
        )
        room = _ROOM * float(np.ptp(force))
        low, high = min(0.0, float(np.min(command))), max(0.0, float(np.max(command)))
        for name, kind, value, span in (
            (INITIAL_FORCE, unit, float(force[0]), (force[0] - room, force[0] + room)),
            (INITIAL_RATE, f"{unit}/s", 0.0, (-float(fast), float(fast))),
            (EARLIER, unit, float(command[0]), (low, high)),
        ):
            least, most = span[0] - 1e-9, span[1] + 1e-9
            found.append(Unknown(f"{name}[{number}]", kind, least, most, (value,), log=number))
    return tuple(found)


def _inputs(log: Log, told: _Told) -> dict[str, jax.Array]:
    return {
        "time": jnp.asarray(filled(log.time, rising=True)),
        "command": jnp.asarray(filled(told(log))),
        "first": jnp.asarray(log["force"][0]),
    }


def _simulate(
    values: Mapping[str, jax.Array | float], inputs: Mapping[str, jax.Array]
) -> jax.Array:
    first = jnp.asarray(values[INITIAL_FORCE]), jnp.asarray(values[EARLIER])
    measured = inputs["first"], inputs["command"][0]
    force, earlier = (
        jnp.where(jnp.isnan(given), known, given)
        for given, known in zip(first, measured, strict=True)
    )
    begun = {INITIAL_FORCE: force - values["offset"], EARLIER: earlier}
    return torque_loop.simulate(inputs["time"], inputs["command"], {**values, **begun})
