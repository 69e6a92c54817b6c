"""Signatures of mjlab 1.6.0: actuator/actuator.py and actuator/pd_actuator.py.

`Entity` builds actuators with `cfg.build(entity, target_ids, target_names)`, calls `initialize`
once the model is compiled, `reset` with its environments, and `compute` before every physics step.
"""

from dataclasses import dataclass

import torch


@dataclass
class ActuatorCmd:
    position_target: torch.Tensor
    velocity_target: torch.Tensor
    effort_target: torch.Tensor
    pos: torch.Tensor
    vel: torch.Tensor


@dataclass(kw_only=True)
class ActuatorCfg:
    target_names_expr: tuple[str, ...]
    armature: float | None = None
    delay_min_lag: int = 0
    delay_max_lag: int = 0


@dataclass(kw_only=True)
class IdealPdActuatorCfg(ActuatorCfg):
    stiffness: float
    damping: float
    effort_limit: float = float("inf")


class IdealPdActuator:
    def __init__(self, cfg, entity, target_ids, target_names):
        self.cfg, self.entity = cfg, entity
        self._target_ids_list, self._target_names = target_ids, target_names

    @property
    def target_names(self):
        return self._target_names

    def initialize(self, mj_model, model, data, device):
        shape = (data.nworld, len(self._target_names))
        self.stiffness = torch.full(shape, self.cfg.stiffness, dtype=torch.float, device=device)
        self.damping = torch.full(shape, self.cfg.damping, dtype=torch.float, device=device)
        self.force_limit = torch.full(
            shape, self.cfg.effort_limit, dtype=torch.float, device=device
        )

    def reset(self, env_ids=None):
        """Of the target's delay buffer, which there is none of here."""
