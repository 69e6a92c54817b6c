"""The drives of a robot's joints, from logs that C MuJoCo made."""

import json
import re
import tomllib
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

import jaxact as jx
from jaxact.cli.main import main
from jaxact.identification import links
from jaxact.identification.log import LINKS, Log, stretches
from jaxact.identification.robot import IdentifiedRobot, Part
from jaxact.loops import toml
from jaxact.robots.model import read

ARM = """
<mujoco>
  <option timestep="0.0001" integrator="implicitfast"/>
  <default>
    <!-- Dry friction that is dry: by default MuJoCo's creeps, as if through a spring of 20 ms. -->
    <joint solreffriction="0.001 1" solimpfriction="0.99 0.999 0.001 0.5 2"/>
  </default>
  <worldbody>
    <body pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" armature="{armature}" damping="{damping}"
             frictionloss="{friction}"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1.2"/>
      <body pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0" armature="{armature}" damping="{damping}"
               frictionloss="{friction}"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.8"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="m1" joint="shoulder"/><motor name="m2" joint="elbow"/></actuator>
</mujoco>
"""
TRUTH = {"armature": 0.03, "damping": 0.4, "friction": 0.3}
GUESSED = {"armature": 0.01, "damping": 0.1, "friction": 0.5}
KP, KD, PERIOD, STEPS, LATE = 60.0, 2.0, 2e-3, 20, 30
DELAY = 2.95e-3  # MuJoCo's integrator has positions half a step ahead of velocities
ROWS = 2000


def _swing(seed):
    """Setpoints, positions and commands of both joints, shape (rows, 2): PD, 3 ms late."""
    model = mujoco.MjModel.from_xml_string(ARM.format(**TRUTH))
    data = mujoco.MjData(model)
    generator = np.random.default_rng(seed)
    setpoints = np.repeat(0.3 * generator.normal(size=(ROWS // 50, 2)), 50, axis=0)
    positions, commands = np.empty((ROWS, 2)), np.empty((ROWS, 2))
    waiting = [np.zeros(2)] * LATE
    for row in range(ROWS):
        positions[row] = data.qpos
        commands[row] = KP * (setpoints[row] - data.qpos) - KD * data.qvel
        for _ in range(STEPS):
            waiting.append(commands[row])
            data.ctrl[:] = waiting.pop(0)
            mujoco.mj_step(model, data)
    return setpoints, positions, commands


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm")
    (path / "arm.xml").write_text(ARM.format(**GUESSED))
    for name, seed in (("fit", 1), ("other", 2)):
        table = np.column_stack([np.arange(ROWS) * PERIOD, *_swing(seed)])
        head = "time,set_shoulder,set_elbow,q_shoulder,q_elbow,c_shoulder,c_elbow"
        np.savetxt(path / f"{name}.csv", table, delimiter=",", header=head, comments="")
    (path / "map.toml").write_text(
        'joints = ["shoulder", "elbow"]\nsetpoint = "set_{joint}"\nposition = "q_{joint}"\n'
        f"kp = {KP}\nkd = {KD}\n"
    )
    return path


@pytest.fixture(scope="module")
def found(folder):
    return jx.identify(
        folder / "fit.csv", folder / "arm.xml", validate=folder / "other.csv",
        columns=folder / "map.toml", groups=(".*",),
    )  # fmt: skip


def _in_the_air(time):
    """Positions, velocities, accelerations of both joints and what forces they take, by MuJoCo."""
    model = mujoco.MjModel.from_xml_string(ARM.format(armature=0.0, damping=0.0, friction=0.0))
    data = mujoco.MjData(model)
    wide, fast = np.array([0.5, 0.4]), np.array([6.0, 8.0])
    phase = fast * time[:, None] + np.array([0.0, 1.0])
    motion = wide * np.sin(phase), wide * fast * np.cos(phase), -wide * fast**2 * np.sin(phase)
    forces = np.empty((len(time), 2))
    for row, (data.qpos[:], data.qvel[:], data.qacc[:]) in enumerate(zip(*motion, strict=True)):
        mujoco.mj_inverse(model, data)
        forces[row] = data.qfrc_inverse
    return *motion, forces


def _logs(time, positions, commands):
    each = enumerate(("shoulder", "m2"))
    return [
        Log("air", time, {"position": positions[:, at], "command": commands[:, at]}, name)
        for at, name in each
    ]


@pytest.mark.parametrize(
    ("kept", "held"),
    [
        (np.arange(1500), 1),
        (np.r_[0:600, 700:750, 1100:1500], 1),  # too little to be used between two gaps
        (np.delete(np.arange(1500), [400, 900, 901]), 1),
        (np.arange(1500), 5),
    ],
    ids=["whole", "gaps", "single rows missing", "held over five rows"],
)
def test_the_links_do_what_inverse_dynamics_says(folder, kept, held):
    """With M, the forces and the accelerations of MuJoCo along a motion that is a formula."""
    robot = read(folder / "arm.xml", base="fixed")
    time = np.arange(1500) * 1e-3
    q, _, accelerations, forces = _in_the_air(time)
    written = q[np.arange(1500) // held * held]
    logs = _logs(time[kept], written[kept], forces[kept])
    done = [part for log in links.with_links(logs, robot) for part in stretches(log)]
    assert len(done) == (4 if len(kept) < 1400 else 2)
    for log in done:
        end = len(log) - held + 1  # what follows the last new row is as in it
        rows = np.rint(1e3 * log.time[:end]).astype(int)
        at = ["shoulder", "m2"].index(log.joint)
        inertia, force, _ = (log[name][:end] for name in LINKS)
        found, most = inertia * accelerations[rows, at] + force, np.max(np.abs(forces[:, at]))
        np.testing.assert_allclose(found, forces[rows, at], atol=0.01 * most)


def test_constant_forces_are_found_in_logs_with_gaps(folder):
    robot = read(folder / "arm.xml", base="fixed")
    kept = np.r_[0:600, 700:750, 1100:1500]
    q, velocities, accelerations, forces = (
        rows[kept] for rows in _in_the_air(np.arange(1500) * 1e-3)
    )
    commands = forces + 0.03 * accelerations + 0.4 * velocities - np.array([0.2, -0.1])
    done = links.with_links(_logs(kept * 1e-3, q, commands), robot)
    found = links.constant_forces(done)
    assert found == {"shoulder": pytest.approx(0.2, abs=0.01), "m2": pytest.approx(-0.1, abs=0.01)}


@pytest.mark.exhaustive
def test_armature_friction_and_delay_are_found_through_the_links(found):
    (part,) = found.parts
    numbers = part.found.chosen.numbers
    assert numbers["armature"] == pytest.approx(TRUTH["armature"], rel=0.03)
    assert numbers["viscous"] == pytest.approx(TRUTH["damping"], rel=0.03)
    assert numbers["coulomb"] == pytest.approx(TRUTH["friction"], rel=0.03)
    assert part.delay.identified and part.delay.value == pytest.approx(DELAY, abs=1e-4)
    assert min(part.found.chosen.scores) > 99.0


@pytest.mark.exhaustive
def test_the_gain_of_a_drive_is_found_from_recorded_commands(folder):
    columns = folder / "commands.toml"
    columns.write_text(
        'joints = ["shoulder", "elbow"]\nposition = "q_{joint}"\n'
        'command = { column = "c_{joint}", scale = 0.5 }\n'
    )
    found = jx.identify(folder / "fit.csv", folder / "arm.xml", columns=columns, joint="m2",
                        validate=folder / "other.csv")  # fmt: skip
    numbers = found.parts[0].found.chosen.numbers
    assert numbers["gain"] == pytest.approx(2.0, rel=0.03)
    assert numbers["coulomb"] == pytest.approx(TRUTH["friction"], rel=0.1)


@pytest.mark.exhaustive
def test_a_robot_takes_what_its_model_has_not_yet(found, folder):
    loop = jx.robot(folder / "arm.xml", drive=found, joint_damping=0.0)
    numbers = found.parts[0].found.chosen.numbers
    both = "shoulder|elbow"
    added = loop.values[f"joint_armature@{both}"]
    assert added == pytest.approx(numbers["armature"] - GUESSED["armature"])
    assert loop.values[f"kp@{both}"] == pytest.approx(KP)
    assert f"joint_damping@{both}" not in loop.values  # what is said wins
    (less,) = found.drive.left_out(robot=True)
    assert less.startswith("frictionloss of .*") and "not the 0.5 of arm.xml" in less


PARTLY = ARM.replace('armature="{armature}"', 'armature="0.01"', 1)


def _part(robot, names, joint, numbers):
    """A drive of some joints, as far as a robot's file needs it."""
    drive = SimpleNamespace(
        joint={"delay": 0.004, **joint}, numbers=numbers, uncertainty={}, document={},
        beyond_a_loop=[],
    )  # fmt: skip
    joints = tuple(one for one in robot.joints if one.name in names)
    delay = SimpleNamespace(low=0.003, high=0.005)
    return Part("|".join(names), joints, SimpleNamespace(drive=drive), delay)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("partly") / "arm.xml"
    path.write_text(PARTLY.format(armature=0.02, damping=0.1, friction=0.0))
    return read(path, base="fixed")


def test_every_joint_of_a_group_ends_with_what_was_identified(robot):
    """MuJoCo's own armature and damping and what is added are the total of each joint."""
    numbers = {"armature": 0.05, "viscous": 0.4}
    part = _part(robot, ["shoulder", "elbow"], {"control_rate": 500.0}, numbers)
    values, _, less = IdentifiedRobot(robot, (part,))._parameters()
    for joint in robot.joints:
        own = {"armature": robot.model.dof_armature, "damping": robot.model.dof_damping}
        for name, total in (("armature", 0.05), ("damping", 0.4)):
            more = [v for key, v in values.items() if key.startswith(f"joint_{name}@")
                    and re.fullmatch(key.partition("@")[2], joint.name)]  # fmt: skip
            assert float(own[name][joint.dof]) + more[0] == pytest.approx(total) and not more[1:]
    assert not less and not any("friction" in key for key in values)  # none was identified


def test_one_of_a_group_that_has_more_already_is_named(robot):
    part = _part(robot, ["shoulder", "elbow"], {"control_rate": 500.0}, {"armature": 0.015})
    values, _, less = IdentifiedRobot(robot, (part,))._parameters()
    assert values["joint_armature@shoulder"] == pytest.approx(0.005)
    assert "armature of elbow, which is 0.015 and not the 0.02 of arm.xml" in less


def test_a_gain_and_a_rate_are_the_robots_or_said(robot):
    def shared(first, second):
        parts = tuple(_part(robot, [name], own, {}) for name, own in
                      (("shoulder", first), ("elbow", second)) if own)  # fmt: skip
        values, _, less = IdentifiedRobot(robot, parts)._parameters()
        kept = {name: values.get(name) for name in ("gain_scale", "control_rate")}
        return kept, [words for words in less if "arm.xml" not in words]

    fast, slow = {"control_rate": 1e3, "gain_scale": 0.6}, {"control_rate": 500.0}
    assert shared(fast, fast) == ({"gain_scale": 0.6, "control_rate": 1e3}, [])
    kept, less = shared(fast, slow)
    assert kept == {"gain_scale": None, "control_rate": None}
    assert "control rates (1000 Hz of shoulder, 500 Hz of elbow)" in less[0]
    assert "the gain 0.6 of shoulder: multiply its kp and kd by that" in less[1]
    assert shared(fast, None)[1][0].startswith("the gain 0.6 of shoulder")  # of one of two joints


@pytest.mark.exhaustive
def test_the_report_has_every_drive_of_the_robot(found, tmp_path):
    text = jx.report(found, tmp_path / "drives.html").text
    data = json.loads(re.search(r'id="data">(.*?)</script>', text)[1])
    assert list(data) == ["identified"]  # a robot's loops are no joint's map
    (drive,) = data["identified"]["drives"]
    assert drive["name"] == ".*" and [one["role"] for one in drive["logs"]].count("fitted") == 2
    delay = next(one for one in drive["estimates"] if one["name"] == "delay")
    assert delay["low"] < 1e3 * DELAY < delay["high"]
    assert [one["name"] for one in drive["profiles"]] == ["delay"]
    (tmp_path / "drive.toml").write_text(toml.dumps(found.document()), encoding="utf-8")
    again = jx.report(tmp_path / "drive.toml", tmp_path / "file.html").text
    assert json.dumps(drive["ladder"]) in again


@pytest.mark.exhaustive
def test_the_command_writes_the_drives_of_a_robot(folder, tmp_path, capsys):
    out = tmp_path / "drive.toml"
    given = ["identify", str(folder / "fit.csv"), "--map", str(folder / "map.toml")]
    given += ["--plant", str(folder / "arm.xml")]
    assert main([*given, "--joint", "elbow", "--out", str(out), "--quiet"]) == 0
    assert "elbow: " in capsys.readouterr().out
    document = tomllib.loads(out.read_text())
    assert document["plant"] == "robot" and "joint_armature@elbow" in document["robot"]
    assert (tmp_path / "drive.png").stat().st_size > 10_000
    drive = jx.load_drive(out)
    low, high = drive.uncertainty["delay@elbow"]
    assert low <= DELAY <= high
    replayed = ["simulate", "--drive", str(out), "--replay", str(folder / "other.csv")]
    replayed += ["--map", str(folder / "map.toml"), "--out", str(tmp_path / "replay.png")]
    assert main([*replayed, "--joint", "elbow", "--model", str(folder / "arm.xml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["log"] == "other.csv, elbow" and found["nrmse"] < 0.02
    assert main([*replayed, "--joint", "elbow"]) == 2
    assert "give its --model" in capsys.readouterr().err
    assert main([*replayed, "--joint", "shoulder", "--model", str(folder / "arm.xml")]) == 2
    assert "joint shoulder: is not in drive.toml" in capsys.readouterr().err
    assert main(["margins", "--drive", str(out), "--inertia", "0.05"]) == 2
    assert "has the drives of a robot's joints; give its --model" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--joint", "knee"], "joint 'knee' is not in arm.xml; allowed: shoulder, elbow"),
        (["--groups", "hip"], "--groups 'hip': matches no driven joint"),
        (["--plant", "mass", "--groups", "hip"], "--groups: are of a robot's joints"),
        (["--plant", "none.xml"], "none.xml: no such"),
    ],
)
def test_what_does_not_fit_is_one_line(folder, tmp_path, capsys, options, said):
    given = ["identify", str(folder / "fit.csv"), "--map", str(folder / "map.toml")]
    plant = [] if "--plant" in options else ["--plant", str(folder / "arm.xml")]
    out = tmp_path / "drive.toml"
    assert main([*given, *plant, "--out", str(out), "--quiet", *options]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())
