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
    "boundary": "jaxact.verbs.boundary",
    "check": "jaxact.verbs.check",
    "continuous_boundary": "jaxact.analysis.boundary.boundary",
    "Controller": "jaxact.drive.controller",
    "ControlLoop": "jaxact.loops.control_loop",
    "Drive": "jaxact.drive.step",
    "drive_around": "jaxact.loops.around",
    "environments": "jaxact.environments",
    "export": "jaxact.verbs.export",
    "GainsWarning": "jaxact.errors",
    "Goal": "jaxact.tuning.goal",
    "identify": "jaxact.verbs.identify",
    "joint": "jaxact.loops.building",
    "JointLoop": "jaxact.analysis.joint.frequency",
    "keep_programs": "jaxact.verbs.kept",
    "linear": "jaxact.verbs.sweep",
    "load_result": "jaxact.verbs.results",
    "load_drive": "jaxact.loops.drives",
    "log": "jaxact.verbs.sweep",
    "Loop": "jaxact.loops.loop",
    "loop_of": "jaxact.loops.building",
    "margins": "jaxact.verbs.margins",
    "Mass": "jaxact.plants.mass",
    "plot": "jaxact.verbs.plot",
    "open_result": "jaxact.verbs.results",
    "render": "jaxact.verbs.render",
    "replay": "jaxact.verbs.identify",
    "report": "jaxact.verbs.report",
    "robot": "jaxact.loops.building",
    "sampled_boundary": "jaxact.analysis.boundary.boundary",
    "Sensor": "jaxact.drive.sensor",
    "Setpoint": "jaxact.drive.controller",
    "simulate": "jaxact.verbs.simulate",
    "sweep": "jaxact.verbs.sweep",
    "tune": "jaxact.verbs.tune",
    "InexactWarning": "jaxact.errors",
    "UserError": "jaxact.errors",
    "Verdict": "jaxact.status",
    "widget": "jaxact.verbs.widget",
}

__all__ = sorted([*_PUBLIC, "__version__"])


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        from difflib import get_close_matches  # not needed otherwise

        close = get_close_matches(name, _PUBLIC, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        raise AttributeError(f"module 'jaxact' has no attribute {name!r}{hint}")
    module = importlib.import_module(_PUBLIC[name])
    return getattr(module, name, module)  # `plot` is a module


def __dir__() -> list[str]:
    return __all__
