"""What shakes and what topples, against closed forms and rollouts in plain MuJoCo."""

import mujoco
import numpy as np
import pytest
import scipy.linalg
from quickly import compiled_quickly as compiled_quickly

from jaxact.analysis.robot import modes as robot_modes
from jaxact.loops import reading
from jaxact.robot_margins import whole_robot

# Two joints apart from each other: one upright in gravity, one that turns about the vertical.
UPRIGHT = """<mujoco><option timestep="0.001"/><worldbody>
<body><joint name="upright" axis="0 1 0" armature="1e-6"/>
<geom size="0.01" pos="0 0 1" mass="2"/></body>
<body pos="2 0 0"><joint name="turning" axis="0 0 1" armature="0.05"/>
<geom size="0.01" mass="0.1"/></body></worldbody>
<actuator><motor joint="upright"/><motor joint="turning"/></actuator></mujoco>"""
GRAVITY = 9.81


def found(folder, *overrides):
    (folder / "upright.xml").write_text(UPRIGHT)
    document = """engine = "mujoco"
    plant.model = "upright.xml"
    plant.posture = "keyframe"
    [parameters]
    control_rate = 1000
    "kp@upright" = 10
    "kd@upright" = 20
    "kp@turning" = 20
    "kd@turning" = 4
    [axes]
    feedforward = [0.0]"""
    (one,) = whole_robot.evaluate(reading.parse(document, folder, overrides))
    return one


def rollout(gains, ticks, seconds=6.0):
    """Joint positions after a kick, the command late by whole ticks; nothing of jaxact."""
    model = mujoco.MjModel.from_xml_string(UPRIGHT)
    data = mujoco.MjData(model)
    data.qvel[:] = 1e-6
    kp, kd = np.array(gains).T
    late, path = [np.zeros(2)] * ticks, []
    for _ in range(round(seconds / 0.001)):
        late.append(-kp * data.qpos - kd * data.qvel)
        data.ctrl = late.pop(0)
        mujoco.mj_step(model, data)
        path.append(data.qpos.copy())
        if np.abs(path[-1]).max() > 0.05:
            break
    return np.array(path)


@pytest.fixture(scope="module")
def toppling(tmp_path_factory):
    return found(tmp_path_factory.mktemp("upright"))


def test_too_soft_an_upright_joint_topples(toppling):
    margins = toppling.margins
    assert margins.verdict == "topples" and not margins.stable and margins.whole is None
    # J s^2 + kd s + kp - m g l = 0
    expected = np.roots([2.0, 20.0, 10.0 - 2.0 * GRAVITY]).max()
    assert margins.toppling_rate == pytest.approx(expected, rel=2e-3)
    assert margins.critical.frequency == 0.0 and margins.critical.participation[0] > 0.999
    path = rollout([(10.0, 20.0), (20.0, 4.0)], 0, 12.0)
    np.testing.assert_allclose(
        np.log(path[-1, 0] / path[-2001, 0]) / 2.0, margins.toppling_rate, rtol=1e-2
    )


def test_it_stops_toppling_where_the_spring_holds_the_weight(toppling):
    change = toppling.margins.changes.topple_more_gain
    assert change.value == pytest.approx(2.0 * GRAVITY / 10.0, rel=1e-4)
    assert change.frequency == 0.0 and change.participation[0] > 0.999
    assert toppling.margins.changes.topple_less_gain is None


def test_a_robot_that_topples_has_its_margins_to_shaking(toppling):
    changes = toppling.margins.changes
    assert changes.more_delay.participation[1] > 0.999  # the joint that has kd/J = 80 1/s
    ticks = changes.more_delay.value / 0.001
    gains = [(10.0, 20.0), (20.0, 4.0)]
    before = np.abs(rollout(gains, int(np.floor(0.95 * ticks)))[:, 1])
    after = np.abs(rollout(gains, int(np.ceil(1.05 * ticks)))[:, 1])
    assert before[-500:].max() < before[:500].max() < after.max()
    borne = toppling.delay_borne
    assert borne.topples and not borne.shakes and not borne.stable
    assert borne.delay == pytest.approx(changes.more_delay.value, rel=1e-6)
    assert toppling.margins.ranking == [1, 0]
    assert changes.more_gain.participation[1] > 0.999 and changes.more_gain.value > 2.0


LEG = """<body pos="{0} 0 1"><joint name="hip{0}" axis="0 1 0" armature="0.01"/>
<geom size="0.02" pos="0 0 -0.2" mass="1"/><body pos="0 0 -0.25">
<joint name="knee{0}" axis="0 1 0" armature="0.01"/><geom size="0.02" pos="0 0 -0.2" mass="0.5"/>
</body></body>"""
LEGS = f"""<mujoco><option timestep="0.001"/><worldbody>{"".join(map(LEG.format, range(3)))}
</worldbody><actuator>{
    "".join(f'<motor joint="{name}{leg}"/>' for leg in range(3) for name in ("hip", "knee"))
}</actuator></mujoco>"""


def test_legs_that_are_alike_have_equal_shares_in_what_begins_to_shake(tmp_path):
    (tmp_path / "legs.xml").write_text(LEGS)

    def of(delay):
        document = f"""engine = "mujoco"
        plant.model = "legs.xml"
        plant.posture = "keyframe"
        parameters = {{ control_rate = 1000, kp = 60, kd = 3, delay = {delay} }}
        [axes]
        feedforward = [0.0]"""
        (one,) = whole_robot.evaluate(reading.parse(document, tmp_path))
        return one

    legs = of(0.0)
    borne, changes = legs.delay_borne, legs.margins.changes
    shaking = of(1.2 * borne.delay)
    for motion in (borne, changes.more_delay, changes.more_gain, legs.margins.at_peak,
                   shaking.margins.critical, shaking.margins.changes.less_delay,
                   shaking.delay_borne):  # fmt: skip
        shares = motion.participation.reshape(3, 2)
        np.testing.assert_allclose(shares, np.tile(shares[:1], (3, 1)), atol=1e-6)
        assert shares.sum() == pytest.approx(1.0) and shares.min() > 1e-4
    assert legs.margins.ranking[0] in (0, 1)


def test_what_shakes_says_where_it_stops(tmp_path, toppling):
    later = toppling.margins.changes.more_delay.value
    margins = found(tmp_path, f"delay={1.2 * later}", "kp@upright=100").margins
    assert margins.verdict == "shakes" and margins.shaking_rate == margins.growth_rate > 0.0
    assert margins.changes.more_delay is None
    assert margins.changes.less_delay.value == pytest.approx(0.2 * later, rel=1e-3)
    assert margins.changes.less_delay.participation[1] > 0.999
    factor = margins.changes.less_gain.value
    assert 0.5 < factor < 1.0
    inside = found(tmp_path, f"delay={1.2 * later}", "kp@upright=100",
                   f"gain_scale={0.99 * factor}").margins  # fmt: skip
    assert "shakes" not in inside.verdict


def test_what_stops_shaking_is_the_mode_that_shakes(tmp_path, toppling):
    """With a delay of whole periods, of which parts are taken: more commands matter then."""
    changes = toppling.margins.changes
    later = changes.more_delay.value
    for periods in np.ceil(1e3 * later) + np.array([1, 4]):
        less = found(tmp_path, f"delay={1e-3 * periods}", "kp@upright=100").margins
        less = less.changes.less_delay
        assert less.value == pytest.approx(1e-3 * periods - later, rel=2e-2)
        assert less.frequency == pytest.approx(changes.more_delay.frequency, rel=2e-2)
        assert less.participation[1] > 0.999


def test_both_are_said(tmp_path, toppling):
    later = toppling.margins.changes.more_delay.value
    margins = found(tmp_path, f"delay={1.2 * later}").margins
    assert margins.verdict == "shakes and topples"
    assert margins.critical.participation[1] > 0.999  # what shakes, not what grows fastest


def test_roots_are_sorted_by_how_they_move():
    roots = np.array([1.01, 0.9, 1.01 * np.exp(0.3j), -1.2, np.exp(0.02 + 0.01j), 0.0])
    assert robot_modes.growing(roots).tolist() == [True, False, True, True, True, False]
    assert robot_modes.swinging(roots).tolist()[:5] == [False, False, True, True, False]
    assert robot_modes.fastest(roots, 0.5, swing=True) == pytest.approx(2.0 * np.log(1.2))


CHAIN = """<mujoco><option timestep="0.001"/><worldbody>
<body><joint name="ankle" axis="0 1 0" armature="0.3"/>
<geom size="0.01" pos="0 0 0.5" mass="3"/>
<body pos="0 0 0.5"><joint name="knee" axis="0 1 0" armature="0.1"/>
<geom size="0.01" pos="0 0 0.4" mass="2"/></body></body></worldbody>
<actuator><motor joint="ankle"/><motor joint="knee"/></actuator></mujoco>"""


def test_what_begins_to_topple_is_the_direction_that_nothing_holds(tmp_path):
    (tmp_path / "chain.xml").write_text(CHAIN)
    document = """engine = "mujoco"
    plant = { model = "chain.xml", posture = "keyframe" }
    parameters = { control_rate = 1000, "kp@ankle" = 100, "kp@knee" = 40, kd = 10 }
    axes = { feedforward = [0.0] }"""
    (one,) = whole_robot.evaluate(reading.parse(document, tmp_path))
    # Potential energy of the upright chain: weights on the two angles, which add up.
    low, high = 3.0 * GRAVITY * 0.5 + 2.0 * GRAVITY * 0.5, 2.0 * GRAVITY * 0.4
    weight = np.array([[low + high, high], [high, high]])
    factors, directions = scipy.linalg.eigh(weight, np.diag([100.0, 40.0]))
    change = one.margins.changes.topple_less_gain
    assert change.value == pytest.approx(factors[-1], rel=1e-5)
    energy = one.robot.inertias * directions[:, -1] ** 2
    np.testing.assert_allclose(change.participation, energy / energy.sum(), atol=1e-4)


FLOATING = """<mujoco><option timestep="0.001" gravity="0 0 {gravity}"/><worldbody>
<body name="base" pos="0 0 3"><freejoint/><geom type="box" size=".3 .2 .1" mass="12"/>
<body pos=".2 .1 -.1"><joint name="hip" axis="0 1 0" armature=".01"/>
<geom type="capsule" fromto="0 0 0 .05 0 -.3" size=".03" mass="1.5"/>
<body pos=".05 0 -.3"><joint name="knee" axis="0 1 0" armature=".01"/>
<geom type="capsule" fromto="0 0 0 -.1 0 -.3" size=".02" mass=".6"/></body></body></body>
</worldbody><actuator><motor joint="hip"/><motor joint="knee"/></actuator></mujoco>"""


@pytest.mark.exhaustive
@pytest.mark.parametrize("gravity", [0.0, -9.81])
def test_a_base_that_drifts_in_the_air_neither_shakes_nor_topples(tmp_path, gravity):
    """Its twelve roots are at 1, in Jordan blocks, which rounding parts."""
    (tmp_path / "floating.xml").write_text(FLOATING.format(gravity=gravity))
    document = """engine = "mujoco"
    plant.model = "floating.xml"
    plant.posture = "keyframe"
    [parameters]
    control_rate = 1000
    kp = 60
    kd = 2
    [axes]
    feedforward = [0.0]"""
    (one,) = whole_robot.evaluate(reading.parse(document, tmp_path))
    assert one.margins.verdict == "stable" and one.margins.unstable_roots == 0
    borne = one.delay_borne
    assert borne.stable and borne.frequency > 1.0
    later = [f"delay={factor * borne.delay}" for factor in (0.95, 1.05)]
    below, above = (whole_robot.evaluate(reading.parse(document, tmp_path, [d]))[0] for d in later)
    assert (below.margins.verdict, above.margins.verdict) == ("stable", "shakes")
    assert one.margins.whole.delay_margin == pytest.approx(borne.delay, rel=1e-6)


def test_a_slow_fall_is_no_rounding():
    """An upright pendulum that falls by 1e-3 1/s, sampled at 1 kHz."""
    roots = np.array([1.0 + 1e-6, 1.0 - 1e-6, 1.0 + 6e-8, 1.0 + 5e-8j])
    assert list(robot_modes.growing(roots)) == [True, False, False, False]
