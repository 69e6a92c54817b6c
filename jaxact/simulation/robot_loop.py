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

from dataclasses import dataclass, fields, replace

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from jaxact.drive import history as _history
from jaxact.drive.controller import Setpoint
from jaxact.drive.step import DriveOptions
from jaxact.loops import loop as _loop
from jaxact.loops.loop import Loop, LoopState
from jaxact.plants.linear import LinearPlant
from jaxact.simulation.growth import rate as _growth


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


for _class in (PeriodMap, OpenMap):
    jax.tree_util.register_dataclass(
        _class, data_fields=[item.name for item in fields(_class)], meta_fields=[]
    )


def period_map(loop: Loop, options: DriveOptions) -> PeriodMap:
    """The linear map of a closed loop over one control period.

    Noise, quantisation and limits are left out. So is the setpoint delay, which no loop passes.

    Args:
        loop: of a linear plant (`jaxact.plants.linear`, `Mass`); may be traced, and differentiated
            with respect to gains, actuators and delays.
        options: static, from `jaxact.drive.step.options`.

    Returns:
        The matrices, in the precision that JAX has at this moment.
    """
    smooth = replace(options.linearised(), setpoint_slots=0)
    prepared = _loop.prepare(loop, smooth)
    rest = jnp.zeros_like(prepared.drive.drive.controller.kp)
    state = _loop.init(prepared, smooth, rest, rest)
    vector, merge = _growth.split(_growth.aligned(state))
    flat, unravel = ravel_pytree(vector)

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


def open_frequency_response(loop: Loop, options: DriveOptions, frequency: jax.Array) -> jax.Array:
    """G(e^(jwT)) from commands to what the controllers measure, at the ticks; free of the gains.

    Args:
        loop, options: as for `period_map`; differentiable in actuators and delays.
        frequency: w [rad/s], in (0, pi/T], shape (frequencies,).

    Returns:
        [i, a, q, b]: at frequency i, position (q = 0) or velocity (q = 1) of joint a by the command
        of joint b, complex, shape (frequencies, joints, 2, joints).
    """
    opened = open_map(loop, options)
    z = jnp.exp(1j * frequency * loop.drive.control_period)
    eye = jnp.eye(opened.A.shape[0])
    seen = jnp.stack([opened.positions, opened.velocities], axis=1)

    def at(z: jax.Array) -> jax.Array:
        states = jnp.linalg.solve(z * eye - opened.A, opened.B.astype(z.dtype))
        return jnp.einsum("aqn,nb->aqb", seen, states)

    return jax.lax.map(at, z)


def sensitivity(G: jax.Array, kp: jax.Array, kd: jax.Array) -> jax.Array:
    """S = (I + [kp kd] G)^-1 at the plant's input, for any gains; differentiable in all.

    Args:
        G: from `open_frequency_response`, shape (frequencies, joints, 2, joints).
        kp, kd: gains of the joints, shape (joints,) each.

    Returns:
        shape (frequencies, joints, joints).
    """
    gains = jnp.stack([kp, kd], axis=1)
    loop = jnp.einsum("aq,iaqb->iab", gains, G)
    return jnp.linalg.inv(jnp.eye(kp.shape[0])[None] + loop)


def effective_inertias(plant: LinearPlant) -> jax.Array:
    """Inertias of the joints against forces within a physics step [kg or kg m^2], (joints,)."""
    return plant.step / jnp.diagonal(plant.velocities @ plant.B)
