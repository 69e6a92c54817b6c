"""`jaxact.drive_around`: the drive around a simulator that is not ours, against a loop by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.errors import UserError

START = (0.01, -0.02)
H = 1e-3  # physics step [s]
J = 0.02  # [kg m^2]


def step(state, force):
    """Two inertias by semi-implicit Euler."""
    position, velocity = state
    velocity = velocity + H * force / J
    return position + H * velocity, velocity


def measure(state):
    return state


def around(loop, longest=None, joints=2):
    return jx.drive_around(
        step, loop, measure=measure, physics_step=H, joints=joints, longest=longest
    )


def rolled(drive, start, ticks, key=None):
    def one(state, _):
        state, output = drive.step(state, jnp.zeros(2), key)
        return state, output.position_before

    return jax.lax.scan(one, drive.init(start), None, length=ticks)[1]


def by_hand(kp, kd, command_steps, measurement_steps, substeps, ticks, start):
    """Ideal actuator, delays of whole physics steps: NumPy, with histories as lists."""
    q, v = np.array(start), np.zeros(2)
    states, commands, found = [(q, v)], [], []
    for tick in range(ticks):
        found.append(q)
        late = max(tick * substeps - measurement_steps, 0)
        sensed = states[late]
        commands += [-(kp * sensed[0] + kd * sensed[1])] * substeps
        for inner in range(substeps):
            number = tick * substeps + inner - command_steps
            v = v + H * (commands[number] if number >= 0 else 0.0) / J
            q = q + H * v
            states.append((q, v))
    return np.array(found)


@pytest.mark.parametrize(
    "command_steps, measurement_steps",
    [
        (0, 0),
        pytest.param(3, 0, marks=pytest.mark.exhaustive),
        pytest.param(0, 4, marks=pytest.mark.exhaustive),
        (3, 5),
    ],
)
def test_delays_are_those_of_a_loop_by_hand(command_steps, measurement_steps):
    loop = jx.joint(kp=8.0, kd=0.4, delay=command_steps * H, control_rate=500.0,
                    measurement_delay=measurement_steps * H)  # fmt: skip
    start = jnp.array([0.01, -0.02]), jnp.zeros(2)
    with jax.enable_x64(True):
        drive = jx.drive_around(step, loop, measure=measure, physics_step=H, joints=2)
        found = jax.jit(rolled, static_argnums=2)(drive, jax.tree.map(jnp.float64, start), 120)
    expected = by_hand(8.0, 0.4, command_steps, measurement_steps, 2, 120, [0.01, -0.02])
    assert np.asarray(found) == pytest.approx(expected, abs=1e-9)


@pytest.mark.exhaustive
def test_the_growth_rate_is_that_of_the_margins():
    loop = jx.joint(kp=80.0, kd=2.0, mass=J, actuator="starleth", delay=0.002)
    drive = jx.drive_around(step, loop, measure=measure, physics_step=H, joints=2)
    found = rolled(drive, (jnp.array([1e-6, 1e-6]), jnp.zeros(2)), 1000)
    envelope = np.abs(np.asarray(found)[:, 0]).reshape(10, 100).max(axis=1)
    growth = np.polyfit(0.1 * np.arange(2, 10), np.log(envelope[2:]), 1)[0]
    # Semi-implicit Euler damps a little.
    assert growth == pytest.approx(float(jx.margins(loop, sampled=True).growth_rate), rel=0.1)


@pytest.mark.exhaustive
def test_it_can_be_mapped_and_differentiated_by_the_delay():
    loop = jx.joint(kp=8.0, kd=0.4, actuator="hyq", control_rate=500.0)
    start = jnp.array([0.01, -0.02]), jnp.zeros(2)

    def end(delay):
        drive = jx.drive_around(
            step, loop.replace(delay=delay), measure=measure, physics_step=H, joints=2,
            longest=loop.replace(delay=0.02),
        )  # fmt: skip
        return rolled(drive, start, 60)[-1, 0]

    delays = jnp.array([0.0, 0.0031, 0.02])
    mapped = jax.vmap(end)(delays)
    assert np.asarray(mapped) == pytest.approx([float(end(d)) for d in delays], rel=1e-4)
    ends = [float(end(0.0031 + sign * 1e-4)) for sign in (-1.0, 1.0)]
    assert float(jax.jacfwd(end)(0.0031)) == pytest.approx((ends[1] - ends[0]) / 2e-4, rel=0.02)


@pytest.mark.exhaustive
def test_joints_may_have_drives_of_their_own_and_noise_of_their_own():
    loop = jx.joint(kp=np.array([8.0, 4.0]), kd=0.4, position_noise=1e-3)
    drive = jx.drive_around(step, loop, measure=measure, physics_step=H, joints=2)
    start = jnp.zeros(2), jnp.zeros(2)
    one, other = (rolled(drive, start, 50, jax.random.key(k)) for k in (0, 1))
    assert not np.allclose(one, other) and not np.allclose(one[:, 0], one[:, 1])
    with pytest.raises(UserError, match="key: a drive with noise needs one"):
        rolled(drive, start, 2)


def test_a_control_period_that_does_not_fit_is_refused():
    with pytest.raises(UserError, match="not a multiple of the physics step"):
        jx.drive_around(step, jx.joint(control_rate=300.0), measure=measure, physics_step=H)


def test_a_rate_that_is_advised_is_taken():
    with pytest.raises(UserError, match="allowed e.g. control_rate = ") as refused:
        jx.drive_around(step, jx.joint(), measure=measure, physics_step=3e-4, joints=2)
    rate = float(str(refused.value).rpartition("= ")[2])
    assert rate == pytest.approx(1000.0, rel=0.2)
    jx.drive_around(step, jx.joint(control_rate=rate), measure=measure, physics_step=3e-4, joints=2)


@pytest.mark.parametrize(
    ("loop", "joints", "setpoint", "measured", "said"),
    [
        ({}, None, [0.0, 0.0], measure, r"measure: gives \(2,\) and.* None; give joints=2"),
        ({}, 2, [0.0, 0.0], lambda state: state[0], "measure: gives one"),
        ({}, 2, [0.0, 0.0, 0.0], measure, r"setpoint: has shape \(3,\)"),
        ({"kp": [1.0, 2.0, 3.0]}, 2, [0.0, 0.0], measure, r"controller.kp has shape \(3,\)"),
    ],
)
def test_shapes_that_do_not_fit_are_said_in_one_line(loop, joints, setpoint, measured, said):
    start = jnp.zeros(2), jnp.zeros(2)
    with pytest.raises(UserError, match=said):
        drive = jx.drive_around(
            step, jx.joint(**loop), measure=measured, physics_step=H, joints=joints
        )
        drive.step(drive.init(start), jnp.array(setpoint))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"physics_step": 0.0}, "physics_step: 0.0 is not a physics step; give seconds above 0"),
        ({"physics_step": -1e-3}, "physics_step: -0.001 is not a physics step"),
        ({"physics_step": float("nan")}, "physics_step: nan is not a physics step"),
        ({"physics_step": "1ms"}, "physics_step: '1ms' is not a physics step"),
        ({"joints": 0}, "joints: 0 is not a number of joints; give 1 or more"),
        ({"joints": 2.0}, "joints: 2.0 is not a number of joints"),
        (
            {"loop": {"kp": 8.0}},
            "loop: a value of type dict is not a loop; give one from jaxact.joint",
        ),
        ({"longest": {"kp": 8.0}}, "longest: a value of type dict is not a loop"),
        ({"measure": 3}, "measure: a value of type int is not a function"),
    ],
)
def test_what_is_no_loop_or_no_number_is_said_in_one_line(given, said):
    given = {"loop": jx.joint(), "joints": 2, "physics_step": H, "measure": measure, **given}
    with pytest.raises(UserError, match=said) as refused:
        jx.drive_around(step, given.pop("loop"), **given)
    assert "\n" not in str(refused.value)


def test_a_batch_of_robots_does_not_pass_for_joints(tmp_path):
    rows = "".join(
        f'<body><joint name="{name}" axis="0 1 0"/><geom size="0.1" mass="1"/></body>'
        for name in ("knee", "hip")
    )
    drives = "".join(f'<position joint="{name}" kp="8" kv="0.4"/>' for name in ("knee", "hip"))
    (tmp_path / "robot.xml").write_text(
        f"<mujoco><worldbody>{rows}</worldbody><actuator>{drives}</actuator></mujoco>"
    )
    robots = jx.robot(tmp_path / "robot.xml", kp=[10.0, 20.0])
    with pytest.raises(UserError, match=r"loop: a batch of robots of shape \(2,\); give one"):
        jx.drive_around(step, robots, measure=measure, physics_step=H)


@pytest.mark.exhaustive
def test_a_robots_loop_gives_each_joint_its_own_drive(tmp_path):
    rows = "".join(
        f'<body pos="0 {n} 0"><joint name="{name}" axis="0 1 0"/><geom size="0.1" mass="1"/></body>'
        for n, name in enumerate(("knee", "hip"))
    )
    (tmp_path / "robot.xml").write_text(
        f"<mujoco><worldbody>{rows}</worldbody><actuator>"
        '<position joint="knee" kp="8" kv="0.4" forcerange="-3 3"/>'
        '<position joint="hip" kp="4" kv="0.2"/></actuator></mujoco>'
    )
    common = {"actuator": "hyq", "delay": 2 * H, "control_rate": 500.0}
    robot = jx.robot(tmp_path / "robot.xml", kd={"hip": 0.3}, gain_scale=1.5, **common)
    plain = jx.joint(kp=np.array([12.0, 6.0]), kd=np.array([0.6, 0.45]),
                     force_limit=np.array([3.0, np.inf]), **common)  # fmt: skip
    start = jnp.array([0.01, -0.02]), jnp.zeros(2)
    found = [
        rolled(jx.drive_around(step, loop, measure=measure, physics_step=H, **given), start, 60)
        for loop, given in ((robot, {}), (plain, {"joints": 2}))
    ]
    assert np.asarray(found[0]) == pytest.approx(np.asarray(found[1]), abs=1e-7)

    @jax.jit
    def traced(delay):
        drive = around(robot.replace(delay=delay), robot.replace(delay=5 * H), joints=None)
        return rolled(drive, start, 60)

    np.testing.assert_allclose(traced(2 * H), found[1], atol=1e-6)
    assert np.isnan(traced(7 * H)[1:]).all()


def test_a_traced_loop_needs_its_longest():
    def build(delay):
        return jx.drive_around(step, jx.joint(delay=delay), measure=measure, physics_step=H)

    with pytest.raises(TypeError, match="longest"):
        jax.jit(build)(1e-3)


@pytest.mark.exhaustive
@pytest.mark.parametrize("late", ["delay", "output_delay", "measurement_delay", "setpoint_delay"])
@pytest.mark.parametrize("room", [0.0, 0.002, 0.05])
def test_a_traced_delay_without_room_gives_no_number_and_never_a_wrong_one(late, room):
    loop = jx.joint(kp=8.0, kd=0.4)

    def last(delay):
        drive = around(loop.replace(**{late: delay}), loop.replace(**{late: room}))
        return rolled(drive, (jnp.array([0.01, -0.02]), jnp.zeros(2)), 120)[-1]

    def known(delay):
        drive = around(loop.replace(**{late: delay}))
        return rolled(drive, (jnp.array([0.01, -0.02]), jnp.zeros(2)), 120)[-1]

    traced = jax.jit(last)
    if room:
        np.testing.assert_allclose(traced(0.5 * room), known(0.5 * room), atol=1e-6)
    assert np.isnan(traced(room + 0.004)).all()
    with pytest.raises(UserError, match="longest: lacks what the loop has: .*delay"):
        last(room + 0.004)


@pytest.mark.parametrize(
    "name, value",
    [("delay", -1e-3), ("measurement_delay", -1e-4), ("wn", -800.0), ("wn", 0.0), ("zeta", -0.4)],
)
def test_a_traced_value_that_none_may_have_gives_no_number(name, value):
    loop = jx.joint(kp=8.0, kd=0.4, wn=800.0, zeta=0.4, delay=1e-3, measurement_delay=1e-3)

    def last(value):
        drive = around(loop.replace(**{name: value}), loop)
        return rolled(drive, (jnp.array([0.01, -0.02]), jnp.zeros(2)), 20)[-1]

    found = jax.jit(jax.vmap(last))(jnp.array([value, float(loop.parameters[name])]))
    assert np.isnan(found[0]).all() and np.isfinite(found[1]).all()


def test_a_step_that_gives_no_state_is_said_in_one_line():
    drive = jx.drive_around(lambda state, force: None, jx.joint(), measure=measure,
                            physics_step=H, joints=2)  # fmt: skip
    state = drive.init((jnp.zeros(2), jnp.zeros(2)))
    with pytest.raises(UserError, match="step: gives a value of type NoneType, other than the"):
        drive.step(state, jnp.zeros(2))


@pytest.mark.parametrize(
    "part",
    [
        {"force_limit": 2.0},
        {"force_rate_limit": 20.0},
        {"position_noise": 1e-3},
        {"position_bias_walk": 1e-3},
        {"position_resolution": 1e-3},
        {"command_resolution": 1e-3},
        {"policy_rate": 50.0},
        {"velocity": "differenced"},
    ],
    ids=str,
)
def test_a_longest_without_a_part_of_the_loop_is_refused(part):
    plain = jx.joint(kp=8.0, kd=0.4)
    with pytest.raises(UserError, match="longest: "):
        around(plain.replace(**part), plain)


def rolled_from_start(drive, ticks=60):
    return np.asarray(rolled(drive, (jnp.array(START), jnp.zeros(2)), ticks))


@pytest.mark.parametrize("given", [{}, {"control_rate": 500.0}], ids=str)
def test_the_control_period_is_that_of_the_loop_whatever_longest_says_of_delays(given):
    loop = jx.joint(kp=8.0, kd=0.4, delay=4e-3, control_rate=500.0)
    found = rolled_from_start(around(loop, jx.joint(delay=5e-3, **given)))
    expected = by_hand(8.0, 0.4, 4, 0, 2, 60, START)
    assert found == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("rate", [250.0, 1000.0])
def test_another_control_rate_of_longest_is_refused_by_its_name(rate):
    loop = jx.joint(kp=8.0, kd=0.4, delay=4e-3, control_rate=500.0)
    said = f"longest: its control_rate is {rate:g} Hz and that of the loop 500 Hz; give both"
    with pytest.raises(UserError, match=said):
        around(loop, jx.joint(delay=5e-3, control_rate=rate))


def test_a_traced_control_rate_is_that_of_longest_or_gives_no_number():
    loop = jx.joint(kp=8.0, kd=0.4, delay=4e-3)

    def run(rate):
        drive = around(loop.replace(control_rate=rate), loop.replace(control_rate=500.0))
        return rolled(drive, (jnp.array(START), jnp.zeros(2)), 60)

    same, other = jax.jit(jax.vmap(run))(jnp.array([500.0, 1000.0]))
    assert np.asarray(same) == pytest.approx(by_hand(8.0, 0.4, 4, 0, 2, 60, START), abs=1e-6)
    assert np.isnan(other[1:]).all()


def test_several_control_rates_are_said_to_be_the_reason():
    with pytest.raises(UserError, match="control_rate: several, from 500 to 1000 Hz, .* give one"):
        around(jx.joint(control_rate=[500.0, 1000.0]))


@pytest.mark.parametrize("rate, advised", [(300.0, "250"), (2000.0, "1000"), (999.0, "500")])
def test_a_policy_rate_that_does_not_divide_is_refused_as_in_a_simulation(rate, advised):
    loop = jx.joint(policy_rate=rate)
    said = f"policy_rate = {rate:g} Hz does not divide the control rate 1000 Hz.*: {advised}$"
    with pytest.raises(UserError, match=said):
        jx.simulate(loop)
    with pytest.raises(UserError, match=said):
        around(loop)
    with pytest.raises(UserError, match=said):
        around(jx.joint(), longest=loop)


def test_a_policy_rate_holds_setpoints_and_a_traced_one_that_cannot_gives_no_number():
    still = jx.joint(kp=2.0, kd=0.0)
    setpoints = np.random.default_rng(0).normal(size=12)

    def commands(rate):
        drive = jx.drive_around(
            lambda state, force: state, still.replace(policy_rate=rate), physics_step=H,
            measure=lambda state: (state, state), longest=still.replace(policy_rate=250.0),
        )  # fmt: skip
        return jax.lax.scan(lambda state, r: _command(drive, state, r), drive.init(0.0),
                            jnp.asarray(setpoints))[1]  # fmt: skip

    held, fastest, other, beyond = jax.jit(jax.vmap(commands))(
        jnp.array([250.0, np.inf, 300.0, 2000.0])
    )
    np.testing.assert_allclose(held, 2.0 * setpoints[4 * (np.arange(12) // 4)], rtol=1e-6)
    np.testing.assert_allclose(fastest, 2.0 * setpoints, rtol=1e-6)
    assert np.isnan(other).all() and np.isnan(beyond).all()


def _command(drive, state, setpoint):
    state, output = drive.step(state, setpoint)
    return state, output.command


@pytest.mark.exhaustive
@pytest.mark.parametrize("late", ["delay", "output_delay"])
@pytest.mark.parametrize("limits", [{}, {"force_limit": 1.0}], ids=str)
def test_no_number_stays_none_when_all_is_compiled_as_one(late, limits):
    """Written out, where a compiler knows that a selector of the line is 0 or 1."""
    loop = jx.joint(kp=8.0, kd=0.4, **limits)

    def run(delay):
        drive = around(loop.replace(**{late: delay}), loop.replace(**{late: 5e-3}), joints=None)
        state = drive.init((0.01, 0.0))
        for _ in range(8):
            state, output = drive.step(state, 0.3)
        return output

    run = jax.jit(run)
    for delay in (6e-3, 0.2, -1e-3):
        assert all(np.isnan(value) for value in jax.tree.leaves(run(delay))[2:])
    known = around(loop.replace(**{late: 3e-3}), joints=None)
    state = known.init((0.01, 0.0))
    for _ in range(8):
        state, output = known.step(state, 0.3)
    np.testing.assert_allclose(jax.tree.leaves(run(3e-3)), jax.tree.leaves(output), rtol=1e-5)


def test_the_force_is_the_mean_over_the_physics_step():
    """A critically damped actuator under a constant command, f = u (1 - (1 + w t) exp(-w t))."""
    w, u = 300.0, 5.0
    loop = jx.joint(kp=0.0, kd=0.0, feedforward=u, wn=w, zeta=1.0)
    drive = jx.drive_around(lambda state, force: force, loop, physics_step=H,
                            measure=lambda state: (0.0, 0.0))  # fmt: skip
    state, found = drive.init(0.0), []
    for _ in range(6):
        state, _ = drive.step(state, 0.0)
        found.append(float(state.simulator))
    t = H * np.arange(7)
    integral = u * (t + (t + 2.0 / w) * np.exp(-w * t))
    np.testing.assert_allclose(found, np.diff(integral) / H, rtol=1e-4)


def test_a_robot_with_an_actuator_that_is_refused_is_not_driven_without_it(tmp_path):
    text = """<mujoco><worldbody><body><joint name="a"/><geom size=".1"/><body><joint name="b"/>
        <geom size=".1"/></body></body></worldbody><actuator><motor joint="a"/>
        <muscle joint="b" lengthrange="0 1"/></actuator></mujoco>"""
    (tmp_path / "arm.xml").write_text(text)
    loop = jx.robot(tmp_path / "arm.xml", kp=50.0, kd=5.0)
    around = {"measure": lambda state: state, "physics_step": 1e-3}
    with pytest.raises(UserError, match="actuator 1: it is a muscle; name other joints"):
        jx.drive_around(lambda state, force: state, loop, **around)
    driven = jx.drive_around(lambda state, force: state, loop.replace(joints=("a",)), **around)
    assert driven.prepared.plant.joints == 1
