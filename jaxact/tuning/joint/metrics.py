"""Exact metrics of every loop and their derivatives, float64: what is polished and certified.

No smoothing: the margins are those of `jaxact.analysis.joint.margins` and
`jaxact.analysis.sampled.margins`, refined to rounding. Derivatives are by the logarithms of the
gains and by the members' parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.analysis.joint.frequency import JointLoop
from jaxact.analysis.joint.margins import margins
from jaxact.analysis.sampled.margins import sampled_margins
from jaxact.analysis.sampled.period_map import SampledLoop, delay_steps
from jaxact.compilation.filling import in_chunks
from jaxact.compilation.programs import Program
from jaxact.parameters import OF_JOINT
from jaxact.tuning.joint.ensemble import DEFAULT_PERIOD, PARAMETERS, PLANT, Ensemble, Sampling
from jaxact.tuning.joint.noise import (
    bandwidth,
    noise_gain,
    sampled_bandwidth,
    sampled_noise_gain,
)

# Loops are computed in batches of one size, so that one program is compiled.
_SIZE = 32
_ALWAYS = (
    "sensitivity_peak", "complementary_peak", "gain_margin", "delay_margin", "disk_margin",
    "log_gain_to_boundary",
)  # fmt: skip
_EXTRA = ("bandwidth", "noise_gain")
# The gains and a bare mass; the gains and any joint.
_BARE, _INPUTS = 2 + len(PARAMETERS), 2 + len(PLANT)


@dataclass(frozen=True)
class Exact:
    """Metrics of loops, NumPy float64; `log` and `slope` are NaN where they mean nothing.

    Attributes:
        stable: shape (...).
        log: ln of each metric by name, shape (...); `log_gain_to_boundary` is the metric itself.
        slope: derivatives of `log` by (ln kp, ln kd, mass, wn, zeta, delay, damping, stiffness),
            shape (..., 8); 0 by the last two of bare masses.
    """

    stable: np.ndarray
    log: Mapping[str, np.ndarray]
    slope: Mapping[str, np.ndarray]

    @property
    def gain_slope(self) -> dict[str, np.ndarray]:
        """Derivatives by the logarithms of the two gains, shape (..., 2)."""
        return {name: array[..., :2] for name, array in self.slope.items()}


def evaluate(
    log_kp: np.ndarray,
    log_kd: np.ndarray,
    members: Ensemble | Mapping[str, np.ndarray],
    sampling: Sampling,
    extra: tuple[str, ...] = (),
    timed: Any = None,
) -> Exact:
    """Exact metrics of many loops.

    Args:
        log_kp, log_kd: ln of the gains, any shape.
        members: parameters that broadcast with them; of a mapping those of the joint may be
            missing.
        sampling: of the controller.
        extra: metrics beyond the margins, "noise_gain" and "bandwidth"; other names change nothing.
        timed: static `jaxact.tuning.joint.response.Timed`, of what takes simulated time, or None.
    """
    own = members if isinstance(members, Mapping) else {n: getattr(members, n) for n in PLANT}
    rows = [own.get(name, np.zeros(())) for name in PLANT]
    arrays = np.broadcast_arrays(log_kp, log_kd, *rows)
    shape = arrays[0].shape
    flat = np.stack([np.asarray(a, dtype=float).reshape(-1) for a in arrays])
    inputs = _INPUTS if flat[_BARE:].any() else _BARE
    flat = flat[:inputs]
    steps = 0
    if sampling.control_period is not None and flat.shape[1]:
        steps = delay_steps(flat[5], sampling.control_period)
    # Only what makes a difference to the program, so that goals share it.
    wanted = tuple(name for name in _EXTRA if name in extra)
    static = {"sampling": sampling, "steps": steps, "wanted": wanted}
    with jax.enable_x64(True):
        stable, log, slope = in_chunks(partial(_with_slopes, **static), flat, _SIZE)
        if timed is not None:
            own, own_slope = in_chunks(partial(_simulated, timed=timed), flat, _SIZE)
            log = log | {timed.metric: np.where(stable, own, np.nan)}
            slope = slope | {timed.metric: np.where(stable, own_slope, np.nan)}
    return Exact(
        stable.reshape(shape),
        {name: a.reshape(shape) for name, a in log.items()},
        {
            name: np.pad(np.moveaxis(a, 0, -1), ((0, 0), (0, _INPUTS - inputs))).reshape(
                (*shape, _INPUTS)
            )
            for name, a in slope.items()
        },
    )


@Program
def _with_slopes(
    inputs: jax.Array, *, sampling: Sampling, steps: int, wanted: tuple[str, ...]
) -> tuple[jax.Array, dict[str, jax.Array], dict[str, jax.Array]]:
    """Which loops are stable, ln of all metrics, and its slopes; inputs (6 or 8, loops)."""

    def logs(inputs: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
        """ln of all metrics of loops, shape (loops,), and which loops are stable."""
        kp, kd = jnp.exp(inputs[0]), jnp.exp(inputs[1])
        found = _metrics(kp, kd, inputs[2:], sampling, steps, wanted)
        stable = found.pop("stable")
        distance = found.pop("log_gain_to_boundary")
        result = {name: jnp.log(value) for name, value in found.items()}
        return result | {"log_gain_to_boundary": distance}, stable

    value, push, stable = jax.linearize(logs, inputs, has_aux=True)
    return stable, value, jax.vmap(push)(_each_input(inputs))


@Program
def _simulated(inputs: jax.Array, *, timed: Any) -> tuple[jax.Array, jax.Array]:
    """ln of what takes simulated time and its slopes; apart, so that goals share the margins."""

    def log(inputs: jax.Array) -> jax.Array:
        return jnp.log(timed.of_loops(jnp.exp(inputs[0]), jnp.exp(inputs[1]), inputs[2:]))

    value, push = jax.linearize(log, inputs)
    return value, jax.vmap(push)(_each_input(inputs))


def _each_input(inputs: jax.Array) -> jax.Array:
    """Each loop depends on its own inputs only: one pass for each kind of input does all loops."""
    return jnp.eye(len(inputs), dtype=inputs.dtype)[:, :, None] * jnp.ones_like(inputs)[None]


def _metrics(
    kp: jax.Array,
    kd: jax.Array,
    plant: jax.Array,
    sampling: Sampling,
    steps: int,
    wanted: tuple[str, ...],
) -> dict[str, jax.Array]:
    """All metrics of a flat batch, with `stable`; the gains' own logarithms are not among them."""
    (mass, wn, zeta, delay), joint = plant[:4], dict(zip(OF_JOINT, plant[4:], strict=False))
    found: Any
    finite = math.isfinite(sampling.velocity_filter)
    cutoff = jnp.full_like(kp, sampling.velocity_filter) if finite else None
    extra: dict[str, Callable[[], jax.Array]]
    if sampling.control_period is None:
        held = JointLoop(kp, kd, mass, wn, zeta, delay, cutoff, **joint)
        found = margins(held)
        extra = {"noise_gain": partial(noise_gain, held, DEFAULT_PERIOD),
                 "bandwidth": partial(bandwidth, held)}  # fmt: skip
    else:
        period = sampling.control_period
        loop = SampledLoop(
            kp, kd, mass, wn, zeta, delay,
            jnp.full_like(kp, period), jnp.full_like(kp, sampling.velocity_filter),
            velocity=sampling.velocity, **joint,
        )  # fmt: skip
        found = sampled_margins(loop, max_delay_steps=steps)
        extra = {"noise_gain": partial(sampled_noise_gain, loop),
                 "bandwidth": partial(sampled_bandwidth, loop)}  # fmt: skip
    result = {name: getattr(found, name) for name in _ALWAYS}
    for name in wanted:
        result[name] = jnp.where(found.stable, extra[name](), jnp.nan)
    return result | {"stable": found.stable}
