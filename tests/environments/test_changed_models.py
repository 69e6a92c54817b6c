"""Drives in environments whose models are changed: their limits are those of the model as it is."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from jaxact import environments

pytest.importorskip("gymnasium", reason="needs jaxact[gymnasium]; `make test` has it")
pytest.importorskip("mujoco_playground", reason="needs jaxact[playground]; `make test` has it")

import gymnasium as gym
from gymnasium.envs.mujoco import MujocoEnv
from ml_collections import config_dict
from mujoco_playground._src import mjx_env
from mujoco_playground._src.wrapper import wrap_for_brax_training
from quickly import compiled_quickly as compiled_quickly

STEP, FRAMES = 0.002, 5
ARM = f"""<mujoco><option timestep="{STEP}"/><default><joint axis="0 1 0" armature="0.01"/>
<geom contype="0" conaffinity="0"/></default><worldbody>
<body><joint name="hip"/><geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.3"/>
<body pos="0 0 -0.3"><joint name="knee"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.3"/>
</body></body></worldbody><actuator>
<position joint="hip" kp="30" kv="0.6" gear="2" ctrlrange="-0.6 0.6" forcerange="-4 4"/>
<motor joint="knee" gear="3" ctrlrange="-0.4 0.4"/></actuator></mujoco>"""
# Of hip and knee: what each change is, which field it is in, and its row there.
FIELDS = {
    "forcerange": ("actuator_forcerange", 0),
    "ctrlrange of a servo": ("actuator_ctrlrange", 0),
    "ctrlrange of a motor": ("actuator_ctrlrange", 1),
    "gear of a servo": ("actuator_gear", 0),
    "gear of a motor": ("actuator_gear", 1),
    "gain of a motor": ("actuator_gainprm", 1),
}


class Arm(MujocoEnv):
    """A servo and a motor; it hangs, and begins at an angle."""

    metadata = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"],
                "render_fps": round(1 / (STEP * FRAMES))}  # fmt: skip

    def __init__(self, path):
        super().__init__(str(path), FRAMES, observation_space=gym.spaces.Box(-9, 9, (4,)))

    def _get_obs(self):
        return np.concatenate([self.data.qpos, self.data.qvel])

    def step(self, action):
        self.do_simulation(action, self.frame_skip)
        return self._get_obs(), 0.0, False, False, {}

    def reset_model(self):
        self.set_state(np.array([0.5, -0.3]), np.zeros(2))
        return self._get_obs()


class Hanging(mjx_env.MjxEnv):
    """The same for Playground; its angle follows from the key."""

    def __init__(self):
        super().__init__(config_dict.create(ctrl_dt=STEP * FRAMES, sim_dt=STEP))
        self._mj_model = mujoco.MjModel.from_xml_string(ARM)
        self._mjx_model = mjx.put_model(self._mj_model, impl="jax")

    def reset(self, rng):
        qpos = jax.random.uniform(jax.random.split(rng)[0], (2,))
        data = mjx_env.make_data(self._mj_model, qpos=qpos, impl="jax")
        zero = jnp.zeros(())
        return mjx_env.State(data, data.qpos, zero, zero, {}, {})

    def step(self, state, action):
        data = mjx_env.step(self._mjx_model, state.data, action, self.n_substeps)
        return state.replace(data=data, obs=data.qpos)

    xml_path = ""
    action_size = property(lambda self: 2)
    mj_model = property(lambda self: self._mj_model)
    mjx_model = property(lambda self: self._mjx_model)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    found = tmp_path_factory.mktemp("arm") / "arm.xml"
    found.write_text(ARM)
    return found


@pytest.fixture(scope="module")
def arm(path):
    """Compiled once; whoever changes its model changes it back."""
    return environments.gymnasium(Arm(path))


def controls(count):
    """Beyond every limit, in both directions."""
    return np.sin(np.arange(count)[:, None] * [0.5, 0.9] + [0.0, 1.0])


def plain(model, qpos, asked):
    """Positions after each control, of MuJoCo's own actuators without implicit damping."""
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    data = mujoco.MjData(model)
    data.qpos, found = qpos, []
    for control in asked:
        data.ctrl = control
        mujoco.mj_step(model, data, FRAMES)
        found.append(data.qpos.copy())
    return np.array(found)


def driven(env, asked):
    return np.array([env.step(control)[0][:2] for control in asked])


@pytest.mark.parametrize("factor", (0.6, 1.5))
@pytest.mark.parametrize("what", FIELDS)
def test_what_is_changed_in_the_model_counts_at_once(arm, what, factor):
    """Lowered and raised, in the middle of an episode: as of plain MuJoCo with that model."""
    field, row = FIELDS[what]
    asked, model = controls(12), arm.unwrapped.model
    start, _ = arm.reset(seed=0)
    nominal = getattr(model, field)[row].copy()
    ordinary = plain(mujoco.MjModel.from_xml_string(ARM), start[:2], asked)
    getattr(model, field)[row] *= factor
    try:
        found = driven(arm, asked)
    finally:
        getattr(model, field)[row] = nominal
    other = mujoco.MjModel.from_xml_string(ARM)
    getattr(other, field)[row] *= factor
    expected = plain(other, start[:2], asked)
    np.testing.assert_allclose(found, expected, atol=2e-5)
    assert np.abs(expected - ordinary).max() > 0.01


def test_limits_that_come_into_the_model_or_leave_it_count(path):
    env, asked = environments.gymnasium(Arm(path)), controls(12)
    for change in (_limit_of_the_joint, _no_limits, _other_limits_by_direction):
        start, _ = env.reset(seed=0)
        other = mujoco.MjModel.from_xml_string(ARM)
        for model in (env.unwrapped.model, other):
            change(model)
        np.testing.assert_allclose(driven(env, asked), plain(other, start[:2], asked), atol=2e-5)
    np.testing.assert_allclose(env.values["lowest_force"], [-2.0, -1.2])
    np.testing.assert_allclose(env.values["highest_force"], [14.0, 1.2])


def _limit_of_the_joint(model):
    model.jnt_actfrclimited[:] = 1
    model.jnt_actfrcrange[:] = [[-2.5, 2.5], [-0.8, 0.8]]


def _no_limits(model):
    model.jnt_actfrclimited[:] = 0
    model.actuator_forcelimited[:] = 0
    model.actuator_ctrllimited[:] = 0


def _other_limits_by_direction(model):
    model.actuator_forcelimited[0] = model.actuator_ctrllimited[:] = 1
    model.actuator_forcerange[0] = [-1, 7]
    model.actuator_ctrlrange[:] = [[-0.6, 0.9], [-0.4, 0.4]]


def test_a_force_waits_at_the_limit_of_its_direction(path):
    """A limited rate begins from the limit when the command turns, not from beyond it."""
    most, low, high = 4000.0 * STEP, -2.0, 14.0  # most that the force changes in a step
    env = environments.gymnasium(Arm(path), force_rate_limit={"hip": most / STEP})
    start, _ = env.reset(seed=0)
    env.unwrapped.model.actuator_forcerange[0] = [low / 2, high / 2]  # gear 2
    env.unwrapped.model.actuator_ctrlrange[0] = [-9, 9]
    servo = ARM[ARM.index("<position") : ARM.index("<motor")]
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(ARM.replace(servo, '<motor joint="hip"/>')))
    data.qpos, force, reached = start[:2], None, []
    for asked in (1.0, 2.0, 2.0, -2.0, -2.0, 2.0):
        for _ in range(FRAMES):
            wish = 120 * (asked / 2 - data.qpos[0]) - 2.4 * data.qvel[0]
            gap = np.clip(wish, low, high) - (wish if force is None else force)
            force = wish if force is None else force
            ramp, end = min(abs(gap) / most, 1.0), force + np.clip(gap, -most, most)
            data.ctrl[0] = ramp * (force + end) / 2 + (1 - ramp) * end
            force = end
            mujoco.mj_step(data.model, data)
        reached.append(force)
        found, *_ = env.step(np.array([asked, 0.0]))
        np.testing.assert_allclose(found[:2], data.qpos, atol=1e-5)
    assert max(reached) == high and min(reached) == low


@pytest.mark.parametrize(
    ("drive", "most"),
    [({"setpoint_delay": 7e-3, "wn": 300.0, "zeta": 0.7}, np.inf),
     ({"force_limit": 5.0, "force_rate_limit": 50.0}, 5.0)],
)  # fmt: skip
def test_a_reset_drive_gives_the_force_of_its_first_command(drive, most, tmp_path):
    """Of a joint that does not move: held for ever, and within the limits of the force."""
    heavy = tmp_path / "heavy.xml"
    heavy.write_text(ARM.replace('armature="0.01"', 'armature="1e9"').replace("forcerange", "user"))
    env = environments.gymnasium(Arm(heavy), **drive)
    start, _ = env.reset(seed=0)
    for asked in (0.1, 0.1, 0.1):
        env.step(np.array([asked, 0.0]))
        force = np.clip(30 * 2 * (asked - 2 * start[0]), -most, most)
        assert env.unwrapped.data.qfrc_actuator[0] == pytest.approx(force, rel=1e-5)


@pytest.mark.exhaustive
def test_randomised_models_bring_their_own_limits():
    """As of plain MuJoCo, for each of the models, in either direction."""
    with jax.numpy_rank_promotion("allow"):
        scales = np.array([0.6, 1.0, 1.5])
        names = {field for field, _ in FIELDS.values()}

        def changed(model, scale):
            return {
                "actuator_forcerange": model.actuator_forcerange * scale,
                "actuator_ctrlrange": model.actuator_ctrlrange * scale,
                "actuator_gear": model.actuator_gear / scale**0.5,
                "actuator_gainprm": model.actuator_gainprm * np.array([[1.0], [scale]]),
            }

        def randomise(model):
            own = [changed(model, scale) for scale in scales]
            stacked = {name: jnp.stack([one[name] for one in own]) for name in names}
            axes = jax.tree.map(lambda leaf: None, model)
            return model.tree_replace(stacked), axes.tree_replace(dict.fromkeys(names, 0))

        env = environments.playground(Hanging())
        env = wrap_for_brax_training(env, randomization_fn=randomise)
        state = jax.jit(env.reset)(jnp.tile(jax.random.PRNGKey(3), (3, 1)))
        start, step, found, asked = np.asarray(state.data.qpos), jax.jit(env.step), [], controls(10)
        for control in asked:
            state = step(state, jnp.tile(jnp.asarray(control, jnp.float32), (3, 1)))
            found.append(np.asarray(state.data.qpos))
    expected = []
    for member, scale in enumerate(scales):
        model = mujoco.MjModel.from_xml_string(ARM)
        for name, value in changed(model, scale).items():
            getattr(model, name)[:] = value
        expected.append(plain(model, start[member], asked))
    np.testing.assert_allclose(np.stack(found, axis=1), expected, atol=2e-5)
    assert min(np.abs(expected[i] - expected[1]).max() for i in (0, 2)) > 0.05


@pytest.mark.exhaustive
def test_an_environment_begins_as_it_does_without_a_drive():
    """And what the drive draws has nothing to do with it."""
    with jax.numpy_rank_promotion("allow"):
        env = environments.playground(Hanging(), delay=(0.0, 0.01))
        keys = jax.random.split(jax.random.PRNGKey(5), 400)
        state = jax.jit(jax.vmap(env.reset))(keys)
        start, bare = (
            np.asarray(one.data.qpos) for one in (state, jax.vmap(Hanging().reset)(keys))
        )
        np.testing.assert_array_equal(start, bare)
        own = state.info["jaxact"]["key"]
        for children in (jax.vmap(lambda key: jax.random.split(key, 50))(keys), keys[:, None]):
            assert not (own[:, None] == children).all(-1).any()
        drawn = np.asarray(jax.vmap(env.drive.draw)(own))[:, 0]
    assert abs(np.corrcoef(drawn, start[:, 0])[0, 1]) < 0.15 and 0.45 < drawn.mean() < 0.55
