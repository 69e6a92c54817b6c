"""What is given to `jaxact.drive_around`, and to the steps of what it makes, checked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.drive.controller import Setpoint
from jaxact.drive.options import Drive
from jaxact.errors import UserError, shown
from jaxact.loops import checks, torque_speed
from jaxact.loops.control_loop import ControlLoop, demand
from jaxact.loops.simulator import as_numbers
from jaxact.parameters import CONTROL_RATE, SETPOINT

_ROUNDING = 1e-6


def traced(tree: Any) -> bool:
    """Whether JAX traces a leaf of a tree."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def demand_loop(name: str, loop: Any) -> None:
    """Raise UserError for what is not a loop, and for robots whose batch would pass for joints."""
    if isinstance(loop, Drive):
        return
    demand(loop, name)
    if loop.kind.plant is not None and loop.shape:
        raise UserError(
            f"{name}: a batch of robots of shape {loop.shape}; give one (several: jax.vmap; "
            'gains per joint: kp={"knee": 80.0})'
        )


def demand_known(loop: ControlLoop | Drive, longest: ControlLoop | Drive | None) -> None:
    """Raise TypeError where the lengths of the delay lines would have to come of traced values."""
    if longest is None and traced(loop):
        raise TypeError(
            "values of the loop are traced: give longest, a loop with the longest delays and with "
            "every part that may occur"
        )
    if traced(longest):
        raise TypeError("values of longest are traced: give it numbers that are known")


def demand_numbers(physics_step: Any, joints: Any) -> None:
    """Raise UserError for a step that no simulator has, and for what is not a number of joints."""
    number = isinstance(physics_step, float | int | np.number | np.ndarray | jax.Array)
    if not number or np.ndim(physics_step) or not 0.0 < float(physics_step) < math.inf:
        raise UserError(
            f"physics_step: {physics_step!r} is not a physics step; give seconds above 0, "
            "e.g. 0.002"
        )
    whole = isinstance(joints, int | np.integer) and not isinstance(joints, bool)
    if joints is not None and not (whole and joints > 0):
        raise UserError(
            f"joints: {joints!r} is not a number of joints; give 1 or more, or None for one "
            "joint without an axis"
        )


def demand_shapes(drive: Drive, shape: tuple[int, ...]) -> None:
    """Raise UserError where a drive's value is neither a number nor of this shape."""
    for path, value in jax.tree_util.tree_flatten_with_path(drive)[0]:
        if jnp.shape(value) not in ((), shape):
            name = jax.tree_util.keystr(path, simple=True, separator=".")
            raise UserError(
                f"loop: its {name} has shape {jnp.shape(value)}; give a number, or an array of "
                f"shape {shape}, one for each of the simulator's joints (several loops: jax.vmap)"
            )


def control_period(drive: Drive, known: Drive, longest: ControlLoop | Drive | None) -> float:
    """The control period [s], as a number that is known.

    Args:
        drive: of the loop; its rate counts, unless it is traced.
        known: the drive of `longest`, or of the loop itself.
        longest: None where it is not given; need not have a rate of its own.

    Raises:
        UserError: there are several rates.
    """
    own = None if traced(drive.control_period) else _one_period(drive)
    other = _one_period(known)
    if own is None:
        return other
    has_one = isinstance(longest, Drive) or (longest is not None and CONTROL_RATE in longest.values)
    if has_one and abs(own - other) > _ROUNDING * own:
        raise UserError(
            f"longest: its control_rate is {1 / other:g} Hz and that of the loop {1 / own:g} Hz; "
            "give both the same control_rate"
        )
    return own


def _one_period(drive: Drive) -> float:
    periods = np.asarray(drive.control_period, float)
    lowest, highest = float(periods.min()), float(periods.max())
    if highest - lowest > _ROUNDING * highest:
        raise UserError(
            f"control_rate: several, from {1 / highest:g} to {1 / lowest:g} Hz, while the joints "
            "of a simulator tick together; give one number"
        )
    return lowest


def substeps_in(period: float, physics_step: float) -> int:
    """Physics steps in a control period [s].

    Raises:
        UserError: they are not a whole number.
    """
    ratio = period / physics_step
    substeps = round(ratio)
    if substeps < 1 or abs(ratio - substeps) > _ROUNDING * ratio:
        raise UserError(
            f"control_rate: its period {period:g} s is not a multiple of the physics step "
            f"{physics_step:g} s; allowed e.g. control_rate = "
            f"{1 / (max(substeps, 1) * physics_step):.9g}"
        )
    return substeps


def demand_policy(drive: Drive, period: float) -> None:
    """Raise UserError for a policy's rate that does not divide the control rate, unless traced."""
    if traced(drive.policy_period):
        return
    for own in np.unique(np.asarray(drive.policy_period, float)).tolist():
        if own > 0.0:  # 0 is that of a policy that gives setpoints at every tick
            checks.check_policy_rate(1.0 / own, 1.0 / period)


def demand_line(drive: Drive, names: Sequence[str]) -> None:
    """Raise UserError for half a torque-speed line of a joint, unless traced.

    Args:
        drive: of the joints, with values of shape () or (joints,).
        names: of the joints; () for a single one, or where they have none.
    """
    line = (drive.actuator.stall_force, drive.actuator.no_load_speed)
    if traced(line):
        return
    count = max(map(np.size, line))
    several = any(map(np.ndim, line))
    torque_speed.check(line, (names or [f"joint {i}" for i in range(count)]) if several else ())


def setpoint_of(value: Any, shape: tuple[int, ...]) -> Setpoint:
    """A setpoint of arrays, from one or from positions alone.

    Raises:
        UserError: it is not of numbers, or of another number of joints.
    """
    if not isinstance(value, Setpoint):
        return Setpoint(_joint_values(SETPOINT, value, shape))
    return Setpoint(
        **{
            name: _joint_values(f"{SETPOINT}.{name}", part, shape)
            for name, part in vars(value).items()
        }
    )


def command_of(value: Any, shape: tuple[int, ...]) -> jax.Array:
    """A past command as an array.

    Raises:
        UserError: it is not of finite numbers, or of another number of joints.
    """
    command = _joint_values("command", value, shape)
    if not isinstance(command, jax.core.Tracer) and not np.isfinite(np.asarray(command)).all():
        raise UserError(f"command: {shown(value)} is not finite; give the force so far, e.g. 0.0")
    return command


def _joint_values(name: str, value: Any, shape: tuple[int, ...]) -> jax.Array:
    array = as_numbers(value)
    if array is None:
        needed = "a number" if not shape else f"a number, or an array of shape {shape}"
        raise UserError(
            f"{name}: {shown(value)}, of type {type(value).__name__}, is not of numbers; "
            f"give {needed}"
        )
    if array.shape not in ((), shape):
        raise UserError(f"{name}: has shape {array.shape}; the joints' is {shape}")
    return array


def demand_key(key: Any) -> None:
    """Raise UserError for what is not one random key."""
    if key is None:
        raise UserError("key: a drive with noise needs one at every step, e.g. jax.random.key(0)")
    kind = getattr(key, "dtype", None)
    typed = kind is not None and jnp.issubdtype(kind, jax.dtypes.prng_key)
    if not typed and kind != np.uint32:
        seed = key if isinstance(key, int | np.integer) else 0
        raise UserError(
            f"key: {shown(key)} is not a random key; give jax.random.key({seed:d}), the same at "
            "every step"
        )
    if np.ndim(key) != (0 if typed else 1):
        raise UserError(
            f"key: keys of shape {np.shape(key)}; give one (several simulators: jax.vmap)"
        )
