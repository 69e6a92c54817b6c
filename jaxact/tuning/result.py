"""The result as files: a small TOML with what was assumed and guaranteed, and an MJCF snippet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxact import __version__
from jaxact.loops import toml
from jaxact.tuning.goal import OBJECTIVES
from jaxact.tuning.joint import metrics
from jaxact.tuning.joint.ensemble import PARAMETERS
from jaxact.tuning.joint.search import Tuned

# Figure -> whether its largest value is the worst.
_WORST = {
    "sensitivity_peak": True,
    "complementary_peak": True,
    "gain_margin": False,
    "delay_margin": False,
    "disk_margin": False,
}


def worst(tuned: Tuned, *, before: bool = False) -> dict[str, float | None]:
    """Each figure at its worst over all members, exact; None where a member is unstable.

    before: with the gains of the start
    """
    gains = tuned.before if before else (tuned.kp, tuned.kd)
    assert gains is not None
    kp, kd = np.log(gains)
    found = metrics.evaluate(kp, kd, tuned.members, tuned.members.sampling)
    if not found.stable.all():
        return dict.fromkeys(_WORST)
    ends = {name: np.max if large else np.min for name, large in _WORST.items()}
    return {name: float(np.exp(end(found.log[name]))) for name, end in ends.items()}


def document(
    tuned: Tuned, command: str = "", nominal: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The result as tables of plain values.

    command: that made it
    nominal: figures of the nominal loop by name, None where they are not known
    """
    import jax

    goal, certificate = tuned.goal, tuned.certificate
    assumed: dict[str, Any] = {"members": len(tuned.members)}
    for name in PARAMETERS:
        values = getattr(tuned.members, name)
        low, high = float(values.min()), float(values.max())
        assumed[name] = low if low == high else [low, high]
    sampling = tuned.members.sampling
    if sampling.control_period is not None:
        assumed |= {"control_period": sampling.control_period, "velocity": sampling.velocity}
    if math.isfinite(sampling.velocity_filter):
        assumed |= {"velocity_filter": sampling.velocity_filter}
    asked = {name: getattr(goal, name) for name in goal.active}
    asked |= {"min_kp": goal.min_kp} if goal.min_kp > 0 else {}
    asked |= {"max_kp": goal.max_kp} if math.isfinite(goal.max_kp) else {}
    guaranteed: dict[str, Any] = {
        "certified": tuned.certified,
        "verdict": tuned.verdict,
        "stable": certificate.stable,
        "binding": list(certificate.binding),
    }
    guaranteed |= {f"worst_{check.figure}": check.value for check in certificate.checks}
    return {
        **({"command": command} if command else {}),
        "gains": {"kp": tuned.kp, "kd": tuned.kd},
        "objective": {
            "name": goal.objective,
            "figure": goal.figure,
            "unit": OBJECTIVES[goal.objective][2],
            "value": tuned.value,
            "risk": goal.risk,
        },
        "asked": asked,
        "assumed": assumed,
        "guaranteed": guaranteed,
        **({"nominal": _tables(nominal)} if nominal is not None else {}),
        **({"worst": _tables(worst(tuned))} if len(tuned.members) > 1 else {}),
        "versions": {"jaxact": __version__, "jax": jax.__version__},
    }


def _tables(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Those of the figures that have a value."""
    return {name: figures[name] for name in _WORST if figures[name] is not None}


def toml_text(tuned: Tuned, command: str = "", nominal: Mapping[str, Any] | None = None) -> str:
    """The result as TOML; arguments as for `document`."""
    return toml.dumps(document(tuned, command, nominal))


def mjcf_text(tuned: Tuned, joint: str = "joint") -> str:
    """A MuJoCo position actuator with the gains, for the joint of that name.

    The actuator's lag and delay are not in it: MuJoCo's own are something else.
    """
    return (
        "<mujoco>\n  <actuator>\n"
        f'    <position name="{joint}" joint="{joint}" kp="{tuned.kp!r}" kv="{tuned.kd!r}"/>\n'
        "  </actuator>\n</mujoco>\n"
    )
