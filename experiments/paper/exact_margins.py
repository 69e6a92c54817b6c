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
from jaxact.analysis.sampled.margins import sampled_margins
from jaxact.analysis.sampled.period_map import SampledLoop, delay_steps
from jaxact.analysis.sampled.search import sampled_response
from jaxact.compilation.programs import Program

# The margins work through their batch in tiles of so many; a rest would be compiled on its own.
_TILE = 64


def continuous_margins(cases: Cases) -> dict[str, np.ndarray]:
    """The fields of `jaxact.analysis.joint.margins.Margins` by name, each of the cases' shape.

    cases: at the nominal gains
    """
    return _arrays(Program(lambda: margins, "margins"), _joint_loop, cases)


def sampled_at_1_khz(cases: Cases) -> dict[str, np.ndarray]:
    """The fields of `jaxact.analysis.sampled.margins.SampledMargins` by name, each of the cases'
    shape.

    cases: at the nominal gains, control at CONTROL_RATE, sampled velocity
    """
    steps = delay_steps(np.asarray(cases.delay), 1.0 / CONTROL_RATE)
    function = functools.partial(sampled_margins, max_delay_steps=steps)
    return _arrays(Program(lambda: function, ("sampled margins", steps)), _sampled_loop, cases)


def continuous_sensitivity(cases: Cases, w: np.ndarray) -> np.ndarray:
    """|S(jw)| [-], shape (*cases.shape, k).

    cases: at the nominal gains
    w: frequency [rad/s], shape (k,)
    """
    with jax.enable_x64(True):
        loop = jax.tree.map(lambda a: a[:, None], _joint_loop(cases.flat()))
        found = np.abs(np.asarray(sensitivity(loop, jnp.asarray(w)[None])))
    return found.reshape((*cases.shape, len(w)))


def sampled_sensitivity(cases: Cases, w: np.ndarray) -> np.ndarray:
    """|S(exp(jwT))| [-] of the sampled loop, shape (*cases.shape, k).

    cases: at the nominal gains
    w: frequency [rad/s], up to pi CONTROL_RATE, shape (k,)
    """
    with jax.enable_x64(True):
        loops = _sampled_loop(cases.flat())
        one = Program(lambda: jax.vmap(sampled_response, in_axes=(0, None)), "sampled responses")
        found = np.abs(1.0 / (1.0 + np.asarray(one(loops, jnp.asarray(w)))))
    return found.reshape((*cases.shape, len(w)))


def _arrays(
    function: Callable[[Any], Any], build: Callable[[Cases], Any], cases: Cases
) -> dict[str, np.ndarray]:
    row = cases.flat()
    count = row.shape[0]
    with jax.enable_x64(True):
        found = function(build(row.padded(-count % _TILE)))
        return {
            field.name: np.asarray(getattr(found, field.name))[:count].reshape(cases.shape)
            for field in fields(found)
        }


def _columns(cases: Cases) -> dict[str, Any]:
    """The fields that both kinds of loop share; to be called where float64 is on."""
    wn = jnp.asarray(cases.natural_frequency)
    return {
        "kp": jnp.full_like(wn, KP),
        "kd": jnp.full_like(wn, KD),
        "mass": jnp.full_like(wn, MASS),
        "natural_frequency": wn,
        "damping_ratio": jnp.asarray(cases.damping_ratio),
        "delay": jnp.asarray(cases.delay),
    }


def _joint_loop(cases: Cases) -> JointLoop:
    return JointLoop(**_columns(cases))


def _sampled_loop(cases: Cases) -> SampledLoop:
    columns = _columns(cases)
    ones = jnp.ones_like(columns["kp"])
    return SampledLoop(
        **columns, control_period=ones / CONTROL_RATE, velocity_filter=jnp.inf * ones
    )
