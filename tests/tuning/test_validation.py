"""Gains of robots in nonlinear rollouts: against a loop written out in C, and across engines."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from robots import HOPPER, PENDULUM, QUADRUPED

import jaxact as jx
from jaxact.errors import UserError
from jaxact.loops import reading, robots
from jaxact.loops.specification import Push
from jaxact.status import Verdict
from jaxact.tuning.rollouts.exposure import USUAL, exposed, usual_push
from jaxact.tuning.rollouts.validation import validate

KP, KD = np.array([80.0, 30.0]), np.array([4.0, 1.0])
PUSH = Push("lower", (0.0, 0.0, 0.2), 0.02, 0.03)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robots")
    (folder / "pendulum.xml").write_text(PENDULUM)
    (folder / "hopper.xml").write_text(HOPPER)
    return folder


def _asked(folder, name, keyframe=None, **options):
    key = f'keyframe = "{keyframe}"\n' if keyframe else ""
    text = f'[plant]\nmodel = "{name}.xml"\n{key}[axes]\ngain_scale = [1.0]\n'
    return replace(reading.parse(text, folder), axes=(), **options)


@pytest.fixture(scope="module")
def pendulum(folder):
    bare = _asked(folder, "pendulum", "home", push=PUSH, duration=0.4, precision="float64")
    return {"home": bare}


def _farthest(asked):
    """Largest distances from the setpoint of a PD loop at every step, written out."""
    scene = robots.scene(asked.plant)
    model, start = scene.robot.model, scene.posture
    data = mujoco.MjData(model)
    data.qpos = start.qpos
    body = model.body(PUSH.body).id
    farthest = np.zeros(2)
    for number in range(round(asked.duration / 1e-3)):
        data.ctrl = start.force + KP * (start.qpos - data.qpos) - KD * data.qvel
        pushed = PUSH.time <= number * 1e-3 + 1e-9 < PUSH.time + PUSH.duration - 1e-9
        data.xfrc_applied[body, :3] = np.array(PUSH.impulse) / PUSH.duration * pushed
        mujoco.mj_step(model, data)
        farthest = np.maximum(farthest, np.abs(data.qpos - start.qpos))
    return farthest


@pytest.fixture(scope="module")
def members():
    return {"delay": np.array([0.0, 0.003, 0.08])}


@pytest.mark.exhaustive
def test_excursions_are_those_of_a_loop_written_out(pendulum, members):
    found = validate(pendulum, KP, KD, members, engine="mujoco")
    assert found.engines == ("mujoco",) and found.joints == ("shoulder", "elbow")
    np.testing.assert_allclose(found.excursion[0, 0], _farthest(pendulum["home"]), rtol=1e-6)
    np.testing.assert_array_equal(found.stable, [[True, True, False]])
    assert not found.fallen.any()
    for own, excursion in zip(found.motions[0], found.excursion[0], strict=True):
        kept = [np.abs(joint.position - joint.setpoint).max() for joint in own]
        np.testing.assert_allclose(kept, excursion, rtol=1e-9)
    # What shakes is what the linearised loop says.
    np.testing.assert_array_equal(found.growth_rate > 0.0, [[False, False, True]])
    situation, member, reason = found.worst
    assert (situation, member) == ("home", 2) and "perturbations grow at" in reason


@pytest.mark.exhaustive
def test_both_engines_say_the_same(pendulum, members):
    noisy = {"home": exposed(pendulum["home"], duration=0.4)}
    one, other = (validate(noisy, KP, KD, members, engine=name) for name in ("mujoco", "mjx"))
    np.testing.assert_array_equal(one.verdict, other.verdict)
    np.testing.assert_array_equal(one.growth_rate, other.growth_rate)
    np.testing.assert_allclose(one.excursion[:, :2], other.excursion[:, :2], rtol=0.02)


@pytest.mark.exhaustive
def test_a_robot_that_falls_is_not_stable(folder):
    push = Push("box", (0.0, 40.0, 0.0), 0.1, 0.05)
    asked = _asked(folder, "hopper", push=push, duration=2.0)
    gentle = replace(asked, push=replace(push, impulse=(0.0, 0.5, 0.0)))
    found = validate({"hard": asked, "gentle": gentle}, np.array([60.0]), np.array([2.0]), {})
    np.testing.assert_array_equal(found.fallen, [[True], [False]])
    np.testing.assert_array_equal(found.verdict, [[Verdict.UNSTABLE], [Verdict.STABLE]])
    assert found.reasons[0][0].startswith("falls") and found.worst[0] == "hard"


def test_the_usual_push_gives_a_body_its_velocity(folder):
    asked = exposed(_asked(folder, "hopper"))
    scene = robots.scene(asked.plant)
    assert asked.push.body == "box" and asked.push.impulse[2] == 0.0
    assert asked.push.time + asked.push.duration <= 0.25 * asked.duration
    # In free space, where nothing but the push acts.
    model = scene.robot.model
    model.opt.gravity = 0.0
    data = mujoco.MjData(model)
    data.qpos = scene.posture.qpos + np.array([0.0, 0.0, 1.0, *np.zeros(model.nq - 3)])
    model.opt.timestep = 1e-6
    data.xfrc_applied[model.body("box").id, :3] = np.array(asked.push.impulse) / 1e-6
    mujoco.mj_step(model, data)
    assert np.linalg.norm(data.qvel[:3]) == pytest.approx(0.1, rel=0.02)


def test_a_tuned_robot_is_pushed_as_its_loop_says(folder, monkeypatch):
    class BegunError(Exception):
        """What a search is given."""

    def begun(situations, *rest, **options):
        raise BegunError(*situations)

    monkeypatch.setattr("jaxact.tuning.robot.search.tune", begun)
    loop = jx.robot(folder / "pendulum.xml", keyframe="home", delay=2e-3, push=PUSH)
    with pytest.raises(BegunError) as found:
        jx.tune(loop, max_peak=2.0, progress=False)
    (one,) = found.value.args
    assert exposed(one.specification, duration=0.4).push == PUSH


def test_what_a_specification_says_of_errors_and_pushes_is_kept():
    given = reading.load(QUADRUPED / "stand.toml")
    kept = exposed(given, duration=6.0)
    assert kept.push == given.push
    assert kept.parameters["position_noise"] == given.parameters["position_noise"]
    assert exposed(given, duration=6.0, push=False).push is None
    bare = replace(given, parameters={}, push=None)
    assert USUAL.items() <= exposed(bare).parameters.items()
    of_one = replace(bare, parameters={**bare.parameters, "position_noise@j": 1e-3})
    assert not {*USUAL} & {*exposed(of_one, push=False).parameters}
    assert exposed(bare).push == usual_push(robots.scene(bare.plant), 2.0)
    with pytest.raises(UserError, match="first quarter"):
        exposed(given, duration=0.5)


def test_what_does_not_fit_is_refused(folder, pendulum):
    hopper = _asked(folder, "hopper")
    with pytest.raises(UserError, match="other joints"):
        validate({**pendulum, "hopper": hopper}, KP, KD, {})
    with pytest.raises(UserError, match="not a parameter"):
        validate(pendulum, KP, KD, {"weight": np.zeros(2)})
    with pytest.raises(UserError, match="out of range"):
        validate(pendulum, KP, KD, {"zeta": np.array([0.5, -0.5])})
    with pytest.raises(UserError, match="needs a value for each member"):
        validate(pendulum, KP, KD, {"zeta": np.ones(2), "wn": np.ones(3)})
    with pytest.raises(UserError, match="needs a posture"):
        validate({}, KP, KD, {})
