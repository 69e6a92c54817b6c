"""A result of tuning as files for people and programs: a small TOML and an MJCF snippet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import mujoco
import numpy as np

from jaxact import __version__
from jaxact.loops import robots, toml
from jaxact.parameters import (
    CONTROL_RATE,
    DELAY,
    INERTIA,
    KD,
    KP,
    MASS,
    MEASUREMENT_DELAY,
    OUTPUT_DELAY,
    VELOCITY_FILTER,
)
from jaxact.robots import elements
from jaxact.tuning import report
from jaxact.tuning.result import OfRobot, Tuned

if TYPE_CHECKING:
    from jaxact.tuning.rollouts.tracking import Tracked
    from jaxact.tuning.rollouts.validation import Rollouts


def document(
    tuned: Tuned,
    command: str = "",
    nominal: Mapping[str, Any] | None = None,
    rollouts: Rollouts | None = None,
) -> dict[str, Any]:
    """The result as tables of plain values.

    Args:
        command: that made it.
        nominal: metrics of a joint's nominal loop by name, None where they are not known.
        rollouts: that a robot's gains were held against, None if they were not.
    """
    goal, certificate, robot = tuned.goal, tuned.certificate, tuned.robot
    asked = {name: getattr(goal, name) for name in goal.active}
    asked |= {"min_kp": goal.min_kp} if goal.min_kp > 0 else {}
    if robot is not None and robot.tracked is not None:
        asked["tracking_weight"] = robot.tracked.weight
    asked |= {"max_kp": goal.max_kp} if math.isfinite(goal.max_kp) else {}
    objective = {"unit": tuned.units[2], "value": tuned.value}
    if robot is None:
        objective = {"metric": goal.metric, **objective, "risk": goal.risk}
    guaranteed: dict[str, Any] = {
        "certified": tuned.certified,
        "verdict": tuned.verdict,
        "stable": certificate.stable,
        "binding": list(certificate.binding),
    }
    guaranteed |= {"interrupted": tuned.interrupted} if tuned.interrupted else {}
    guaranteed |= {f"worst_{check.metric}": check.value for check in certificate.checks}
    versions = {"jaxact": __version__, "jax": jax.__version__}
    seen: dict[str, Any]
    if robot is None:
        gains, assumed = {"gains": {KP: tuned.kp, KD: tuned.kd}}, _of_joint(tuned)
        seen = {"nominal": {} if nominal is None else _known(nominal)}
        seen |= {"worst": _known(report.worst(tuned)[""])} if len(tuned.members) > 1 else {}
        seen |= _shown_of_joint(tuned)
    else:
        gains, assumed = _gains(tuned, robot), _of_robot(tuned, robot)
        seen = {"before": _before(tuned, robot), "checks": _checks(tuned)}
        seen |= {"simulated": _simulated(robot.tracked, rollouts)}
        seen |= {"motion": {} if rollouts is None else _moved(tuned, robot, rollouts)}
        versions["mujoco"] = mujoco.__version__
    return {
        **({"command": command} if command else {}),
        **gains,
        "objective": {"name": goal.objective, **objective},
        "asked": asked,
        "assumed": assumed,
        "guaranteed": guaranteed,
        **{name: rows for name, rows in seen.items() if rows},
        "versions": versions,
    }


def _shown_of_joint(tuned: Tuned) -> dict[str, Any]:
    """The start, every constraint, and the loops that they are about, with the tuned gains.

    `jaxact margins --loops` reads the loops: the nominal one of an ensemble, and the worst ones.
    """
    members: Any = tuned.members
    checks = _checks(tuned)
    before = () if tuned.before is None else zip((KP, KD), map(float, tuned.before), strict=True)
    worst = {check["member"] for check in checks}
    rows = [_nominal(tuned)] if tuned.loop is not None and len(members) > 1 else []
    rows += [
        {"name": members.name(index), **_of_member(tuned, members, index)}
        for index in range(len(members))
        if members.name(index) in worst
    ]
    return {"before": dict(before), "checks": checks, "loop": rows}


def _checks(tuned: Tuned) -> list[dict[str, Any]]:
    """Every constraint, and what it is at its worst."""
    return [
        {"metric": c.metric, "bound": c.bound, "value": c.value, "member": c.member, "met": c.met}
        for c in tuned.certificate.checks
    ]


def _nominal(tuned: Tuned) -> dict[str, Any]:
    """The loop that was given, all its delay at the command."""
    from jaxact.loops import conversion
    from jaxact.tuning.joint.ensemble import FIELDS, ensemble

    own = conversion.one(tuned.loop)
    own |= {DELAY: own[DELAY] + own[MEASUREMENT_DELAY] + own[OUTPUT_DELAY]}
    plant: Any = {field: own[short] for short, field in FIELDS.items()}
    sampling = tuned.members.sampling  # type: ignore[union-attr]
    return {"name": "nominal", **_of_member(tuned, ensemble(**plant, sampling=sampling), 0)}


def _of_member(tuned: Tuned, members: Any, index: int) -> dict[str, Any]:
    """A plant with the tuned gains by short name, as a table of loops has it."""
    from jaxact.tuning.joint.ensemble import FIELDS, PARAMETERS

    rotary = tuned.loop is not None and tuned.loop.kind.unit == "rad"
    found = {KP: float(tuned.kp), KD: float(tuned.kd)}
    for short, field in FIELDS.items():
        value = float(getattr(members, field)[index])
        if field in PARAMETERS or value != 0.0:
            found[INERTIA if rotary and short == MASS else short] = value
    sampling = members.sampling
    if sampling.control_period is not None:
        found[CONTROL_RATE] = 1.0 / sampling.control_period
    if sampling.velocity != "sampled":
        found["velocity"] = sampling.velocity
    if math.isfinite(sampling.velocity_filter):
        found[VELOCITY_FILTER] = sampling.velocity_filter
    return found


def _known(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Those of the metrics that have a value."""
    return {name: metrics[name] for name in report.SHOWN if metrics[name] is not None}


def _gains(tuned: Tuned, robot: OfRobot) -> dict[str, Any]:
    groups = robot.case.groups
    shared = {
        name: [j for j, own in zip(groups.joints, groups.members, strict=True) if own == number]
        for number, name in enumerate(groups.names)
    }
    kp, kd = (dict(zip(groups.joints, map(float, k), strict=True)) for k in (tuned.kp, tuned.kd))
    return {KP: kp, KD: kd, "groups": shared}


def _before(tuned: Tuned, robot: OfRobot) -> dict[str, dict[str, float]]:
    """The gains of the start by joint; none without a start."""
    return {
        name: dict(zip(robot.case.groups.joints, map(float, gains), strict=True))
        for name, gains in zip((KP, KD), tuned.before or (), strict=False)
    }


def _of_joint(tuned: Tuned) -> dict[str, Any]:
    """What was assumed of a joint: its parameters, or the ends of their ranges."""
    from jaxact.tuning.joint.ensemble import PARAMETERS, PLANT

    members: Any = tuned.members
    assumed: dict[str, Any] = {"members": len(members)}
    if tuned.loop is not None and tuned.loop.kind.unit is not None:
        assumed["unit"] = tuned.loop.kind.unit
    for name in PLANT:
        values = getattr(members, name)
        if name not in PARAMETERS and not values.any():
            continue
        low, high = float(values.min()), float(values.max())
        assumed[name] = low if low == high else [low, high]
    sampling = members.sampling
    if sampling.control_period is not None:
        assumed |= {"control_period": sampling.control_period, "velocity": sampling.velocity}
    if math.isfinite(sampling.velocity_filter):
        assumed |= {"velocity": sampling.velocity, VELOCITY_FILTER: sampling.velocity_filter}
    return assumed


def _of_robot(tuned: Tuned, robot: OfRobot) -> dict[str, Any]:
    plants = [one.specification.plant for one in robot.situations]
    return {
        "situations": [one.name for one in robot.situations],
        # Where the files lie is the user's own.
        "models": [plant.model.name for plant in plants if plant is not None],
        "control_period": robot.situations[0].period,
        "loops": len(tuned.members),
        **report.box(robot.situations),
    }


def _simulated(tracked: Tracked | None, rollouts: Rollouts | None) -> dict[str, Any]:
    simulated: dict[str, Any] = {} if tracked is None else {"tracking_rms": tracked.rms}
    if rollouts is not None:
        stable, of = rollouts.stable
        simulated |= {"duration": rollouts.duration, "stable": stable, "rollouts": of}
    return simulated


def _moved(tuned: Tuned, robot: OfRobot, rollouts: Rollouts) -> dict[str, str]:
    """Which rollout is kept joint by joint, and what became of it with which gains."""
    name, member = rollouts.shown
    loops = robot.case.table.loops
    place = [one.name for one in robot.situations].index(name)
    own = np.flatnonzero(loops.situation == place)[member]
    unit = {"N m/rad": "rad", "N/m": "m"}.get(tuned.units[0], "rad or m")
    return {"member": loops.name(int(own)), "unit": unit, **rollouts.verdicts}


def toml_text(tuned: Tuned, command: str = "", **seen: Any) -> str:
    """The result as TOML; arguments as for `document`."""
    return toml.dumps(document(tuned, command, **seen))


def mjcf_text(tuned: Tuned, joint: str = "joint") -> str:
    """MuJoCo position actuators with the gains, of a robot in place of the model's own.

    The drives' lag and delay are not in them: MuJoCo's own are something else.

    Args:
        joint: name of a single joint.
    """
    if tuned.robot is not None:
        plant = tuned.robot.situations[0].specification.plant
        assert plant is not None
        return elements.actuators(robots.scene(plant).robot, tuned.kp, tuned.kd)
    return (
        "<mujoco>\n  <actuator>\n"
        f'    <position name="{joint}" joint="{joint}" kp="{tuned.kp!r}" kv="{tuned.kd!r}"/>\n'
        "  </actuator>\n</mujoco>\n"
    )
