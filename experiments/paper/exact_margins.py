"""Margins and sensitivities of the study's loops, exact: in continuous time and as sampled."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from study import CONTROL_RATE, KD, KP, MASS, Cases

from jaxact.analysis.joint.frequency import JointLoop, sensitivity
from jaxact.analysis.joint.margins import margins
from jaxact.analysis.sampled import margins as sampled
from jaxact.analysis.sampled.period_map import SampledLoop, delay_steps
from jaxact.analysis.sampled.search import sampled_response
from jaxact.compilation.filling import filled
from jaxact.compilation.programs import Program

# The margins work through their batch in tiles of so many; a rest would be compiled on its own.
_TILE = 64

Values = float | np.ndarray

_margins = Program(margins)
_sampled_margins = Program(sampled.sampled_margins)


@Program
def _responses(loops: SampledLoop, w: jax.Array) -> jax.Array:
    return jax.vmap(sampled_response, in_axes=(0, None))(loops, w)


def continuous_margins(
    cases: Cases, kp: Values = KP, kd: Values = KD, mass: Values = MASS
) -> dict[str, np.ndarray]:
    """Margins in continuous time.

    Args:
        cases: of any shape.
        kp, kd, mass: the study's, or others [N/m], [N s/m], [kg], broadcast to the cases' shape.

    Returns:
        The fields of `jaxact.analysis.joint.margins.Margins` by name, each of the cases' shape.
    """
    return _arrays(_margins, JointLoop, _columns(cases, kp, kd, mass))


def sampled_margins(cases: Cases, control_rate: Values = CONTROL_RATE) -> dict[str, np.ndarray]:
    """Margins of the sampled loop, with sampled velocity, at the nominal gains.

    Args:
        cases: of any shape.
        control_rate: [Hz], broadcast to the cases' shape.

    Returns:
        The fields of `jaxact.analysis.sampled.margins.SampledMargins` by name, each of the cases'
        shape.
    """
    columns = _sampled_columns(cases, control_rate)
    steps = delay_steps(columns["delay"], columns["control_period"])
    function = functools.partial(_sampled_margins, max_delay_steps=steps)
    return _arrays(function, SampledLoop, columns)


def continuous_sensitivity(cases: Cases, w: np.ndarray) -> np.ndarray:
    """S(jw) [-], complex, at the nominal gains; w: [rad/s], shape (k,); (*cases.shape, k)."""
    with jax.enable_x64(True):
        columns = {name: jnp.asarray(a.reshape((-1, 1))) for name, a in _columns(cases).items()}
        found = sensitivity(JointLoop(**columns), jnp.asarray(w)[None])
    return np.asarray(found).reshape((*cases.shape, len(w)))


def sampled_sensitivity(cases: Cases, w: np.ndarray) -> np.ndarray:
    """S(exp(jwT)) [-], complex, of the loop sampled at CONTROL_RATE; as `continuous_sensitivity`.

    Args:
        cases: at the nominal gains.
        w: up to pi CONTROL_RATE [rad/s], shape (k,).
    """
    with jax.enable_x64(True):
        columns = _sampled_columns(cases, CONTROL_RATE)
        loops = SampledLoop(**{name: jnp.asarray(a.reshape(-1)) for name, a in columns.items()})
        found = 1.0 / (1.0 + np.asarray(_responses(loops, jnp.asarray(w))))
    return found.reshape((*cases.shape, len(w)))


def _arrays(
    function: Callable[[Any], Any], kind: type, columns: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """What a function finds of the loops of these columns; in tiles of one size, compiled once."""
    shape = columns["kp"].shape
    count = columns["kp"].size
    rows = {name: array.reshape(-1) for name, array in columns.items()}
    with jax.enable_x64(True):
        found = function(kind(**filled(rows, count + -count % _TILE)))
        return {
            field.name: np.asarray(getattr(found, field.name))[:count].reshape(shape)
            for field in fields(found)
            if getattr(found, field.name) is not None
        }


def _columns(
    cases: Cases, kp: Values = KP, kd: Values = KD, mass: Values = MASS
) -> dict[str, np.ndarray]:
    """The fields that both kinds of loop share, each of the cases' shape."""
    names = ("kp", "kd", "mass", "natural_frequency", "damping_ratio", "delay")
    return {
        name: np.broadcast_to(np.asarray(value, float), cases.shape)
        for name, value in zip(names, (kp, kd, mass, *cases.columns), strict=True)
    }


def _sampled_columns(cases: Cases, control_rate: Values) -> dict[str, np.ndarray]:
    period = np.broadcast_to(1.0 / np.asarray(control_rate, float), cases.shape)
    unfiltered = np.full(cases.shape, np.inf)
    return {**_columns(cases), "control_period": period, "velocity_filter": unfiltered}
