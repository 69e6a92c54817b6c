"""Delay in the loop shakes an environment's robot where `jaxact.margins` says so."""

from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly  # noqa: F401
from robots import QUADRUPED

import jaxact as jx
from jaxact.robots import assets

pytest.importorskip("mujoco_playground", reason="needs jaxact[playground]; `make test` has it")

from mujoco_playground._src import mjx_env
from test_playground import STEP, Leg, as_users_have_it, leg  # noqa: F401

from jaxact.environments import playground

GO1 = Path(mjx_env.__file__).parent / "locomotion" / "go1" / "xmls" / "go1_mjx.xml"


class Hung(Leg):
    """A robot in the air, a little off its posture."""

    def reset(self, rng):
        qpos = jnp.asarray(self.mj_model.qpos0) + 1e-3 * jax.random.normal(rng, (self.mj_model.nq,))
        data = mjx_env.make_data(self.mj_model, qpos=qpos, impl="jax")
        zero = jnp.zeros(())
        return mjx_env.State(data, data.qpos, zero, zero, {}, {"time": zero})


def hung(spec, servo=None):
    """The text of a model without floating base, gravity, contacts and dry friction.

    Margins are those of a moving joint; so little motion as here stiction would hold.
    """
    for joint in list(spec.joints):
        joint.frictionloss = 0.0
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            spec.delete(joint)
    for key in list(spec.keys):
        spec.delete(key)
    for actuator in spec.actuators:
        if servo:
            actuator.set_to_position(kp=servo[0], kv=servo[1])
        actuator.ctrllimited = False
    spec.option.gravity, spec.option.timestep = [0, 0, 0], STEP
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    return spec.to_xml()


def robots_in_the_air():
    go1 = mujoco.MjSpec.from_file(str(GO1))
    for geom in list(go1.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            go1.delete(geom)
    for mesh in list(go1.meshes):
        go1.delete(mesh)
    assets.compile_model(go1)
    quadruped = mujoco.MjSpec.from_file(str(QUADRUPED / "quadruped_hung.xml"))
    return {"leg": leg(gravity=0.0), "Go1": hung(go1), "HyQ": hung(quadruped, (150.0, 4.0))}


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ("leg", "Go1", "HyQ"))
def test_delay_in_the_loop_shakes_where_margins_say_so_and_of_the_setpoint_does_not(tmp_path, name):
    text = robots_in_the_air()[name]
    path = tmp_path / "robot.xml"
    path.write_text(text)
    stand = jx.robot(path, integrator_correction=True, control_rate=1 / STEP, posture="keyframe")
    critical = float(jx.margins(stand).delay_margin)
    assert 1e-3 < critical < 0.1
    env = Hung(text)
    joints = env.mj_model.actuator_trnid[:, 0]
    held = jnp.asarray(env.mj_model.qpos0[env.mj_model.jnt_qposadr[joints]])

    def largest(**values):
        driven = playground(env, **values)

        def one(state, _):
            state = driven.step(state, held)
            return state, jnp.abs(state.data.qpos - env.mj_model.qpos0).max()

        def run(key):
            return jax.lax.scan(one, driven.reset(key), None, length=150)[1]

        key = jax.random.split(jax.random.PRNGKey(2))[0]  # a start with much of what grows
        found = np.asarray(jax.jit(run)(key))
        return found[-20:].max() / found[:5].max()

    assert largest(delay=0.8 * critical) < 0.3
    assert largest(delay=1.25 * critical) > 3.0
    assert largest(setpoint_delay=1.25 * critical) < 0.3
