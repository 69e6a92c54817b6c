"""The drive inside environments of MuJoCo Playground, against drives stepped by hand."""

import dataclasses
import functools
import operator

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

import jaxact as jx
from jaxact.errors import UserError

pytest.importorskip("mujoco_playground", reason="needs jaxact[playground]; `make test` has it")

from ml_collections import config_dict
from mujoco_playground._src import mjx_env, registry
from mujoco_playground._src.wrapper import wrap_for_brax_training
from quickly import compiled_quickly as compiled_quickly

from jaxact.environments import playground

STEP, SUBSTEPS, KP, KD = 0.002, 5, 30.0, 0.6


def leg(armature=0.01, damping=0.0, gravity=9.81, kv=KD, actuator="position"):
    """A leg of two hinges that hangs; its actuators are position servos, or motors."""
    rows = {
        "position": f'<position joint="hip" kp="{KP}" kv="{kv}" ctrlrange="-1 1" gear="2"/>'
        f'<position joint="knee" kp="{KP}" kv="{kv}" forcerange="-9 9"/>',
        "motor": '<motor joint="hip" gear="3"/><motor joint="knee"/>',
        "filtered": '<general joint="hip" dyntype="filter" dynprm="0.01"/><motor joint="knee"/>',
        "tendon": '<motor tendon="both"/>',
    }
    tendon = (
        '<tendon><fixed name="both"><joint joint="hip" coef="1"/><joint joint="knee" coef="1"/>'
        "</fixed></tendon>"
    )
    return (
        f'<mujoco><option timestep="{STEP}" gravity="0 0 -{gravity}"/>'
        f'<default><joint axis="0 1 0" armature="{armature}" damping="{damping}"/>'
        '<geom contype="0" conaffinity="0"/></default><worldbody>'
        '<body><joint name="hip"/><geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.3"/>'
        '<body pos="0 0 -0.3"><joint name="knee"/>'
        '<geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.3"/></body></body></worldbody>'
        f"{tendon if actuator == 'tendon' else ''}<actuator>{rows[actuator]}</actuator></mujoco>"
    )


class Leg(mjx_env.MjxEnv):
    """The leg as an environment: it begins at an angle, and ends where `horizon` says.

    A reset that settles takes steps of its own, which no drive is in. They take long to compile.
    """

    def __init__(self, text, horizon=1e9, bypass=False, settles=False):
        super().__init__(config_dict.create(ctrl_dt=STEP * SUBSTEPS, sim_dt=STEP))
        self._mj_model = mujoco.MjModel.from_xml_string(text)
        self._mjx_model = mjx.put_model(self._mj_model, impl="jax")
        self.horizon, self.bypass, self.settles = horizon, bypass, settles

    def reset(self, rng):
        qpos, qvel = 0.3 * jax.random.normal(rng, (2, 2))
        data = mjx_env.make_data(self._mj_model, qpos=qpos, qvel=qvel, impl="jax")
        if self.settles:
            data = mjx_env.step(self._mjx_model, data, jnp.zeros(self.action_size), 2)
        zero = jnp.zeros(())
        return mjx_env.State(data, data.qpos, zero, zero, {}, {"time": zero})

    def step(self, state, action):
        if self.bypass:
            data = mjx.step(self._mjx_model, state.data.replace(ctrl=action))
        else:
            data = mjx_env.step(self._mjx_model, state.data, action, self.n_substeps)
        time = state.info["time"] + 1.0
        return state.replace(data=data, obs=data.qpos, info={**state.info, "time": time},
                             done=jnp.where(data.time > self.horizon, 1.0, 0.0))  # fmt: skip

    xml_path = ""
    action_size = property(lambda self: self._mj_model.nu)
    mj_model = property(lambda self: self._mj_model)
    mjx_model = property(lambda self: self._mjx_model)


@pytest.fixture(autouse=True)
def as_users_have_it():
    """Mujoco.mjx relies on NumPy's broadcasting of ranks."""
    with jax.numpy_rank_promotion("allow"):
        yield


def joint_forces(state):
    return np.asarray(state.data.qfrc_actuator)


def actions(count, envs=()):
    one = 0.4 * np.sin(np.arange(count)[:, None] * np.array([0.3, 0.5]))
    return np.broadcast_to(one.reshape(count, *(1 for _ in envs), 2), (count, *envs, 2))


def by_hand(text, data, controls, values, gains=(KP, KD)):
    """Joint forces after each control, from `jaxact.drive_around` a step of MJX with motors."""
    gains = jnp.asarray(gains)
    begin = data.qpos, data.qvel, data.time, data.qacc_warmstart
    return np.asarray(_by_hand(text, begin, jnp.asarray(controls), values, gains))


@functools.partial(jax.jit, static_argnums=0)
def _by_hand(text, begin, controls, values, gains):
    motors = text.replace(f'<position joint="hip" kp="{KP}" kv="{KD}" ctrlrange="-1 1" gear="2"/>',
                          '<motor joint="hip"/>')  # fmt: skip
    motors = motors.replace(f'<position joint="knee" kp="{KP}" kv="{KD}"', '<motor joint="knee"')
    model = mjx.put_model(mujoco.MjModel.from_xml_string(motors), impl="jax")
    kp, kd = (np.array([4.0, 1.0]) * one for one in gains)  # the gear of 2 counts twice

    def advance(data, force):
        return mjx.step(model, data.replace(ctrl=force))

    fixed = {"unit": "rad", "control_rate": 1 / STEP, "force_limit": [np.inf, 9.0]}
    loop = jx.joint(**fixed, kp=kp, kd=kd, **values)
    longest = jx.joint(**fixed, kp=KP, kd=KD, **dict.fromkeys(values, 1.0) | {"delay": 0.02})
    drive = jx.drive_around(advance, loop, measure=lambda data: (data.qpos, data.qvel),
                            physics_step=STEP, joints=2, longest=longest)  # fmt: skip
    setpoints = controls / np.array([2.0, 1.0])
    qpos, qvel, time, warmstart = begin
    first = kp * (setpoints[0] - qpos) - kd * qvel + values.get("feedforward", 0.0)
    fresh = mjx.make_data(model).replace(qpos=qpos, qvel=qvel, time=time,
                                         qacc_warmstart=warmstart)  # fmt: skip

    def control(state, setpoint):
        state, _ = jax.lax.scan(lambda s, _: drive.step(s, setpoint), state, None, length=SUBSTEPS)
        return state, state.simulator.qfrc_actuator

    state = drive.init(fresh, command=first)
    return jax.lax.scan(control, state, setpoints)[1]


@pytest.mark.exhaustive
def test_without_delay_it_is_an_explicit_pd():
    with jax.enable_x64(True):
        env = playground(Leg(leg()))
        state = jax.jit(env.reset)(jax.random.PRNGKey(1))
        controls = jnp.asarray(actions(200))

        def one(state, action):
            state = env.step(state, action)
            return state, state.data.qpos

        _, found = jax.lax.scan(one, state, controls)
        model = mujoco.MjModel.from_xml_string(leg(actuator="motor"))
        data = mujoco.MjData(model)
        data.qpos, data.qvel = state.data.qpos, state.data.qvel
        expected = []
        for control in np.asarray(controls):
            setpoint = control / [2.0, 1.0]
            for _ in range(SUBSTEPS):
                force = KP * np.array([4, 1]) * (setpoint - data.qpos)
                force -= KD * np.array([4, 1]) * data.qvel
                force[1] = np.clip(force[1], -9, 9)
                data.ctrl = force / [3.0, 1.0]
                mujoco.mj_step(model, data)
            expected.append(data.qpos.copy())
    assert np.abs(expected).max() > 0.3
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.exhaustive
def test_a_feedforward_is_a_constant_force_and_part_of_the_first_command():
    values = {"feedforward": np.array([1.5, -0.5]), "delay": 0.004}
    with jax.enable_x64(True):
        env = playground(Leg(leg()), **values)
        state, found = jax.jit(env.reset)(jax.random.PRNGKey(2)), []
        data, step = state.data, jax.jit(env.step)
        for control in actions(5):
            state = step(state, jnp.asarray(control))
            found.append(joint_forces(state))
        expected = by_hand(leg(), data, actions(5), values)
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


@pytest.fixture(scope="module")
def four():
    """Four environments with drives that differ, stepped 30 times.

    Returns:
        The driven environment, a compiled step of the four, their states, and their controls.
    """
    with jax.numpy_rank_promotion("allow"), jax.enable_x64(True):
        env = playground(Leg(leg(), settles=True), wn=(60.0, 200.0), zeta=0.7, delay=(0.0, 0.02))
        reset, step = jax.jit(jax.vmap(env.reset)), jax.jit(jax.vmap(env.step))
        first = reset(jax.random.split(jax.random.PRNGKey(3), 4))
        controls, states = actions(30, (4,)), [first]
        for control in controls:
            states.append(step(states[-1], jnp.asarray(control)))
    return env, step, states, controls


def drawn(env, state, member):
    draws = state.data.userdata[member, 1 : 1 + env.drive.draws]
    values = env.drive.values(draws, env.mjx_model)
    return {name: float(values[name]) for name in ("wn", "zeta", "delay")}


@pytest.mark.exhaustive
def test_torques_are_those_of_the_drive_stepped_by_hand(four):
    env, _, states, controls = four
    delays = []
    for member in range(4):
        with jax.enable_x64(True):
            values = drawn(env, states[1], member)
            data = jax.tree.map(operator.itemgetter(member), states[0].data)
            expected = by_hand(leg(), data, controls[:, member], values)
        found = [joint_forces(state)[member] for state in states[1:]]
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
        delays.append(values["delay"])
    assert len({round(one, 6) for one in delays}) == 4 and all(0 <= one <= 0.02 for one in delays)


@pytest.mark.exhaustive
def test_what_an_environment_draws_stays_until_it_is_reset(four):
    env, _, states, _ = four
    shares = [np.asarray(state.data.userdata[:, 1 : 1 + env.drive.draws]) for state in states]
    assert not shares[0].any() and all((one == shares[1]).all() for one in shares[2:])


@pytest.mark.exhaustive
def test_one_environment_of_four_begins_anew(four):
    """The others keep what they have drawn, and it what follows from its own draw."""
    _, step, states, controls = four
    with jax.enable_x64(True):
        state, control = states[-1], jnp.asarray(controls[-1])
        begun = jnp.arange(4)[:, None] != 2
        emptied = state.data.replace(userdata=jnp.where(begun, state.data.userdata, 0.0))
        mixed = step(state.replace(data=emptied), control).data
        whole = step(state, control).data
        assert (mixed.userdata[:, 0] == 1.0).all() and mixed.userdata[2, 1] != whole.userdata[2, 1]
        others = np.array([0, 1, 3])
        for name in ("userdata", "qpos", "qfrc_actuator"):
            found, expected = getattr(mixed, name)[others], getattr(whole, name)[others]
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
        alone = emptied.replace(userdata=jnp.zeros_like(emptied.userdata))
        alone = step(state.replace(data=alone), control).data
        np.testing.assert_allclose(mixed.userdata[2], alone.userdata[2], rtol=1e-12, atol=1e-12)


@pytest.mark.exhaustive
def test_the_gradient_through_steps_is_that_of_differences():
    with jax.enable_x64(True):
        text = leg().replace("<option ", '<option iterations="1" ls_iterations="4" ')
        env = playground(Leg(text), wn=(60.0, 200.0), delay=(0.0, 0.02))
        first = jax.jit(env.reset)(jax.random.PRNGKey(1))

        def cost(action):
            state, _ = jax.lax.scan(lambda s, _: (env.step(s, action), None), first, None, length=4)
            return jnp.sum(state.data.qpos**2)

        action, compiled = jnp.array([0.2, -0.3]), jax.jit(jax.value_and_grad(cost))
        _, found = compiled(action)
        for number, moved in enumerate(1e-5 * np.eye(2)):
            difference = (compiled(action + moved)[0] - compiled(action - moved)[0]) / 2e-5
            np.testing.assert_allclose(found[number], difference, rtol=1e-6, atol=1e-9)
        assert np.abs(found).max() > 1e-3


@pytest.mark.exhaustive
@pytest.mark.parametrize("full_reset", (False, True))
def test_drives_begin_anew_with_their_episode(full_reset):
    """Through Playground's wrapper: with the first command held before, and another draw."""
    env = playground(Leg(leg(), horizon=0.055), delay=(0.02, 0.03))  # longer than a step
    wrapped = wrap_for_brax_training(env, episode_length=1000, full_reset=full_reset)
    state = jax.jit(wrapped.reset)(jax.random.split(jax.random.PRNGKey(5), 3))
    step = jax.jit(wrapped.step)
    draws, starts = [], []
    for number, control in enumerate(actions(20, (3,))):
        before, state = state.data, step(state, jnp.asarray(control))
        draws.append(np.asarray(state.data.userdata[:, 1]))
        if not np.asarray(before.userdata[:, 0]).any():
            starts.append(number)
            held = KP * (control / [2, 1] - before.qpos) - KD * before.qvel
            expected = np.array(np.array([4, 1]) * held)
            expected[:, 1] = np.clip(expected[:, 1], -9, 9)
            np.testing.assert_allclose(joint_forces(state), expected, rtol=1e-4, atol=1e-4)
    assert len(starts) > 2 and len(set(np.diff(starts))) == 1
    assert (draws[starts[0]] != draws[starts[1]]).all()


@pytest.mark.exhaustive
def test_randomised_models_bring_their_own_gains():
    """Beside `randomization_fn`, which ordinary wrappers are left out by."""
    env = playground(Leg(leg()), delay=0.004)
    scales = jnp.array([0.5, 1.0, 2.0])

    def randomise(model):
        axes = jax.tree.map(lambda leaf: None, model)
        names = ("actuator_gainprm", "actuator_biasprm")
        changed = {name: scales[:, None, None] * getattr(model, name) for name in names}
        return model.tree_replace(changed), axes.tree_replace(dict.fromkeys(names, 0))

    wrapped = wrap_for_brax_training(env, randomization_fn=randomise)
    key = jnp.tile(jax.random.PRNGKey(7), (3, 1))
    state = jax.jit(wrapped.reset)(key)
    begin = state.data
    controls = actions(12, (3,))
    found = []
    step = jax.jit(wrapped.step)
    for control in controls:
        state = step(state, jnp.asarray(control))
        found.append(joint_forces(state))
    for member, scale in enumerate((0.5, 1.0, 2.0)):
        own = jax.tree.map(operator.itemgetter(member), begin)
        expected = by_hand(leg(), own, controls[:, member], {"delay": 0.004},
                           gains=(scale * KP, scale * KD))  # fmt: skip
        np.testing.assert_allclose(
            np.array(found)[:, member], expected, atol=2e-5 * np.abs(expected).max()
        )


@pytest.mark.exhaustive
def test_forces_of_motors_are_delayed():
    env = playground(Leg(leg(actuator="motor")), delay=2.5 * STEP * SUBSTEPS)
    step = jax.jit(env.step)
    state = step(jax.jit(env.reset)(jax.random.PRNGKey(0)), jnp.array([0.1, 0.2]))
    found = []
    for _ in range(5):
        state = step(state, jnp.array([0.5, 0.6]))
        found.append(joint_forces(state))
    np.testing.assert_allclose(found[0], [0.3, 0.2], rtol=1e-6)  # gear 3
    np.testing.assert_allclose(found[-1], [1.5, 0.6], rtol=1e-6)


@pytest.mark.exhaustive
def test_damping_moves_into_the_drive():
    inside = playground(Leg(leg(damping=0.4, kv=0.0)), damping="drive", delay=0.004).drive
    values = inside.values(jnp.zeros(0), mjx.put_model(
        mujoco.MjModel.from_xml_string(leg(damping=0.4, kv=0.0)), impl="jax"))  # fmt: skip
    np.testing.assert_allclose(values["kd"], [0.4, 0.4])
    fields = inside.actuators.as_motors(
        mjx.put_model(mujoco.MjModel.from_xml_string(leg(damping=0.4)), impl="jax"), damping=True
    )
    assert not fields["dof_damping"].any()


@pytest.mark.exhaustive
def test_an_environment_of_playground_is_wrapped():
    env = registry.load("CartpoleBalance", config_overrides={"impl": "jax"})
    own = mjx_env.step
    driven = playground(env, actuator="starleth", delay=(0.002, 0.008))
    wrapped = wrap_for_brax_training(driven, episode_length=5)
    state = jax.jit(wrapped.reset)(jax.random.split(jax.random.PRNGKey(0), 2))
    step = jax.jit(wrapped.step)
    for _ in range(7):
        state = step(state, jnp.full((2, 1), 0.2))
    assert np.isfinite(np.asarray(state.obs)).all()
    assert mjx_env.step is own  # nothing is left behind
    with pytest.raises(UserError, match="already"):
        playground(driven)


BAD = {
    "multiple of the physics": (leg(), {"control_rate": 300.0}),
    "multiple of the control period": (leg(), {"control_rate": 1 / (2 * STEP)}),
    "hip: its actuator has a filter": (leg(actuator="filtered"), {}),
    "couples several joints": (leg(actuator="tendon"), {}),
    "no joint matches": (leg(), {"joints": "elbow"}),
    "ends below": (leg(), {"delay": (0.01, 0.0)}),
    "is not a range": (leg(), {"delay": (0.01, 0.0, 1.0)}),
    "unknown parameter": (leg(), {"dleay": 0.01}),
    "not a parameter of a drive": (leg(), {"mass": 1.0}),
    "`policy_rate`: follows from the environment": (leg(), {"policy_rate": 50.0}),
    "shape (3,)": (leg(), {"delay": np.zeros(3)}),
    "did you mean 'drive'": (leg(), {"damping": "drives"}),
}


@pytest.mark.parametrize("words", BAD)
def test_what_cannot_work_is_said_at_once(words):
    text, options = BAD[words]
    with pytest.raises(UserError) as caught:
        playground(Leg(text), **options)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_an_environment_that_steps_by_itself_is_refused():
    with pytest.raises(UserError, match=r"mjx_env\.step"):
        playground(Leg(leg(), bypass=True))


@pytest.mark.exhaustive
def test_ranges_of_patterns_and_of_each_joint():
    drive = playground(
        Leg(leg()), delay={"hip": (0.002, 0.004), "knee": 0.001}, each_joint=True
    ).drive
    model = Leg(leg()).mjx_model
    ends = [drive.values(jnp.full(drive.draws, share), model)["delay"] for share in (0.0, 1.0)]
    np.testing.assert_allclose(ends, [[0.002, 0.001], [0.004, 0.001]], rtol=1e-6)
    assert dataclasses.is_dataclass(drive) and drive.draws == 2
