"""`jaxact render` as a user types it."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from quickly import ENVIRONMENT

from jaxact.cli.main import main
from jaxact.errors import UserError
from jaxact.plotting import scene

ROOT = Path(__file__).resolve().parent.parent
ROBOT = """
<mujoco>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <body pos="0 0 1"><joint name="swing" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.05"/></body>
  </worldbody>
  <actuator><motor joint="swing"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A robot and two motions of it: one swings, one diverges."""
    folder = tmp_path_factory.mktemp("render")
    (folder / "robot.xml").write_text(ROBOT)
    time = np.arange(0.0, 0.5, 0.001)
    np.savez(folder / "bare.npz", time=time, qpos=0.1 * np.sin(9.0 * time)[:, None])
    wild = np.exp(15.0 * time)[:, None]
    wild[400:] = np.nan
    np.savez(folder / "drive.npz", time=time, qpos=wild)
    np.savez(folder / "other.npz", time=time, qpos=np.zeros((500, 3)))
    np.savez(folder / "bad.npz", time=time[::-1], qpos=np.zeros((500, 1)))
    np.savez(folder / "short.npz", time=time[:1], qpos=np.zeros((1, 1)))
    np.savez(folder / "none.npz", position=time)
    (folder / "text.npz").write_text("no archive")
    return folder


def _render(folder, *options, **environment):
    command = [sys.executable, "-W", "error", "-m", "jaxact", "render"]
    files = [
        "--model",
        "robot.xml",
        "--bare",
        "bare.npz",
        "--drive",
        "drive.npz",
        "--size",
        "120",
        "96",
    ]
    return subprocess.run(
        [*command, *files, *options], capture_output=True, text=True, cwd=folder,
        env=os.environ | ENVIRONMENT | {"PYTHONPATH": str(ROOT)} | environment,
    )  # fmt: skip


def test_writes_a_film_and_says_so(folder):
    try:
        scene.backend()
    except UserError as error:
        pytest.skip(str(error))
    ran = _render(folder, "--speed", "0.5", "--duration", "0.2", "--start", "0.1")
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout == "wrote robots.gif\n" and ran.stderr == ""
    with Image.open(folder / "robots.gif") as film:
        assert film.n_frames == 11 and film.width == 244
    (folder / "robots.gif").unlink()


@pytest.mark.exhaustive
def test_simulates_both_motions_itself(folder):
    """A pendulum with more damping than its late actuator bears; the gains are the same."""
    try:
        scene.backend()
    except UserError as error:
        pytest.skip(str(error))
    (folder / "loop.toml").write_text(
        '[plant]\nmodel = "robot.xml"\n[parameters]\nkp = 50\nactuator = "starleth"\n'
        "delay = 0.005\nposition_noise = 1e-4\n[axes]\nkd = [1, 300]\n"
    )
    command = [sys.executable, "-W", "error", "-m", "jaxact", "render"]
    small = ["--kd", "300", "--size", "64", "64", "--duration", "0.3", "--out", "two.gif"]
    ran = subprocess.run(
        [*command, "--spec", "loop.toml", "--push", "1", "0", "0", "0", *small],
        capture_output=True, text=True, cwd=folder,
        env=os.environ | ENVIRONMENT | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert ran.returncode == 2 and "push.body" in ran.stderr
    ran = subprocess.run(
        [*command, "--spec", "loop.toml", *small],
        capture_output=True, text=True, cwd=folder,
        env=os.environ | ENVIRONMENT | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert ran.returncode == 0 and ran.stderr == "", ran.stderr
    bare, drive, wrote = ran.stdout.splitlines()
    assert bare.startswith("bare: ideal actuators: stable, growth rate -")
    assert drive.startswith("with the drive model: ") and "growth rate -" not in drive
    assert wrote == "wrote two.gif"
    with Image.open(folder / "two.gif") as film:
        assert film.n_frames >= 5
    (folder / "two.gif").unlink()


@pytest.mark.parametrize("asked", ["disable", "bogus"])
def test_without_opengl_it_says_so_in_one_line_and_writes_nothing(folder, asked):
    before = sorted(os.listdir(folder))
    ran = _render(folder, MUJOCO_GL=asked)
    assert ran.returncode == 2 and ran.stdout == ""
    assert ran.stderr.startswith("jaxact: ") and ran.stderr.count("\n") == 1
    assert "MUJOCO_GL" in ran.stderr
    assert sorted(os.listdir(folder)) == before


def test_an_opengl_that_fails_leaves_the_other_commands_alone(folder):
    ran = subprocess.run(
        [sys.executable, "-m", "jaxact", "check", "robot.xml"],
        capture_output=True, text=True, cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT), "MUJOCO_GL": "bogus"},
    )  # fmt: skip
    assert ran.returncode == 0 and "swing" in ran.stdout, ran.stderr


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--bare", "nothing.npz"], "nothing.npz: no such file"),
        (["--bare", "text.npz"], "is not an NPZ file"),
        (["--bare", "none.npz"], "has no 'time'"),
        (["--drive", "bad.npz"], "do not increase"),
        (["--drive", "short.npz"], "two steps or more"),
        (["--speed", "0"], "--speed 0: must be a positive number"),
        (["--fps", "-1"], "--fps -1: must be a positive number"),
        (["--fps", "60"], "a GIF cannot show 60"),
        (["--size", "10", "10"], "--size 10 10"),
        (["--start", "7"], "lasts from 0 to 0.499 s"),
        (["--speed", "0.001"], "at most 3000"),
        (["--duration", "0"], "--duration 0: must be a positive number"),
        (["--out", "film.avi"], "not a film format"),
        (["--kp", "3"], "which --kp cannot change"),
        (["--keyframe", "home"], "which the others cannot change"),
    ],
)
def test_a_mistake_is_one_line_and_writes_nothing(folder, monkeypatch, capsys, options, message):
    monkeypatch.chdir(folder)
    before = sorted(os.listdir(folder))
    files = ["--bare", "bare.npz", "--drive", "drive.npz"]
    assert main(["render", "--model", "robot.xml", *files, *options]) == 2
    said = capsys.readouterr()
    assert said.out == "" and message in said.err
    assert said.err.startswith("jaxact: ") and said.err.count("\n") == 1
    assert sorted(os.listdir(folder)) == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--model", "robot.xml", "--bare", "bare.npz"], "--bare needs --drive"),
        (["--drive", "drive.npz"], "--drive needs --bare"),
        (["--bare", "bare.npz", "--drive", "drive.npz"], "give its --model"),
        (["--kp", "3"], "no robot to film"),
        (["--model", "robot.xml", "--delay", "-1"], "--delay = -1"),
        (["--model", "robot.xml", "--duration", "1000", "--kp", "1"], "at most 3000"),
    ],
)
def test_what_is_missing_is_told(folder, monkeypatch, capsys, options, message):
    monkeypatch.chdir(folder)
    assert main(["render", *options]) == 2
    said = capsys.readouterr()
    assert message in said.err and said.err.count("\n") == 1 and said.out == ""


@pytest.mark.parametrize(
    ("model", "options", "message"),
    [
        ("missing.xml", [], "missing.xml"),
        ("robot.xml", ["--drive", "other.npz"], "qpos has 3 columns, robot.xml has 1 positions"),
    ],
)
def test_a_model_that_does_not_fit_is_told(folder, monkeypatch, capsys, model, options, message):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(scene, "backend", lambda: "mujoco.egl")
    files = ["--bare", "bare.npz", "--drive", "drive.npz"]
    assert main(["render", "--model", model, *files, *options]) == 2
    assert message in capsys.readouterr().err
    assert not (folder / "robots.gif").exists()
