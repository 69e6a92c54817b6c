"""A robot and its drives closed to a loop, as matrices over one control period.

    x' = M x + N d,     u = C x + d

x is the state of the plant and of all drives between two ticks, d a force that is added to each
joint's command where its controller issues it (before hold, delay and actuator), u the command with
it. From d to u that is the sensitivity at the plant's input with all loops closed,

    S(z) = I + C (z I - M)^-1 N,     T = I - S,     L_i = 1 / S_ii - 1,

with L_i the loop of joint i while all others stay closed. A factor on the command of each joint,
diag(g), gives the map M + N diag(g - 1) C.

The matrices are the derivative of the one step that simulates (`jax.jacfwd` of
`jaxact.loops.loop.step`), so that hold, fractional delays and actuators are in them exactly.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from jaxact.compilation.programs import building
from jaxact.drive import history as _history
from jaxact.drive.controller import Setpoint
from jaxact.drive.step import DriveOptions
from jaxact.errors import UserError
from jaxact.loops import loop as _loop
from jaxact.loops.loop import Loop, LoopState
from jaxact.loops.specification import Setting
from jaxact.loops.template import Template
from jaxact.plants.linear import LinearPlant
from jaxact.simulation import kernel
from jaxact.simulation.growth import rate as _growth
from jaxact.simulation.kernel import Case

# Of a linear loop: its matrices, square in them, take 0.5 GB each then.
MOST_STATES = 8000


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PeriodMap:
    """A closed loop over one control period; n states, m joints.

    Attributes:
        M: of the state, shape (n, n).
        N: of forces added to the commands, shape (n, m).
        C: commands that the state gives rise to, shape (m, n).
        positions, velocities: of the joints at the tick [m or rad], per second, shape (m, n) each.
    """

    M: jax.Array
    N: jax.Array
    C: jax.Array
    positions: jax.Array
    velocities: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class OpenMap:
    """The same with the controllers taken out: x' = A x + B u, and what they would measure.

    Attributes:
        A: shape (n, n).
        B: shape (n, m).
        positions, velocities: as the controllers measure them, delays and filters included,
            shape (m, n) each.
    """

    A: jax.Array
    B: jax.Array
    positions: jax.Array
    velocities: jax.Array


def period_map(loop: Loop, options: DriveOptions) -> PeriodMap:
    """The linear map of a closed loop over one control period.

    Noise, quantisation and limits are left out. So is the setpoint delay, which no loop passes.

    Args:
        loop: of a linear plant (`jaxact.plants.linear`, `Mass`); may be traced, and differentiated
            with respect to gains, actuators and delays.
        options: static, from `jaxact.drive.step.options`.

    Returns:
        The matrices, in the precision that JAX has at this moment.

    Raises:
        UserError: so many states that the square matrices of them would not fit.
    """
    smooth = replace(options.linearised(), setpoint_slots=0)
    prepared = _loop.prepare(loop, smooth)
    rest = jnp.zeros_like(prepared.drive.drive.controller.kp)
    state = _loop.init(prepared, smooth, rest, rest)
    vector, merge = _growth.split(_growth.aligned(state))
    flat, unravel = ravel_pytree(vector)
    if flat.size > MOST_STATES:
        raise UserError(
            f"the robot's linear loop has {flat.size:,} states, most of them the delays' (in"
            f" seconds) at its control rate; allowed: {MOST_STATES:,}; shorten a delay, or lower"
            " the rate"
        )

    def advance(flat: jax.Array, force: jax.Array):
        before = merge(unravel(flat))
        after, (output, _) = _loop.step(prepared, smooth, before, Setpoint(rest, force=force))
        after = _growth.aligned(after)
        after = LoopState(after.plant, _history.forget(prepared.drive, after.drive))
        seen = output.command, output.position_before, output.velocity_before
        return ravel_pytree(_growth.split(after)[0])[0], seen

    (M, N), seen = jax.jacfwd(advance, argnums=(0, 1))(jnp.zeros_like(flat), rest)
    C, positions, velocities = (by_state for by_state, _ in seen)
    return PeriodMap(M=M, N=N, C=C, positions=positions, velocities=velocities)


def with_gains(loop: Loop, kp: jax.Array | float, kd: jax.Array | float) -> Loop:
    """The loop with other gains, [N/m or N m/rad] and [N s/m or N m s/rad]."""
    controller = replace(loop.drive.controller, kp=kp, kd=kd)
    return replace(loop, drive=replace(loop.drive, controller=controller))


def with_later_commands(loop: Loop, extra: jax.Array | float) -> Loop:
    """The loop with its command delays longer by `extra` [s], a number or one for each joint."""
    actuator = replace(loop.drive.actuator, delay=loop.drive.actuator.delay + extra)
    return replace(loop, drive=replace(loop.drive, actuator=actuator))


def open_map(loop: Loop, options: DriveOptions) -> OpenMap:
    """The loop opened at its controllers, whatever their gains.

    With kp = 1 and kd = 0 a command is minus the measured position, with kp = 0 and kd = 1 minus
    the measured velocity; what the command does in return is taken out again.

    Args:
        loop, options: as for `period_map`.
    """
    one, none = jnp.ones(()), jnp.zeros(())
    gains = jnp.stack([one, none]), jnp.stack([none, one])
    maps = jax.vmap(lambda kp, kd: period_map(with_gains(loop, kp, kd), options))(*gains)
    return OpenMap(
        A=maps.M[0] - maps.N[0] @ maps.C[0],
        B=maps.N[0],
        positions=-maps.C[0],
        velocities=-maps.C[1],
    )


def effective_inertias(plant: LinearPlant) -> jax.Array:
    """Inertias of the joints against forces within a physics step [kg or kg m^2], (joints,)."""
    return plant.step / jnp.diagonal(plant.velocities @ plant.B)


@functools.lru_cache(maxsize=8)
def template(case: Case, setting: Setting) -> Template:
    """What the loops of a linearised robot share, in float64; `case` from `kernel.linear_part`."""
    with jax.enable_x64(True):
        return kernel.template_of(case, setting, "growth_rate")


@building
def matrices(*, case: Case, setting: Setting) -> Callable:
    """From parameters of a robot, A and B of a model of its own, and an extra delay to its loop.

    Returns:
        A function to the period map, effective inertias, kp, kd and command delays, (joints,) each.
    """
    shared = template(case, setting)
    # Lines with room for up to a period of delay more.
    options = replace(case.drive, command_slots=case.drive.command_slots + 2)

    def one(values, moved, extra):
        loop = kernel.linear_loop(case, shared, values, moved)
        found = period_map(with_later_commands(loop, extra), options)
        like = jnp.zeros(loop.plant.shape)
        gains, delay = loop.drive.controller, loop.drive.actuator.delay
        inertias = effective_inertias(loop.plant)
        return found, inertias, gains.kp + like, gains.kd + like, delay + like

    return one
