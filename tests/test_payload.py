"""Robots with a payload that their controllers do not know: against plain MuJoCo and formulas."""

import json
import warnings
from contextlib import nullcontext

import mujoco
import numpy as np
import pytest
from scipy.optimize import brentq, fsolve

import jaxact as jx
from jaxact.cli.main import main
from jaxact.loops import reading, robots
from jaxact.loops.samples import expand
from jaxact.robots import rest
from jaxact.simulation import changed_models, plans, spectra

GRAVITY = 9.81
# A turntable under an arm: the further the arm sags, the less inertia the turntable feels.
YAW = """<mujoco model="yaw"><option timestep="0.001"/>
<worldbody>
<body name="base" pos="0 0 1"><joint name="yaw" axis="0 0 1" armature="0.002"/>
<geom type="cylinder" size="0.05 0.05" mass="0.5"/>
<body name="fore"><joint name="pitch" axis="0 1 0" damping="0.5" armature="0.01"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0.4 0 0" mass="0.4"/>
<body name="hand" pos="0.4 0 0"><geom size="0.03" mass="0.2"/></body>
</body></body></worldbody>
<actuator><position name="yaw" joint="yaw" kp="60" kv="6"/>
<position name="pitch" joint="pitch" kp="12" kv="0.5"/></actuator>
<keyframe><key name="home" qpos="0 0.2" ctrl="0 0.2"/></keyframe>
</mujoco>"""
HELD = 0.2  # of the pitch joint [rad]
YAW_KP, YAW_KD, DELAY = np.array([340.0, 12.0]), np.array([34.0, 0.5]), 12

# A point mass M on a rod of length 0.5 m, upright at 0, with a hand that weighs nothing.
MASS, LENGTH, DAMPING = 1.0, 0.5, 0.05
ROD = f"""<mujoco><option timestep="0.001"/><worldbody>
<body name="rod"><joint name="j" axis="0 1 0" damping="{DAMPING}"/>
<inertial pos="0 0 {LENGTH}" mass="{MASS}" diaginertia="1e-9 1e-9 1e-9"/>
<body name="hand" pos="0 0 {LENGTH}">
<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/></body></body>
</worldbody><actuator><motor joint="j"/></actuator>
<keyframe><key name="home" qpos="0.3"/></keyframe></mujoco>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("changed")
    (folder / "yaw.xml").write_text(YAW)
    (folder / "rod.xml").write_text(ROD)
    return folder


def _parsed(folder, model, parameters, axes="feedforward = [0.0]", plant=""):
    return reading.parse(
        f'engine = "mujoco"\n[plant]\nmodel = "{model}.xml"\nkeyframe = "home"\n'
        f'payload_body = "hand"\n{plant}\n[parameters]\n{parameters}\n[axes]\n{axes}\n',
        folder,
    )


def _moved(asked):
    """A and B of every sample, and where each rests."""
    samples = expand(asked)
    (plan,) = plans.groups(asked, samples)
    own = plan.case, asked.setting, samples.take(np.arange(len(samples)))
    return changed_models.moved(*own), changed_models.rests(*own)


def _plain(payload):
    """The model of `YAW` with a payload and without its servos, and what bears it at q."""
    model = mujoco.MjModel.from_xml_string(YAW)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    model.body_mass[model.body("hand").id] += payload

    def bearing(q):
        data = mujoco.MjData(model)
        data.qpos = q
        mujoco.mj_forward(model, data)
        return data.qfrc_bias.copy()

    return model, bearing


def _growth(payload):
    """Of a rollout in plain MuJoCo, with a delay of its own: sag of both joints, rate [1/s]."""
    home = np.array([0.0, 0.2])
    force = _plain(0.0)[1](home)  # of the robot that the controllers know
    model, bearing = _plain(payload)
    rest = fsolve(lambda q: YAW_KP * (home - q) + force - bearing(q), home, xtol=1e-9)
    data = mujoco.MjData(model)
    data.qpos, data.qvel[0] = rest, 1e-6
    waiting = [YAW_KP * (home - rest) + force] * DELAY
    yaw = []
    for _ in range(600):
        waiting.append(YAW_KP * (home - data.qpos) - YAW_KD * data.qvel + force)
        data.qfrc_applied = waiting.pop(0)
        mujoco.mj_step(model, data)
        yaw.append(data.qpos[0])
    # Peaks of |yaw| from when other modes have decayed.
    size = np.abs(yaw)
    peaks = [k for k in range(200, 599) if size[k - 1] < size[k] >= size[k + 1]]
    return rest - home, np.polyfit(1e-3 * np.array(peaks), np.log(size[peaks]), 1)[0]


@pytest.mark.exhaustive
def test_growth_under_a_payload_is_that_of_a_plain_rollout(folder):
    """At its nominal posture the same loop would be stable: its inertia about the yaw is larger."""
    asked = _parsed(
        folder, "yaw", '"kp@yaw" = 340.0\n"kd@yaw" = 34.0\ndelay = 0.012',
        "payload = [0.0, 1.0, 2.0]",
    )  # fmt: skip
    samples = expand(asked)
    (plan,) = plans.groups(asked, samples)
    ((numbers, count),) = plans.batches(plan, samples)
    found = spectra.rates_batch(plan, asked, samples, numbers).growth[:count]
    _, where = _moved(asked)
    for number, payload in ((1, 1.0), (2, 2.0)):
        sag, rate = _growth(payload)
        np.testing.assert_allclose(where[number].sag, sag, atol=1e-5)
        assert found[number] == pytest.approx(rate, rel=0.02, abs=0.05)
    assert found[2] > 10.0 and where[2].sag[1] > 0.4


def test_margins_say_who_carries_a_payload_and_how_far_it_sags(folder):
    loop = jx.robot(
        folder / "yaw.xml", keyframe="home", payload_body="hand", payload=2.0, delay=0.012,
        kp={"yaw": 340.0}, kd={"yaw": 34.0},
    )  # fmt: skip
    found = jx.margins(loop)
    assert found.verdict == "shakes"
    sag, rate = _growth(2.0)
    assert float(found.growth_rate) == pytest.approx(rate, rel=0.02)
    text = " ".join(repr(found).split())
    assert "payload 2 kg (on 'hand')" in text and f"sags by {sag[1]:.3g} rad at pitch" in text
    row = json.loads(found.to_json())
    assert row["payload_body"] == "hand" and row["leaves_posture"] is None
    assert row["sag"]["pitch"] == pytest.approx(sag[1], abs=1e-5)
    assert row["residual"] < 1e-3
    (posture,) = (one.rest.posture for one in found.details)
    bearing = _plain(2.0)[1](posture.qpos)
    np.testing.assert_allclose(posture.force, bearing, atol=1e-5)


@pytest.mark.exhaustive
def test_simulate_says_in_json_how_far_a_payload_makes_it_sag(folder, capsys):
    words = ("simulate", "--model", str(folder / "yaw.xml"), "--keyframe", "home", "--json",
             "--kp", "12", "--kd", "2", "--duration", "0.05", "--engine", "mujoco",
             "--out", str(folder / "run.png"), "--set", "plant.payload_body=hand")  # fmt: skip
    assert main([*words, "--set", "payload=1"]) == 0
    loaded = json.loads(capsys.readouterr().out)
    assert loaded["payload_body"] == "hand" and loaded["leaves_posture"] is None
    at = fsolve(lambda q: 12.0 * (HELD - q) + _moment(q, 1.0) - _moment(HELD, 0.0), HELD)[0]
    assert loaded["sag"]["pitch"] == pytest.approx(at - HELD, abs=1e-5)
    assert main([*words]) == 0
    bare = json.loads(capsys.readouterr().out)
    assert bare["payload_body"] is bare["sag"] is bare["leaves_posture"] is None


def _moment(angle, payload):
    """Of gravity on the pitch joint of the turntable's arm, about its axis [N m]."""
    return GRAVITY * 0.4 * (0.4 / 2.0 + 0.2 + payload) * np.cos(angle)


def _rod(payload, kp, lead=0.3):
    """The closed form: rest of the rod, and its stiffness there and at the posture."""
    nominal, loaded = (m * GRAVITY * LENGTH for m in (MASS, MASS + payload))
    at = brentq(
        lambda q: kp * (lead - q) - nominal * np.sin(lead) + loaded * np.sin(q), lead, 3.0
    )  # fmt: skip
    return at, kp - loaded * np.cos(at), kp - loaded * np.cos(lead)


@pytest.mark.parametrize("payload", [0.5, 1.0])
def test_a_rod_rests_where_its_spring_bears_it(folder, payload):
    """I s^2 + (kd + d) s + kp - m g l cos q, at kp (q0 - q) + f0 + m g l sin q = 0."""
    kp, kd = 12.0, 20.0
    loop = jx.robot(
        folder / "rod.xml", keyframe="home", payload_body="hand", payload=payload, kp=kp, kd=kd
    )
    found = jx.margins(loop)
    at, stiffness, before = _rod(payload, kp)
    assert float(found.details[0].rest.sag[0]) == pytest.approx(at - 0.3, abs=2e-5)
    inertia = (MASS + payload) * LENGTH**2
    want = np.roots([inertia, kd + DAMPING, stiffness]).real.max()
    unsagged = np.roots([inertia, kd + DAMPING, before]).real.max()
    assert float(found.growth_rate) == pytest.approx(want, rel=1e-3)
    assert abs(want / unsagged - 1.0) > 0.05


def test_a_rod_that_its_spring_does_not_hold_topples(folder):
    """What it falls to, far away, is no posture; linearised where it was, it shows the fall."""
    kp, kd = 12.0, 2.0
    loop = jx.robot(
        folder / "rod.xml", keyframe="home", payload_body="hand", payload=2.0, kp=kp, kd=kd
    )
    found = jx.margins(loop)
    assert found.verdict == "topples" and "does not rest" in repr(found)
    assert json.loads(found.to_json())["leaves_posture"]
    stiffness = kp - (MASS + 2.0) * GRAVITY * LENGTH * np.cos(0.3)
    want = np.roots([(MASS + 2.0) * LENGTH**2, kd + DAMPING, stiffness]).real.max()
    assert float(found.growth_rate) == pytest.approx(want, rel=1e-2)


def test_a_force_limit_that_does_not_bear_the_payload_is_told(folder):
    at, *_ = _rod(0.5, 12.0)
    need = (MASS + 0.5) * GRAVITY * LENGTH * np.sin(at)
    given = {"payload_body": "hand", "payload": 0.5, "kp": 12.0, "kd": 2.0}
    for limit, leaves in ((1.01 * need, False), (0.99 * need, True)):
        for line in ({"force_limit": limit}, {"stall_force": limit, "no_load_speed": 20.0}):
            loop = jx.robot(folder / "rod.xml", keyframe="home", **line, **given)
            words = f"j would have to bear {need:.4g}"
            with pytest.warns(jx.InexactWarning, match=words) if leaves else nullcontext():
                found = jx.margins(loop)
            assert (words in " ".join(repr(found).split())) == leaves


def _speed(limit, kp, kd, payload):
    """Of the rod after 4 s with clipped springs, in plain MuJoCo; it falls until it goes round."""
    model = mujoco.MjModel.from_xml_string(ROD)
    model.body_mass[2] += payload
    data = mujoco.MjData(model)
    data.qpos[0] = 0.3
    held = MASS * GRAVITY * LENGTH * np.sin(0.3)
    fastest = 0.0
    for _ in range(4000):
        force = -held + kp * (0.3 - data.qpos[0]) - kd * data.qvel[0]
        data.ctrl[0] = np.clip(force, -limit, limit)
        mujoco.mj_step(model, data)
        fastest = max(fastest, abs(data.qvel[0]))
    return fastest


@pytest.mark.parametrize("verb", ["margins", "sweep"])
def test_a_robot_that_falls_under_its_load_is_told_of_where_linear_metrics_are_stable(folder, verb):
    at, *_ = _rod(0.5, 12.0)
    need = (MASS + 0.5) * GRAVITY * LENGTH * np.sin(at)
    for limit, falls in ((1.05 * need, False), (0.95 * need, True)):
        assert (_speed(limit, 12.0, 2.0, 0.5) > 2.0) == falls
        given = {"payload_body": "hand", "kp": 12.0, "kd": 2.0, "force_limit": limit}
        loop = jx.robot(folder / "rod.xml", keyframe="home", **given)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            if verb == "margins":
                assert jx.margins(loop.replace(payload=[0.0, 0.5])).stable.all()
            else:
                jx.sweep(loop, payload=[0.0, 0.5], engine="linear")
        said = [str(one.message) for one in told if "would have to bear" in str(one.message)]
        assert len(said) == falls
        assert all("does not rest near its posture" in line for line in said)


def test_a_feedforward_that_bears_the_payload_leaves_no_sag(folder):
    need = float(-0.5 * GRAVITY * LENGTH * np.sin(0.3))
    asked = _parsed(
        folder, "rod", f"kp = 12\nkd = 2\npayload = 0.5\nfeedforward = {need!r}", "delay = [0.0]"
    )
    (_, (where,)) = _moved(asked)
    np.testing.assert_allclose(where.sag, 0.0, atol=1e-6)


def test_a_joint_without_stiffness_is_held(folder):
    loop = jx.robot(
        folder / "yaw.xml", keyframe="home", payload_body="hand", payload=2.0, kp={"pitch": 0.0}
    )
    np.testing.assert_allclose(jx.margins(loop).details[0].rest.sag, 0.0, atol=1e-3)


@pytest.mark.parametrize(
    ("parameters", "axes"),
    [
        ("kp = 12", "payload = [0.0]\nkd = [1.0, 2.0]"),
        ("kp = 12\nkd = 2", "joint_damping = [0.0, 0.4]\njoint_armature = [0.0, 0.2]"),
        ("kp = 12\nkd = 2", "inertia_scale = [1.0]\njoint_friction = [0.0, 0.1]"),
    ],
)
def test_where_nothing_moves_the_rest_it_is_not_looked_for(folder, monkeypatch, parameters, axes):
    """And the robot is linearised where its nominal one is, to the last bit."""

    def looked(*_):
        raise AssertionError

    monkeypatch.setattr(rest, "resting", looked)
    asked = _parsed(folder, "rod", parameters, axes)
    _, where = _moved(asked)
    nominal = robots.scene(asked.plant).posture
    for one in where:
        np.testing.assert_array_equal(one.posture.qpos, nominal.qpos)
        np.testing.assert_array_equal(one.posture.force, nominal.force)
        assert not one.sag.any() and not one.leaves


def test_a_map_over_the_damping_looks_for_each_rest_once(folder, monkeypatch):
    counted, original = [], rest.resting

    def counting(*given):
        counted.append(given)
        return original(*given)

    monkeypatch.setattr(rest, "resting", counting)
    asked = _parsed(
        folder, "rod", "payload = 0.31",
        "kp = [12.0, 24.0]\nkd = [1.0, 2.0, 3.0]\njoint_damping = [0.0, 0.1]",
    )  # fmt: skip
    (A, _), where = _moved(asked)
    assert len(counted) == 2 and len(A) == len(where) == 12


@pytest.mark.exhaustive
def test_tuned_gains_keep_their_bound_where_the_robot_sags(folder):
    """With stiff joints the bound would be kept by gains that miss it by 1 % where it rests."""
    given = {"keyframe": "home", "payload_body": "hand", "delay": 0.012}
    tuned = jx.tune(
        jx.robot(folder / "yaw.xml", **given), max_peak=1.72, max_kp=80.0,
        uncertainty={"payload": (1.5, 2.0)},
    )  # fmt: skip
    assert tuned.certified
    gains = {
        name: dict(zip(("yaw", "pitch"), map(float, row), strict=True))
        for name, row in (("kp", tuned.kp), ("kd", tuned.kd))
    }
    peaks = []
    for payload in (1.5, 1.75, 2.0):
        found = jx.margins(jx.robot(folder / "yaw.xml", payload=payload, **given, **gains))
        assert found.details[0].rest.sag[1] > 0.05
        peaks.append(max(float(found.sensitivity_peak), float(found.complementary_peak)))
    assert max(peaks) == pytest.approx(1.72, rel=1e-6)
    # What the search alone had found, see the module of `jaxact.tuning.robot.resting`.
    stiffly = {"kp": 80.0, "kd": {"yaw": 11.9593, "pitch": 12.77615623}}
    missed = jx.margins(jx.robot(folder / "yaw.xml", payload=1.5, **given, **stiffly))
    assert float(missed.sensitivity_peak) > 1.01 * 1.72


@pytest.mark.exhaustive
def test_gains_are_not_certified_where_a_force_limit_does_not_bear_the_payload(folder):
    """Weight of up to 1.5 kg more at the end of the rod, whose angle hardly changes its torque."""
    need = (MASS + 1.5) * GRAVITY * LENGTH * np.sin(0.3)
    for limit, certified in ((0.8 * need, False), (2.0 * need, True)):
        loop = jx.robot(
            folder / "rod.xml", keyframe="home", payload_body="hand", force_limit=limit, delay=2e-3
        )
        tuned = jx.tune(loop, max_peak=1.6, min_kp=200.0, uncertainty={"payload": (0.0, 1.5)})
        assert tuned.certified == certified
        assert ("j would have to bear" in tuned.verdict) == (not certified)


def test_the_world_carries_no_payload(folder):
    with pytest.raises(jx.UserError, match="'world': no such body.*rod, hand"):
        jx.margins(jx.robot(folder / "rod.xml", payload_body="world", payload=1.0, kp=9.0, kd=1.0))


@pytest.fixture(scope="module")
def pedestal(folder):
    """The rod on a base that is heavier than all that moves, and stands on the ground."""
    path = folder / "pedestal.xml"
    base = '<worldbody>\n<body name="stand"><geom type="box" size=".1 .1 .1" mass="20"/></body>'
    path.write_text(ROD.replace("<worldbody>", base))
    return path


def test_a_payload_that_moves_nothing_is_refused(pedestal):
    """No margin holds for a load that the robot does not carry."""
    given = {"keyframe": "home", "kp": 40.0, "kd": 4.0}
    bare = jx.margins(jx.robot(pedestal, **given))
    assert bare.stable
    said = r"plant.payload_body: 'stand' cannot move.*of which 'rod' is the heaviest$"
    with pytest.raises(jx.UserError, match=said):
        jx.margins(jx.robot(pedestal, **given, payload=0.5))
    with pytest.raises(jx.UserError, match=said):
        jx.tune(jx.robot(pedestal, **given), max_peak=2.0, uncertainty={"payload": (0.0, 0.5)})
    carried = jx.margins(jx.robot(pedestal, **given, payload=0.5, payload_body="rod"))
    assert carried.details[0].rest.sag[0] > 1e-3


@pytest.mark.exhaustive
def test_a_push_that_moves_nothing_is_refused(pedestal):
    push = {"body": "stand", "impulse": [0.0, 1.0, 0.0], "time": 0.01, "duration": 0.01}
    loop = jx.robot(pedestal, keyframe="home", kp=40.0, kd=4.0, push=push)
    with pytest.raises(jx.UserError, match=r"push.body: 'stand' cannot move"):
        jx.simulate(loop, duration=0.1)
