"""The actuators of an environment's model, taken over by a drive.

The environment keeps its model: what it reads there (limits of the action, gains) stays. Only the
physics steps are taken with a copy in which the driven actuators are motors, whose force at the
joint, gear G and control u, is G clip(u, forcerange).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from jaxact.drive.controller import Setpoint
from jaxact.errors import UserError
from jaxact.robots import selection
from jaxact.robots.actuators import FORCE, POSITION, VELOCITY, Law, UndrivableError, law
from jaxact.robots.selection import Driven

_FAR = 1e30  # a range of the control that nothing reaches
_FEEDFORWARD_INPUT = int(mujoco.mjtCtrlInput.mjINPUT_FF)


@dataclass(frozen=True)
class Actuators:
    """The driven actuators, in the order of their controls; arrays of shape (joints,).

    Attributes:
        names: of their joints.
        controls: places among the controls.
        indices: places among the actuators.
        outputs: places of their forces, of which an actuator may have several.
        joints: ids of their joints.
        positions, velocities: addresses of their joints in qpos and qvel.
        commands: of each "position", "velocity" or "force": what its control asks for.
        shared: whether gravity compensation acts on the joint through its own limit as well, or
            another actuator, so that the limit is not the drive's.
        pids: of each whether it is a pid, whose input is the setpoint and has no gain of its own.
        biased: whether MuJoCo adds a bias to the force.
    """

    names: tuple[str, ...]
    controls: np.ndarray
    indices: np.ndarray
    outputs: np.ndarray
    joints: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    commands: tuple[str, ...]
    shared: np.ndarray
    pids: np.ndarray
    biased: np.ndarray

    def _are(self, kind: str) -> np.ndarray:
        return np.array([one == kind for one in self.commands])

    def moments(self, model: Any) -> Any:
        """Joint force for a unit force of each actuator, of a model of MuJoCo or MJX."""
        return model.actuator_gear[self.outputs, 0]

    def gains(self, model: Any) -> tuple[Any, Any]:
        """Kp and kd at the joints that the model has now, 0 of motors [N m/rad, N m s/rad]."""
        square = self.moments(model) ** 2
        bias = model.actuator_biasprm[self.indices]
        servo = 1.0 - self._are(FORCE)
        return (0.0 - bias[:, 1]) * square * servo, (0.0 - bias[:, 2]) * square * servo

    def setpoint(self, model: Any, control: Any, numeric: Any, damping: Any = 0.0) -> Setpoint:
        """What a control asks of the joints: positions, velocities or forces.

        Args:
            model: of MuJoCo or MJX, which may be traced.
            control: all controls, shape (nu,).
            numeric: module of arrays, `numpy` or `jax.numpy`.
            damping: that kd has beside the servos' own [N s/m or N m s/rad], shape (joints,): the
                same force at rest then asks for a slower velocity.
        """
        control = numeric.clip(control[self.controls], *self._accepted(model, numeric))
        moment = self.moments(model)
        gain, offset = self._input(model, numeric)
        bias = model.actuator_biasprm[self.indices]
        asked = gain * control + offset
        stiff, damp = self._are(POSITION), self._are(VELOCITY)
        return Setpoint(
            position=numeric.where(stiff, asked / numeric.where(stiff, -bias[:, 1] * moment, 1), 0),
            velocity=numeric.where(
                damp, asked * moment / numeric.where(damp, damping - bias[:, 2] * moment**2, 1), 0
            ),
            force=numeric.where(self._are(FORCE), asked * moment, 0),
        )

    def _input(self, model: Any, numeric: Any) -> tuple[Any, Any]:
        """Gain g and bias b0 of what a control u asks for, g u + b0."""
        gain, bias = model.actuator_gainprm[self.indices, 0], model.actuator_biasprm[self.indices]
        offset = bias[:, 0]
        if self.pids.any():
            gain = numeric.where(self.pids, -bias[:, 1], gain)
        if not self.biased.all():
            offset = numeric.where(self.biased, offset, 0.0)
        return gain, offset

    def _accepted(self, model: Any, numeric: Any) -> tuple[Any, Any]:
        """Range that MuJoCo clamps the controls to, +-inf where there is none."""
        return _range(self._clamped(model), model.actuator_ctrlrange[self.controls], numeric)

    def _clamped(self, model: Any) -> np.ndarray:
        """Whether MuJoCo clamps the controls."""
        return model.actuator_ctrllimited[self.controls].astype(bool) & _clamps(model)

    def forces(self, model: Any, numeric: Any) -> tuple[Any, Any]:
        """Lowest and highest force at the joints that the model allows the actuators now.

        By `forcerange`, of motors also by what their `ctrlrange` lets be asked for, and by the
        joint's `actuatorfrcrange` where that is the drive's alone.

        Args:
            model: of MuJoCo or MJX, which may be traced.
            numeric: module of arrays, `numpy` or `jax.numpy`.

        Returns:
            [N or N m], +-inf where there is no limit, each of shape (joints,).
        """
        at, asked, moment = self.indices, self.controls, self.moments(model)
        gain, offset = self._input(model, numeric)
        motors = self._clamped(model) & self._are(FORCE)
        alone = model.jnt_actfrclimited[self.joints].astype(bool) & ~self.shared
        ranges = (
            _range(model.actuator_forcelimited[at], model.actuator_forcerange[at], numeric, moment),
            _range(
                motors, model.actuator_ctrlrange[asked], numeric, gain * moment, offset * moment
            ),
            _range(alone, model.jnt_actfrcrange[self.joints], numeric),
        )
        lows, highs = zip(*ranges, strict=True)
        return functools.reduce(numeric.maximum, lows), functools.reduce(numeric.minimum, highs)

    def as_motors(self, model: Any, *, damping: bool) -> dict[str, Any]:
        """The fields of a model in which the driven actuators are motors.

        Args:
            model: of MuJoCo or MJX, which may be traced.
            damping: the joints' own damping is taken out.
        """
        at = self.indices
        gain, bias = model.actuator_gainprm, model.actuator_biasprm
        own = {"gain": np.eye(1, gain.shape[1]), "viscous": np.eye(1, bias.shape[1], 2)}
        viscous = (bias[at, 2] * self._are(FORCE))[:, None] * own["viscous"]
        found = {
            "actuator_gainprm": _with(gain, at, own["gain"]),
            "actuator_biasprm": _with(bias, at, viscous),
            "actuator_ctrlrange": _with(model.actuator_ctrlrange, self.controls, [-_FAR, _FAR]),
        }
        if self.pids.any():
            kinds, fixed = model.actuator_gaintype, int(mujoco.mjtGain.mjGAIN_FIXED)
            found["actuator_gaintype"] = _with(kinds, self.indices[self.pids], fixed)
        if damping:
            found["dof_damping"] = _with(model.dof_damping, self.velocities, 0.0)
        return found


def _with(values: Any, places: np.ndarray, new: Any) -> Any:
    """A copy of an array, of NumPy or JAX, with other values at some places."""
    if isinstance(values, np.ndarray):
        values = values.copy()
        values[places] = new
        return values
    return values.at[places].set(new)


def _range(
    limited: Any, bounds: Any, numeric: Any, scale: Any = 1.0, offset: Any = 0.0
) -> tuple[Any, Any]:
    """Ends of `offset + scale x` for x within bounds of shape (joints, 2); +-inf where none."""
    one, other = offset + scale * bounds[:, 0], offset + scale * bounds[:, 1]
    low, high = numeric.minimum(one, other), numeric.maximum(one, other)
    return numeric.where(limited, low, -np.inf), numeric.where(limited, high, np.inf)


def find(model: mujoco.MjModel, patterns: Sequence[str], where: str) -> Actuators:
    """The actuators of the joints that patterns choose.

    Args:
        model: of the environment.
        patterns: as for `jaxact.robot`.
        where: the environment, in messages.

    Raises:
        UserError: no joint matches, or an actuator is not one that a drive can take over; its joint
            is named.
    """
    found = []
    for index in selection.chosen(Path(where), model, patterns):
        name = selection.names_of(model, index)[-1]
        try:
            own = law(model, index, "actuator")
        except UndrivableError as refusal:
            raise UserError(f"{where}: {name}: {refusal.finding.advice}") from None
        _demand_plain(model, own, f"{where}: {name}")
        found.append(own)
    taken = [one.joint for one in found]
    for one in found:
        if taken.count(one.joint) > 1:
            name = model.joint(one.joint).name
            raise UserError(f"{where}: {name}: several actuators act on it; drive other `joints`")
    controls = np.array([model.actuator_ctrladr[one.index] for one in found])
    indices = np.array([one.index for one in found])
    return Actuators(
        names=tuple(model.joint(one.joint).name for one in found),
        controls=controls,
        indices=indices,
        outputs=model.actuator_outadr[indices],
        joints=np.array(taken),
        positions=np.array([model.jnt_qposadr[one.joint] for one in found]),
        velocities=np.array([model.jnt_dofadr[one.joint] for one in found]),
        commands=tuple(one.commands for one in found),
        shared=np.array([selection.shares(model, Driven(one, ())) for one in found]),
        pids=model.actuator_gaintype[indices] == mujoco.mjtGain.mjGAIN_PID,
        biased=model.actuator_biastype[indices] != mujoco.mjtBias.mjBIAS_NONE,
    )


def _demand_plain(model: mujoco.MjModel, own: Law, where: str) -> None:
    """Raise UserError for an actuator with dynamics of its own, or not on a joint itself."""
    kind = mujoco.mjtTrn(model.actuator_trntype[own.index])
    if kind not in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
        raise UserError(f"{where}: its actuator pulls on a tendon; drive other `joints`")
    dynamics = {
        "an integrator": own.integrated,
        "a filter": own.lag > 0.0,
        "a delay": own.delay > 0.0,
        "a velocity input": own.velocity_scale != 0.0,
        "a feedforward input": bool(model.actuator_ctrlspec[own.index] & _FEEDFORWARD_INPUT),
    }
    for what, there in dynamics.items():
        if there:
            raise UserError(
                f"{where}: its actuator has {what} of its own; take it out of the model, or drive"
                " other `joints`"
            )


def _clamps(model: Any) -> bool:
    """Whether a model of MuJoCo or MJX clamps controls at all."""
    return not int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
