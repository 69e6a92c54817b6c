"""One physics step of MJX, with a constraint solver that also finishes in float32.

Robots of a few joints are unrolled to scalars, see `jaxact.plants.mjx.scalars`; of larger ones a
batch is computed side by side on a CPU, see `jaxact.plants.mjx.side_by_side`.

MJX's solver goes on only where that makes the cost of the constraints smaller. In float32 a cost of
some thousand is known to 1e-4 or so, and the solver stops where a step would gain less: not far
from the solution, but always on the side it came from, so that a robot that sways slowly on its
feet drifts. The gradient of the cost is known far better. A Newton step that makes it smaller is
taken at the end.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.plants.mjx import side_by_side
from jaxact.plants.mjx.derived import derived
from jaxact.plants.mjx.library import mjx as mjx
from jaxact.plants.mjx.library import solver as solver
from jaxact.plants.mjx.scalars.step import written_out

STATE = ("qpos", "qvel", "act", "qacc_warmstart", "time")
"""What MJX integrates; everything else in its data follows from it."""

# Most degrees of freedom of a robot whose step is written out, and most of them times the rows of
# its constraints: beyond, compiling takes longer than without, and a step no less.
_FREEDOMS, _PRODUCT = 7, 48


def solved(model: Any, data: Any) -> Any:
    """The data with the accelerations and forces of the constraints.

    Args:
        model, data: of MJX's own implementation, in either precision; data with everything up to
            the unconstrained accelerations.
    """
    data = mjx.solve(model, data)
    if data.qacc.dtype != jnp.float32:
        return data
    newton = model.tree_replace({"opt.solver": mjx.SolverType.NEWTON})
    there = solver.Context.create(newton, data)
    qacc = data.qacc + there.search
    after = solver.Context.create(newton, data.replace(qacc=qacc), grad=False)
    gradient = after.Ma - data.qfrc_smooth - after.qfrc_constraint
    nearer = jnp.linalg.norm(gradient) < jnp.linalg.norm(there.grad)
    return data.replace(
        qacc=jnp.where(nearer, qacc, data.qacc),
        qfrc_constraint=jnp.where(nearer, after.qfrc_constraint, data.qfrc_constraint),
    )


def step(
    model: Any,
    data: Any,
    solve: Callable[[Any, Any], Any] = solved,
    pushed: tuple[int, ...] | None = None,
) -> Any:
    """The data given, with the state one step later.

    Args:
        model, data: of MJX's own implementation.
        solve: finds the accelerations of the constraints, as `solved`; the integrator RK4, which
            needs them several times, uses MJX's own.
        pushed: the only bodies that external forces act on; None for all.
    """
    # MJX multiplies matrices by vectors as NumPy allows; a user may have forbidden that.
    with jax.numpy_rank_promotion("allow"):
        if is_small(model, data):
            return written_out(lambda *given: _whole(*given, solve))(model, data)
        return _of_larger(model, data, solve=solve, pushed=pushed)


# Loops within loops are traced again and again under `jax.vmap`; this is traced once.
@functools.partial(jax.jit, static_argnames=("solve", "pushed"))
def _of_larger(
    model: Any,
    data: Any,
    *,
    solve: Callable[[Any, Any], Any],
    pushed: tuple[int, ...] | None,
) -> Any:
    """As `step`, of a robot that is not small."""

    def whole(model: Any, data: Any) -> Any:
        return _whole(model, data, solve)

    def beside_others(model: Any, data: Any) -> Any:
        return side_by_side.step(model, data, pushed, STATE)

    if solve is solved and is_side_by_side(model, data):
        return derived(beside_others, whole)(model, data)
    return whole(model, data)


def is_small(model: Any, data: Any) -> bool:
    """Whether a robot's step is written out."""
    return model.nv <= _FREEDOMS and model.nv * rows(data) <= _PRODUCT


def rows(data: Any) -> int:
    """How many constraints there may be in a model in MJX's own implementation."""
    return data._impl.efc_J.shape[0]


def is_side_by_side(model: Any, data: Any) -> bool:
    """Whether the constraints of a robot that is not small are computed of many at once."""
    return constrained(data) and side_by_side.serves(model, data)


def constrained(data: Any) -> bool:
    """Whether a model in MJX's own implementation has contacts, limits or friction."""
    return rows(data) > 0


def _whole(model: Any, given: Any, solve: Callable[[Any, Any], Any]) -> Any:
    """The given data, with the state one step later."""
    if model.opt.integrator == mjx.IntegratorType.RK4:
        after = mjx.step(model, given)
    else:
        data = mjx.fwd_velocity(model, mjx.fwd_position(model, given))
        data = mjx.fwd_acceleration(model, mjx.fwd_actuation(model, data))
        data = solve(model, data) if constrained(data) else data.replace(qacc=data.qacc_smooth)
        euler = model.opt.integrator == mjx.IntegratorType.EULER
        after = mjx.euler(model, data) if euler else mjx.implicit(model, data)
    return given.replace(**{name: getattr(after, name) for name in STATE})
