"""A robot in C MuJoCo: many simulations of one model, stepped on all cores (`mujoco.batch`).

It holds states and steps them under joint forces; the drive is the same as everywhere.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from jaxact.robots.model import Robot, demand
from jaxact.robots.posture import Posture


@dataclass(frozen=True)
class Impulse:
    """A constant force on a body's centre of mass for a while.

    Attributes:
        body: number of the body.
        force: in the world's axes [N], shape (3,).
        start, duration: [s].
    """

    body: int
    force: np.ndarray
    start: float
    duration: float


@dataclass(frozen=True)
class JointPush:
    """Constant forces on the driven joints for a while, others for each simulation.

    Attributes:
        force: [N or N m], shape (number, joints).
        start, duration: [s].
    """

    force: np.ndarray
    start: float
    duration: float


class Simulations:
    """Simulations of one robot side by side, all starting in the same posture.

    Args:
        robot: from `jaxact.robots.model.read`.
        posture: to start from.
        step: physics step [s].
        number: of simulations.
        same: a label for each; those of one label start and are driven alike, and are computed
            once, shape (number,); None if all differ.
        fields: of the model that differ between simulations, by name, shape (number, ...).
        impulse: on a body, or None.
        push: on the joints beside their drives, or None; those of one label share it.
        corrected: whether the joints' positions are taken half a physics step earlier, see
            `jaxact.plants.mjx.plant.MjxPlant`.
        threads: used for stepping; 0 for one on each core that this process may use.

    Raises:
        UserError: the robot uses what cannot be simulated.
    """

    def __init__(
        self,
        robot: Robot,
        posture: Posture,
        step: float,
        number: int,
        *,
        same: np.ndarray | None = None,
        fields: Mapping[str, np.ndarray] | None = None,
        impulse: Impulse | None = None,
        push: JointPush | None = None,
        corrected: bool = False,
        threads: int = 0,
    ) -> None:
        demand(robot, "mujoco")
        self.model = stepped(robot.model, step)
        # Of all that are asked for those that are computed, and where of these each one is.
        self._first, self._back = _distinct(number, same)
        computed = np.arange(number)[self._first].size
        self._batch = Batch(self.model, computed, threads or min(computed, cores()))
        for name, values in (fields or {}).items():
            self._batch.expand(name)[:] = values[self._first]
        self._posture, self._impulse, self._joint_push = posture, impulse, push
        self._step, self._steps = step, 0
        self._lead = 0.5 * step if corrected else 0.0
        joints = robot.joints
        self._places = _together([joint.qpos for joint in joints])
        self._dofs = _together([joint.dof for joint in joints])
        self._actuators = _together([joint.index for joint in joints])
        self._limit = np.array([
            one.force_high if one.force_high == -one.force_low else np.inf for one in joints
        ])  # fmt: skip
        self._rounded = self._limit.astype(np.float32).astype(float)
        self._rounded_up = bool((self._rounded > self._limit).any())
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._ctrl = self._batch.bind("ctrl")
        self._pushed = self._batch.bind("xfrc_applied")
        self._applied = self._batch.bind("qfrc_applied")

    def start(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """Put all simulations into the posture, their driven joints where they are told to be.

        Args:
            position: [m or rad], shape (number, joints).
            velocity: per second, shape (number, joints).
        """
        self._batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self._qpos[:], self._qvel[:] = self._posture.qpos, self._posture.qvel
        ahead = position + self._lead * velocity
        self._qpos[:, self._places] = ahead[self._first]
        self._qvel[:, self._dofs] = velocity[self._first]
        self._ctrl[:] = self._posture.ctrl
        if self.model.na:
            self._batch.bind("act")[:] = self._posture.act
        self._steps = 0

    def measure(self) -> np.ndarray:
        """Positions and velocities of the driven joints, a copy of shape (number, 2, joints)."""
        position, velocity = self._qpos[:, self._places], self._qvel[:, self._dofs]
        found = np.empty((len(position), 2, position.shape[1]))
        found[:, 0], found[:, 1] = position, velocity
        if self._lead:
            found[:, 0] -= self._lead * velocity
        return found[self._back]

    def configuration(self) -> np.ndarray:
        """Of the whole robot, as MuJoCo orders it, a copy of shape (number, nq)."""
        return self._qpos.copy()[self._back]

    def advance(self, force: np.ndarray) -> None:
        """One physics step under these mean joint forces [N or N m], shape (number, joints).

        A simulation that MuJoCo gives up keeps its state, which is not a number from then on.
        MuJoCo warns of it; see `jaxact.robots.silence`.
        """
        self._ctrl[:, self._actuators] = self._within(force[self._first])
        if self._impulse is not None:
            share = self._share(self._impulse.start, self._impulse.duration)
            self._pushed[:, self._impulse.body, :3] = share * self._impulse.force
        if self._joint_push is not None:
            share = self._share(self._joint_push.start, self._joint_push.duration)
            self._applied[:, self._dofs] = share * self._joint_push.force[self._first]
        try:
            self._batch.step()
        except SimulationError as error:
            self._qpos[error.ids] = np.nan
            self._qvel[error.ids] = np.nan
        self._steps += 1

    def _within(self, force: np.ndarray) -> np.ndarray:
        """The forces, none beyond the model's limit by the rounding of a drive in float32."""
        if not self._rounded_up:
            return force
        there = np.abs(force) == self._rounded
        return np.where(there, np.copysign(self._limit, force), force)

    def _share(self, start: float, duration: float) -> float:
        """Of this physics step, the share in which something that lasts so long is there."""
        now = self._steps * self._step
        overlap = min(now + self._step, start + duration) - max(now, start)
        return max(overlap, 0.0) / self._step


def _distinct(
    number: int, same: np.ndarray | None
) -> tuple[np.ndarray | slice, np.ndarray | slice]:
    """First of each kind, and the kind of each; slices where all differ, which copy nothing."""
    if same is not None:
        kinds, first, back = np.unique(same, return_index=True, return_inverse=True)
        if kinds.size < number:
            return first, back
    return slice(None), slice(None)


def _together(places: list[int]) -> list[int] | slice:
    """A slice instead of places that follow on each other: NumPy takes it much faster."""
    ends = places[0], places[-1] + 1
    return slice(*ends) if places == list(range(*ends)) else places


def is_held(robot: Robot, posture: Posture) -> bool:
    """Whether contacts, dry friction, limits or other constraints act in a posture."""
    data = mujoco.MjData(robot.model)
    data.qpos[:] = posture.qpos
    mujoco.mj_fwdPosition(robot.model, data)
    return data.nefc > 0


def cores() -> int:
    """Cores that this process may use, on all of which simulations are stepped."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def stepped(model: mujoco.MjModel, step: float) -> mujoco.MjModel:
    """A copy of a model with another physics step [s], which never resets a diverged simulation."""
    model = copy.copy(model)
    model.opt.timestep = step
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    return model
