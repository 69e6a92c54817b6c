"""MJX's step of a robot with constraints, its matrices computed for many robots side by side.

    a = M^-1 f,    x: see `jaxact.plants.mjx.newton`,    (M + h D) v = f + J' f_constraints,

where D is the damping that the integrator takes from the end of the step. MJX calls a library for
the factors of each robot's matrices, and several times for one constraint solve.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.compilation.single_kernel import single_kernel
from jaxact.plants.mjx import cholesky, newton
from jaxact.plants.mjx.constraint_cost import Problem, Settings
from jaxact.plants.mjx.lanes import lanes
from jaxact.plants.mjx.library import derivative, mjx, support, types

# Most degrees of freedom of a robot times the rows of its constraints that are about several: all
# of them are taken to be about all. Within, a step takes half of MJX's time (18 times 16) to four
# fifths of it (24 times 16), and compiling as long.
_PRODUCT = 512


def serves(model: Any, data: Any) -> bool:
    """Whether `step` is there for a robot."""
    return (
        jax.default_backend() == "cpu"
        and data.qvel.dtype == jnp.float32
        and model.opt.integrator != mjx.IntegratorType.RK4
        and model.opt.solver == mjx.SolverType.NEWTON
        and model.opt.cone == mjx.ConeType.PYRAMIDAL
        and model.nv * _alone(model, data._impl).count(-1) <= _PRODUCT
    )


def step(model: Any, given: Any, pushed: tuple[int, ...] | None, state: tuple[str, ...]) -> Any:
    """The given data, with what is named in `state` one step later.

    Args:
        model, given: of MJX's own implementation.
        pushed: the only bodies that external forces act on; None for all.
        state: names of fields.
    """
    data = mjx.fwd_velocity(model, mjx.fwd_position(model, given))
    data = mjx.fwd_actuation(model, data)
    applied = data.qfrc_applied + _pushes(model, data, pushed)
    force = data.qfrc_passive - data.qfrc_bias + data.qfrc_actuator + applied
    inertia, damping, flags = support.full_m(model, data), None, model.opt.disableflags
    if model.opt.integrator == mjx.IntegratorType.IMPLICITFAST:
        slopes = derivative.deriv_smooth_vel(model, data)
        damping = None if slopes is None else -model.opt.timestep * slopes
    elif not flags & mjx.DisableBit.EULERDAMP:
        damping = jnp.diag(model.opt.timestep * model.dof_damping)
    first, mean = _accelerations(model, data, inertia, force, damping)
    plain = model.tree_replace({"opt.disableflags": flags | mjx.DisableBit.EULERDAMP})
    after = mjx.euler(plain, data.replace(qacc=mean)).replace(qacc_warmstart=first)
    return given.replace(**{name: getattr(after, name) for name in state})


def _pushes(model: Any, data: Any, pushed: tuple[int, ...] | None) -> Any:
    """Generalised forces of the external ones; those of all bodies take a fifth of a step."""
    if pushed is None:
        return support.xfrc_accumulate(model, data)
    forces, places = data.xfrc_applied, data.xipos
    return sum(
        support.apply_ft(model, data, forces[i, :3], forces[i, 3:], places[i], jnp.int32(i))
        for i in pushed
    )


def _accelerations(
    model: Any,
    data: Any,
    inertia: jax.Array,
    force: jax.Array,
    damping: jax.Array | None,
) -> tuple[jax.Array, jax.Array]:
    """The accelerations at the beginning of a step, and those that it integrates.

    Args:
        model, data: of MJX's own implementation, data with everything up to the forces.
        inertia: M, shape (n, n).
        force: all but those of constraints, shape (n,).
        damping: h D, shape (n, n); None for none.
    """
    impl, option = data._impl, model.opt
    first, last = impl.ne, impl.ne + impl.nf
    given = {
        "inertia": inertia,
        "rows": impl.efc_J,
        "stiffness": impl.efc_D,
        "reference": impl.efc_aref,
        "friction": impl.efc_frictionloss[first:last],
        "force": force,
        "start": data.qacc_warmstart,
        "tolerance": jnp.asarray(option.tolerance, force.dtype),
        "search_tolerance": jnp.asarray(option.ls_tolerance, force.dtype),
    }
    settings = Settings(
        equalities=first,
        alone=_alone(model, impl),
        warm=not option.disableflags & mjx.DisableBit.WARMSTART,
        iterations=option.iterations,
        search_iterations=option.ls_iterations,
    )

    def many(given: dict[str, jax.Array], damping: jax.Array | None) -> Any:
        inertia, force = given["inertia"], given["force"]
        free = _solution(inertia, force)
        x, pull = newton.solve(Problem(free=free, **given), settings)
        return x, x if damping is None else _solution(inertia + damping, force + pull)

    return lanes(single_kernel(many))(given, damping)


def _alone(model: Any, impl: Any) -> tuple[int, ...]:
    """See `Settings`: dry friction and the limits of hinges and slides, in MJX's order."""
    flags, bits = model.opt.disableflags, mjx.DisableBit
    rows = [-1] * impl.ne
    if not flags & bits.FRICTIONLOSS:
        rows += np.nonzero(model._impl.dof_hasfrictionloss)[0].tolist()
        rows += [-1] * int(model._impl.tendon_hasfrictionloss.sum())
    if not flags & bits.LIMIT:
        kinds, limited = np.asarray(model.jnt_type), np.asarray(model.jnt_limited, bool)
        ball = kinds == types.JointType.BALL
        single = np.isin(kinds, (types.JointType.HINGE, types.JointType.SLIDE))
        rows += [-1] * int((ball & limited).sum())
        rows += np.asarray(model.jnt_dofadr)[single & limited].tolist()
    return tuple(rows) + (-1,) * (impl.efc_J.shape[0] - len(rows))


def _solution(matrices: jax.Array, values: jax.Array) -> jax.Array:
    """Of symmetric matrices times x equals the values; the last axis is for the robots."""
    matrices = jax.lax.optimization_barrier(matrices)

    def column(j: jax.Array) -> jax.Array:
        return jax.lax.dynamic_index_in_dim(matrices, j, 0, keepdims=False)

    return cholesky.solve(cholesky.factor(column, *values.shape), values)
