"""One physics step of MJX, with a constraint solver that also finishes in float32.

MJX's solver goes on only where that makes the cost of the constraints smaller. In float32 a cost of
some thousand is known to 1e-4 or so, and the solver stops where a step would gain less: not far
from the solution, but always on the side it came from, so that a robot that sways slowly on its
feet drifts. The gradient of the cost is known far better. A Newton step that makes it smaller is
taken at the end.
"""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.plants.mjx_small import written_out

# Most degrees of freedom of a robot whose matrices are written out.
_SMALL = 3


@contextlib.contextmanager
def _without_warp_notice() -> Iterator[None]:
    """MJX prints that the optional Warp is missing; keep that, and only that, off the screen."""
    captured = io.StringIO()
    with contextlib.redirect_stdout(captured):
        yield
    for line in captured.getvalue().splitlines():
        if not line.startswith(("Failed to import warp", "Failed to import mujoco_warp")):
            print(line, file=sys.stdout)


with _without_warp_notice():
    from mujoco import mjx as mjx
    from mujoco.mjx._src import solver as solver


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


def step(model: Any, data: Any, solve: Callable[[Any, Any], Any] = solved) -> Any:
    """The data one step later.

    Args:
        model, data: of MJX's own implementation.
        solve: finds the accelerations of the constraints, as `solved`; the integrator RK4, which
            needs them several times, uses MJX's own.
    """
    # MJX multiplies matrices by vectors as NumPy allows; a user may have forbidden that.
    with jax.numpy_rank_promotion("allow"):
        if model.opt.integrator == mjx.IntegratorType.RK4:
            return mjx.step(model, data)
        small = model.nv <= _SMALL
        data = (written_out(_unconstrained) if small else _unconstrained)(model, data)
        if data._impl.efc_J.size:
            return _integrated(model, solve(model, data))
        data = data.replace(qacc=data.qacc_smooth)
        return (written_out(_integrated) if small else _integrated)(model, data)


def _unconstrained(model: Any, data: Any) -> Any:
    """The data with all but the accelerations and forces of the constraints."""
    data = mjx.fwd_velocity(model, mjx.fwd_position(model, data))
    return mjx.fwd_acceleration(model, mjx.fwd_actuation(model, data))


def _integrated(model: Any, data: Any) -> Any:
    """The data one step later, from its accelerations."""
    euler = model.opt.integrator == mjx.IntegratorType.EULER
    return mjx.euler(model, data) if euler else mjx.implicit(model, data)
