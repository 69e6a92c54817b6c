"""What `jaxact.drive_around` and its steps are given: taken where it can be, else said in a line.

Also that states of Python's own numbers do.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from robots import PENDULUM

import jaxact as jx
from jaxact.errors import UserError

H = 1e-3  # physics step [s]
J = 0.02  # [kg m^2]


def step(state, force):
    """An inertia, or several, by semi-implicit Euler."""
    position, velocity = state
    velocity = velocity + H * force / J
    return position + H * velocity, velocity


def around(joints=None, measure=lambda state: state, **loop):
    return jx.drive_around(
        step, jx.joint(**{"kp": 8.0, "kd": 0.4, **loop}), measure=measure, physics_step=H,
        joints=joints,
    )  # fmt: skip


def by_hand(setpoint, substeps, ticks):
    position, velocity = 0.0, 0.0
    for _ in range(ticks):
        force = 8.0 * (setpoint - position) - 0.4 * velocity
        for _ in range(substeps):
            velocity += H * force / J
            position += H * velocity
    return position, velocity


@pytest.mark.parametrize("rest", [0.0, 0])
@pytest.mark.parametrize("rate", [1000.0, 500.0])
def test_a_state_of_pythons_own_numbers_is_taken(rate, rest):
    drive = around(control_rate=rate)
    state = drive.init((rest, rest))
    for _ in range(5):
        state, output = drive.step(state, 0.1)
    expected = by_hand(0.1, round(1000 / rate), 5)
    np.testing.assert_allclose(state.simulator, expected, rtol=1e-5)
    np.testing.assert_allclose((output.position, output.velocity), expected, rtol=1e-5)


@pytest.mark.parametrize("rate", [1000.0, 500.0])
def test_a_state_of_whole_numbers_that_becomes_another_is_said_in_one_line(rate):
    drive = around(control_rate=rate)
    with pytest.raises(UserError, match="step: gives a number with decimals where"):
        drive.step(drive.init((jnp.zeros((), int), np.zeros((), np.int32))), 0.1)


def test_whole_numbers_of_a_state_that_stay_so_are_kept():
    drive = jx.drive_around(
        lambda state, force: (state[0] + 1, state[1] + force), jx.joint(control_rate=500.0),
        measure=lambda state: (state[1], 0.0), physics_step=H,
    )  # fmt: skip
    state, _ = drive.step(drive.init((0, 0.0)), 0.1)
    assert state.simulator[0] == 2 and state.simulator[0].dtype == jnp.int32


def test_lists_of_numbers_are_measurements_and_setpoints():
    def listed(state):
        return [[state[0][0], state[0][1]], [state[1][0], state[1][1]]]

    found = []
    for measure, setpoint, force in (
        (lambda state: state, jnp.array([0.1, 0.2]), 0.5),
        (listed, [0.1, 0.2], [0.5, 0.5]),
    ):
        drive = around(2, measure, measurement_delay=5e-4, control_rate=500.0)
        state = drive.init((np.zeros(2), np.zeros(2)))
        for _ in range(3):
            state, output = drive.step(state, jx.Setpoint(setpoint, force=force))
        found.append(output.position)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)


@pytest.mark.parametrize(
    "joints, command, said",
    [
        (None, jnp.zeros(4), r"command: has shape \(4,\); the joints' is \(\)"),
        (2, [1.0, 2.0, 3.0], r"command: has shape \(3,\); the joints' is \(2,\)"),
        (None, "a", "command: 'a', of type str, is not of numbers; give a number$"),
        (2, None, r"command: None, of type NoneType, .* or an array of shape \(2,\)"),
        (None, float("nan"), "command: nan is not finite"),
        (2, [0.0, float("inf")], "command: .* is not finite"),
    ],
)
def test_a_past_command_that_is_none_is_said_in_one_line(joints, command, said):
    zero = jnp.zeros(() if joints is None else joints)
    with pytest.raises(UserError, match=said) as refused:
        around(joints).init((zero, zero), command=command)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("command", [1.5, [1.5, 1.5]])
def test_a_past_command_is_the_force_of_the_first_period(command):
    state = (jnp.zeros(2), jnp.zeros(2))
    drive = around(2, delay=H)
    _, output = drive.step(drive.init(state, command=command), [0.1, 0.1])
    np.testing.assert_allclose(output.peak_force, [1.5, 1.5])


@pytest.mark.parametrize(
    "setpoint, said",
    [
        ("a", "setpoint: 'a', of type str, is not of numbers"),
        (None, "setpoint: None, of type NoneType, is not of numbers"),
        (1j, "setpoint: 1j, of type complex, is not of numbers"),
        (jx.Setpoint([0.1, 0.2, 0.3]), r"setpoint.position: has shape \(3,\); the joints' is"),
        (jx.Setpoint(0.1, velocity=jnp.zeros(3)), r"setpoint.velocity: has shape \(3,\)"),
        (jx.Setpoint(0.1, force=jnp.zeros((2, 1))), r"setpoint.force: has shape \(2, 1\)"),
        (jx.Setpoint(0.1, force=None), "setpoint.force: None, of type NoneType"),
    ],
)
def test_a_setpoint_that_is_none_is_said_in_one_line(setpoint, said):
    drive = around(2)
    with pytest.raises(UserError, match=said) as refused:
        drive.step(drive.init((jnp.zeros(2), jnp.zeros(2))), setpoint)
    assert "\n" not in str(refused.value)


def test_a_state_that_is_not_from_init_is_said_in_one_line():
    with pytest.raises(UserError, match=r"state: a value of type tuple .* give drive\.init\("):
        around().step((jnp.zeros(()), jnp.zeros(())), 0.3)


@pytest.mark.parametrize(
    "measured, said",
    [
        (("a", 0.0), r"measure: gives a str and \(\); needed are"),
        ((None, None), "measure: gives a NoneType and a NoneType"),
        ((0.0, 0.0, 0.0), r"measure: gives \(\) and \(\) and \(\)"),
        ((), "measure: gives nothing"),
        (0.0, "measure: gives one float"),
        ({"q": 0.0, "v": 0.0}, "measure: gives one dict"),
        (([0.0], [0.0]), r"measure: gives \(1,\) and \(1,\)"),
    ],
)
def test_a_measurement_that_is_none_is_said_in_one_line(measured, said):
    with pytest.raises(UserError, match=said) as refused:
        around(measure=lambda state: measured).init((0.0, 0.0))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "key, said",
    [
        (3, r"key: 3 is not a random key; give jax\.random\.key\(3\), the same"),
        (0, r"key: 0 is not a random key; give jax\.random\.key\(0\)"),
        (None, r"key: a drive with noise needs one"),
        ("a", r"key: 'a' is not a random key; give jax\.random\.key\(0\)"),
        (jnp.zeros(2), "key: .* is not a random key"),
        (jax.random.split(jax.random.key(0), 3), r"key: keys of shape \(3,\); give one"),
    ],
)
def test_what_is_no_key_is_said_in_one_line(key, said):
    drive = around(position_noise=1e-3)
    state = drive.init((0.0, 0.0))
    with pytest.raises(UserError, match=said) as refused:
        drive.step(state, 0.3, key)
    assert "\n" not in str(refused.value)


def test_both_kinds_of_keys_of_jax_are_taken_and_say_the_same():
    drive = around(position_noise=1e-3)
    state = drive.init((0.0, 0.0))
    one, other = (drive.step(state, 0.3, make(7))[1] for make in (jax.random.key,
                                                                 jax.random.PRNGKey))  # fmt: skip
    assert one.command == other.command and one.command != pytest.approx(2.4, abs=1e-7)


def test_values_of_longest_must_be_known():
    def build(delay):
        return jx.drive_around(step, jx.joint(), measure=lambda state: state, physics_step=H,
                               longest=jx.joint(delay=delay))  # fmt: skip

    with pytest.raises(TypeError, match="values of longest are traced"):
        jax.jit(build)(1e-3)


@pytest.mark.parametrize(
    "joints, line, said",
    [
        (None, {"no_load_speed": 3.0}, "^stall_force: a torque-speed line needs"),
        (None, {"stall_force": 20.0}, "^no_load_speed: a torque-speed line needs"),
        (2, {"stall_force": 20.0, "no_load_speed": [3.0, np.inf]}, "^no_load_speed of joint 1: "),
        (2, {"stall_force": [20.0, np.inf], "no_load_speed": [np.inf, 3.0]},
         "^no_load_speed of joint 0, stall_force of joint 1: a torque-speed line needs"),
    ],
)  # fmt: skip
def test_half_a_torque_speed_line_is_said_in_one_line(joints, line, said):
    with pytest.raises(UserError, match=said) as raised:
        around(joints, **line)
    assert "\n" not in str(raised.value)


def test_a_robots_joint_with_half_a_torque_speed_line_is_named(tmp_path):
    (tmp_path / "arm.xml").write_text(PENDULUM)
    loop = jx.robot(tmp_path / "arm.xml", stall_force=20.0, no_load_speed={"elbow": 3.0})
    with pytest.raises(UserError, match="^no_load_speed of shoulder: a torque-speed line needs"):
        jx.drive_around(step, loop, measure=lambda state: state, physics_step=H)


def test_whole_torque_speed_lines_may_be_traced():
    def force(stall_force):
        line = {"stall_force": stall_force, "no_load_speed": 3.0}
        drive = jx.drive_around(
            step, jx.joint(kp=8.0, kd=0.4, **line), measure=lambda state: state, physics_step=H,
            longest=jx.joint(stall_force=20.0, no_load_speed=3.0),
        )  # fmt: skip
        return drive.step(drive.init((0.0, 0.0)), 1.0)[1].peak_force

    assert jax.jit(force)(0.5) == pytest.approx(0.5)
