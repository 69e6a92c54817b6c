"""The drive as an actuator of mjlab 1.6: `compute` runs before every physics step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from mjlab.actuator import ActuatorCmd, IdealPdActuator, IdealPdActuatorCfg

from jaxact.environments.torch_sources.parameters import DriveParameters
from jaxact.environments.torch_sources.recursion import Drive


@dataclass(kw_only=True)
class DriveActuatorCfg(IdealPdActuatorCfg):
    """PD gains and a force limit as of `IdealPdActuatorCfg`, behind a drive.

    Its `delay_min_lag` and `delay_max_lag` delay targets as ever, in physics steps.

    Attributes:
        drive: what lies between the gains and the joint.
    """

    drive: DriveParameters = field(default_factory=DriveParameters)

    def build(self, entity: Any, target_ids: list[int], target_names: list[str]) -> DriveActuator:
        """As mjlab asks for it."""
        return DriveActuator(self, entity, target_ids, target_names)


class DriveActuator(IdealPdActuator):
    """Joints behind their drives; `set_gains` and `set_effort_limit` work as ever."""

    def initialize(self, mj_model: Any, model: Any, data: Any, device: str) -> None:
        """After compilation: the drives of all environments."""
        super().initialize(mj_model, model, data, device)
        step, joints = float(mj_model.opt.timestep), len(self.target_names)
        self._drive = Drive(self.cfg.drive, step, data.nworld, joints, device)

    def reset(self, env_ids: torch.Tensor | slice | None = None) -> None:
        """Drives of these environments that have not begun, with numbers drawn anew."""
        super().reset(env_ids)
        self._drive.reset(env_ids)

    def compute(self, cmd: ActuatorCmd) -> torch.Tensor:
        """The mean forces over the physics step that begins now."""
        force, _ = self._drive.step(
            self.stiffness, self.damping, self.force_limit, cmd.position_target,
            cmd.velocity_target, cmd.effort_target, cmd.pos, cmd.vel,
        )  # fmt: skip
        return force
