"""The experiment on gains that robots ship with: its facts, and one small robot from end to end."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from experiment_modules import imported
from quickly import compiled_quickly as compiled_quickly

from jaxact.errors import UserError

FOLDER = Path(__file__).resolve().parent.parent / "experiments" / "shipped_gains"
ARM = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body name="base">
<freejoint/><geom size="0.1" mass="5"/>
<body pos="0 0 -0.2"><joint name="elbow" axis="0 1 0" armature=".001" damping="3"
frictionloss=".2"/><geom size="0.04" pos="0 0 -0.3" mass="0.1"/></body></body></worldbody>
<actuator><motor joint="elbow"/></actuator>
<keyframe><key name="home" qpos="0 0 1 1 0 0 0 0"/></keyframe></mujoco>"""


@pytest.fixture(scope="module")
def experiment():
    names = ("models", "pictures", "report", "tuned", "run")
    with imported(FOLDER, *names) as found:
        yield dict(zip(names, found, strict=True))


def test_facts_are_complete(experiment):
    rows = experiment["models"].robots()
    assert len({row.name.partition(",")[0] for row in rows}) >= 12
    for row in rows:
        assert row.source and row.closes and row.delay and row.passive in ("none", "model")
        assert bool(row.kp) == bool(row.kd)
        for patterns in (row.kp, row.kd, row.armature):
            assert all(re.compile(pattern) and value > 0.0 for pattern, value in patterns.items())


def test_a_missing_wheel_is_said_in_a_line(experiment):
    row = replace(experiment["models"].robots()[0], package="no_such_wheel_1")
    experiment["models"].WHEELS["no_such_wheel_1"] = "no-such-wheel"
    with pytest.raises(UserError, match="comes with no-such-wheel; pip install"):
        experiment["models"].located(row)


@pytest.fixture(scope="module")
def arm(experiment, tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.xml").write_text(ARM)
    row = experiment["models"].robots()[0]
    row = replace(
        row, name="arm", keyframe="home", kp={"elbow": 40.0}, kd={"elbow": 2.0},
        armature={"elbow": 0.02}, passive="none",
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(experiment["models"], "located", lambda robot: folder / "arm.xml")
        model = experiment["models"].prepared(row, folder)
    return row, model, folder


def test_the_published_armature_is_in_the_model(arm):
    written = mujoco.MjModel.from_xml_path(str(arm[1]))
    assert written.joint("elbow").damping[0] == 3.0
    assert written.dof_armature[written.joint("elbow").dofadr[0]] == 0.02
    assert not np.any(written.dof_armature[:6])


@pytest.mark.exhaustive
def test_one_robot_from_end_to_end(experiment, arm):
    row, model, folder = arm
    experiment["run"].DELAYS[:] = [0.0, 0.005, 0.02]
    found = experiment["run"].looked_at(row, model)
    stand = found["stand"]["ideal"]
    # J q'' + e^(-s t) (kd s + kp) q = 0, t the delay and half a control period more or less.
    inertia = 0.02 + 0.1 * 0.3**2 + 0.4 * 0.1 * 0.04**2
    w = np.sqrt((2.0**2 + np.sqrt(2.0**4 + 4.0 * (40.0 * inertia) ** 2)) / 2.0) / inertia
    expected = np.arctan2(2.0 * w, 40.0) / w
    assert stand["delay"] == pytest.approx(expected, abs=1e-3)
    assert stand["joint"] == "elbow" and stand["friction_left_out"] == 0.2
    assert found["stuck"]["delay"] is None or found["stuck"]["delay"] > 2.0 * stand["delay"]
    assert stand["peak"][0] > 1.0 and stand["delays"] == [0.0, 0.005, 0.02]
    shaking = expected < 0.02
    assert (stand["growth_rate"][2] > 0.0) == shaking == (stand["peak"][2] is None)
    experiment["pictures"].write([found], folder)
    assert (folder / "delay_margins.png").stat().st_size > 10_000
    page = experiment["report"].page([found])
    assert "| arm | booster_gym |" in page and row.source in page
    assert "1 of 1 bear" in page
    _hold_tuned(found["tuned"], inertia)
    experiment["run"].kept([found], folder)
    experiment["run"].written(experiment["run"].known(folder), folder)
    assert "published pattern" in (folder / "README.md").read_text()


def _hold_tuned(tuned, inertia):
    """S = 1/(1 + L), L = (kp + kd s) e^(-s (5 ms + half a control period)) / (J s^2): Ms is 2."""
    assert tuned["certified"] and tuned["shared_by"] == "pattern"
    ((kp, kd),) = tuned["gains"].values()
    assert tuned["stiffness"] == pytest.approx(kp / 40.0)
    s = 1j * np.geomspace(1.0, 3000.0, 20_000)
    L = (kp + kd * s) * np.exp(-0.0055 * s) / (inertia * s**2)
    peaks = np.abs(1.0 / (1.0 + L)).max(), np.abs(L / (1.0 + L)).max()
    assert max(peaks) == pytest.approx(2.0, rel=0.05)
    w = np.sqrt((kd**2 + np.sqrt(kd**4 + 4.0 * (kp * inertia) ** 2)) / 2.0) / inertia
    assert tuned["delay"] == pytest.approx(np.arctan2(kd * w, kp) / w, abs=1e-3)
    assert tuned["delay"] > 0.005


def test_joints_of_a_pattern_or_of_a_kind_share_gains(experiment):
    names = ("LL_HAA", "LR_HAA", "l_knee", "FR_hip", "hl_hip", "left_knee", "waist")
    one = SimpleNamespace(
        names=tuple((name, f"m{i}") for i, name in enumerate(names)),
        kp=np.array([1.0, 1, 2, 2, 2, 1, 1]), kd=np.array([1.0, 1, 1, 1, 1, 1, 3]),
    )  # fmt: skip
    kinds = experiment["tuned"].kinds(one)
    assert kinds.names == ("HAA", "knee", "hip", "waist")
    np.testing.assert_array_equal(kinds.members, [0, 0, 1, 2, 2, 1, 3])
    row = experiment["models"].robots()[0]
    own = experiment["tuned"].published(replace(row, kp={}, kd={}), one)
    np.testing.assert_array_equal(own.members, [0, 0, 1, 1, 1, 0, 2])
    pattern = replace(row, kp={".*(HAA|waist)": 3.0, ".*": 2.0})
    np.testing.assert_array_equal(
        experiment["tuned"].published(pattern, one).members, [0, 0, 1, 1, 1, 1, 0]
    )
