"""A MuJoCo model as a plant, simulated in MJX.

Each motor on a slide or hinge joint is one driven joint: the drive's force goes through the motor,
so that gears and limits in the model keep their meaning. Other actuators are refused.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jaxact.drive import Force
from jaxact.errors import UserError

SLIDE = Path(__file__).with_name("slide.xml")
"""The first model: one slide joint with a motor, the mass of the study's loop."""


@contextlib.contextmanager
def _without_warp_notice() -> Iterator[None]:
    """MJX prints that the optional Warp is missing; keep that, and only that, off the screen."""
    captured = io.StringIO()
    with contextlib.redirect_stdout(captured):
        yield
    for line in captured.getvalue().splitlines():
        if not line.startswith(("Failed to import warp", "Failed to import mujoco_warp")):
            print(line, file=sys.stdout)


with _without_warp_notice():
    from mujoco import mjx


@dataclass(frozen=True)
class MjxState:
    """What MJX integrates; everything else in its data follows from it.

    Attributes:
        qpos, qvel, act: positions, velocities and actuator states as MuJoCo orders them.
        warmstart: accelerations the constraint solver starts from.
        time: [s].
    """

    qpos: jax.Array
    qvel: jax.Array
    act: jax.Array
    warmstart: jax.Array
    time: jax.Array


@dataclass(frozen=True)
class MjxPlant:
    """A MuJoCo model in MJX; build it with `load`.

    Attributes:
        model: the compiled model on the device.
        data: template that a state is filled into.
        mass: [kg] given to the driven body instead of the model's own, or None.
        qpos, dofs, actuators: where the driven joints are; static.
        gears: of the motors; static.
        bodies: bodies that the driven joints move; static.
    """

    model: Any
    data: Any
    mass: jax.Array | float | None
    qpos: tuple[int, ...]
    dofs: tuple[int, ...]
    actuators: tuple[int, ...]
    gears: tuple[float, ...]
    bodies: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the joint quantities: (joints,)."""
        return (len(self.dofs),)

    def with_mass(self, mass: jax.Array | float) -> MjxPlant:
        """The plant with another mass [kg] of the body that the first driven joint moves."""
        return replace(self, mass=mass)

    def prepare(self, step: jax.Array) -> MjxPlant:
        """The plant with its time step set to `step` [s] and its mass, if given, filled in."""
        model = self.model.tree_replace({"opt.timestep": step})
        if self.mass is not None:
            body = self.bodies[0]
            ratio = self.mass / model.body_mass[body]
            difference = self.mass - model.body_mass[body]
            model = model.replace(
                body_mass=model.body_mass.at[body].set(self.mass),
                body_inertia=model.body_inertia.at[body].multiply(ratio),
                body_subtreemass=model.body_subtreemass.at[np.array([0, body])].add(difference),
            )
        return replace(self, model=model, mass=None)

    def init(self, position: jax.Array, velocity: jax.Array) -> MjxState:
        """State of the template with the driven joints placed, [m or rad] and per second."""
        data = self.data
        joints = (len(self.dofs),)
        return MjxState(
            qpos=data.qpos.at[np.array(self.qpos)].set(jnp.broadcast_to(position, joints)),
            qvel=data.qvel.at[np.array(self.dofs)].set(jnp.broadcast_to(velocity, joints)),
            act=data.act,
            warmstart=data.qacc_warmstart,
            time=jnp.zeros_like(data.time),
        )

    def measure(self, state: MjxState) -> tuple[jax.Array, jax.Array]:
        """Positions [m or rad] and velocities of the driven joints, shape (joints,)."""
        return state.qpos[np.array(self.qpos)], state.qvel[np.array(self.dofs)]

    def advance(self, state: MjxState, force: Force) -> MjxState:
        """One MJX step under the mean force, with the model's own integrator."""
        ctrl = self.data.ctrl.at[np.array(self.actuators)].set(
            force.mean / np.array(self.gears, force.mean.dtype)
        )
        data = self.data.replace(
            qpos=state.qpos,
            qvel=state.qvel,
            act=state.act,
            qacc_warmstart=state.warmstart,
            time=state.time,
            ctrl=ctrl,
        )
        # MJX multiplies matrices by vectors as NumPy allows; a user may have forbidden that.
        with jax.numpy_rank_promotion("allow"):
            data = mjx.step(self.model, data)
        return MjxState(data.qpos, data.qvel, data.act, data.qacc_warmstart, data.time)

    def between(
        self, before: MjxState, after: MjxState, force: Force, offset: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """State `offset` [s] into a step: cubic Hermite position, linear velocity.

        For a smooth motion the error is of fourth order in the step for the position and of second
        order for the velocity, on top of the integrator's own.
        """
        step = self.model.opt.timestep
        (q0, v0), (q1, v1) = self.measure(before), self.measure(after)
        s = offset / step
        rise = s * s * (3.0 - 2.0 * s)
        position = q0 + rise * (q1 - q0) + step * s * (1.0 - s) * ((1.0 - s) * v0 - s * v1)
        return position, v0 + s * (v1 - v0)


jax.tree_util.register_dataclass(
    MjxState, data_fields=["qpos", "qvel", "act", "warmstart", "time"], meta_fields=[]
)
jax.tree_util.register_dataclass(
    MjxPlant,
    data_fields=["model", "data", "mass"],
    meta_fields=["qpos", "dofs", "actuators", "gears", "bodies"],
)


_MOTOR = (
    int(mujoco.mjtGain.mjGAIN_FIXED),
    int(mujoco.mjtBias.mjBIAS_NONE),
    int(mujoco.mjtDyn.mjDYN_NONE),
)
_SINGLE = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))


def _driven(model: mujoco.MjModel, name: str) -> list[tuple[int, int]]:
    """(actuator, joint) pairs of all motors, or a refusal that names what is in the way."""
    pairs = []
    for index in range(model.nu):
        label = f"{name}: actuator '{model.actuator(index).name or index}'"
        if int(model.actuator_trntype[index]) != int(mujoco.mjtTrn.mjTRN_JOINT):
            raise UserError(f"{label} does not act on a joint; only joint motors can be driven")
        kinds = (
            int(model.actuator_gaintype[index]),
            int(model.actuator_biastype[index]),
            int(model.actuator_dyntype[index]),
        )
        if kinds != _MOTOR:
            raise UserError(
                f"{label} is not a plain motor; replace it by <motor>, the drive brings its own "
                "gains and dynamics"
            )
        if model.actuator_delay[index] > 0.0 or model.actuator_history[index, 0] > 0:
            raise UserError(
                f"{label} has a delay of its own, which MJX would ignore; remove it from the model "
                "and give it to the drive as `delay`"
            )
        if model.actuator_gear[index, 0] * model.actuator_gainprm[index, 0] == 0.0:
            raise UserError(f"{label} has a gear or gain of 0 and can give no force")
        joint = int(model.actuator_trnid[index, 0])
        if int(model.jnt_type[joint]) not in _SINGLE:
            raise UserError(f"{label} acts on a ball or free joint; only slide and hinge joints")
        pairs.append((index, joint))
    if not pairs:
        raise UserError(f"{name}: the model has no motor, so there is nothing to drive")
    return pairs


def compile_model(path: Path) -> mujoco.MjModel:
    """Compile an MJCF or URDF file.

    Raises:
        UserError: the file is missing or MuJoCo refuses it; with MuJoCo's reason in one line.
    """
    if not path.is_file():
        raise UserError(f"{path}: no such model file")
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise UserError(f"{path}: MuJoCo cannot compile this model: {reason}") from error


def digest(path: Path) -> str:
    """A fingerprint of what a model file compiles to, with all that it includes.

    Raises:
        UserError: as `compile_model`.
    """
    model = compile_model(path)
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()


def load(path: Path = SLIDE) -> MjxPlant:
    """Load a model for MJX.

    Args:
        path: MJCF or URDF file.

    Returns:
        The plant, in the precision that JAX has at this moment.

    Raises:
        UserError: the file is missing, does not compile, has an actuator that is not a motor on a
            slide or hinge joint, or uses a feature that MJX does not have.
    """
    model = compile_model(path)
    pairs = _driven(model, path.name)
    try:
        with jax.numpy_rank_promotion("allow"):
            on_device = mjx.put_model(model, impl="jax")
            data = mjx.put_data(model, mujoco.MjData(model), impl="jax")
    except NotImplementedError as error:
        raise UserError(f"{path}: MJX cannot simulate this model: {error}") from error
    joints = [joint for _, joint in pairs]
    gains = [model.actuator_gear[i, 0] * model.actuator_gainprm[i, 0] for i, _ in pairs]
    return MjxPlant(
        model=on_device,
        data=data,
        mass=None,
        qpos=tuple(int(model.jnt_qposadr[joint]) for joint in joints),
        dofs=tuple(int(model.jnt_dofadr[joint]) for joint in joints),
        actuators=tuple(actuator for actuator, _ in pairs),
        gears=tuple(float(gain) for gain in gains),
        bodies=tuple(int(model.jnt_bodyid[joint]) for joint in joints),
    )
