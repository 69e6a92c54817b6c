"""Of isaaclab/utils/types.py."""

from dataclasses import dataclass

import torch


@dataclass
class ArticulationActions:
    joint_positions: torch.Tensor | None = None
    joint_velocities: torch.Tensor | None = None
    joint_efforts: torch.Tensor | None = None
    joint_indices: torch.Tensor | slice | None = None
