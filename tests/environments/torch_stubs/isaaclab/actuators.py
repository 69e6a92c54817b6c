"""Signatures of Isaac Lab 2.3: actuator_base.py, actuator_pd.py, actuator_cfg.py of its actuators.

`Articulation` builds actuators with `cfg.class_type(cfg, joint_names=..., joint_ids=...,
num_envs=..., device=..., stiffness=..., ...)`, calls `reset` with its environments, and `compute`
before every physics step.
"""

import re
from dataclasses import MISSING

import torch

from isaaclab.utils import configclass


@configclass
class IdealPDActuatorCfg:
    class_type: type = MISSING
    joint_names_expr: list[str] = MISSING
    effort_limit: dict[str, float] | float | None = None
    stiffness: dict[str, float] | float | None = MISSING
    damping: dict[str, float] | float | None = MISSING


class IdealPDActuator:
    def __init__(
        self, cfg, joint_names, joint_ids, num_envs, device, stiffness=0.0, damping=0.0,
        armature=0.0, friction=0.0, dynamic_friction=0.0, viscous_friction=0.0,
        effort_limit=torch.inf, velocity_limit=torch.inf,
    ):  # fmt: skip
        self.cfg, self._num_envs, self._device = cfg, num_envs, device
        self._joint_names, self._joint_indices = joint_names, joint_ids
        self.stiffness = self._parse_joint_parameter(cfg.stiffness, stiffness)
        self.damping = self._parse_joint_parameter(cfg.damping, damping)
        self.effort_limit = self._parse_joint_parameter(cfg.effort_limit, effort_limit)
        self.computed_effort = torch.zeros(num_envs, self.num_joints, device=device)
        self.applied_effort = torch.zeros_like(self.computed_effort)

    @property
    def num_joints(self):
        return len(self._joint_names)

    def _parse_joint_parameter(self, cfg_value, default_value):
        value = torch.zeros(self._num_envs, self.num_joints, device=self._device)
        if isinstance(cfg_value, dict):
            for pattern, number in cfg_value.items():
                meant = [bool(re.fullmatch(pattern, name)) for name in self._joint_names]
                value[:, torch.tensor(meant)] = number
        else:
            value[:] = default_value if cfg_value is None else cfg_value
        return value
