"""The drive as an explicit actuator of Isaac Lab 2.3 and 3.0, which runs before physics steps."""

from __future__ import annotations

from dataclasses import MISSING
from typing import Any

import torch
from isaaclab.actuators import IdealPDActuator, IdealPDActuatorCfg
from isaaclab.sim import SimulationContext
from isaaclab.utils import configclass
from isaaclab.utils.types import ArticulationActions

from jaxact.environments.torch_sources.parameters import DriveParameters
from jaxact.environments.torch_sources.recursion import Drive


class DriveActuator(IdealPDActuator):
    """Joints behind their drives; gains and limits may be randomised as ever."""

    cfg: DriveActuatorCfg

    def __init__(self, cfg: DriveActuatorCfg, *arguments: Any, **named: Any) -> None:
        super().__init__(cfg, *arguments, **named)
        step = float(SimulationContext.instance().get_physics_dt())
        self._drive = Drive(cfg.drive, step, self._num_envs, self.num_joints, self._device)

    def reset(self, env_ids: Any) -> None:
        """Drives of these environments that have not begun, with numbers drawn anew."""
        self._drive.reset(env_ids)

    def compute(
        self, control_action: ArticulationActions, joint_pos: torch.Tensor, joint_vel: torch.Tensor
    ) -> ArticulationActions:
        """The mean forces over the physics step that begins now."""
        self.applied_effort, self.computed_effort = self._drive.step(
            self.stiffness, self.damping, self.effort_limit, control_action.joint_positions,
            control_action.joint_velocities, control_action.joint_efforts, joint_pos, joint_vel,
        )  # fmt: skip
        control_action.joint_efforts = self.applied_effort
        control_action.joint_positions = None
        control_action.joint_velocities = None
        return control_action


@configclass
class DriveActuatorCfg(IdealPDActuatorCfg):
    """PD gains and a force limit as of `IdealPDActuatorCfg`, behind a drive.

    Attributes:
        drive: what lies between the gains and the joint.
    """

    class_type: type = DriveActuator
    drive: DriveParameters = MISSING  # type: ignore[assignment]
