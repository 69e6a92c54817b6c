"""What the force acts on: the exact mass, or a MuJoCo model in MJX."""

from jaxact.plants.base import Plant
from jaxact.plants.mass import Mass

__all__ = ["Mass", "Plant"]
