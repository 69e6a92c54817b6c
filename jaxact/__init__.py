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
    "Actuator": "jaxact.drive.actuator",
    "Controller": "jaxact.drive.controller",
    "Drive": "jaxact.drive.step",
    "JointLoop": "jaxact.analysis.joint.frequency",
    "Loop": "jaxact.loops.loop",
    "Mass": "jaxact.plants.mass",
    "Sensor": "jaxact.drive.sensor",
    "Setpoint": "jaxact.drive.controller",
    "UserError": "jaxact.errors",
    "Verdict": "jaxact.status",
    "continuous_boundary": "jaxact.analysis.boundary.boundary",
    "load_result": "jaxact.sweeping.opening",
    "open_result": "jaxact.sweeping.opening",
    "sampled_boundary": "jaxact.analysis.boundary.boundary",
}

__all__ = sorted([*_PUBLIC, "__version__"])


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'jaxact' has no attribute {name!r}")
    return getattr(importlib.import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return __all__
