"""jaxact: closed-loop stability maps and exact margins for robot joint controllers, in JAX.

The public names below are imported on first use, so that `import jaxact` and `jaxact --help` do not
wait for JAX.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # `typing` takes longer to import than all of this
if TYPE_CHECKING:
    from typing import Any

__version__ = "0.1.0"

# Public name -> the module it lives in.
_PUBLIC = {
    "Actuator": "jaxact.actuator",
    "Controller": "jaxact.controller",
    "Drive": "jaxact.drive",
    "JointLoop": "jaxact.frequency",
    "Loop": "jaxact.loop",
    "Mass": "jaxact.plants.mass",
    "Sensor": "jaxact.sensor",
    "Setpoint": "jaxact.controller",
    "UserError": "jaxact.errors",
    "Verdict": "jaxact.status",
    "continuous_boundary": "jaxact.boundary",
    "load_result": "jaxact.sweep.opening",
    "open_result": "jaxact.sweep.opening",
    "sampled_boundary": "jaxact.boundary",
}

__all__ = sorted([*_PUBLIC, "__version__"])


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'jaxact' has no attribute {name!r}")
    return getattr(importlib.import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return __all__
