"""A MuJoCo model in MJX whose steps have the derivatives that they should have.

The accelerations x of a step minimise the cost of the constraints (contacts, limits, friction),

    g(x, p) = M x - f_smooth - J' f(J x - a_ref) = 0,

where p stands for everything that they depend on. MJX finds them by iteration. The derivative of
the iterations is not that of their limit: none where they start at the solution, too little where
they stop early, and none at all backwards, because their number is not known beforehand. By the
implicit function theorem the limit has

    dx = -H^-1 (dg/dp) dp,    H = dg/dx = M + J' (df/dr) J,

which is the derivative of one Newton step taken from the solution. Values stay those of MJX; also
those of orientations, which MJX integrates with no derivative at rest.

Source: MuJoCo's documentation, "Computation", constraint solver; the implicit differentiation of
optima, Griewank & Walther, "Evaluating Derivatives", 2nd ed., section 15.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import jax

from jaxact.drive.step import Force
from jaxact.errors import UserError
from jaxact.plants.mjx import step as _mjx_step
from jaxact.plants.mjx.plant import STATIC, MjxPlant, MjxState
from jaxact.plants.mjx.step import mjx, solver
from jaxact.plants.tangent import displaced


@dataclass(frozen=True)
class SmoothPlant(MjxPlant):
    """An `MjxPlant` whose steps can be differentiated forwards and backwards; see `smooth`."""

    def advance(self, state: MjxState, force: Force) -> MjxState:
        """One MJX step under the mean force; the same values as `MjxPlant.advance`."""
        data = _mjx_step.step(self.model, self.loaded(state, force), _solved)
        after = self.state(data)
        step = self.model.opt.timestep
        # MJX has moved the configuration by the velocities at the end of the step.
        qpos = _valued(after.qpos, displaced(self.kinds, state.qpos, step * after.qvel))
        return replace(after, qpos=qpos)


jax.tree_util.register_dataclass(
    SmoothPlant,
    data_fields=[item.name for item in fields(SmoothPlant) if item.name not in STATIC],
    meta_fields=list(STATIC),
)


def smooth(plant: MjxPlant) -> SmoothPlant:
    """The same plant with derivatives.

    Raises:
        UserError: its integrator solves for the constraints several times in a step.
    """
    if plant.model.opt.integrator == mjx.IntegratorType.RK4:
        raise UserError(
            'integrator: derivatives of simulations need integrator="implicitfast" or '
            '"Euler", the model has "RK4"'
        )
    return SmoothPlant(**{item.name: getattr(plant, item.name) for item in fields(MjxPlant)})


def _valued(value: Any, slope: Any) -> Any:
    """The value of one array with the derivative of another, which is close to it."""
    return jax.lax.stop_gradient(value) + (slope - jax.lax.stop_gradient(slope))


def _solved(model: Any, data: Any) -> Any:
    """The data with accelerations and constraint forces, and their derivatives."""
    found = _mjx_step.solved(model, jax.lax.stop_gradient(data))
    newton = model.tree_replace({"opt.solver": mjx.SolverType.NEWTON})
    there = solver.Context.create(newton, data.replace(qacc=found.qacc))
    qacc = _valued(found.qacc, there.search)
    # At the solution g = 0, whatever the parameters.
    balance = mjx.mul_m(model, data, qacc) - data.qfrc_smooth
    return data.replace(qacc=qacc, qfrc_constraint=_valued(found.qfrc_constraint, balance))
