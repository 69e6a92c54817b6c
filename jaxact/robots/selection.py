"""Which actuators of a model are driven: chosen by name, one law to a joint."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco

from jaxact.errors import UserError, nearest, shown
from jaxact.robots import actuators
from jaxact.robots.actuators import POSITION, VELOCITY, Law, UndrivableError
from jaxact.robots.findings import EMULATED, Finding, named, refused
from jaxact.robots.parity import switched_off


@dataclass(frozen=True)
class Driven:
    """The actuator that drives a joint, and velocity servos beside it that it takes in."""

    law: Law
    partners: tuple[Law, ...]


def chosen(path: Path, model: mujoco.MjModel, patterns: Sequence[str]) -> list[int]:
    """The actuators that the patterns choose by their own or their joint's name.

    Raises:
        UserError: a pattern is not a regular expression, or matches nothing.
    """
    names = [names_of(model, index) for index in range(model.nactuator)]
    found: set[int] = set()
    for pattern in patterns:
        try:
            matches = re.compile(pattern).fullmatch
        except re.error as error:
            raise UserError(
                f"joints: {shown(pattern)} is not a regular expression: {error}"
            ) from None
        these = {
            i
            for i, pair in enumerate(names)
            if any(map(matches, _matched(model, i))) or pattern in (pair[0], re.escape(pair[0]))
        }
        if not these:
            known = list(dict.fromkeys(pair[-1] for pair in names))
            raise UserError(f"{path}: no joint matches {shown(pattern)}; {nearest(pattern, known)}")
        found |= these
    return sorted(found)


def names_of(model: mujoco.MjModel, index: int) -> tuple[str, ...]:
    """What an actuator can be chosen by: its name, and its joint's if it acts on a single one."""
    own = model.actuator(index).name or f"actuator {index}"
    try:
        joint, _ = actuators.transmission(model, index)
    except UndrivableError:
        return (own,)
    return own, model.joint(joint).name or f"joint {joint}"


def _matched(model: mujoco.MjModel, index: int) -> list[str]:
    """The names among them that patterns are held against: those that the model gives, if any.

    A name that is made for an actuator without one chooses it only as it is written.
    """
    own, *joint = names_of(model, index)
    named = [own] if model.actuator(index).name else []
    return [*named, *joint] or [own]


def patterns_without(model: mujoco.MjModel, indices: Sequence[int]) -> list[str]:
    """Patterns that choose all actuators but these; [] if none is left."""
    names = [_matched(model, index) for index in range(model.nactuator)]
    dropped = list(dict.fromkeys(name for index in indices for name in names[index]))
    wanted = [index for index in range(model.nactuator) if index not in indices]
    if all(set(names[index]) - set(dropped) for index in wanted):
        return [f"(?!({'|'.join(map(re.escape, dropped))})$).*"] if wanted else []
    return [re.escape(names_of(model, index)[0]) for index in wanted]


def laws(
    model: mujoco.MjModel, indices: Sequence[int], kinds: Sequence[str]
) -> tuple[list[Law], list[Finding]]:
    """The laws of these actuators, and why some have none.

    An actuator that the model switches off has no law, and that is not a fault.

    Args:
        kinds: the element that each actuator of the model is written with.
    """
    found, findings = [], []
    for index in indices:
        if switched_off(model, index):
            continue
        try:
            found.append(actuators.law(model, index, kinds[index]))
        except UndrivableError as refusal:
            findings.append(refusal.finding)
    return found, findings


def one_to_a_joint(
    model: mujoco.MjModel, found: Sequence[Law]
) -> tuple[list[Driven], list[Finding]]:
    """One driven law to a joint, in the order of the actuators; and the clashes."""
    driven, clashes = [], []
    for joint in dict.fromkeys(law.joint for law in found):
        first, *others = sorted(
            (law for law in found if law.joint == joint), key=lambda law: law.commands != POSITION
        )
        if all(_adds_damping(first, other) for other in others):
            driven.append(Driven(first, tuple(others)))
            continue
        names = " and ".join(actuators.label(model, law.index) for law in (first, *others))
        clashes.append(
            refused(
                named("joint", model.joint(joint).name, joint),
                "actuators",
                names,
                "adds their forces",
                f"{names} act on it together and are no plain pair of a position and a velocity "
                "servo; choose one of them by name with `joints = [...]`",
            )  # fmt: skip
        )
    return sorted(driven, key=lambda pair: pair.law.index), clashes


def _adds_damping(position: Law, velocity: Law) -> bool:
    """Whether a position servo and a velocity servo on one joint make one PD law exactly."""
    unlimited = all(
        math.isinf(bound)
        for law in (position, velocity)
        for bound in (law.force_low, law.force_high)
    )
    plain = all(law.delay == law.lag == 0.0 for law in (position, velocity))
    return position.commands == POSITION and velocity.commands == VELOCITY and unlimited and plain


def joint_limits(model: mujoco.MjModel, driven: Driven) -> tuple[float, float]:
    """Limits that the joint itself sets for its actuators (`actuatorfrcrange`), +-inf if none.

    They become the drive's, as the actuator's own do, and leave the model. Where other actuators or
    gravity compensation share them with the drive, they are only the model's.
    """
    joint = driven.law.joint
    if not model.jnt_actfrclimited[joint] or shares(model, driven):
        return -math.inf, math.inf
    low, high = model.jnt_actfrcrange[joint]
    return float(low), float(high)


def shares(model: mujoco.MjModel, driven: Driven) -> bool:
    """Whether gravity compensation or another actuator acts on the joint through its limit."""
    joint = driven.law.joint
    if model.jnt_actgravcomp[joint]:
        return True
    own = {law.index for law in (driven.law, *driven.partners)}
    for index in set(range(model.nactuator)) - own:
        try:
            shared = actuators.transmission(model, index)[0] == joint
        except UndrivableError:
            shared = True
        if shared:
            return True
    return False


def shared_limit(model: mujoco.MjModel, driven: Driven) -> list[Finding]:
    """What is said of a joint whose limit its drive shares with other forces."""
    joint = driven.law.joint
    if not model.jnt_actfrclimited[joint] or not shares(model, driven):
        return []
    low, high = model.jnt_actfrcrange[joint]
    others = "gravity compensation" if model.jnt_actgravcomp[joint] else "other actuators"
    return [
        Finding(
            named("joint", model.joint(joint).name, joint), "actuatorfrcrange",
            f"{low:g} {high:g}", "simulates it", EMULATED,
            f"it limits the sum of the drive's force and {others}: motions are those under it, and "
            "the forces that are reported are the drive's own, before it",
        )
    ]  # fmt: skip


def own(model: mujoco.MjModel, law: Law) -> dict[str, float]:
    """Gear of a position servo as MuJoCo's own element has it, and the actuator's own inertia.

    Returns:
        The values of `jaxact.robots.robot.Joint` by name.
    """
    plain = law.commands == POSITION and law.offset == 0.0 and not law.integrated
    servo = plain and math.isclose(law.scale * law.moment, 1.0, rel_tol=1e-9)
    gear = law.moment if servo else 1.0
    ratio = (float(model.actuator_gear[model.actuator_outadr[law.index], 0]) / gear) ** 2
    armature = ratio * float(model.actuator_armature[law.index])
    damping = ratio * float(model.actuator_damping[law.index]) + law.viscous / gear**2
    return {"gear": gear, "own_armature": armature, "own_damping": damping}
