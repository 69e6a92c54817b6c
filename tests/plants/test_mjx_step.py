"""Accelerations of contacts that MJX finds in float32, against C MuJoCo's converged ones."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.plants.mjx import step as mjx_step
from jaxact.plants.mjx.step import mjx

# In float32 the cost of the heavy box hides what the light arm would gain.
BOX = """
<mujoco>
  <option iterations="{iterations}" cone="{cone}"/>
  <worldbody>
    <geom type="plane" size="5 5 0.1"/>
    <body pos="0 0 0.2495">
      <freejoint/>
      <geom type="box" size="0.3 0.2 0.25" mass="60"/>
      <body pos="0 0 0.25">
        <joint name="arm" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0.3" size="0.03" mass="0.05"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="arm" gear="0.01"/></actuator>
</mujoco>
"""
OFF = 0.05  # [rad/s^2] of the arm, from which the solver starts, next to the solution


def _exact(model, torque):
    """The state on its contacts, and the accelerations there, in C and to the last digit."""
    model.opt.iterations, model.opt.tolerance = 100, 0.0
    data = mujoco.MjData(model)
    data.ctrl[0] = torque
    mujoco.mj_forward(model, data)
    assert data.ncon == 4
    return data, data.qacc.copy()


def _found(text, dtype, torque, offsets, *solvers):
    """Accelerations that MJX comes to from starts that are off by these, shape (n, nv).

    And the forces of its constraints, both as differences from the exact ones, of each solver.
    """
    model = mujoco.MjModel.from_xml_string(text)
    data, exact = _exact(mujoco.MjModel.from_xml_string(text), torque)
    with jax.enable_x64(dtype == np.float64), jax.numpy_rank_promotion("allow"):
        on_device, start = mjx.put_model(model), mjx.put_data(model, data)

        def accelerations(offset):
            one = start.replace(qacc_warmstart=jnp.asarray(exact, dtype) + offset)
            one = mjx.fwd_velocity(on_device, mjx.fwd_position(on_device, one))
            one = mjx.fwd_acceleration(on_device, mjx.fwd_actuation(on_device, one))
            ends = [solve(on_device, one) for solve in solvers]
            return [(end.qacc, end.qfrc_constraint) for end in ends]

        ends = jax.jit(jax.vmap(accelerations))(jnp.asarray(offsets, dtype))
    return [
        (np.asarray(qacc) - exact, np.asarray(forces) - data.qfrc_constraint)
        for qacc, forces in ends
    ]


@pytest.mark.exhaustive
@pytest.mark.parametrize(("cone", "iterations"), [("pyramidal", 1), ("elliptic", 20)])
def test_the_solver_finishes_in_float32(cone, iterations):
    text = BOX.format(cone=cone, iterations=iterations)
    offsets = OFF * np.linspace(-1.0, 1.0, 21)[:, None] * np.eye(7)[6]
    ((off, forces_off),) = _found(text, np.float32, 12.0, offsets, mjx_step.solved)
    # The solver of MJX 3.17 alone stays where it starts.
    assert np.abs(off).max() < 2e-4
    assert np.abs(forces_off).max() < 5e-3


@pytest.mark.exhaustive
def test_in_float64_it_is_the_solver_of_mjx():
    text = BOX.format(cone="pyramidal", iterations=1)
    offsets = OFF * np.linspace(-1.0, 1.0, 5)[:, None] * np.eye(7)[6]
    both = _found(text, np.float64, 12.0, offsets, mjx_step.solved, mjx.solve)
    (off, _), (theirs, _) = both
    np.testing.assert_array_equal(off, theirs)
    assert np.abs(off).max() < 1e-9
