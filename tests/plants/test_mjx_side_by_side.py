"""Steps of robots with contacts, computed for many side by side, against C MuJoCo's."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.plants.mjx import plant as mjx
from jaxact.plants.mjx import side_by_side
from jaxact.plants.mjx.lanes import lanes

# A table with an arm, and a second tree; joints of all kinds, held in all ways.
ROBOT = """
<mujoco>
  <option timestep="0.002" iterations="{iterations}" ls_iterations="20" {option}>
    <flag {flag}/>
  </option>
  <default><geom solref="0.02 1" friction="0.7 0.02 0.01"/></default>
  <worldbody>
    <geom type="plane" size="5 5 0.1" condim="{condim}"/>
    <body name="trunk" pos="0 0 0.248">
      <freejoint/>
      <geom type="box" size="0.3 0.2 0.2" mass="6" {apart}/>
      <geom size="0.05" pos="0.3 0.2 -0.2" condim="{condim}"/>
      <geom size="0.05" pos="-0.3 0.2 -0.2" condim="{condim}"/>
      <geom size="0.05" pos="0.3 -0.2 -0.2" condim="{condim}"/>
      <geom size="0.05" pos="-0.3 -0.2 -0.2" condim="{condim}"/>
      <body name="arm" pos="0 0 0.25">
        <joint name="shoulder" axis="0 1 0" damping="0.3" {shoulder}/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0.3" size="0.03" mass="0.5" {apart}/>
        <body name="hand" pos="0.4 0 0.3">
          <joint name="elbow" axis="0 1 0.2" range="-0.05 0.05" limited="true" armature="0.01"/>
          <geom type="capsule" fromto="0 0 0 0.3 0 0.1" size="0.02" mass="0.3" {apart}/>
        </body>
      </body>
    </body>
    <body name="swing" pos="2 0 1">
      <joint name="swing" type="ball" {ball}/>
      <geom type="capsule" fromto="0 0 0 0.3 0 -0.1" size="0.03" mass="0.6" {apart}/>
      <body name="end" pos="0.3 0 -0.1">
        <joint name="slide" type="slide" axis="1 0 0" damping="0.5" stiffness="10"/>
        <geom size="0.05" mass="0.2" {apart}/>
      </body>
    </body>
  </worldbody>
  {more}
  <actuator>
    <motor joint="shoulder" ctrlrange="-9 9"/><motor joint="elbow"/><motor joint="slide"/>
  </actuator>
</mujoco>
"""
APART = 'contype="0" conaffinity="0"'
TENDON = """
  <tendon><fixed limited="true" range="-0.02 0.02" frictionloss="0.4">
    <joint joint="shoulder" coef="1"/><joint joint="elbow" coef="-0.5"/></fixed></tendon>"""
EQUALITY = """
  <equality><joint joint1="shoulder" joint2="elbow" polycoef="0 0.5 0 0 0"/></equality>"""
FRICTION = 'frictionloss="0.5"'
FLAGS = 'warmstart="disable" eulerdamp="disable"'
CASES = {
    "contacts": {"condim": 3},
    "no friction": {"condim": 1, "option": 'integrator="implicitfast"'},
    "contacts that turn": {"condim": 4, "shoulder": FRICTION},
    "contacts that roll": {
        "condim": 6,
        "shoulder": FRICTION,
        "flag": FLAGS,
    },
    "a tendon, a ball": {"condim": 3, "more": TENDON, "ball": 'limited="true" range="0 0.1"'},
    "equalities": {"condim": 3, "more": EQUALITY, "shoulder": FRICTION},
}
ROBOTS = 12


def _text(**given):
    rest = {"iterations": 50, "option": "", "flag": "", "shoulder": "", "ball": "", "more": ""}
    return ROBOT.format(**(rest | given), apart=APART)


def _states(model, random):
    """Positions, velocities, forces and accelerations before, of some robots near the start."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start = data.qpos.copy()
    qvel = random.normal(size=(ROBOTS, model.nv)) * 0.3
    qpos = np.empty((ROBOTS, model.nq))
    for row, moved in zip(qpos, random.normal(size=(ROBOTS, model.nv)) * 0.05, strict=True):
        moved[:6] *= 0.02
        row[:] = start
        mujoco.mj_integratePos(model, row, moved, 1.0)
    return qpos, qvel, random.normal(size=(ROBOTS, model.nu)), random.normal(size=qvel.shape)


def _exact(model, state, push=None):
    """Velocities and positions after a step in C, its solver run to the last digit."""
    data = mujoco.MjData(model)
    model.opt.iterations, model.opt.tolerance = 200, 0.0
    data.qpos, data.qvel, data.ctrl, data.qacc_warmstart = state
    if push is not None:
        data.xfrc_applied[push.body, :3] = push.force
    mujoco.mj_step(model, data)
    return data.qvel.copy(), data.qpos.copy()


def _loaded(text, tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(text)
    return mjx.load(path)


def _stepped(plant, states):
    """The same in float32, of all robots at once."""
    plant = plant.prepare(jnp.asarray(2e-3, jnp.float32))

    def one(qpos, qvel, force, start):
        data = plant.data.replace(qpos=qpos, qvel=qvel, qacc_warmstart=start)
        after = plant.advance(plant.state(data), mjx.Force(mean=force, moment=force, partial=None))
        return after.qvel, after.qpos

    states = [jnp.asarray(each, jnp.float32) for each in states]
    return [np.asarray(each) for each in jax.jit(jax.vmap(one))(*states)]


EVERY_DAY = ("contacts that roll",)


@pytest.mark.parametrize(
    "name",
    [
        name if name in EVERY_DAY else pytest.param(name, marks=pytest.mark.exhaustive)
        for name in CASES
    ],
)
def test_steps_are_those_of_c(name, tmp_path):
    text = _text(**CASES[name])
    model = mujoco.MjModel.from_xml_string(text)
    plant = _loaded(text, tmp_path)
    assert side_by_side.serves(plant.model, plant.data)
    states = _states(model, np.random.default_rng(3))
    found = _stepped(plant, states)
    exact = [_exact(model, state) for state in zip(*states, strict=True)]
    for got, want, within in zip(found, zip(*exact, strict=True), (2e-4, 1e-6), strict=True):
        np.testing.assert_allclose(got, np.array(want), rtol=0, atol=within)


@pytest.mark.exhaustive
def test_a_push_is_felt_where_it_is(tmp_path):
    text = _text(condim=3)
    model = mujoco.MjModel.from_xml_string(text)
    push = mjx.Push(force=np.array([5.0, -8.0, 3.0]), start=-1.0, duration=9.0, body=3)
    plant = dataclasses.replace(_loaded(text, tmp_path), push=push)
    states = _states(model, np.random.default_rng(4))
    found, _ = _stepped(plant, states)
    exact = [_exact(model, state, push)[0] for state in zip(*states, strict=True)]
    np.testing.assert_allclose(found, np.array(exact), rtol=0, atol=2e-4)


def test_what_vmap_adds_comes_last():
    """Of one robot, of many, and of many times many, with and without what all share."""

    def many(tree):
        assert tree["a"].ndim == 3 and tree["b"].shape[-1] == tree["a"].shape[-1]
        return {"sum": tree["a"].sum(axis=1) + tree["b"]}

    random = np.random.default_rng(0)
    a, b = random.normal(size=(4, 5, 2, 3)), random.normal(size=(5, 2))
    function = lanes(many)
    one = function({"a": a[0, 0], "b": b[0]})["sum"]
    np.testing.assert_allclose(one, a[0, 0].sum(axis=1) + b[0], rtol=1e-6)

    def of_rows(a):
        return jax.vmap(lambda a, b: function({"a": a, "b": b})["sum"])(a, b)

    np.testing.assert_allclose(jax.vmap(of_rows)(a), a.sum(axis=3) + b, rtol=1e-5)


@pytest.mark.exhaustive
def test_a_robot_does_the_same_whoever_is_beside_it(tmp_path):
    text = _text(condim=3, iterations=3)
    plant, random = _loaded(text, tmp_path), np.random.default_rng(5)
    states = _states(mujoco.MjModel.from_xml_string(text), random)
    alone = _stepped(plant, [np.repeat(each[:1], ROBOTS, axis=0) for each in states])
    beside = _stepped(plant, states)
    for one, other in zip(alone, beside, strict=True):
        np.testing.assert_array_equal(one[0], other[0])


@pytest.mark.exhaustive
def test_derivatives_are_those_of_the_step_of_mjx(tmp_path):
    plant = _loaded(_text(condim=3), tmp_path).prepare(jnp.asarray(2e-3, jnp.float32))
    zero = jnp.zeros(3)
    state = plant.init(zero, zero)

    def ours(force):
        force = mjx.Force(mean=force, moment=force, partial=None)
        return plant.advance(state, force).qvel

    def theirs(force):
        force = mjx.Force(mean=force, moment=force, partial=None)
        with jax.numpy_rank_promotion("allow"):
            return mjx.mjx.step(plant.model, plant.loaded(state, force)).qvel

    found, want = (jax.jit(jax.jacfwd(function))(zero) for function in (ours, theirs))
    np.testing.assert_allclose(found, want, rtol=1e-3, atol=1e-5)
