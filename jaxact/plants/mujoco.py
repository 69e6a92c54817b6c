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

from jaxact.plants.model import Robot, demand
from jaxact.plants.posture import Posture
from jaxact.plants.silence import silenced


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


class Simulations:
    """Simulations of one robot side by side, all starting in the same posture.

    Args:
        robot: from `jaxact.plants.model.read`.
        posture: to start from.
        step: physics step [s].
        number: of simulations.
        fields: of the model that differ between simulations, by name, shape (number, ...).
        impulse: on a body, or None.
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
        fields: Mapping[str, np.ndarray] | None = None,
        impulse: Impulse | None = None,
        threads: int = 0,
    ) -> None:
        demand(robot, "mujoco")
        self.model = stepped(robot.model, step)
        self._batch = Batch(self.model, number, threads or min(number, _cores()))
        for name, values in (fields or {}).items():
            self._batch.expand(name)[:] = values
        self._posture, self._impulse = posture, impulse
        self._step, self._steps = step, 0
        joints = robot.joints
        self._qpos = [joint.qpos for joint in joints]
        self._dofs = [joint.dof for joint in joints]
        self._actuators = [joint.index for joint in joints]
        self._low = np.array([joint.force_low for joint in joints])
        self._high = np.array([joint.force_high for joint in joints])
        self.qpos, self.qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._ctrl = self._batch.bind("ctrl")
        self._pushed = self._batch.bind("xfrc_applied")

    def start(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """Put all simulations into the posture, their driven joints where they are told to be.

        Args:
            position: [m or rad], shape (number, joints).
            velocity: per second, shape (number, joints).
        """
        self._batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self.qpos[:], self.qvel[:] = self._posture.qpos, self._posture.qvel
        self.qpos[:, self._qpos] = position
        self.qvel[:, self._dofs] = velocity
        self._ctrl[:] = self._posture.ctrl
        if self.model.na:
            self._batch.bind("act")[:] = self._posture.act
        self._steps = 0

    def measure(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities of the driven joints, copies of shape (number, joints)."""
        return self.qpos[:, self._qpos], self.qvel[:, self._dofs]

    def advance(self, force: np.ndarray) -> None:
        """One physics step under these mean joint forces [N or N m], shape (number, joints).

        A simulation that MuJoCo gives up keeps its state, which is not a number from then on.
        """
        self._ctrl[:, self._actuators] = np.clip(force, self._low, self._high)
        if self._impulse is not None:
            self._push(self._impulse)
        try:
            with silenced():
                self._batch.step()
        except SimulationError as error:
            self.qpos[error.ids] = np.nan
            self.qvel[error.ids] = np.nan
        self._steps += 1

    def _push(self, impulse: Impulse) -> None:
        now = self._steps * self._step
        end = impulse.start + impulse.duration
        overlap = min(now + self._step, end) - max(now, impulse.start)
        share = max(overlap, 0.0) / self._step
        self._pushed[:, impulse.body, :3] = share * impulse.force


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def stepped(model: mujoco.MjModel, step: float) -> mujoco.MjModel:
    """A copy of a model with another physics step [s], which never resets a diverged simulation."""
    model = copy.copy(model)
    model.opt.timestep = step
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    return model
