"""A robot's result as files: a small TOML, and the gains as MuJoCo position actuators."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxact import __version__
from jaxact.loops import robots, toml
from jaxact.parameters import base
from jaxact.robots import elements
from jaxact.tuning.goal import OBJECTIVES
from jaxact.tuning.robot.loops import Situation
from jaxact.tuning.robot.tuned import RobotTuned
from jaxact.tuning.robot.uncertainty import OF_BODY
from jaxact.tuning.rollouts.exposure import exposed
from jaxact.tuning.rollouts.validation import Validation, validate


@dataclass(frozen=True)
class Held:
    """Gains held against nonlinear rollouts, in every situation with every member.

    duration: of each rollout [s]
    after, before: by name of the situation; `before` is empty without a start
    """

    duration: float
    after: Mapping[str, Validation]
    before: Mapping[str, Validation]

    @property
    def stable(self) -> tuple[int, int]:
        """How many of the rollouts with the tuned gains were stable, and of how many."""
        return counted(self.after)


def counted(rollouts: Mapping[str, Validation]) -> tuple[int, int]:
    """How many rollouts were stable, and of how many."""
    verdicts = [one.stable for one in rollouts.values()]
    return sum(int(v.sum()) for v in verdicts), sum(v.size for v in verdicts)


def hold(tuned: RobotTuned, duration: float, factor: float = 1.0) -> Held:
    """Simulate the gains before and after with everything that the drives have.

    duration: of each rollout [s]
    factor: on all gains
    """
    pairs = {"after": (tuned.kp, tuned.kd)} | ({"before": tuned.before} if tuned.before else {})
    found: dict[str, dict[str, Validation]] = {"after": {}, "before": {}}
    for place, one in enumerate(tuned.situations):
        fraction = tuned.loops.fraction[tuned.loops.situation == place]
        asked = {one.name: exposed(one.specification, duration=duration)}
        for name, (kp, kd) in pairs.items():
            columns = one.columns(fraction)
            found[name][one.name] = validate(asked, factor * kp, factor * kd, columns)
    return Held(duration, found["after"], found["before"])


def units(tuned: RobotTuned) -> tuple[str, str]:
    """Units of kp and kd: of hinges, of slides, or of both."""
    rotary = np.unique(np.concatenate([one.rotary for one in tuned.situations]))
    if rotary.size > 1:
        return "N/m or N m/rad", "N s/m or N m s/rad"
    return ("N m/rad", "N m s/rad") if rotary[0] else ("N/m", "N s/m")


def objective_unit(tuned: RobotTuned) -> str:
    """Unit of the objective's value."""
    return units(tuned)[0] if tuned.goal.figure == "kp" else OBJECTIVES[tuned.goal.objective][2]


def worst(tuned: RobotTuned, *, before: bool = False) -> dict[str, dict[str, Any]]:
    """Figures of the worst loop of each situation, by its name; None where a loop is unstable."""
    found = tuned.exact_before if before else tuned.exact
    assert found is not None
    rows: dict[str, dict[str, Any]] = {}
    for place, one in enumerate(tuned.situations):
        own = tuned.loops.situation == place
        row: dict[str, Any] = {"growth_rate": float(found.growth_rate[own].max())}
        row["unstable_members"] = int((~found.stable[own]).sum())
        for name, log in found.log.items():
            end = np.min if name == "disk_margin" else np.max
            row[name] = float(np.exp(end(log[own]))) if found.stable[own].all() else None
        rows[one.name] = row
    return rows


def box(tuned: RobotTuned) -> dict[str, Any]:
    """What was uncertain: the ends of every parameter by key, over all situations.

    And, where the body of the robot was, whose setpoint and feedforward are meant.
    """
    found: dict[str, Any] = {}
    for one in tuned.situations:
        for key, low, high in zip(one.keys, one.low, one.high, strict=True):
            known = found.get(key, [low, high])
            found[key] = [float(min(low, known[0])), float(max(high, known[1]))]
    if "payload" in found:
        found["payload_body"] = tuned.situations[0].payload_body
    if any(base(key) in OF_BODY for key in found):
        found["setpoint_and_feedforward"] = "of the nominal robot"
    return found


def document(tuned: RobotTuned, held: Held | None, command: str = "") -> dict[str, Any]:
    """The result as tables of plain values.

    held: against rollouts, None if it was not
    command: that made it
    """
    import jax
    import mujoco

    goal, certificate = tuned.goal, tuned.certificate
    assumed: dict[str, Any] = {
        "situations": [one.name for one in tuned.situations],
        "models": [_model(one) for one in tuned.situations],
        "control_period": tuned.situations[0].period,
        "loops": len(tuned.loops),
    }
    assumed |= box(tuned)
    asked = {name: getattr(goal, name) for name in goal.active}
    asked |= {"min_kp": goal.min_kp} if goal.min_kp > 0 else {}
    if tuned.tracked is not None:
        asked["tracking_weight"] = tuned.tracked.weight
    asked |= {"max_kp": goal.max_kp} if math.isfinite(goal.max_kp) else {}
    guaranteed: dict[str, Any] = {
        "certified": tuned.certified,
        "verdict": tuned.verdict,
        "stable": certificate.stable,
        "binding": list(certificate.binding),
    }
    guaranteed |= {f"worst_{check.figure}": check.value for check in certificate.checks}
    simulated: dict[str, Any] = {}
    if tuned.tracked is not None:
        simulated = {"tracking_rms": tuned.tracked.rms}
    if held is not None:
        stable, of = held.stable
        simulated |= {"duration": held.duration, "stable": stable, "rollouts": of}
    return {
        **({"command": command} if command else {}),
        "kp": dict(zip(tuned.groups.joints, map(float, tuned.kp), strict=True)),
        "kd": dict(zip(tuned.groups.joints, map(float, tuned.kd), strict=True)),
        "groups": {
            name: [j for j, own in zip(tuned.groups.joints, tuned.groups.members, strict=True)
                   if own == number]
            for number, name in enumerate(tuned.groups.names)
        },
        "objective": {"name": goal.objective, "unit": objective_unit(tuned), "value": tuned.value},
        "asked": asked,
        "assumed": assumed,
        "guaranteed": guaranteed,
        **({"simulated": simulated} if simulated else {}),
        "versions": {"jaxact": __version__, "jax": jax.__version__, "mujoco": mujoco.__version__},
    }  # fmt: skip


def _model(one: Situation) -> str:
    """Name of the file; where it lies is the user's own."""
    plant = one.specification.plant
    assert plant is not None
    return plant.model.name


def toml_text(tuned: RobotTuned, held: Held | None, command: str = "") -> str:
    """The result as TOML; arguments as for `document`."""
    return toml.dumps(document(tuned, held, command))


def mjcf_text(tuned: RobotTuned) -> str:
    """MuJoCo position actuators with the gains, in place of the model's own.

    The drives' lag and delay are not in them: MuJoCo's own are something else.
    """
    plant = tuned.situations[0].specification.plant
    assert plant is not None
    return elements.actuators(robots.scene(plant).robot, tuned.kp, tuned.kd)
