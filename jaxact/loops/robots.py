"""A robot as a specification describes it: posture, joints, setpoint motion, what varies.

Made once for each compiled kernel, from what is static; the values of the samples come later.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jaxact import files
from jaxact.errors import UserError
from jaxact.loops import bodies, joint_ranges
from jaxact.loops.joint_ranges import RANGES
from jaxact.loops.specification import Plant
from jaxact.parameters import (
    DELAY,
    FORCE_LIMIT,
    KD,
    KP,
    OF_MODEL,
    PARAMETERS,
    SETPOINT_DELAY,
    WN,
    ZETA,
    base,
)
from jaxact.robots import friction as _friction
from jaxact.robots import model as _model
from jaxact.robots import posture as _posture
from jaxact.robots.model import Robot
from jaxact.robots.posture import Posture

_BROUGHT = {
    KP: KP,
    KD: KD,
    WN: "natural_frequency",
    ZETA: "damping_ratio",
    DELAY: DELAY,
    SETPOINT_DELAY: SETPOINT_DELAY,
}


# The posture settled last: it takes a simulation, and is asked for several times.
_POSTURES: dict[tuple[str, Plant], Posture] = {}


@dataclass(frozen=True)
class Scene:
    """A robot in its start posture.

    Attributes:
        robot: as it was read.
        posture: where it starts.
        payload_body: number of the body that carries a payload.
    """

    robot: Robot
    posture: Posture
    payload_body: int

    @property
    def names(self) -> tuple[tuple[str, str], ...]:
        """Names of each driven joint and of its actuator, which patterns match."""
        return tuple((joint.name, joint.actuator) for joint in self.robot.joints)

    @property
    def carrier(self) -> str:
        """Name of the body that carries a payload, or its number in words."""
        return bodies.label(self.robot, self.payload_body)

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of each driven joint."""
        return tuple(joint.name for joint in self.robot.joints)

    @property
    def positions(self) -> np.ndarray:
        """Of the driven joints in the posture [m or rad], shape (joints,)."""
        return self.posture.joints(self.robot)


def scene(plant: Plant) -> Scene:
    """The robot of a specification, read and placed.

    Raises:
        UserError: the file, the keyframe, a pattern or a body is wrong, or the robot does not come
            to rest.
    """
    robot = driven(plant)
    key = (robot.digest, plant)
    if key not in _POSTURES:
        find = _posture.settled if plant.posture == "settled" else _posture.given
        _POSTURES.clear()
        _POSTURES[key] = find(robot)
    return Scene(robot, _POSTURES[key], bodies.payload_body(robot, plant.payload_body))


def driven(plant: Plant) -> Robot:
    """The robot of a specification, all of whose actuators can be driven.

    Raises:
        UserError: one cannot, and as `read`.
    """
    robot = files.once_read(plant, lambda: read(plant))
    _model.demand(robot, "mujoco")
    return robot


def read(plant: Plant) -> Robot:
    """The robot of a specification, with the gains of its file where it names one.

    Raises:
        UserError: the model, the keyframe, a pattern or the file of gains is wrong.
    """
    robot = _model.read(
        plant.model,
        keyframe=plant.keyframe,
        joints=plant.joints,
        base=plant.base,
        damping=plant.damping,
        settle=plant.posture == "settled",
    )
    if plant.gains is None:
        return robot
    from jaxact.gains import applying  # with YAML's reader, which few need

    return applying.applied(robot, plant.gains)


def linearised(scene: Scene, plant: Plant | None) -> Scene:
    """The robot as margins and growth rates see it: without dry friction, unless it is "stuck"."""
    if plant is None or plant.friction == "stuck":
        return scene
    robot, posture = _friction.moving(scene.robot, scene.posture)
    return replace(scene, robot=robot, posture=posture)


# Beyond its range by more than this share of it, a joint is held by its limit: one that rests
# against a stop is so by less.
BEYOND = 0.01


def at_stops(robot: Robot, qpos: np.ndarray) -> tuple[str, ...]:
    """The driven joints that a configuration has outside their ranges, where limits hold them.

    What their drives do, and bear, is not seen there: a limit is as stiff as the joint is weak.

    Args:
        robot: from `jaxact.robots.model.read`.
        qpos: as MuJoCo orders it.

    Returns:
        Of each its name, where it is, and its range.
    """
    return tuple(
        told for told, beyond, width in beyond_ranges(robot, qpos) if beyond > BEYOND * width
    )


def beyond_ranges(robot: Robot, qpos: np.ndarray) -> list[tuple[str, float, float]]:
    """How far beyond its range each driven joint with a limit is.

    Args:
        robot: from `jaxact.robots.model.read`.
        qpos: as MuJoCo orders it.

    Returns:
        Of each its name, where it is and its range in words; how far beyond, negative within the
        range; and the width of the range [m or rad].
    """
    model = robot.model
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_LIMIT:
        return []
    found = []
    for joint in robot.joints:
        low, high = model.jnt_range[joint.joint]
        if model.jnt_limited[joint.joint]:
            told = f"{joint.name} ({qpos[joint.qpos]:.3g}; range {low:.3g} to {high:.3g})"
            beyond = max(low - qpos[joint.qpos], qpos[joint.qpos] - high)
            found.append((told, float(beyond), float(high - low)))
    return found


def keyframes_within(robot: Robot) -> list[str]:
    """The keyframes of the model that have no driven joint outside its range; name or number."""
    model = robot.model
    return [
        model.key(index).name or str(index)
        for index in range(model.nkey)
        if not at_stops(robot, model.key_qpos[index])
    ]


def held_by_limits(stopped: Sequence[str]) -> str:
    """In words, of joints from `at_stops`."""
    more = len(stopped) - 1
    if not more:
        they = "is outside its range at this posture and held there by its limit"
        return f"{stopped[0]} {they}, so what its drive bears is not seen"
    they = "are outside their ranges at this posture and held there by their limits"
    return f"{stopped[0]} and {more} more {they}, so what their drives bear is not seen"


def keyframe_advice(names: Sequence[str]) -> str:
    """What to do about it; names of keyframes that have every joint within its range."""
    if not names:
        return "the model needs a keyframe that has every joint within its range"
    return f"give a posture: `keyframe` {' or '.join(map(shlex.quote, names))}"


def matched(scene: Scene, key: str) -> np.ndarray:
    """Which driven joints a key such as `kp@.*_knee` is meant for, shape (joints,).

    Raises:
        UserError: none matches.
    """
    pattern = key.partition("@")[2]
    which = [any(re.fullmatch(pattern, name) for name in names) for names in scene.names]
    if not any(which):
        raise UserError(f"{key}: matches no driven joint; they are {', '.join(scene.labels)}")
    return np.array(which)


def brought(scene: Scene) -> dict[str, np.ndarray]:
    """What the model brings of the drive's parameters, shape (joints,); NaN where nothing.

    Ranges that are no parameters (`jaxact.loops.joint_ranges.RANGES`) are there where it has any.
    """
    found = {}
    for name in OF_MODEL:
        if name == FORCE_LIMIT:
            limits = [
                np.inf if joint_ranges.one_sided(joint) else joint.force_high
                for joint in scene.robot.joints
            ]
            found[name] = np.array(limits, float)
            continue
        own = np.array([getattr(joint, _BROUGHT[name]) for joint in scene.robot.joints], float)
        if name not in (KP, KD):
            own = np.where(np.isnan(own), PARAMETERS[name].default, own)
        found[name] = own
    return found | joint_ranges.of(scene.robot, scene.positions)


def check(scene: Scene, keys: Sequence[str], given: set[str]) -> None:
    """Every key of a specification matches a joint, and every joint gets gains.

    Args:
        scene: the robot.
        keys: of parameters for some joints.
        given: parameters that are given for all joints.

    Raises:
        UserError: otherwise.
    """
    covered = {name: np.zeros(len(scene.labels), bool) for name in (KP, KD)}
    for key in keys:
        which = matched(scene, key)
        if base(key) in covered:
            covered[base(key)] |= which
    own = brought(scene)
    for name, which in covered.items():
        if name in given:
            continue
        missing = np.flatnonzero(np.isnan(own[name]) & ~which)
        if missing.size:
            joint = scene.robot.joints[int(missing[0])]
            raise UserError(
                f"{name}: joint '{joint.name}' needs one, its actuator in the model "
                f"({joint.kind}) brings none; give {name}, or {name}@{joint.name} (in Python "
                f"{name}={{{joint.name!r}: ...}})"
            )


def check_values(scene: Scene, keys: Sequence[str], along: Mapping[str, np.ndarray]) -> None:
    """As `check`, and what varies does so for some joint.

    Args:
        scene: the robot.
        keys: of parameters for some joints; later ones win over earlier ones.
        along: values by key, any shape.

    Raises:
        UserError: as `check`, or later keys have all the joints of one that varies, which would
            change nothing.
    """
    check(scene, keys, {name for name, values in along.items() if not np.isnan(values).any()})
    every = np.full(len(scene.labels), True)
    left = {base(key): every for key in keys}
    for key in (*reversed(keys), *left):
        which = matched(scene, key) if "@" in key else every
        free, missing = left[base(key)], np.isnan(along[key])
        known = along[key][~missing]
        if known.size and known.min() < known.max() and not (which & free).any():
            others = [one for one in keys if base(one) == base(key) and one != key]
            raise UserError(
                f"{key}: varies, and changes no joint, since {' and '.join(others)} has each of"
                " them; vary that instead, or leave one of the two out"
            )
        if not missing.any():
            left[base(key)] = free & ~which


def check_integrator(scene: Scene) -> None:
    """The model's integrator has positions and velocities apart, so that it can be corrected for.

    Raises:
        UserError: otherwise.
    """
    if scene.robot.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        raise UserError(
            "integrator_correction: the model integrates with RK4, which needs none; drop it"
        )


def each_joint(
    values: Mapping[str, Any], defaults: Mapping[str, np.ndarray], masks: Mapping[str, np.ndarray]
) -> dict[str, Any]:
    """The parameters of one sample, those of a drive for each joint.

    Args:
        values: by key, shape () each; NaN where the model's own counts.
        defaults: from `brought`.
        masks: from `matched`, of every key for some joints, in order: JAX sorts those of `values`.

    Returns:
        By name, shape () or (joints,), with the ranges of the joints. Later keys win over earlier
        ones.
    """
    found: dict[str, Any] = {name: defaults[name] for name in RANGES if name in defaults}
    for name in (key for key in values if "@" not in key):
        value = values[name]
        if name in defaults:
            value = jnp.where(jnp.isnan(value), jnp.asarray(defaults[name], value.dtype), value)
        found[name] = value
    for key in sorted((key for key in values if "@" in key), key=[*masks].index):
        value, which = values[key], masks[key]
        found[base(key)] = jnp.where(which & ~jnp.isnan(value), value, found[base(key)])
    return found


def of_drives(plant: Plant, values: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters of a robot's drives, apart from its posture; shapes as of `each_joint`.

    Args:
        plant: the robot's.
        values: by key, shape () each; NaN where the model's own counts.

    Raises:
        UserError: as `driven` and `check`.
    """
    robot = driven(plant)
    placed = Scene(robot, _posture.given(robot), bodies.payload_body(robot, None))
    keys = [key for key in values if "@" in key]
    given = {
        key for key, value in values.items()
        if isinstance(value, jax.core.Tracer) or not np.any(np.isnan(value))
    }  # fmt: skip
    check(placed, keys, given)
    masks = {key: matched(placed, key) for key in keys}
    known = {key: jnp.asarray(value, float) for key, value in values.items()}
    return each_joint(known, brought(placed), masks)


def spread(
    along: Mapping[str, np.ndarray], defaults: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Smallest and largest finite value that occurs of each parameter, and infinity if it does.

    Args:
        along: values by key, any shape; NaN where the model's own counts.
        defaults: from `brought`.

    Returns:
        By name, shape (3,): smallest, largest, largest or infinity; the ranges of the joints as
        they are.
    """
    found: dict[str, list[np.ndarray]] = {}
    for key, values in along.items():
        parts = found.setdefault(base(key), [])
        if np.isnan(values).any() and key in defaults:
            parts.append(defaults[key])
        parts.append(np.ravel(values))
    ranges = {name: defaults[name] for name in RANGES if name in defaults}
    return {name: _extremes(np.concatenate(parts)) for name, parts in found.items()} | ranges


def _extremes(values: np.ndarray) -> np.ndarray:
    finite = values[np.isfinite(values)]
    ends = (finite.min(), finite.max()) if finite.size else (np.inf, np.inf)
    return np.array([*ends, np.inf if np.isinf(values).any() else ends[1]])
