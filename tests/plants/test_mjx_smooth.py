"""Derivatives of MJX's steps: against central differences of the steps as MJX takes them."""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from robots import HOPPER, MONOPED

from jaxact.drive.step import Force
from jaxact.errors import UserError
from jaxact.plants.mjx import plant as mjx
from jaxact.plants.mjx.smooth import smooth
from jaxact.robots import model, posture

STEPS = 20
STEP = 2e-3
# All kinds of constraints: a cone, dry friction and a limit that is passed on the way, under the
# other solver.
SOLVER = 'cone="elliptic" solver="CG" tolerance="0" iterations="400" ls_iterations="50"'
LIMITED = 'name="hip" axis="0 1 0" frictionloss="0.3" limited="true" range="-60 -0.115"'
ELLIPTIC = MONOPED.replace("<option", f"<option {SOLVER}").replace(
    'name="hip" axis="0 1 0"', LIMITED
)


def _robot(folder, text):
    path = folder / "robot.xml"
    path.write_text(text)
    return model.read(path)


def _reached(plant, force, amounts):
    """Configuration and velocity after some steps under a force that grows by two amounts."""

    def step(state, number):
        t = (number + 1.0) / STEPS
        mean = force + amounts[0] * t + amounts[1] * t * t
        return plant.advance(state, Force(mean=mean, moment=mean, partial=None)), None

    data = plant.data
    start = plant.state(data)
    end, _ = jax.lax.scan(step, start, jnp.arange(STEPS))
    return jnp.concatenate([end.qpos, end.qvel])


@dataclass(frozen=True)
class Motion:
    """MJX's own motion as a function; where one with derivatives ends, and its slopes."""

    value: Callable
    found: np.ndarray
    slope: np.ndarray


@pytest.fixture(
    scope="module",
    params=["pyramidal", pytest.param("elliptic", marks=pytest.mark.exhaustive)],
)
def motion(request, tmp_path_factory):
    text = {"pyramidal": MONOPED, "elliptic": ELLIPTIC}[request.param]
    robot = _robot(tmp_path_factory.mktemp(request.param), text)
    start = posture.settled(robot)
    with jax.enable_x64(True):
        plant = mjx.place(robot, start).prepare(jnp.asarray(STEP))
        force = jnp.asarray(start.force)

        def with_slope(x):
            return _reached(smooth(plant), force, x)

        value = jax.jit(lambda x: _reached(plant, force, x), compiler_options=QUICKLY)
        twice = jax.jacfwd(lambda x: (with_slope(x),) * 2, has_aux=True)
        slope, found = jax.jit(twice, compiler_options=QUICKLY)(jnp.asarray(AMOUNTS))
        if robot.model.jnt_limited[1]:
            assert start.qpos[1] < robot.model.jnt_range[1, 1] < found[1]
        return Motion(value, np.asarray(found), np.asarray(slope))


AMOUNTS = np.array([1.5, -0.7])
# Compiled once and run for a moment.
QUICKLY = {"xla_backend_optimization_level": 0}


def test_values_are_those_of_mjx_and_slopes_those_of_central_differences(motion):
    size = 1e-3
    with jax.enable_x64(True):
        ends = [motion.value(jnp.asarray(AMOUNTS + sign * size * unit))
                for unit in np.eye(2) for sign in (1.0, -1.0)]  # fmt: skip
        np.testing.assert_allclose(
            motion.found, motion.value(jnp.asarray(AMOUNTS)), rtol=1e-9, atol=1e-12
        )
    ends = np.array(ends)
    differences = (ends[::2] - ends[1::2]).T / (2 * size)
    np.testing.assert_allclose(motion.slope, differences, atol=1e-4 * np.abs(differences).max())


@pytest.mark.exhaustive
def test_a_floating_robot_moves_as_mjx_has_it(tmp_path):
    robot = _robot(tmp_path, HOPPER)
    start = posture.settled(robot)
    with jax.enable_x64(True):
        plant = mjx.place(robot, start).prepare(jnp.asarray(STEP))
        force = jnp.asarray(start.force)

        @functools.partial(jax.jit, compiler_options=QUICKLY)
        def both(amounts):
            return _reached(plant, force, amounts), _reached(smooth(plant), force, amounts)

        want, found = map(np.asarray, both(jnp.asarray(10.0 * AMOUNTS)))
    assert np.abs(want - np.concatenate([start.qpos, np.zeros(robot.model.nv)])).max() > 0.01
    np.testing.assert_allclose(found, want, rtol=1e-9, atol=1e-12)


def test_an_integrator_that_solves_several_times_a_step_is_refused(tmp_path):
    robot = _robot(tmp_path, HOPPER.replace("<option", '<option integrator="RK4"'))
    with pytest.raises(UserError, match="implicitfast"):
        smooth(mjx.place(robot, posture.given(robot)))
