"""A MuJoCo model as a plant, simulated in MJX.

Every driven joint has a plain motor (`jaxact.robots.model` makes it one), and the drive's force is
the motor's torque. Actuators that are not driven do what they do in the model.
"""

from __future__ import annotations

import copy
import warnings
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jaxact.drive.step import Force
from jaxact.errors import UserError
from jaxact.plants import softness
from jaxact.plants import variation as _variation
from jaxact.plants.linear import hermite
from jaxact.plants.mjx import step as _mjx_step
from jaxact.plants.mjx.step import mjx as mjx
from jaxact.plants.softness import Softness
from jaxact.plants.variation import Variation
from jaxact.robots import model as _model
from jaxact.robots import posture as _posture
from jaxact.robots.model import Robot
from jaxact.robots.posture import Posture

SLIDE = Path(__file__).with_name("slide.xml")
"""The first model: one slide joint with a motor, the mass of the study's loop."""


def put_model(model: mujoco.MjModel) -> tuple[mjx.Model, list[str]]:
    """The model on the device, and what MJX warns of, each warning in one line.

    Raises:
        NotImplementedError: MJX refuses the model.
    """
    with warnings.catch_warnings(record=True) as caught, jax.numpy_rank_promotion("allow"):
        warnings.simplefilter("always", UserWarning)
        on_device = mjx.put_model(model, impl="jax")
    return on_device, [" ".join(str(warning.message).split()) for warning in caught]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MjxState:
    """What MJX integrates; everything else in its data follows from it.

    Attributes:
        qpos, qvel, act: positions, velocities and actuator states as MuJoCo orders them.
        warmstart: accelerations the constraint solver starts from; None without constraints.
        time: [s]; None where nothing depends on it.
    """

    qpos: jax.Array
    qvel: jax.Array
    act: jax.Array
    warmstart: jax.Array | None
    time: jax.Array | None


@dataclass(frozen=True)
class Push:
    """A constant force on a body's centre of mass for a while; its impulse is exact.

    Attributes:
        force: in the world's axes [N], shape (3,).
        start: [s], shape ().
        duration: [s], shape ().
        body: number of the body; static.
    """

    force: jax.Array
    start: jax.Array | float
    duration: jax.Array | float
    body: int


@dataclass(frozen=True)
class MjxPlant:
    """A MuJoCo model in MJX; build it with `load` or `place`.

    Attributes:
        model: the compiled model on the device.
        data: template that a state is filled into, at the start posture.
        mass: [kg] given to the first driven body instead of the model's own, or None.
        variation: what differs from the model.
        softness: what constraints' softness follows from, or None for as in the model.
        push: on a body, or None.
        qpos, dofs, actuators: where the driven joints are; static.
        bodies: bodies that the driven joints move; static.
        payload_body: the body that carries a payload; static.
        kinds: MuJoCo's type of every joint; static.
        impl: what simulates it: "jax", or "warp" (forward only, float32); static.
        corrected: whether the joints' positions are taken half a physics step earlier; static.
            MuJoCo's integrators but RK4 move a position with the velocity at the end of the step,
            which puts it ahead of the velocity by half a step. Without that lead, a free joint
            moves exactly under a force that is constant over each step; see Hairer, Lubich and
            Wanner, Geometric Numerical Integration, section I.1.4.
    """

    model: Any
    data: Any
    mass: jax.Array | float | None
    variation: Variation
    softness: Softness | None
    push: Push | None
    qpos: tuple[int, ...]
    dofs: tuple[int, ...]
    actuators: tuple[int, ...]
    bodies: tuple[int, ...]
    payload_body: int
    kinds: tuple[int, ...]
    impl: str = "jax"
    corrected: bool = False

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the joint quantities: (joints,)."""
        return (len(self.dofs),)

    def with_mass(self, mass: jax.Array | float) -> MjxPlant:
        """The plant with another mass [kg] of the body that the first driven joint moves."""
        return replace(self, mass=mass)

    def prepare(self, step: jax.Array) -> MjxPlant:
        """The plant with its time step set to `step` [s] and everything that varies filled in."""
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
        with jax.numpy_rank_promotion("allow"):
            fields = _variation.changed(
                model,
                self.variation,
                dofs=self.dofs,
                bodies=self.bodies,
                payload_body=self.payload_body,
            )
            if self.softness is not None and softness.DEPENDS.intersection(fields):
                fields |= self.softness.changed(model, fields)
        model = model.replace(**fields)
        return replace(self, model=model, mass=None, variation=Variation(), softness=None)

    def init(self, position: jax.Array, velocity: jax.Array) -> MjxState:
        """State of the start posture with the driven joints placed, [m or rad] and per second."""
        data = self.data
        joints = (len(self.dofs),)
        ahead = position + self._lead(velocity)
        return self.state(
            data.replace(
                qpos=data.qpos.at[np.array(self.qpos)].set(jnp.broadcast_to(ahead, joints)),
                qvel=data.qvel.at[np.array(self.dofs)].set(jnp.broadcast_to(velocity, joints)),
                time=jnp.zeros_like(data.time),
            )
        )

    def state(self, data: Any) -> MjxState:
        """What is to be remembered of MJX's data between two steps."""
        warp = self.impl == "warp"
        solves = warp or _mjx_step.constrained(self.data)
        timed = warp or self.push is not None
        return MjxState(
            data.qpos,
            data.qvel,
            data.act,
            data.qacc_warmstart if solves else None,
            data.time if timed else None,
        )

    def measure(self, state: MjxState) -> tuple[jax.Array, jax.Array]:
        """Positions [m or rad] and velocities of the driven joints, shape (joints,)."""
        velocity = state.qvel[np.array(self.dofs)]
        return state.qpos[np.array(self.qpos)] - self._lead(velocity), velocity

    def _lead(self, velocity: jax.Array) -> jax.Array | float:
        """By what the positions are ahead of the velocities [m or rad], if it is corrected for."""
        return 0.5 * self.model.opt.timestep * velocity if self.corrected else 0.0

    def advance(self, state: MjxState, force: Force) -> MjxState:
        """One MJX step under the mean force, with the model's own integrator."""
        return self.state(self._stepped(self.loaded(state, force)))

    def _stepped(self, data: Any) -> Any:
        if self.impl == "warp":
            from jaxact.plants import warp  # starts from this module's MJX

            with jax.numpy_rank_promotion("allow"):
                return warp.step(self.model, data)
        pushed = () if self.push is None else (self.push.body,)
        return _mjx_step.step(self.model, data, pushed=pushed)

    def loaded(self, state: MjxState, force: Force) -> Any:
        """MJX's data with a state and what acts on it filled in."""
        data = self.data.replace(
            qpos=state.qpos,
            qvel=state.qvel,
            act=state.act,
            ctrl=self.data.ctrl.at[np.array(self.actuators)].set(force.mean),
        )
        if state.warmstart is not None:
            data = data.replace(qacc_warmstart=state.warmstart)
        if state.time is not None:
            data = data.replace(time=state.time)
        if self.push is not None:
            data = data.replace(xfrc_applied=self._pushed(state.time))
        return data

    def _pushed(self, time: jax.Array) -> jax.Array:
        """External forces of the step that begins at `time`, shape (bodies, 6)."""
        push, step = self.push, self.model.opt.timestep
        if push is None:
            return self.data.xfrc_applied
        end = push.start + push.duration
        overlap = jnp.minimum(time + step, end) - jnp.maximum(time, push.start)
        share = jnp.maximum(overlap, 0.0) / step
        return self.data.xfrc_applied.at[push.body, :3].add(share * push.force)

    def between(
        self, before: MjxState, after: MjxState, force: Force, offset: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """State `offset` [s] into a step: cubic Hermite position, linear velocity.

        For a smooth motion the error is of fourth order in the step for the position and of second
        order for the velocity, on top of the integrator's own.
        """
        return hermite(self.measure(before), self.measure(after), offset, self.model.opt.timestep)


jax.tree_util.register_dataclass(
    Push, data_fields=["force", "start", "duration"], meta_fields=["body"]
)
STATIC = (
    "qpos", "dofs", "actuators", "bodies", "payload_body", "kinds", "impl", "corrected",
)  # fmt: skip
"""Fields of a plant that are no arrays."""

jax.tree_util.register_dataclass(
    MjxPlant,
    data_fields=[item.name for item in fields(MjxPlant) if item.name not in STATIC],
    meta_fields=list(STATIC),
)


def load(path: Path = SLIDE, *, keyframe: str | None = None) -> MjxPlant:
    """Load a model for MJX and place it in its start posture, unsettled.

    Args:
        path: MJCF or URDF file.
        keyframe: name of the start posture; None for the model's default.

    Returns:
        The plant, in the precision that JAX has at this moment.

    Raises:
        UserError: the file is missing, does not compile, has an actuator that cannot be driven, or
            uses a feature that MJX does not have.
    """
    robot = _model.demand(_model.read(path, keyframe=keyframe), "mjx")
    return place(robot, _posture.given(robot))


def place(
    robot: Robot,
    posture: Posture,
    *,
    payload_body: int | None = None,
    dry_friction: bool = False,
    impl: str = "jax",
) -> MjxPlant:
    """A robot in MJX, at a start posture.

    Args:
        robot: from `jaxact.robots.model.read`.
        posture: from `jaxact.robots.posture`.
        payload_body: that carries a payload; None for the heaviest body.
        dry_friction: the driven joints' dry friction varies, so it must exist in the model.
        impl: "jax", or "warp".

    Returns:
        The plant, in the precision that JAX has at this moment.

    Raises:
        UserError: the robot uses a feature that MJX does not have, or would ignore; for "warp"
            also, that MJX-Warp is not there.
    """
    _model.demand(robot, "warp" if impl == "warp" else "mjx")
    dofs = tuple(joint.dof for joint in robot.joints)
    model = robot.model
    if dry_friction:
        model = _with_friction(model, dofs)
    start = mujoco.MjData(model)
    start.qpos, start.qvel, start.ctrl = posture.qpos, posture.qvel, posture.ctrl
    if model.na:
        start.act = posture.act
    # Contacts and accelerations of the posture are what the solver starts from.
    start.ctrl[[joint.index for joint in robot.joints]] = posture.force
    mujoco.mj_forward(model, start)
    start.qacc_warmstart = start.qacc
    on_device, data = (_put_in_warp if impl == "warp" else _put)(robot, model, start)
    heaviest = int(np.argmax(model.body_mass))
    return MjxPlant(
        model=on_device,
        data=data,
        mass=None,
        variation=Variation(),
        softness=softness.of(model),
        push=None,
        qpos=tuple(joint.qpos for joint in robot.joints),
        dofs=dofs,
        actuators=tuple(joint.index for joint in robot.joints),
        bodies=tuple(joint.body for joint in robot.joints),
        payload_body=heaviest if payload_body is None else payload_body,
        kinds=tuple(int(kind) for kind in model.jnt_type),
        impl=impl,
    )


def _put(robot: Robot, model: mujoco.MjModel, start: mujoco.MjData) -> tuple[Any, Any]:
    """A robot's model and data in MJX."""
    try:
        on_device, _ = put_model(model)  # `jaxact check` tells of its warnings
        with jax.numpy_rank_promotion("allow"):
            return on_device, mjx.put_data(model, start, impl="jax")
    except NotImplementedError as error:
        from jaxact.plants.mjx import refusals as mjx_refusals  # asks this module's MJX

        reasons = [f"{item.where}: {item.advice}" for item in mjx_refusals.find(model)]
        said = reasons[0] if reasons else f"MJX cannot simulate this model: {error}"
        raise UserError(f"{robot.path.name}: {said}") from error


def _put_in_warp(robot: Robot, model: mujoco.MjModel, start: mujoco.MjData) -> tuple[Any, Any]:
    """A robot's model and data in MJX-Warp."""
    from jaxact.plants import warp  # starts from this module's MJX
    from jaxact.plants.warp_room import room

    try:
        return warp.put(model, start, room(model, start))
    except NotImplementedError as error:
        reason = " ".join(str(error).split()).rstrip(".")
        raise UserError(
            f"{robot.path.name}: MJX-Warp cannot simulate this model: {reason}; choose the engine"
            " `mujoco`"
        ) from error


def _with_friction(model: mujoco.MjModel, dofs: tuple[int, ...]) -> mujoco.MjModel:
    """A copy of the model in which MJX makes room for dry friction of these degrees of freedom."""
    model = copy.copy(model)
    at = list(dofs)
    model.dof_frictionloss[at] = np.maximum(model.dof_frictionloss[at], 1e-9)
    return model
