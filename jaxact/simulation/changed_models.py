"""Samples of a robot whose models differ, a payload say: where each rests, linearised there.

It is done in C whatever the engine, sample by sample. The controllers use the nominal model, so
that a changed robot rests elsewhere (`jaxact.robots.rest`), and where depends on its stiffness.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.compilation.programs import building
from jaxact.loops import robots
from jaxact.loops.joint_ranges import HIGHEST_FORCE, LOWEST_FORCE
from jaxact.loops.specification import Setting
from jaxact.parameters import (
    CONTACT_FRICTION,
    FEEDFORWARD,
    FORCE_LIMIT,
    INERTIA_SCALE,
    JOINT_STIFFNESS,
    KP,
    PARAMETERS,
    PAYLOAD,
    STALL_FORCE,
)
from jaxact.plants import linearize
from jaxact.robots import posture as _posture
from jaxact.robots import rest as _rest
from jaxact.robots.rest import Rest, Springs
from jaxact.simulation import kernel, mujoco_batch
from jaxact.simulation.kernel import Case

Values = Mapping[str, np.ndarray]

STATIC = (PAYLOAD, INERTIA_SCALE, JOINT_STIFFNESS)
"""Changes of a model that move where it rests."""

_Row = tuple[float, ...]


def moved(
    case: Case, setting: Setting, values: Values, stiffness: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """A and B of the linear plant of every sample, where the model varies.

    Each is linearised where its own closed loop rests: under a payload that nothing carries,
    contacts would be on the way to somewhere else.

    Args:
        case, setting: static.
        values: of the samples by key, shape (n,) each.
        stiffness: of the joints that it rests with [N/m or N m/rad], shape (joints,), infinite
            where they are held; None for that of each sample.

    Returns:
        Shapes (n, kept, kept) and (n, kept, joints), in the nominal plant's coordinates.
    """
    case, setting = kernel.linear_part(case, setting)
    rows = _rows(case, setting, values, stiffness)
    distinct, places = np.unique(rows, axis=0, return_inverse=True)
    found = [_linear(case, setting, tuple(row.tolist())) for row in distinct]
    which = places.reshape(-1)
    return np.stack([a for a, _ in found])[which], np.stack([b for _, b in found])[which]


def rests(
    case: Case, setting: Setting, values: Values, stiffness: np.ndarray | None = None
) -> list[Rest]:
    """Where every sample rests that its model is linearised at, as `moved`; see there.

    The residual is that of the robot as it is linearised, without dry friction unless that sticks.
    """
    case, setting = kernel.linear_part(case, setting)
    found = []
    for row in _rows(case, setting, values, stiffness):
        own = tuple(row.tolist())
        scene = robots.linearised(_placed(case, setting, own), setting.plant)
        found.append(replace(_resting(case, setting, own), posture=scene.posture))
    return found


def _rows(case: Case, setting: Setting, values: Values, stiffness: np.ndarray | None) -> np.ndarray:
    """What the linear plant of each sample depends on, shape (n, (varied + 4) * joints).

    The changes of the model, then the springs of its joints: infinitely stiff ones where it rests
    as the nominal robot does, so that it is not looked for again for every stiffness.
    """
    changes = np.stack(
        [mujoco_batch.at_joints(case, setting, values, name) for name in case.varied], axis=1
    )
    count, _, joints = changes.shape
    rows = _springs(case, setting, values, joints)
    if stiffness is not None:
        rows[:, 0] = stiffness
    neutral = np.array([PARAMETERS[name].default for name in case.varied])
    static = np.isin(case.varied, STATIC)
    same = (changes == neutral[:, None])[:, static].all(axis=(1, 2))
    held = np.repeat(np.array([[np.inf], [0.0], [-np.inf], [np.inf]]), joints, axis=1)
    stiff = np.isinf(rows[:, 0]).all(axis=1)
    rows = np.where((same | stiff)[:, None, None], held, rows)
    return np.concatenate([changes, rows], axis=1).reshape(count, -1)


def _springs(case: Case, setting: Setting, values: Values, joints: int) -> np.ndarray:
    """Stiffness, feedforward, lowest and highest force of the joints, shape (n, 4, joints)."""
    with jax.enable_x64(True):
        along = {name: np.asarray(value, float) for name, value in values.items()}
        return np.array(_of_joints(along, case=case, setting=setting, joints=joints))


@building
def _of_joints(*, case: Case, setting: Setting, joints: int) -> Callable[[Any], jax.Array]:
    """What `_springs` gives, from the parameters of the samples."""
    made = mujoco_batch.template(case, setting)

    def one(row: Mapping[str, jax.Array]) -> jax.Array:
        own = kernel.resolved(made, row)
        limit = jnp.minimum(own[FORCE_LIMIT], own[STALL_FORCE])
        parts = (
            own[KP],
            own[FEEDFORWARD],
            jnp.maximum(-limit, own.get(LOWEST_FORCE, -jnp.inf)),
            jnp.minimum(limit, own.get(HIGHEST_FORCE, jnp.inf)),
        )
        return jnp.stack([jnp.broadcast_to(part, (joints,)) for part in parts])

    return jax.vmap(one)


@functools.lru_cache(maxsize=256)
def _linear(case: Case, setting: Setting, row: _Row) -> tuple[np.ndarray, np.ndarray]:
    """A and B with the changes and springs of one sample, a row of `_rows`."""
    moving = robots.linearised(_placed(case, setting, row), setting.plant)
    A, B, _ = linearize.linearise_c(moving.robot, moving.posture, case.step)
    if setting.corrected:
        A, B = linearize.synchronised(A, B, moving.robot.model.nv, case.step)
    basis = _basis(case, setting)
    return basis.T @ A @ basis, basis.T @ B


def _placed(case: Case, setting: Setting, row: _Row) -> robots.Scene:
    """The robot with the changes of one sample, where it rests."""
    scene = _scene(case, setting)
    changes = _split(case, row)[0]
    model = mujoco_batch.changed(case, scene, changes)
    posture = _resting(case, setting, row).posture
    return replace(scene, robot=replace(scene.robot, model=model), posture=posture)


def _resting(case: Case, setting: Setting, row: _Row) -> Rest:
    """Where one sample rests, a row of `_rows`."""
    changes, springs = _split(case, row)
    scene = _scene(case, setting)
    if not np.isfinite(springs[0]).any():
        model = mujoco_batch.changed(case, scene, changes)
        posture = _posture.under(scene.robot, model, scene.posture)
        return Rest(posture, np.zeros(len(scene.labels)))
    # What moves nothing at rest does not make it be looked for again.
    matters = np.isin(case.varied, (*STATIC, CONTACT_FRICTION))
    neutral = np.array([PARAMETERS[name].default for name in case.varied])
    changes = np.where(matters[:, None], changes, neutral[:, None])
    asked = tuple(np.concatenate([changes, springs]).reshape(-1).tolist())
    return _sprung(case, setting, asked)


@functools.lru_cache(maxsize=256)
def _sprung(case: Case, setting: Setting, row: _Row) -> Rest:
    """As `_resting`, of joints that are springs."""
    changes, springs = _split(case, row)
    scene = _scene(case, setting)
    model = mujoco_batch.changed(case, scene, changes)
    return _rest.resting(scene.robot, model, scene.posture, Springs(*springs))


def _split(case: Case, row: _Row) -> tuple[np.ndarray, np.ndarray]:
    """The changes of the model, shape (varied, joints), and the springs, shape (4, joints)."""
    rows = np.reshape(row, (len(case.varied) + 4, -1))
    return rows[:-4], rows[-4:]


def _scene(case: Case, setting: Setting) -> robots.Scene:
    scene = mujoco_batch.template(case, setting).scene
    assert scene is not None
    return scene


@functools.lru_cache(maxsize=16)
def _basis(case: Case, setting: Setting) -> np.ndarray:
    """The nominal plant's coordinates, see `jaxact.plants.linearize.Linearisation`."""
    scene = robots.linearised(_scene(case, setting), setting.plant)
    return linearize.linear_c(
        scene.robot, scene.posture, case.step, corrected=setting.corrected
    ).basis
