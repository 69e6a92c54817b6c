"""The same figures found by simulating the loops, without any of the exact formulas.

Margins come from bisection on the sign of simulated growth rates. The sensitivity comes from one
step response: the command answers the setpoint r with u = kp S r, so that for a step of height 1

    S(exp(jwT)) = sum_k (u_k - u_{k-1}) exp(-jwTk) / kp.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from study import CONTROL_RATE, DELAYS, KD, KP, MASS, Cases

from jaxact.compilation.filling import in_chunks
from jaxact.compilation.programs import building
from jaxact.drive import step as _drive
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.options import DriveOptions
from jaxact.drive.step import Drive
from jaxact.loops import loop as _loop
from jaxact.loops.loop import Loop
from jaxact.plants.mass import Mass
from jaxact.simulation import trajectory
from jaxact.simulation.growth.rate import growth_rate

LARGEST_GAIN = 200.0  # no margin of the sampled loops is larger [-]
LONGEST_DELAY = 0.040  # nor any delay margin [s]
_RUNGS, _ROUNDS = 33, 3
_TILE = 1024
_DURATION = 20.0  # of the step response [s]


def growth_rates(cases: Cases, factor: float = 1.0) -> np.ndarray:
    """Growth rate of a perturbation of the simulated loops [1/s]; the cases' shape.

    Args:
        cases: with delays up to those of the study.
        factor: on both nominal gains [-].
    """
    return _growth(cases, np.full(cases.shape, factor), np.zeros(cases.shape))


def gain_margins(cases: Cases) -> np.ndarray:
    """Smallest factor above 1 on both gains that makes the simulated loop grow [-].

    Bisected to 3e-6 of its value.

    Args:
        cases: delays up to those of the study; NaN where a loop grows already, inf where none does
            up to LARGEST_GAIN.
    """
    ladder = np.geomspace(1.0, LARGEST_GAIN, _RUNGS)
    return _first_growing(lambda wide, rung: _growth(wide, rung, 0.0 * rung), cases, ladder)


def delay_margins(cases: Cases) -> np.ndarray:
    """Smallest added delay that makes the simulated loop grow [s].

    Bisected to 0.02 microseconds.

    Args:
        cases: delays up to those of the study; NaN where a loop grows already, inf where none does
            up to LONGEST_DELAY.
    """
    ladder = np.linspace(0.0, LONGEST_DELAY, _RUNGS)
    return _first_growing(lambda wide, rung: _growth(wide, 1.0 + 0.0 * rung, rung), cases, ladder)


def sensitivity(cases: Cases, w: np.ndarray) -> np.ndarray:
    """|S(exp(jwT))| [-] measured from simulated step responses, shape (*cases.shape, k).

    Args:
        cases: at the nominal gains, stable.
        w: frequency [rad/s], up to pi CONTROL_RATE, shape (k,).
    """
    commands = step_responses(cases, _DURATION)[1]
    changes = np.diff(commands, axis=-1, prepend=0.0)
    turned = np.exp(-1j * np.outer(np.arange(commands.shape[-1]), w) / CONTROL_RATE)
    return np.abs(changes @ turned / KP)


def step_responses(cases: Cases, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Position [m] and command [N] at every control tick after a setpoint step of 1 m.

    Args:
        cases: at the nominal gains.
        duration: [s].

    Returns:
        Both of shape (*cases.shape, ticks).
    """
    ticks = round(duration * CONTROL_RATE)
    row = cases.flat()
    with jax.enable_x64(True):
        options = _drive.options(_drive_of(row, 1.0, 0.0))

        columns = map(jnp.asarray, row.columns)
        position, command = _steps(*columns, options=options, ticks=ticks)
    shape = (*cases.shape, ticks)
    return np.asarray(position).reshape(shape), np.asarray(command).reshape(shape)


@building
def _steps(options: DriveOptions, ticks: int) -> Callable:
    """Positions and commands of loops at every tick, from their actuators' parameters."""

    def one(wn: jax.Array, zeta: jax.Array, delay: jax.Array) -> tuple[jax.Array, jax.Array]:
        loop = Loop(Mass(jnp.asarray(MASS)), _drive_of(Cases(wn, zeta, delay), 1.0, 0.0))
        run = trajectory.of_loop(loop, options, ticks, Setpoint(jnp.asarray(1.0)))
        return run.position.reshape(ticks), run.command.reshape(ticks)

    return jax.vmap(one)


def _drive_of(cases: Cases, factor: jax.Array | float, added_delay: jax.Array | float) -> Drive:
    return Drive(
        Controller(kp=KP * factor, kd=KD * factor),
        Actuator(cases.natural_frequency, cases.damping_ratio, cases.delay + added_delay),  # type: ignore[arg-type]
        control_period=1.0 / CONTROL_RATE,
    )


def _growth(cases: Cases, factor: np.ndarray, added_delay: np.ndarray) -> np.ndarray:
    """Growth rates [1/s]; all of the cases' shape, in tiles of one size, compiled once."""
    row = cases.flat()
    columns = (*row.columns, factor.reshape(-1), added_delay.reshape(-1))
    longest = max(DELAYS) + LONGEST_DELAY
    every_part = Cases(np.array([1.0]), np.array([1.0]), np.array([longest]))
    with jax.enable_x64(True):
        options = _drive.options(_drive_of(every_part, 1.0, 0.0))
        found = in_chunks(lambda part: _growth_rates(*part, options=options), columns, _TILE)
    return found.reshape(cases.shape)


@building
def _growth_rates(options: DriveOptions) -> Callable:
    """Growth rates of a tile of loops."""

    def growth(
        wn: jax.Array, zeta: jax.Array, delay: jax.Array, factor: jax.Array, added: jax.Array
    ) -> jax.Array:
        loop = Loop(Mass(jnp.asarray(MASS)), _drive_of(Cases(wn, zeta, delay), factor, added))
        prepared = _loop.prepare(loop, options)
        still = jnp.zeros(())
        state = _loop.init(prepared, options, still, still)
        return growth_rate(prepared, options, state, Setpoint(still))

    return jax.vmap(growth)


def _first_growing(
    measure: Callable[[Cases, np.ndarray], np.ndarray], cases: Cases, ladder: np.ndarray
) -> np.ndarray:
    """Where along a rising ladder the growth rate first turns positive; the cases' shape.

    Args:
        measure: growth rates of cases with an axis of rungs added, at values of the same shape.
    """
    row = cases.flat()
    rungs = np.broadcast_to(ladder, (*row.shape, len(ladder)))
    low, high, start, end = _bracket(measure, row, rungs)
    for _ in range(_ROUNDS):
        share = np.linspace(0.0, 1.0, _RUNGS)
        inside = low[:, None] + (high - low)[:, None] * share
        low, high, _, _ = _bracket(measure, row, inside)
    found = 0.5 * (low + high)
    found = np.where(end, np.inf, found)
    return np.where(start, np.nan, found).reshape(cases.shape)


def _bracket(
    measure: Callable[[Cases, np.ndarray], np.ndarray], row: Cases, rungs: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The rungs around the first one that grows; whether that is the first of all, or none."""
    wide = Cases(*(np.broadcast_to(column[:, None], rungs.shape) for column in row.columns))
    grows = measure(wide, rungs) >= 0.0
    none = ~np.any(grows, axis=1)
    first = np.where(none, rungs.shape[1] - 1, np.argmax(grows, axis=1))
    lower = np.maximum(first - 1, 0)
    every = np.arange(len(rungs))
    return rungs[every, lower], rungs[every, first], grows[:, 0], none
