"""A robot linearised at a posture: its plant alone, and its whole closed loop over one period.

    x' = A x + B (f - f0)

is the derivative of the one physics step (`jax.jacfwd` of MJX, contacts as they are), in the
tangent space of the configuration: x holds displacements [m or rad], velocities, and the states of
actuators that are not driven. Where a floating robot may be anywhere on the plane, its position and
heading are not part of its stability: such directions, in which nothing changes when the robot is
displaced, are taken out (`without_neutral`).
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jaxact.drive.step import Force
from jaxact.plants.linear import LinearPlant
from jaxact.plants.tangent import difference, displaced
from jaxact.robots.model import Robot
from jaxact.robots.posture import Posture

if TYPE_CHECKING:  # MJX takes long to import, and C MuJoCo does without it
    from jaxact.plants.mjx.plant import MjxPlant, MjxState

# Singular values below this share of the largest one are not a motion.
_NEUTRAL = 1e-7
# [rad/s^2 or m/s^2]
_NUDGE = 1e-2
# [rad/s]
_TURNING = 1e-7
# Of the difference quotients in C [rad, m, and per second]; the smaller ones where a contact or a
# limit is nearer to its beginning than this many of the first, times the model's size.
_DIFFERENCE, _SMALLER = 1e-6, (1e-7, 1e-8, 1e-9, 1e-10)
_NEAR = 10.0
# Two differences agree where they differ by less than this share of the largest entry. Across the
# beginning of a contact they differ by more than all of it.
_AGREE = 1e-3


@dataclass(frozen=True)
class Linearisation:
    """A plant at a posture.

    Attributes:
        plant: deviations over one physics step.
        residual: largest acceleration left at the posture [rad/s^2 or m/s^2]; 0 at an equilibrium.
        basis: of the plant's coordinates in displacements, velocities and actuator states, shape
            (2 nv + na, n).
    """

    plant: LinearPlant
    residual: float
    basis: np.ndarray

    @property
    def neutral(self) -> int:
        """Number of directions that were taken out."""
        return self.basis.shape[0] - self.basis.shape[1]


def _start(plant: MjxPlant) -> MjxState:
    """The start posture as it is."""
    return plant.state(plant.data.replace(time=jnp.zeros_like(plant.data.time)))


def jacobians(plant: MjxPlant, force: jax.Array) -> tuple[jax.Array, jax.Array]:
    """A and B of a plant over one physics step, by forward differentiation of the step itself.

    Args:
        plant: prepared for its physics step; its start posture is linearised at.
        force: of the driven joints at the posture [N or N m], shape (joints,).

    Returns:
        A of shape (n, n) and B of shape (n, joints), n = 2 nv + na. Differentiable where MJX is,
        and batchable over what the plant varies.
    """
    start = _start(plant)
    size = start.qvel.shape[0]
    # From its own solution the constraint solver takes no step, and has no derivative then; from
    # close by it takes a Newton step, whose derivative is that of the solution.
    nudge = _NUDGE * jnp.cos(jnp.arange(size, dtype=start.qvel.dtype))

    # MJX takes a rotation slower than 1e-8 rad/s for none, and has no derivative of it.
    turning = jnp.where(start.qvel == 0.0, _TURNING, 0.0)

    def advanced(deviation: jax.Array, extra: jax.Array) -> MjxState:
        state = replace(
            start,
            qpos=displaced(plant.kinds, start.qpos, deviation[:size]),
            qvel=start.qvel + turning + deviation[size : 2 * size],
            act=start.act + deviation[2 * size :],
            warmstart=None if start.warmstart is None else start.warmstart + nudge,
        )
        total = force + extra
        return plant.advance(state, Force(mean=total, moment=total, partial=None))

    still = jnp.zeros(2 * size + start.act.shape[0], start.qvel.dtype)
    after = jax.lax.stop_gradient(advanced(still, jnp.zeros_like(force)))

    def deviation(deviation: jax.Array, extra: jax.Array) -> jax.Array:
        state = advanced(deviation, extra)
        moved = difference(plant.kinds, after.qpos, state.qpos)
        return jnp.concatenate([moved, state.qvel - after.qvel, state.act - after.act])

    return jax.jacfwd(deviation, argnums=(0, 1))(still, jnp.zeros_like(force))


def selectors(plant: MjxPlant) -> tuple[np.ndarray, np.ndarray]:
    """C_q and C_v of the driven joints, each of shape (joints, n)."""
    size = plant.data.qvel.shape[0]
    rows = np.zeros((2, len(plant.dofs), 2 * size + plant.data.act.shape[0]))
    for place, dof in enumerate(plant.dofs):
        rows[0, place, dof] = 1.0
        rows[1, place, size + dof] = 1.0
    return rows[0], rows[1]


def neutral(A: np.ndarray, positions: np.ndarray, size: int) -> np.ndarray:
    """Directions in which a displaced robot stays displaced and nothing else happens.

    Args:
        A: of the plant, shape (n, n).
        positions: C_q of the driven joints: they must not move in such a direction.
        size: number of degrees of freedom; the directions are displacements, not velocities.

    Returns:
        Orthonormal columns, shape (n, number).
    """
    moves = (A - np.eye(len(A)))[:, :size]
    # Joints are weighed like the largest motion, so that no direction with a joint in it is left.
    scale = max(float(np.abs(moves).max(initial=0.0)), 1.0)
    _, values, rows = np.linalg.svd(np.vstack([moves, scale * positions[:, :size]]))
    values = np.concatenate([values, np.zeros(size - values.size)])
    kept = rows[values <= _NEUTRAL * max(float(values.max(initial=0.0)), 1.0)]
    return np.vstack([kept.T, np.zeros((len(A) - size, len(kept)))])


def without_neutral(directions: np.ndarray) -> np.ndarray:
    """An orthonormal basis of all other directions, shape (n, n - number)."""
    whole, _ = np.linalg.qr(np.hstack([directions, np.eye(len(directions))]))
    return whole[:, directions.shape[1] :]


def linearise(plant: MjxPlant, force: np.ndarray, step: float) -> Linearisation | None:
    """The plant of a robot at its start posture, in float64.

    Args:
        plant: from `jaxact.plants.mjx.plant.place`, made in float64.
        force: of the driven joints at the posture [N or N m], shape (joints,).
        step: physics step [s].

    Returns:
        The linear plant, rigid-body modes removed, and how far the posture is from rest; None
        where the derivatives of MJX are not numbers, as at some contacts of meshes.
    """
    with jax.enable_x64(True):
        compute = jax.jit(lambda plant, force, step: _at(plant.prepare(step), force))
        A, B, before, after = compute(plant, jnp.asarray(force, float), jnp.asarray(step, float))
        A, B = np.asarray(A), np.asarray(B)
        if not (np.isfinite(A).all() and np.isfinite(B).all()):
            return None
        residual = float(np.max(np.abs(np.asarray(after - before)), initial=0.0)) / step
    size = plant.data.qvel.shape[0]
    if plant.corrected:
        A, B = synchronised(A, B, size, step)
    return _reduced(A, B, selectors(plant), size, step, residual)


def linearise_c(
    robot: Robot, posture: Posture, step: float, model: mujoco.MjModel | None = None
) -> tuple[np.ndarray, np.ndarray, float]:
    """A and B of a robot in C MuJoCo, by central differences; and what is left of accelerations.

    Args:
        robot: from `jaxact.robots.model.read`.
        posture: to linearise at.
        step: physics step [s].
        model: the robot's model with other parameters; None for its own.

    Returns:
        A (n, n) and B (n, joints) with n = 2 nv + na, and the residual [rad/s^2 or m/s^2].
    """
    model = _model_at(robot.model if model is None else model, step)
    # A difference quotient sees what the solver leaves unfinished.
    model.opt.tolerance, model.opt.iterations = 0.0, max(model.opt.iterations, 100)
    model.opt.ls_tolerance, model.opt.ls_iterations = 1e-10, max(model.opt.ls_iterations, 50)
    data = mujoco.MjData(model)
    data.qpos, data.qvel, data.ctrl = posture.qpos, posture.qvel, posture.ctrl
    if model.na:
        data.act = posture.act
    actuators = [joint.index for joint in robot.joints]
    data.ctrl[actuators] = posture.force
    mujoco.mj_forward(model, data)
    residual = float(np.max(np.abs(data.qacc), initial=0.0))
    explicit = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    A, B = _runge_kutta(model, data) if explicit else _differenced(model, data)
    return A, B[:, actuators], residual


def _differenced(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """A and B by differences that no contact or limit begins or ends within, if there are such.

    A foot that is pressed less deep into stiff ground than a difference moves it would be lifted
    off by it. Such differences depend on their own size, those that touch nothing do not.
    """
    found = _quotients(model, data, _DIFFERENCE)
    if not _near(model, data):
        return found
    larger = found
    for size in _SMALLER:
        smaller = _quotients(model, data, size)
        scale = max(1.0, float(np.max(np.abs(smaller[0]))))
        if float(np.max(np.abs(larger[0] - smaller[0]))) <= _AGREE * scale:
            return larger
        larger = smaller
    return found  # at the beginning itself, or of a collision that is no better computed than so


def _quotients(
    model: mujoco.MjModel, data: mujoco.MjData, difference: float
) -> tuple[np.ndarray, np.ndarray]:
    size = 2 * model.nv + model.na
    A, B = np.zeros((size, size)), np.zeros((size, model.nu))
    mujoco.mjd_transitionFD(model, data, difference, True, A, B, None, None)
    return A, B


def _near(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Whether a contact, or the limit of a joint or a tendon, has only just begun, or is about to.

    Args:
        model, data: after `mj_forward`.
    """
    limits = (mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT, mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON)
    active = np.isin(data.efc_type, [int(limit) for limit in limits])
    gaps = [data.contact.dist - data.contact.includemargin]
    gaps.append((data.efc_pos - data.efc_margin)[active])
    hinged = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    limited = np.flatnonzero(np.isin(model.jnt_type, hinged) & (model.jnt_limited != 0))
    position, margin = data.qpos[model.jnt_qposadr[limited]], model.jnt_margin[limited]
    low, high = model.jnt_range[limited].T
    gaps += [position - low - margin, high - position - margin]
    nearest = float(np.min(np.abs(np.concatenate(gaps)), initial=np.inf))
    return nearest < _NEAR * _DIFFERENCE * max(1.0, float(model.stat.extent))


def _runge_kutta(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """A and B of a step with RK4, which MuJoCo cannot difference; model is changed.

    Of x' = F x + G u it is the Taylor polynomial of the matrix exponential up to (F h)^4. F and G
    are what an explicit Euler step adds.
    """
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    F, G = _differenced(model, data)
    F -= np.eye(len(F))
    F[: model.nv], G[: model.nv] = 0.0, 0.0  # positions are already moved by the new velocities
    F[: model.nv, model.nv : 2 * model.nv] = model.opt.timestep * np.eye(model.nv)
    term, total = np.eye(len(F)), np.zeros_like(F)
    for order in range(1, 5):
        total += term / order
        term = term @ F / order
    return np.eye(len(F)) + F @ total, total @ G


def synchronised(
    A: np.ndarray, B: np.ndarray, size: int, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """A and B where positions are taken half a physics step earlier, see `MjxPlant.corrected`.

    Args:
        A, B: of shape (n, n) and (n, joints), as MuJoCo steps.
        size: number of degrees of freedom.
        step: physics step [s].
    """
    earlier, later = np.eye(len(A)), np.eye(len(A))
    displacements, velocities = np.arange(size), np.arange(size, 2 * size)
    earlier[displacements, velocities] = -0.5 * step
    later[displacements, velocities] = 0.5 * step
    return earlier @ A @ later, earlier @ B


def linear_c(
    robot: Robot, posture: Posture, step: float, *, corrected: bool = False
) -> Linearisation:
    """As `linearise`, of the robot in C MuJoCo; `corrected` as `MjxPlant.corrected`."""
    A, B, residual = linearise_c(robot, posture, step)
    if corrected:
        A, B = synchronised(A, B, robot.model.nv, step)
    return _reduced(A, B, _selectors(robot), robot.model.nv, step, residual)


def _model_at(model: mujoco.MjModel, step: float) -> mujoco.MjModel:
    model = copy.copy(model)
    model.opt.timestep = step
    return model


def _selectors(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """C_q and C_v of the driven joints, each of shape (joints, n)."""
    size = robot.model.nv
    rows = np.zeros((2, len(robot.joints), 2 * size + robot.model.na))
    for place, joint in enumerate(robot.joints):
        rows[0, place, joint.dof] = 1.0
        rows[1, place, size + joint.dof] = 1.0
    return rows[0], rows[1]


def _reduced(A, B, selectors, size: int, step: float, residual: float) -> Linearisation:
    """The linear plant without what is neutral, in float64."""
    positions, velocities = selectors
    basis = without_neutral(neutral(A, positions, size))
    with jax.enable_x64(True):
        # What is left out is neutral: nothing in the basis depends on it.
        linear = LinearPlant(
            A=jnp.asarray(basis.T @ A @ basis),
            B=jnp.asarray(basis.T @ B),
            positions=jnp.asarray(positions @ basis),
            velocities=jnp.asarray(velocities @ basis),
            step=jnp.asarray(step, float),
        )
    return Linearisation(linear, residual, basis)


def _at(plant: MjxPlant, force: jax.Array):
    """A, B, and the velocities before and after one step at the posture."""
    start = _start(plant)
    after = plant.advance(start, Force(mean=force, moment=force, partial=None))
    return *jacobians(plant, force), start.qvel, after.qvel
