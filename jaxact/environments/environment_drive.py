"""The drive of an environment: its parameters, their ranges, and what a reset draws of them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jaxact.drive import options as _options
from jaxact.drive import threefry
from jaxact.drive.controller import Setpoint
from jaxact.drive.options import Drive, DriveOptions
from jaxact.environments import actuators as _actuators
from jaxact.environments.actuators import Actuators
from jaxact.errors import UserError, nearest, shown
from jaxact.loops import given as _given
from jaxact.loops import torque_speed
from jaxact.loops.checks import OF_VELOCITY, check_velocity
from jaxact.loops.conversion import drive_of
from jaxact.loops.joint_ranges import HIGHEST_FORCE, LOWEST_FORCE
from jaxact.parameters import (
    BIASES,
    COMMAND_RESOLUTION,
    CONTROL_RATE,
    DELAYS,
    ERRORS,
    FEEDFORWARD,
    FORCE_LIMIT,
    GAIN_SCALE,
    KD,
    KP,
    LIMITS,
    MEASUREMENT_DELAY,
    NOISES,
    PARAMETERS,
    POLICY_RATE,
    POSITION_RESOLUTION,
    VELOCITY_FILTER,
    VELOCITY_RESOLUTION,
    WALKS,
    WN,
    ZETA,
    canonical,
)
from jaxact.robots.actuators import FORCE, POSITION

_OWN = (KP, KD)  # of the model where they are not given
_TAKEN = (
    *_OWN, GAIN_SCALE, FEEDFORWARD, WN, ZETA, *DELAYS, *LIMITS, *ERRORS, VELOCITY_FILTER,
    COMMAND_RESOLUTION, CONTROL_RATE,
)  # fmt: skip
_NOT_OF_A_DRIVE = "is not a parameter of a drive; leave it out, the environment has its own"
_REFUSED = {
    POLICY_RATE: "follows from the environment, which holds an action for its own step; leave it"
    " out, and change that step",
}
# What changes a force only by way of gains, which motors have none of unless kd is given.
_FELT_BY_GAINS = (
    GAIN_SCALE, MEASUREMENT_DELAY, POSITION_RESOLUTION, VELOCITY_RESOLUTION, *NOISES, *BIASES,
    *WALKS, VELOCITY_FILTER,
)  # fmt: skip
_ROUNDING = 1e-6
_VELOCITIES = ("sampled", "differenced")
_DAMPING = ("joint", "drive")


@dataclass(frozen=True)
class EnvironmentDrive:
    """A drive around the actuators of an environment's model.

    Attributes:
        actuators: that it drives.
        low, high: ends of each parameter's range by short name, shape () or (joints,); alike where
            it does not vary; kp and kd NaN where the model's own count.
        within: lowest and highest force of a file of gains where they differ by direction, beside
            the model's, +-inf for none, shape (joints,) each; None of no joint.
        options: static side, for the longest delays.
        physics_step: of the environment [s].
        damping: the joints' own damping is part of kd.
        each_joint: the joints' parameters are drawn apart; else one number for all of them.
    """

    actuators: Actuators
    low: Mapping[str, np.ndarray]
    high: Mapping[str, np.ndarray]
    within: tuple[np.ndarray, np.ndarray] | None
    options: DriveOptions
    physics_step: float
    damping: bool
    each_joint: bool

    @property
    def varied(self) -> tuple[str, ...]:
        """The parameters that have a range."""
        return tuple(
            name for name in self.low if np.any(_known(self.low[name]) != _known(self.high[name]))
        )

    @property
    def draws(self) -> int:
        """How many numbers are drawn at a reset."""
        return len(self.varied) * (len(self.actuators.names) if self.each_joint else 1)

    def draw(self, key: jax.Array) -> jax.Array:
        """Numbers between 0 and 1 that choose the parameters, shape (draws,)."""
        return threefry.uniform(jax.random.key_data(key), self.draws, jnp.result_type(float))

    def values(self, draws: jax.Array, model: Any) -> dict[str, Any]:
        """The parameters that were drawn, by short name, and the range of force of the model.

        Args:
            draws: from `draw`.
            model: of MuJoCo or MJX, which brings the gains and limits; may be traced.

        Returns:
            Each of shape () or (joints,); the force limit no larger than the model's.
        """
        joints = len(self.actuators.names) if self.each_joint else 1
        shares = draws.reshape(len(self.varied), joints)
        found: dict[str, Any] = {}
        for name, end in self.low.items():
            if name in self.varied:
                share = shares[self.varied.index(name)]
                share = share if self.each_joint else share[0]
                found[name] = end + share * (self.high[name] - end)
            else:
                found[name] = end
        kp, kd = self.actuators.gains(model)
        if self.damping:
            kd = kd + model.dof_damping[self.actuators.velocities]
        scale = found.pop(GAIN_SCALE)
        for name, own in ((KP, kp), (KD, kd)):
            found[name] = scale * jnp.where(jnp.isnan(found[name]), own, found[name])
        low, high = self.actuators.forces(model, jnp)
        if self.within is not None:
            low, high = jnp.maximum(low, self.within[0]), jnp.minimum(high, self.within[1])
        limit = jnp.minimum(found[FORCE_LIMIT], jnp.maximum(-low, high))
        by_direction = {LOWEST_FORCE: low, HIGHEST_FORCE: high}
        return {POLICY_RATE: np.inf, **found, FORCE_LIMIT: limit, **by_direction}

    def setpoint(self, model: Any, control: Any, numeric: Any) -> Setpoint:
        """What a control asks of the joints, of kd with the joints' own damping where it has that.

        Args:
            model: of MuJoCo or MJX, which may be traced.
            control: all controls, shape (nu,).
            numeric: module of arrays, `numpy` or `jax.numpy`.
        """
        if not self.damping:
            return self.actuators.setpoint(model, control, numeric)
        own = np.isnan(self.low[KD]) * model.dof_damping[self.actuators.velocities]
        return self.actuators.setpoint(model, control, numeric, own)

    def drive(self, draws: jax.Array, model: Any) -> Drive:
        """The drive that was drawn; arguments as for `values`."""
        return drive_of(self.values(draws, model))

    def ticks(self, substeps: int) -> int:
        """Control periods in so many physics steps.

        Raises:
            UserError: they are not a whole number.
        """
        ticks, rest = divmod(substeps, self.options.substeps)
        if rest or not ticks:
            period = self.options.substeps * self.physics_step
            raise UserError(
                f"control_rate: the environment's step of {substeps * self.physics_step:g} s is not"
                f" a multiple of the control period {period:g} s; give a faster control_rate"
            )
        return ticks


def _known(values: np.ndarray) -> np.ndarray:
    return np.nan_to_num(values, nan=-1.0)


def build(
    model: mujoco.MjModel,
    where: str,
    parameters: Mapping[str, Any],
    *,
    joints: str | Sequence[str],
    gains: str | Path | None,
    damping: str,
    velocity: str,
    each_joint: bool,
) -> EnvironmentDrive:
    """The drive of an environment.

    Args:
        model: of the environment.
        where: its name, in messages.
        parameters: by either name, or `actuator`: a number, a range (low, high), an array of shape
            (joints,), or a table of patterns of joints -> number or range.
        joints: patterns of the driven ones.
        gains: file of gains, None for the model's; what is given of a parameter counts instead,
            joint by joint.
        damping: "joint" or "drive".
        velocity: that the controller sees, "sampled" or "differenced".
        each_joint: as for `EnvironmentDrive`.

    Raises:
        UserError: a parameter or an actuator that cannot be driven, or a control period that does
            not fit the physics step.
    """
    for name, value, known in (("damping", damping, _DAMPING), ("velocity", velocity, _VELOCITIES)):
        if value not in known:
            raise UserError(f"`{name}` = {shown(value)}; {nearest(value, known)}")
    if not isinstance(each_joint, bool):
        raise UserError(f"`each_joint` = {shown(each_joint)}; allowed: True, False")
    found = _actuators.find(model, _given.patterns_of(joints), where)
    step = float(model.opt.timestep)
    defaults = {name: np.asarray(PARAMETERS[name].default, float) for name in _TAKEN}
    defaults |= dict.fromkeys(_OWN, np.asarray(np.nan)) | {CONTROL_RATE: np.asarray(1.0 / step)}
    within = None
    if gains is not None:
        of_file, within = _of_file(gains, model, found)
        defaults, _ = ranges(of_file, found.names, defaults)
    low, high = ranges(parameters, found.names, defaults)
    demand_fitting(low, high, velocity)
    _demand_setpoints(found, np.fmax(abs(low[KP]), abs(high[KP])), where)
    _demand_felt(found, low, high, where, damped=damping == "drive")
    substeps = _substeps(low[CONTROL_RATE], high[CONTROL_RATE], step)
    own = np.zeros(len(found.names))
    longest = {name: np.fmax(low[name], high[name]) for name in low}
    # a part that may occur at either end exists, the longest delays first
    ends = {
        name: np.stack([np.broadcast_to(side, own.shape) for side in (longest[name], low[name])])
        for name in low
    }
    # limits may come into a model later: the drive has a place for them in any case
    ends |= dict(zip((LOWEST_FORCE, HIGHEST_FORCE), found.forces(model, np), strict=True))
    static = {**ends, POLICY_RATE: np.inf, CONTROL_RATE: float(low[CONTROL_RATE])}
    options = _options.options(
        drive_of(static), substeps=substeps, differenced=velocity == "differenced"
    )
    apart = damping == "drive"
    return EnvironmentDrive(found, low, high, within, options, step, apart, each_joint)


def demand_fitting(
    low: Mapping[str, np.ndarray], high: Mapping[str, np.ndarray], velocity: str
) -> None:
    """Raise UserError for what the velocity's sensor of the other kind has."""
    for name in OF_VELOCITY:
        ends = [*np.ravel(low[name]).tolist(), *np.ravel(high[name]).tolist()]
        check_velocity(name, ends, f"`{name}`", differenced=velocity == "differenced")


def _demand_setpoints(found: Actuators, kp: np.ndarray, where: str) -> None:
    """Raise UserError for a stiffness of joints without a setpoint to hold them to."""
    stiff = np.broadcast_to(kp > 0.0, len(found.names))
    for name, commands, one in zip(found.names, found.commands, stiff, strict=True):
        if one and commands != POSITION:
            raise UserError(
                f"{where}: {name}: its actuator asks for a {commands}, so {KP} would be a spring"
                " about position 0; leave it out there, or make it a position servo of the model"
            )


def _demand_felt(
    found: Actuators, low: Mapping[str, np.ndarray], high: Mapping[str, np.ndarray], where: str,
    *, damped: bool,
) -> None:  # fmt: skip
    """Raise UserError for what only gains feel, of joints without any, which would change nothing.

    Args:
        found: the driven actuators; servos have gains, whatever these are in a changed model.
        low, high: ends of each parameter's range.
        where: the environment, in messages.
        damped: the joints' own damping is part of kd.
    """
    kd = np.nan_to_num([low[KD], high[KD]]).any(axis=0)
    gains = np.array([one != FORCE for one in found.commands]) | kd | damped
    for name in _FELT_BY_GAINS:
        default = PARAMETERS[name].default
        given = np.broadcast_to((low[name] != default) | (high[name] != default), gains.shape)
        if given.any() and not (given & gains).any():
            raise UserError(
                f"{where}: `{name}`: changes nothing, as motors have no gains, and observations are"
                " not those of the drive's sensor; leave it out"
            )


def _of_file(
    gains: str | Path, model: mujoco.MjModel, found: Actuators
) -> tuple[dict[str, Any], tuple[np.ndarray, np.ndarray] | None]:
    """Tables of the parameters that a file of gains has, and its limits by direction."""
    from jaxact.gains import applying, reading
    from jaxact.gains.table import FORCE_HIGH, FORCE_LOW, READ, matched

    names = [(name, model.actuator(int(index)).name)
             for name, index in zip(found.names, found.indices, strict=True)]  # fmt: skip
    file = reading.read(gains)
    own = matched(file, names)
    applying.warn_of_unmatched(file.path, own)
    tables = {name: {re.escape(joint): value for joint, value in rows.items()}
              for name, rows in own.parameters.items() if name in READ}  # fmt: skip
    low, high = (
        np.array([own.parameters.get(name, {}).get(joint, far) for joint in found.names])
        for name, far in ((FORCE_LOW, -np.inf), (FORCE_HIGH, np.inf))
    )
    return tables, (low, high) if np.isfinite([low, high]).any() else None


def _substeps(low: np.ndarray, high: np.ndarray, step: float) -> int:
    if low.ndim or high.ndim:
        raise UserError("`control_rate`: give one number; the ticks are the same for all joints")
    if low != high:
        raise UserError("`control_rate`: cannot have a range; the ticks are the same for all")
    ratio = 1.0 / (float(low) * step)
    substeps = round(ratio)
    if substeps < 1 or abs(ratio - substeps) > _ROUNDING * ratio:
        raise UserError(
            f"`control_rate`: its period {1 / low:g} s is not a multiple of the physics step"
            f" {step:g} s; allowed e.g. control_rate = {1 / step:.9g}"
        )
    return substeps


def ranges(
    given: Mapping[str, Any], joints: Sequence[str], own: Mapping[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Both ends of every parameter of a drive.

    Args:
        given: as for `build`.
        joints: names, in their order.
        own: of each parameter that a drive has here, what it is where nothing is given.

    Raises:
        UserError: another parameter, a value that is not allowed, or a pattern that no joint
            matches.
    """
    sides: list[dict[str, np.ndarray]] = []
    for name in given:
        short = canonical(name).partition("@")[0]
        if short in (*own, _given.ACTUATOR):
            continue
        if short in PARAMETERS:
            raise UserError(f"`{name}`: {_REFUSED.get(short, _NOT_OF_A_DRIVE)}")
        raise UserError(_given.unknown(name, own))
    for side in (0, 1):
        ends = {name: np.asarray(value, float) for name, value in own.items()}
        chosen = {name: _end(value, side) for name, value in given.items()}
        for key, value in _given.read(chosen, robot=True).items():
            name, _, pattern = key.partition("@")
            array = np.asarray(value, float)
            if pattern:
                meant = [re.fullmatch(pattern, joint) is not None for joint in joints]
                if not any(meant):
                    raise UserError(f"`{key}`: matches no joint; {', '.join(joints)}")
                array = np.where(meant, array, np.broadcast_to(ends[name], len(meant)))
            elif array.shape not in ((), (len(joints),)):
                raise UserError(
                    f"`{name}`: has shape {array.shape}; give a number, a range (low, high), or an"
                    f" array of one number for each of the {len(joints)} joints"
                )
            ends[name] = array
        sides.append(ends)
    for name, low in sides[0].items():
        high = sides[1][name]
        if np.any(low > high):
            raise UserError(f"`{name}`: its range ends below where it begins; give (low, high)")
        if np.any((low != high) & np.isinf(high)):
            raise UserError(
                f"`{name}`: its range has no end, so nothing can be drawn from it; give a finite"
                " (low, high)"
            )
    line = [sides[0][name] for name in torque_speed.LINE]
    torque_speed.check(line, joints if any(map(np.ndim, line)) else ())
    return sides[0], sides[1]


def _end(value: Any, side: int) -> Any:
    """One end of a range, of a number the number itself."""
    if isinstance(value, Mapping):
        return {key: _end(part, side) for key, part in value.items()}
    if isinstance(value, tuple):
        if len(value) != 2:
            raise UserError(f"{shown(value)}: is not a range; give (low, high)")
        return value[side]
    return value
