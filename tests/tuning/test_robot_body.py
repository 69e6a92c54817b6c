"""Gains that hold whatever a robot carries: against models that have it written in."""

from dataclasses import replace

import numpy as np
import pytest
import robots
from quickly import compiled_quickly as compiled_quickly

from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.loops import robots as sweep_robots
from jaxact.loops.samples import explicit
from jaxact.plants import linearize
from jaxact.simulation import changed_models, plans, spectra
from jaxact.tuning import report
from jaxact.tuning.box import Points, read_box
from jaxact.tuning.document import document
from jaxact.tuning.goal import Goal
from jaxact.tuning.groups import group
from jaxact.tuning.robot import search as robot
from jaxact.tuning.robot.loops import VARIED, situation
from jaxact.tuning.robot.open_loops import open_loops
from jaxact.tuning.robot.peaks import growth_rates
from jaxact.tuning.rollouts.validation import rollouts
from jaxact.verbs import tuning_tables

TEXT = """
engine = "mujoco"
[plant]
model = '{path}'
keyframe = "home"
payload_body = "lower"
[parameters]
actuator = "hyq"
delay = 0.002
[axes]
feedforward = [0.0]
"""
SPANS = "payload=0..0.8,inertia_scale=0.9..1.2,joint_damping=0..0.3,joint_armature=0..0.01"
# What the members of the first test are: payload [kg], scale, damping, armature.
MEMBERS = np.array([[0.8, 1.2, 0.3, 0.01], [0.3, 0.9, 0.0, 0.002]])
# A mass at the centre of the lower body, which is in the middle of its capsule.
CARRIED = '<geom type="sphere" pos="0.125 0 0" size="1e-4" mass="{}" contype="0" conaffinity="0"/>'
FLOATING = robots.PENDULUM.replace("<option ", '<option gravity="0 0 0" ')


def _specification(path):
    return reading.parse(TEXT.format(path=path))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("bodies")
    (path / "arm.xml").write_text(robots.PENDULUM)
    (path / "floating.xml").write_text(FLOATING)
    (path / "hopper.xml").write_text(robots.HOPPER)
    for number, member in enumerate(MEMBERS):
        for name, text in (("arm", robots.PENDULUM), ("floating", FLOATING)):
            (path / f"{name}_{number}.xml").write_text(_written(text, *member))
    return path


def _written(text, payload, scale, damping, armature):
    """A model with all of it written in."""
    payload, scale, damping, armature = map(float, (payload, scale, damping, armature))
    for mass in (1.2, 0.6):
        text = text.replace(f'mass="{mass}"', f'mass="{mass * scale}"')
    text = text.replace('damping="0.1"', f'damping="{0.1 + damping}" armature="{armature}"')
    text = text.replace('armature="0.005"', f'damping="{damping}" armature="{0.005 + armature}"')
    lower = text.index("</body>")
    return text[:lower] + CARRIED.format(payload) + text[lower:]


@pytest.fixture(scope="module")
def laden(folder):
    """The arm over a box of payloads and actuators, and its gains."""
    box = read_box("payload=0..0.8,wn=0.9..1.1", VARIED)
    one = situation(_specification(folder / "arm.xml"), "home", box)
    groups = group([], one.names)
    return one, robot.tune([one], Goal(max_peak=1.8), groups, number=4, starts=2, steps=30)


@pytest.mark.exhaustive
def test_a_member_is_the_model_that_has_it_written_in(folder):
    """Weightless, where the feedforward of both is none."""
    one = situation(_specification(folder / "floating.xml"), "home", read_box(SPANS, VARIED))
    for number, member in enumerate(MEMBERS):
        other = situation(_specification(folder / f"floating_{number}.xml"), "home")
        pairs = zip(one.opened(member), other.opened(np.empty(0)), strict=True)
        for mine, theirs in pairs:
            np.testing.assert_allclose(mine, theirs, rtol=1e-6, atol=1e-6)
    # What the search begins with is the lightest.
    light = situation(_specification(folder / "floating.xml"), "home")
    assert np.all(one.inertias < light.inertias)


def test_a_payload_that_is_known_is_no_box(folder):
    asked = _specification(folder / "arm.xml")
    known = replace(asked, parameters={**asked.parameters, "payload": 0.5})
    one, other = (
        situation(known, "home"),
        situation(asked, "home", read_box("payload=0..0.8", VARIED)),
    )
    for mine, theirs in zip(one.opened(np.empty(0)), other.opened(np.array([0.5])), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-12, atol=1e-15)
    # What is given may vary by a factor.
    scaled = situation(known, "home", read_box("payload=0.5x..1.2x", VARIED))
    np.testing.assert_allclose([scaled.low, scaled.high], [[0.25], [0.6]])


def test_a_range_without_a_width_is_no_box(folder):
    """As the robot that was given its values."""
    asked = _specification(folder / "arm.xml")
    text = "payload=0.5..0.5,wn=0.9..0.9,wn@elbow=1.1..1.1,delay=2e-3..2e-3"
    one = situation(asked, "home", read_box(text, VARIED, patterns=True))
    assert not one.box and one.keys == () and one.gives_way
    assert one.known == pytest.approx(
        {"wn": 720.0, "wn@elbow": 880.0, "delay": 2e-3, "payload": 0.5}
    )
    given = {"payload": 0.5, "wn": 720.0, "zeta": 0.45, "wn@elbow": 880.0, "delay": 2e-3}
    known = situation(replace(asked, parameters=given), "home")
    for mine, other in zip(one.opened(np.empty(0)), known.opened(np.empty(0)), strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-12)
    wide = situation(asked, "home", read_box("payload=0.5..0.5,wn=0.9..1.1", VARIED))
    assert wide.keys == ("wn",) and len(wide.box.members(2, 0)) == 4
    found = report.box([wide])
    assert found.pop("wn") == pytest.approx([720.0, 880.0])
    told = "of the nominal robot"
    assert found == {"payload": 0.5, "payload_body": "lower", "setpoint_and_feedforward": told}
    (said,) = tuning_tables._box_lines(report.box([wide]))
    assert said.startswith("for all of: wn 720 to 880, payload 0.5 (on 'lower'); setpoint")


def test_some_joints_may_vary_apart_from_the_others(folder):
    """As the loop with the same values given, whatever the other joints are."""
    asked = _specification(folder / "arm.xml")
    box = read_box(
        "joint_damping@elbow=0..0.3,wn@elbow=0.8..1.2,wn=0.9..1.1", VARIED, patterns=True
    )
    one = situation(asked, "home", box)
    assert one.keys == ("wn", "wn@elbow", "joint_damping@elbow")
    np.testing.assert_allclose(one.low, [720.0, 640.0, 0.0])
    given = {"wn": 760.0, "zeta": 0.45, "wn@elbow": 900.0, "joint_damping@elbow": 0.2}
    parameters = {k: v for k, v in asked.parameters.items() if k != "actuator"}
    known = situation(replace(asked, parameters=parameters | given), "home")
    theirs = known.opened(np.empty(0))
    for mine, other in zip(one.opened(np.array([760.0, 900.0, 0.2])), theirs, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-12)
    with pytest.raises(UserError, match="matches no driven joint"):
        situation(asked, "home", read_box("wn@hip=0.8..1.2", VARIED, patterns=True))


def test_under_gravity_a_member_is_linearised_where_it_rests(folder):
    asked = _specification(folder / "arm.xml")
    home = sweep_robots.scene(asked.plant).posture
    one = situation(asked, "home", read_box(SPANS, VARIED))
    columns = dict(zip(one.keys, MEMBERS.T, strict=True))
    samples = explicit(one.specification, columns)
    (plan,) = plans.groups(one.specification, samples)
    A, B = changed_models.moved(plan.case, asked.setting, samples.take(np.arange(2)))
    basis = linearize.linear_c(sweep_robots.scene(asked.plant).robot, home, 1e-3).basis
    for number in range(2):
        path = folder / f"arm_{number}.xml"
        other = sweep_robots.scene(replace(asked.plant, model=path))
        assert np.abs(other.posture.force - home.force).max() > 0.5
        kp = np.array([80.0, 30.0])
        rest = robots.sagged(other.robot.model, home.qpos, home.force, kp)
        assert np.abs(rest - home.qpos).max() > 0.005
        there = replace(home, qpos=rest, force=kp * (home.qpos - rest) + home.force)
        expected_A, expected_B, _ = linearize.linearise_c(other.robot, there, 1e-3)
        np.testing.assert_allclose(A[number], basis.T @ expected_A @ basis, atol=1e-7)
        np.testing.assert_allclose(B[number], basis.T @ expected_B, rtol=1e-5, atol=1e-9)


@pytest.mark.exhaustive
def test_gains_hold_for_every_payload_of_the_box(folder, laden):
    one, tuned = laden
    assert tuned.certified and tuned.certificate.corners == 4
    rng = np.random.default_rng(0)
    fraction = rng.uniform(size=(10, 2))
    points = Points(fraction, tuple(map(str, range(10))))
    loops = open_loops([one], points)
    z = np.exp(1j * np.pi * np.geomspace(1e-3, 1.0, 1500))[:, None, None]
    for index in range(10):
        M, N, C = loops.closed(index, tuned.kp, tuned.kd)
        S = np.eye(2) + C @ np.linalg.solve(z * np.eye(len(M)) - M, N[None].astype(complex))
        assert np.abs(np.linalg.eigvals(M)).max() < 1.0
        worst = max(np.linalg.norm(X, 2, axis=(1, 2)).max() for X in (S, np.eye(2) - S))
        assert worst <= 1.8 * (1.0 + 1e-6)
    assert any("payload" in name for name in tuned.certificate.binding)


@pytest.mark.exhaustive
def test_rollouts_carry_the_same_payloads(laden):
    one, tuned = laden
    held = rollouts(tuned, 1.0)
    assert held.stable[0] == held.stable[1] == len(tuned.members)
    found = held.after["home"]
    # The heavier, the further it hangs from its posture: the controllers use the nominal model.
    payload = one.columns(tuned.members.fraction)["payload"]
    order = np.argsort(payload)
    sag = found.excursion[0].max(axis=1)[order]
    assert sag[-1] > sag[0] + 0.01
    rate = growth_rates(tuned.members, tuned.kp, tuned.kd)
    np.testing.assert_allclose(found.growth_rate[0], rate, rtol=1e-3)


@pytest.mark.exhaustive
def test_what_was_assumed_is_said(laden):
    _, tuned = laden
    said = document(tuned)["assumed"]
    assert said["payload"] == [0.0, 0.8] and said["payload_body"] == "lower"
    assert said["wn"] == pytest.approx([720.0, 880.0])
    assert said["setpoint_and_feedforward"] == "of the nominal robot"


@pytest.mark.exhaustive
def test_on_its_contacts_a_member_grows_as_in_a_sweep(folder):
    asked = _specification(folder / "hopper.xml")
    asked = replace(asked, plant=replace(asked.plant, keyframe=None, payload_body="box"))
    gains = {"kp": 60.0, "kd": 0.5, "delay": 0.002}
    asked = replace(asked, parameters={**asked.parameters, **gains})
    one = situation(asked, "rest", read_box("payload=0..6,contact_friction=0.3..1", VARIED))
    members = one.box.corners()
    rates = growth_rates(open_loops([one], members), np.array([60.0]), np.array([0.5]))
    samples = explicit(one.specification, one.columns(members.fraction))
    (plan,) = plans.groups(one.specification, samples)
    ((numbers, count),) = plans.batches(plan, samples)
    swept = spectra.rates_batch(plan, one.specification, samples, numbers).growth[:count]
    np.testing.assert_allclose(rates, swept, rtol=1e-3, atol=1e-3)
    assert np.ptp(rates) > 1e-3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("payload=0.8x..1.2x", "is 0, which no factor changes"),
        ("joint_damping=0x..2x", "is 0, which no factor changes"),
        ("payload=0..1e9", "out of range; allowed: 0 to 1e\\+06 \\[kg\\]"),
        ("inertia_scale=0..1", "must be positive"),
        ("joint_friction=0..1", "sweep it instead"),
        ("mass=0.5..1", "vary payload or inertia_scale"),
    ],
)
def test_boxes_that_make_no_sense(folder, text, said):
    with pytest.raises(UserError, match=said):
        situation(_specification(folder / "arm.xml"), "home", read_box(text, VARIED))
