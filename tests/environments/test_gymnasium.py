"""The drive inside environments of gymnasium, against plain MuJoCo and drives stepped by hand."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.errors import UserError

pytest.importorskip("gymnasium", reason="needs jaxact[gymnasium]; `make test` has it")

import gymnasium as gym
from gymnasium.envs.mujoco import MujocoEnv

from jaxact import environments

STEP, FRAMES, KP, KD = 0.002, 6, 30.0, 0.6
GEARS = np.array([4.0, 1.0])  # the gear of 2 counts twice

TEXT = f"""<mujoco><option timestep="{STEP}"/><default><joint axis="0 1 0" armature="0.01"/>
<geom contype="0" conaffinity="0"/></default><worldbody>
<body><joint name="hip"/><geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.3"/>
<body pos="0 0 -0.3"><joint name="knee"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.3"/>
</body></body></worldbody><actuator>
<position joint="hip" kp="{KP}" kv="{KD}" ctrlrange="-1 1" gear="2"/>
<position joint="knee" kp="{KP}" kv="{KD}" ctrlrange="-2 2" forcerange="-9 9"/>
</actuator></mujoco>"""
MOTORS = (
    TEXT[: TEXT.index("<position")]
    + '<motor joint="hip"/><motor joint="knee"/></actuator></mujoco>'
)


class Leg(MujocoEnv):
    """A leg of two hinges that hangs, with position servos."""

    metadata = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"],
                "render_fps": round(1 / (STEP * FRAMES))}  # fmt: skip

    def __init__(self, path):
        space = gym.spaces.Box(-np.inf, np.inf, (4,))
        super().__init__(str(path), FRAMES, observation_space=space)

    def _get_obs(self):
        return np.concatenate([self.data.qpos, self.data.qvel])

    def step(self, action):
        self.do_simulation(action, self.frame_skip)
        return self._get_obs(), 0.0, False, False, {}

    def reset_model(self):
        self.set_state(self.np_random.uniform(-0.3, 0.3, 2), np.zeros(2))
        return self._get_obs()


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    found = tmp_path_factory.mktemp("leg") / "leg.xml"
    found.write_text(TEXT)
    return found


def controls(count):
    return 0.4 * np.sin(np.arange(count)[:, None] * np.array([0.3, 0.5]))


def _torques(env, steps=12):
    """Of the actuators at the joints, after each step under large commands."""
    env.reset(seed=1)
    found = []
    for number in range(steps):
        env.step(np.array([0.0, 2.0 * (-1.0) ** (number // 4)]))
        found.append(env.unwrapped.data.qfrc_actuator[1])
    return np.array(found)


def test_limits_by_direction_of_a_file_of_gains_hold(path, tmp_path):
    file = tmp_path / "gains.xml"
    servo = '<position joint="knee" kp="60" kv="1" forcerange="-3 2"/>'
    file.write_text(f"<mujoco><actuator>{servo}</actuator></mujoco>")
    torques = _torques(environments.gymnasium(Leg(path), gains=file))
    assert (torques.min(), torques.max()) == (pytest.approx(-3.0), pytest.approx(2.0))
    # The model's own, 9 N m, hold beside those of a file that has none.
    file.write_text(file.read_text().replace(' forcerange="-3 2"', ""))
    assert np.abs(_torques(environments.gymnasium(Leg(path), gains=file))).max() > 8.0


def test_a_command_that_is_not_a_number_is_forgotten(path):
    """MuJoCo takes all controls as 0 in a step with one that is not a number."""
    env, plain = (environments.gymnasium(Leg(path), delay=4e-3, wn=200.0) for _ in range(2))
    for one in (env, plain):
        one.reset(seed=1)
        one.step(np.array([0.1, 0.2]))
    env.step(np.array([0.1, np.nan]))
    plain.step(np.zeros(2))
    for _ in range(3):
        observed, expected = (one.step(np.array([0.1, 0.2]))[0] for one in (env, plain))
        np.testing.assert_array_equal(observed, expected)


def test_another_physics_step_than_the_drives_is_refused(path):
    env = environments.gymnasium(Leg(path), delay=4e-3)
    env.reset(seed=1)
    env.unwrapped.model.opt.timestep = STEP / 2
    with pytest.raises(UserError, match="physics step is 0.001 s, and was 0.002 s"):
        env.step(np.zeros(2))


def test_a_plant_that_began_anew_beneath_has_a_fresh_drive(path):
    """As the copy of an environment that gymnasium makes again from its arguments."""
    env = environments.gymnasium(Leg(path), delay=10e-3)
    fresh = []
    for disturbed in (False, True):
        env.reset(seed=1)
        for _ in range(5 * disturbed):
            env.step(np.array([0.5, -0.5]))
        env.unwrapped.reset(seed=2)
        fresh.append(env.step(np.array([0.1, 0.2]))[0])
    np.testing.assert_array_equal(*fresh)


@pytest.mark.parametrize("feedforward", [0.0, np.array([1.5, -0.5])], ids=str)
def test_without_delay_it_is_an_explicit_pd(path, feedforward):
    with jax.enable_x64(True):
        env = environments.gymnasium(Leg(path), feedforward=feedforward)
        observed, _ = env.reset(seed=1)
        model = mujoco.MjModel.from_xml_string(MOTORS)
        data = mujoco.MjData(model)
        data.qpos, data.qvel = observed[:2], observed[2:]
        largest = 0.0
        for control in controls(170):  # 1,020 steps
            for _ in range(FRAMES):
                force = GEARS * (KP * (control / [2, 1] - data.qpos) - KD * data.qvel)
                force += feedforward
                force[1] = np.clip(force[1], -9, 9)
                data.ctrl = force
                mujoco.mj_step(model, data)
            observed, *_ = env.step(control)
            np.testing.assert_allclose(observed[:2], data.qpos, atol=1e-9)
            largest = max(largest, np.abs(observed[:2]).max())
    assert largest > 0.3


@pytest.mark.exhaustive
@pytest.mark.parametrize("late", [{}, {"measurement_delay": 0.0031}])
def test_torques_are_those_of_the_drive_stepped_by_hand(path, late):
    """Of a drive that ticks at every third physics step, around MJX."""
    values = {"delay": 0.0093, "wn": 120.0, "zeta": 0.7, "control_rate": 1 / (3 * STEP), **late}
    with jax.enable_x64(True), jax.numpy_rank_promotion("allow"):
        env = environments.gymnasium(Leg(path), **values)
        observed, _ = env.reset(seed=4)
        model = mjx.put_model(mujoco.MjModel.from_xml_string(MOTORS), impl="jax")
        loop = jx.joint(
            unit="rad", kp=KP * GEARS, kd=KD * GEARS, force_limit=[np.inf, 9.0], **values
        )
        drive = jx.drive_around(
            lambda data, force: mjx.step(model, data.replace(ctrl=force)), loop,
            measure=lambda data: (data.qpos, data.qvel), physics_step=STEP, joints=2,
        )  # fmt: skip
        asked = controls(30)
        first = GEARS * (KP * (asked[0] / [2, 1] - observed[:2]) - KD * observed[2:])
        data = mjx.make_data(model).replace(qpos=jnp.asarray(observed[:2]))
        step = jax.jit(drive.step)
        state, largest = drive.init(data, command=first), 0.0
        for control in asked:
            for _ in range(FRAMES // 3):
                state, _ = step(state, jnp.asarray(control / [2, 1]))
            found, *_ = env.step(control)
            np.testing.assert_allclose(
                env.unwrapped.data.qfrc_actuator,
                state.simulator.qfrc_actuator,
                atol=1e-6,
                rtol=1e-6,
            )
            largest = max(largest, np.abs(found).max())
    assert largest > 0.3


def test_a_drive_has_held_its_first_command_with_the_feedforward(path):
    env = environments.gymnasium(Leg(path), feedforward=(1.0, 2.0), delay=FRAMES * STEP)
    observed, _ = env.reset(seed=2)
    env.step(np.zeros(2))
    own = float(env.values["feedforward"])
    first = GEARS * (-KP * observed[:2] - KD * observed[2:]) + own
    assert 1.0 < own < 2.0
    np.testing.assert_allclose(env.unwrapped.data.qfrc_actuator, first, rtol=1e-5)


def test_what_is_drawn_follows_from_the_seed(path):
    env = environments.gymnasium(Leg(path), delay=(0.002, 0.008), wn=(50.0, 200.0))

    def drawn(**options):
        env.reset(**options)
        env.step(np.zeros(2))
        return float(env.values["delay"]), float(env.values["wn"])

    first, second, again = drawn(seed=7), drawn(), drawn(seed=7)
    assert first == again and first != second
    for delay, wn in (first, second):
        assert 0.002 <= delay <= 0.008 and 50.0 <= wn <= 200.0


def test_the_environment_is_left_as_it_was(path):
    inner = Leg(path)
    names = ("actuator_gainprm", "actuator_biasprm", "actuator_ctrlrange", "dof_damping")
    before = {name: getattr(inner.model, name).copy() for name in names}
    env = environments.gymnasium(inner, delay=0.004)
    env.reset(seed=0)
    env.step(np.array([0.1, 0.2]))
    np.testing.assert_allclose(inner.data.ctrl, [0.1, 0.2])
    assert "_step_mujoco_simulation" not in vars(inner)
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(inner.model, name), value)


def test_gains_that_change_in_the_model_change_the_drive(path):
    env = environments.gymnasium(Leg(path))
    env.reset(seed=0)
    env.step(np.zeros(2))
    np.testing.assert_allclose(env.values["kp"], KP * GEARS)
    env.unwrapped.model.actuator_biasprm[1, 1] *= 2.0
    env.step(np.zeros(2))
    np.testing.assert_allclose(env.values["kp"], KP * GEARS * [1, 2])


@pytest.mark.exhaustive
def test_an_environment_of_gymnasium_is_wrapped_in_a_vector():
    def make(delay):
        return environments.gymnasium(gym.make("InvertedPendulum-v5"), delay=delay)

    vector = gym.vector.SyncVectorEnv([functools.partial(make, 0.0), functools.partial(make, 0.06)])
    vector.reset(seed=3)
    for _ in range(3):
        observed, *_ = vector.step(np.full((2, 1), 1.0))
    plain = gym.make("InvertedPendulum-v5")
    plain.reset(seed=3)
    for _ in range(3):
        expected, *_ = plain.step(np.ones(1))
    np.testing.assert_allclose(observed[0], expected, atol=1e-5)  # motors, no delay: as it was


@pytest.mark.exhaustive
def test_in_processes_of_their_own():
    vector = gym.vector.AsyncVectorEnv([_pendulum] * 2, context="spawn")
    try:
        vector.reset(seed=1)
        observed, *_ = vector.step(np.zeros((2, 1)))
        assert np.isfinite(observed).all()
    finally:
        vector.close()


def _pendulum():
    return environments.gymnasium(gym.make("InvertedPendulum-v5"), delay=(0.0, 0.02))


def test_what_cannot_work_is_said_at_once(path):
    with pytest.raises(UserError, match="not an environment of gymnasium on MuJoCo"):
        environments.gymnasium(gym.make("CartPole-v1"))
    with pytest.raises(UserError, match="multiple of the control period"):
        environments.gymnasium(Leg(path), control_rate=1 / (4 * STEP))
    with pytest.raises(UserError, match="`policy_rate`: follows from the environment, which hold"):
        environments.gymnasium(Leg(path), policy_rate=50.0)
    with pytest.raises(UserError, match="has a drive already"):
        environments.gymnasium(environments.gymnasium(Leg(path)))

    class Alone(Leg):
        def do_simulation(self, ctrl, n_frames):
            mujoco.mj_step(self.model, self.data, n_frames)

    env = environments.gymnasium(Alone(path))
    env.reset(seed=0)
    with pytest.raises(UserError, match="does not step through"):
        env.step(np.zeros(2))
