"""Other starts of a loop than its own: what its verdict rests on, where it is not linear.

A quantised loop has other motions within a few counts than far away, and other ones where the
setpoint lies on a count than between two; a joint with dry friction rests until it is pushed. So
each such loop also starts from rest towards setpoints that are small in its own scales, the same
ones whatever its own setpoint:

    on        27 counts away, on a count: a large step, after which it may rest
    between   half a count away, between two: a small one, after which a bare mass cannot
    near      1.15 counts away, nearer to one of the two
    drift     where the command has steps: at the setpoint, with a velocity that no whole number of
              them stops
    slide     thirty times the displacement that friction withstands, and a kick
    kick      where nothing else disturbs the loop: a small step, of a robot a kick of its joints
    linear    as `between`, without counts and limits: what noise alone sustains

A count is that of the coarsest quantiser, as `jaxact.simulation.scales.count` has it; where that
is not the encoder's, the small steps are one or two counts longer, so that something comes of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.drive.options import Drive, DriveOptions
from jaxact.parameters import (
    INITIAL_POSITION,
    INITIAL_VELOCITY,
    JOINT_FRICTION,
    MASS,
    POSITION_RESOLUTION,
    REST_AMPLITUDE,
    SETPOINT,
)
from jaxact.simulation import scales, verdicts
from jaxact.simulation.verdicts import Judgement
from jaxact.status import Verdict

if TYPE_CHECKING:
    from jaxact.loops.template import Template
    from jaxact.simulation.kernel import Case

LINEAR = "linear"
"""The start that only says what noise sustains."""

# Whole counts of the encoder; more of a coarser quantiser; and the part of a count beyond. Small
# steps are over soon, and what remains of them is what goes on.
_COUNTS = {"on": (27.0, 27.0, 0.0), "between": (0.0, 2.0, 0.5), "near": (1.0, 2.0, 0.15)}
# A start with a velocity: that which swings one count far, made up to whole steps of the command
# over one control period, and this part of one. Forces of whole steps leave such a part of it for
# ever, while from rest they may bring a mass exactly to rest.
_DRIFT = 0.382
# Most that a count may be, for a robot [m or rad]: 27 of them are a posture of its own.
_MOST = 0.002
# A robot's joints are kicked with this velocity [m/s or rad/s].
_KICK = 0.1
# Multiple of the displacement that dry friction withstands, and the most of it [m or rad].
_SLIDE, _FARTHEST = 30.0, 0.2
# Share of the displacement that commands the force limit, and the most of it [m].
_BELOW_LIMIT, _STEP = 0.1, 0.1
# A limit cycle under noise moves the joint by more than so many times what noise does by itself.
_ABOVE_NOISE = 2.0
# Of a robot without any other scale: what counts as rest where noise never lets a motion end
# [m or rad]; and where only counts do not, this share of one.
_TREMBLE, _OF_A_COUNT = 0.002, 0.1


def needed(
    options: DriveOptions, *, linear_plant: bool, rubs: bool, disturbed: bool
) -> tuple[str, ...]:
    """Names of the starts that the loops of a sweep need beside their own: static.

    Args:
        options: of the drives.
        linear_plant: whether the plant is linear.
        rubs: some joint has dry friction.
        disturbed: every loop is moved by its setpoint, its initial state or a push.

    Returns:
        None for linear loops: their growth rate tells. A limit alone needs none where the loop is
        disturbed.
    """
    if linear_plant and options.additive:
        return ()
    found = [LINEAR] if linear_plant and options.random else []
    if options.quantised:
        found += _COUNTS
        found += ["drift"] * (linear_plant and options.quantised_command)
    if rubs:
        found.append("slide")
    if not (options.quantised or rubs or disturbed):
        found.append("kick")
    return tuple(found)


def steps(case: Case) -> int:
    """Physics steps of one loop, from all its starts."""
    return case.rollout.ticks * case.drive.substeps * (1 + len(case.starts))


def given(
    names: tuple[str, ...], values: Mapping[str, Any], drive: Drive, friction: np.ndarray | None
) -> dict[str, jax.Array]:
    """What the starts replace of a loop's parameters.

    Args:
        names: static, from `needed`, without `LINEAR`.
        values: parameters by name, for each joint where joints differ.
        drive: with these parameters.
        friction: dry friction of a robot's joints [N or N m], shape (joints,); None for no robot.

    Returns:
        Setpoint and initial state, shapes (starts, joints).
    """
    count = scales.count(drive)
    if friction is not None:
        count = jnp.minimum(count, _MOST)
    shape = () if friction is None else friction.shape
    like = jnp.broadcast_to(count, jnp.broadcast_shapes(count.shape, shape))
    sign = _signs(like)
    setpoints, velocities = [], []
    for name in names:
        velocity = jnp.zeros_like(like)
        if name in _COUNTS:
            setpoint = _counted(count, jnp.asarray(values[POSITION_RESOLUTION]), *_COUNTS[name])
        elif name == "drift":
            setpoint, velocity = jnp.zeros_like(like), _drifting(count, values, drive)
        elif name == "slide":
            setpoint, velocity = _slide(values, drive, friction), _KICK * sign
        elif friction is not None:
            setpoint, velocity = jnp.zeros_like(like), _KICK * sign
        else:
            setpoint = jnp.minimum(_BELOW_LIMIT * scales.limit(drive), _STEP)
        setpoints.append(sign * setpoint)
        velocities.append(velocity)
    stacked = jnp.stack(setpoints)
    return {
        SETPOINT: stacked,
        INITIAL_POSITION: jnp.zeros_like(stacked),
        INITIAL_VELOCITY: jnp.stack(velocities),
    }


def _signs(like: jax.Array) -> jax.Array:
    """Directions of the joints, so unequal that legs move neither all alike nor all opposed."""
    joints = jnp.arange(like.size, dtype=like.dtype).reshape(like.shape)
    return jnp.where(jnp.cos(1.7 * joints) < 0.0, -1.0, 1.0).astype(like.dtype)


def _counted(
    count: jax.Array, position: jax.Array, whole: float, coarser: float, beyond: float
) -> jax.Array:
    """A displacement of counts and a part of one, which is the encoder's, if there is one."""
    own = jnp.where(position > 0.0, position, 1.0)
    more = jnp.round(coarser * (count - position) / own)
    return jnp.where(position > 0.0, (whole + more + beyond) * own, (coarser + beyond) * count)


def _drifting(count: jax.Array, values: Mapping[str, Any], drive: Drive) -> jax.Array:
    """A velocity of a bare mass that no whole number of steps of the command stops [m/s].

    v = (n + 0.382) dF T / m,   n the whole part of count sqrt(kp / m) m / (dF T)
    """
    mass = jnp.asarray(values[MASS])
    step = drive.controller.command_resolution * drive.control_period / mass
    swing = count * jnp.sqrt(jnp.abs(jnp.asarray(drive.controller.kp)) / mass)
    whole = jnp.floor(swing / jnp.where(step > 0.0, step, 1.0))
    return jnp.where(step > 0.0, (whole + _DRIFT) * step, swing)


def _slide(values: Mapping[str, Any], drive: Drive, friction: np.ndarray | None) -> jax.Array:
    """A displacement that makes joints slide [m or rad]."""
    held = values[JOINT_FRICTION] + jnp.asarray(0.0 if friction is None else friction)
    stiff = jnp.abs(jnp.asarray(drive.controller.kp))
    away = _SLIDE * held.astype(stiff.dtype) / jnp.where(stiff > 0.0, stiff, 1.0)
    return jnp.where(stiff > 0.0, jnp.minimum(away, _FARTHEST), 0.0)


def without_errors(drive: Drive) -> Drive:
    """The drive without counts and limits; its noise stays."""
    none, zero = jnp.asarray(jnp.inf), jnp.asarray(0.0)
    return replace(
        drive,
        controller=replace(drive.controller, command_resolution=zero),
        sensor=replace(drive.sensor, position_resolution=zero, velocity_resolution=zero),
        actuator=replace(
            drive.actuator, force_limit=none, force_rate_limit=none, stall_force=none,
            no_load_speed=none,
        ),
    )  # fmt: skip


def friction(template: Template) -> np.ndarray | None:
    """Dry friction of a robot's driven joints in its model [N or N m]; None for no robot."""
    if template.scene is None:
        return None
    robot = template.scene.robot
    return robot.model.dof_frictionloss[[joint.dof for joint in robot.joints]].copy()


def rubs(template: Template, values: Mapping[str, Any]) -> jax.Array:
    """Whether a robot has dry friction, of its model or of its joints' parameters, shape ()."""
    if template.scene is None:
        return jnp.asarray(False)
    model = template.scene.robot.model
    own = np.any(model.dof_frictionloss > 0.0) | np.any(model.tendon_frictionloss > 0.0)
    return jnp.asarray(own) | jnp.any(jnp.asarray(values[JOINT_FRICTION]) > 0.0)


def above_noise(rest: jax.Array, sustained: jax.Array, growth_rate: jax.Array) -> jax.Array:
    """Half range that counts as at rest where noise sustains this much in the linear loop."""
    return jnp.where(growth_rate < 0.0, jnp.maximum(rest, _ABOVE_NOISE * sustained), rest)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Outcomes(Judgement):
    """What came of each start of a loop, of all its joints together; each of shape (starts,).

    Attributes:
        joint: number of the one whose amplitude and frequency these are, the one that moves most;
            None where there is but one.
    """

    joint: jax.Array | None = None


def listed(own: Judgement, others: Judgement | None) -> Outcomes:
    """The loop's own start and the others: of several joints the worst."""
    rows = jax.tree.map(lambda leaf: leaf[None], own)
    if others is not None:
        rows = jax.tree.map(lambda *both: jnp.concatenate(both), rows, others)
    return of_joints(rows) if own.verdict.ndim else Outcomes(**vars(rows))


def of_joints(rows: Judgement) -> Outcomes:
    """What the joint that moves most has come to: the last axis is that of the joints."""
    moved = jnp.where(rows.moving, rows.amplitude, -1.0)
    most = jnp.argmax(moved, axis=-1)[..., None]

    def its(leaf: jax.Array) -> jax.Array:
        return jnp.take_along_axis(leaf, most, axis=-1)[..., 0]

    known = jnp.where(verdicts.idle(rows), Verdict.STABLE, rows.verdict)
    return Outcomes(
        verdict=verdicts.worst(known, axis=-1),
        moving=jnp.any(rows.moving, axis=-1),
        resting=jnp.all(rows.resting, axis=-1),
        narrowing=its(rows.narrowing),
        widening=its(rows.widening),
        amplitude=its(rows.amplitude),
        frequency=its(rows.frequency),
        joint=most[..., 0],
    )


def rest_amplitude(
    options: DriveOptions, values: Mapping[str, Any], drive: Drive, *, robot: bool
) -> jax.Array:
    """Half range that counts as at rest, as it is given or by default [m or rad], shape (joints,).

    By default that of a bare joint is 0, and that of a robot 2 mm or mrad; where quantisation acts
    on a robot and noise does not, a tenth of a count if that is less.
    """
    given = jnp.asarray(values[REST_AMPLITUDE])
    usual = jnp.asarray(_TREMBLE if robot else 0.0, given.dtype)
    if robot and options.quantised and not options.random:
        count = scales.count(drive)
        usual = jnp.where(count > 0.0, jnp.minimum(usual, _OF_A_COUNT * count), usual)
    return jnp.where(jnp.isnan(given), usual, given)
