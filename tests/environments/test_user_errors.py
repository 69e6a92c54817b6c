"""What people give to environments by mistake is said in a line; and what they may do with them."""

import pickle

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

import jaxact as jx
from jaxact import environments
from jaxact.errors import UserError
from jaxact.parameters import PARAMETERS

pytest.importorskip("gymnasium", reason="needs jaxact[gymnasium]; `make test` has it")
pytest.importorskip("mujoco_playground", reason="needs jaxact[playground]; `make test` has it")

import gymnasium as gym
from ml_collections import config_dict
from mujoco_playground._src import mjx_env
from mujoco_playground._src.wrapper import Wrapper, wrap_for_brax_training

ROWS = {
    "motor": '<motor joint="hip"/>',
    "velocity": '<velocity joint="hip" kv="2"/>',
    "position": '<position joint="hip" kp="9" kv="1"/>',
}


class Hinge(mjx_env.MjxEnv):
    """One joint, which a motor moves, or a servo."""

    def __init__(self, actuator="motor"):
        super().__init__(config_dict.create(ctrl_dt=0.004, sim_dt=0.002))
        self.text = (
            '<mujoco><worldbody><body><joint name="hip"/><geom size="0.1"/></body></worldbody>'
            f"<actuator>{ROWS[actuator]}</actuator></mujoco>"
        )
        self._mj_model = mujoco.MjModel.from_xml_string(self.text)
        self._mjx_model = mjx.put_model(self._mj_model, impl="jax")

    def reset(self, rng):
        data = mjx_env.make_data(self._mj_model, impl="jax")
        return mjx_env.State(data, data.qpos, jnp.zeros(()), jnp.zeros(()), {}, {})

    def step(self, state, action):
        data = mjx_env.step(self._mjx_model, state.data, action, self.n_substeps)
        return state.replace(data=data)

    xml_path = ""
    action_size = property(lambda self: 1)
    mj_model = property(lambda self: self._mj_model)
    mjx_model = property(lambda self: self._mjx_model)


@pytest.fixture(autouse=True)
def as_users_have_it():
    """Mujoco.mjx relies on NumPy's broadcasting of ranks."""
    with jax.numpy_rank_promotion("allow"):
        yield


def said(call, words):
    with pytest.raises(UserError) as caught:
        call()
    assert words in str(caught.value) and "\n" not in str(caught.value)


NO_ENVIRONMENTS = {
    "put the drive in first": lambda: wrap_for_brax_training(Hinge()),
    "'CartpoleBalance' of type str": lambda: "CartpoleBalance",
    "of type NoneType": lambda: None,
    "not an environment of MuJoCo Playground": lambda: gym.make("CartPole-v1"),
}


@pytest.mark.parametrize("words", NO_ENVIRONMENTS)
def test_what_is_no_environment_of_playground(words):
    said(lambda: environments.playground(NO_ENVIRONMENTS[words](), delay=0.01), words)


def test_what_is_no_environment_of_gymnasium():
    for given, words in (
        ("Ant-v5", "'Ant-v5' of type str is not an environment of gymnasium"),
        (None, "of type NoneType"),
        (Hinge(), "of type Hinge"),
    ):
        said(lambda given=given: environments.gymnasium(given), words)


def test_a_state_or_an_action_of_another_environment():
    env = environments.playground(Wrapper(Hinge()))
    state, action = env.reset(jax.random.PRNGKey(0)), jnp.zeros(1)
    said(lambda: env.step(Hinge().reset(jax.random.PRNGKey(0)), action), "begin with its own reset")
    said(lambda: env.step(state, jnp.zeros(2)), "an action of shape (2,); give (1,)")
    said(lambda: jax.jit(env.step)(state, jnp.zeros(())), "an action of shape (); give (1,)")


def test_a_range_without_an_end_and_a_word_for_yes():
    for given in ({"wn": (100.0, np.inf)}, {"force_limit": {"hip": (2.0, np.inf)}}):
        said(lambda given=given: environments.playground(Hinge(), **given), "its range has no end")
    said(
        lambda: environments.playground(Hinge(), each_joint="yes"), "`each_joint` = 'yes'; allowed"
    )


@pytest.mark.parametrize(
    "given, words",
    [
        ({"control_rate": np.full(1, 500.0)}, "`control_rate`: give one number"),
        ({"velocity_filter": 100.0}, "`velocity_filter`: filters differenced positions"),
        ({"velocity_noise": 0.1, "velocity": "differenced"}, "is of the velocity's own sensor"),
    ],
)
def test_what_does_not_fit_the_drive(given, words):
    said(lambda: environments.playground(Hinge(), **given), words)
    said(lambda: environments.gymnasium(gym.make("InvertedPendulum-v5"), **given), words)


@pytest.mark.parametrize(
    "line, words",
    [
        ({"no_load_speed": 3.0}, "stall_force: a torque-speed line needs"),
        ({"stall_force": (10.0, 20.0)}, "no_load_speed: a torque-speed line needs"),
        ({"stall_force": {"hip": 20.0}}, "no_load_speed of hip: a torque-speed line needs"),
    ],
)
def test_half_a_torque_speed_line(line, words):
    said(lambda: environments.playground(Hinge(), **line), words)
    said(lambda: environments.gymnasium(gym.make("InvertedPendulum-v5"), no_load_speed=3.0),
         "stall_force: a torque-speed line needs")  # fmt: skip


@pytest.mark.parametrize(
    "joints, words",
    [
        ([], "joints = [] drives none; leave it out to drive all of them"),
        ("", "joints = '' drives none"),
        (3, "joints = 3; allowed: a pattern, or several in a list"),
        ([3], "joints = [3]; allowed: a pattern, or several in a list"),
        ("(", "joints: '(' is not a regular expression"),
    ],
)
def test_what_are_no_patterns_of_joints(joints, words):
    said(lambda: environments.playground(Hinge(), joints=joints), words)
    said(lambda: environments.gymnasium(gym.make("InvertedPendulum-v5"), joints=joints), words)


@pytest.mark.parametrize("source", ("playground", "gymnasium", "a file for torch"))
def test_an_unknown_parameter_is_answered_with_those_that_are_taken(source, tmp_path):
    (tmp_path / "hinge.xml").write_text(Hinge("position").text)

    def given(**parameters):
        if source == "playground":
            environments.playground(Hinge("position"), **parameters)
        elif source == "gymnasium":
            environments.gymnasium(gym.make("InvertedPendulum-v5"), **parameters)
        else:
            jx.export(tmp_path / "hinge.xml", "mjlab", parameters=parameters)

    with pytest.raises(UserError, match="^`bogus`: unknown parameter; allowed: ") as caught:
        given(bogus=3.0)
    names = str(caught.value).partition("allowed: ")[2].split(", ")
    assert {"kp", "delay", "control_rate", "actuator"} <= set(names)
    refused = set(PARAMETERS) - set(names)
    assert {"mass", "policy_rate", "setpoint", "payload"} <= refused
    for name in sorted(refused):
        with pytest.raises(UserError, match=f"^`{name}`: (is not a parameter|follows from)"):
            given(**{name: 1.0})
    said(lambda: given(stiffnes=3.0), "did you mean 'stiffness'?")


@pytest.mark.parametrize("actuator", ("motor", "velocity"))
def test_a_stiffness_needs_setpoints(actuator):
    words = "hip: its actuator asks for a"
    for kp in (50.0, {"hip": (10.0, 50.0)}):
        said(lambda kp=kp: environments.playground(Hinge(actuator), kp=kp), words)
    drive = environments.playground(Hinge(actuator), kp=0.0, kd=2.0).drive
    assert drive.values(jnp.zeros(0), Hinge(actuator).mj_model)["kd"] == 2.0


def test_a_file_of_gains_may_have_one_gain_and_names_that_no_joint_has(tmp_path):
    file = tmp_path / "gains.toml"
    file.write_text("[kp]\nhp = 500\n[kd]\nhip = 10\n")
    env = Hinge("position")
    with pytest.warns(jx.GainsWarning, match=r"gains\.toml: of none of the robot's joints: hp"):
        drive = environments.playground(env, gains=file).drive
    values = drive.values(jnp.zeros(0), env.mj_model)
    assert (values["kp"], values["kd"]) == (9.0, 10.0)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_an_environment_of_gymnasium_can_be_pickled():
    def stepped(env):
        env.reset(seed=4)
        return np.array([env.step(np.full(1, 0.5))[0] for _ in range(5)])

    env = environments.gymnasium(gym.make("InvertedPendulum-v5"), delay=(0.0, 0.04))
    expected = stepped(env)
    again = pickle.loads(pickle.dumps(env))
    np.testing.assert_array_equal(stepped(again), expected)


@pytest.mark.parametrize(
    "felt",
    [{"gain_scale": (0.5, 1.5)}, {"measurement_delay": 4e-3}, {"position_noise": {"hip": 1e-3}},
     {"velocity_filter": 90.0, "velocity": "differenced"}],
)  # fmt: skip
def test_what_changes_nothing_of_motors_is_refused(felt):
    """Their forces are what the policy asks for, whatever a sensor of the drive would see."""
    name = next(iter(felt))
    said(lambda: environments.playground(Hinge(), **felt), f"`{name}`: changes nothing, as motors")
    said(lambda: environments.gymnasium(gym.make("InvertedPendulum-v5"), **{
        key: value if key != "position_noise" else 1e-3 for key, value in felt.items()
    }), f"`{name}`: changes nothing, as motors")  # fmt: skip
    for more in ({"kd": 0.5}, {"damping": "drive"}):
        assert environments.playground(Hinge(), **felt, **more).drive
    for servo in ("position", "velocity"):
        assert environments.playground(Hinge(servo), **felt).drive
