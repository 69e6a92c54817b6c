"""Films: which moments they show, what is written over them, and the files."""

import os
import stat
import sys

import mujoco
import numpy as np
import pytest
from PIL import Image

from jaxact.errors import UserError
from jaxact.plotting import film, scene, split_screen, video
from jaxact.plotting.split_screen import Side, side_by_side

PENDULUM = """
<mujoco>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <body pos="0 0 1">
      <joint name="swing" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.05"/>
    </body>
    <body name="loose" pos="0 1 1"><freejoint/><geom size="0.1"/></body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def pendulum():
    return mujoco.MjModel.from_xml_string(PENDULUM)


@pytest.fixture(scope="module")
def opengl():
    try:
        return scene.backend()
    except UserError as error:
        pytest.skip(str(error))


def _swinging(model, speed, steps=101, step=0.01):
    time = step * np.arange(steps)
    qpos = np.tile(model.qpos0, (steps, 1))
    qpos[:, 0] = speed * time
    return time, qpos


def _plain(colour, frames, size=(120, 90)):
    width, height = size
    return [np.full((height, width, 3), colour, np.uint8) for _ in range(frames)]


# --- which moments ---


def test_a_film_shows_the_last_sample_before_each_frame():
    time = np.arange(0.0, 1.0005, 0.001)
    shown = video.moments(time, fps=25.0, speed=1.0)
    assert len(shown) == 26
    assert time[shown] == pytest.approx(np.arange(26) / 25.0)
    slower = video.moments(time, fps=25.0, speed=0.25)
    assert len(slower) == 101 and time[slower] == pytest.approx(np.arange(101) / 100.0)
    coarse = video.moments(np.array([2.0, 2.3, 2.9]), fps=10.0, speed=1.0)
    assert coarse.tolist() == [0, 0, 0, 1, 1, 1, 1, 1, 1, 2]


# --- what is written over the pictures ---


def test_two_pictures_stand_beside_each_other_with_their_labels():
    frames = 3
    left = Side(_plain((10, 200, 10), frames), "left one", np.array([0.0, 1.0, 2.0]))
    right = Side(_plain((200, 10, 10), frames), "right one", np.zeros(3), "simulation failed")
    shown = list(side_by_side(left, right, times=[0.0, 0.04, 0.08], speed=0.5))
    assert len(shown) == frames
    height, width, colours = shown[0].shape
    assert colours == 3 and height % 2 == 0 and width % 2 == 0 and shown[0].dtype == np.uint8
    middle = shown[0][height // 2]
    assert tuple(middle[60]) == (10, 200, 10) and tuple(middle[width - 60]) == (200, 10, 10)
    blank = side_by_side(
        Side(_plain((10, 200, 10), 1), "", np.zeros(1)),
        Side(_plain((200, 10, 10), 1), "", np.zeros(1)),
        times=[0.0], speed=1.0,
    )  # fmt: skip
    head = next(blank)[:8]
    assert (head == 255).all() and (shown[0][:8] != 255).any(), "a label is written"
    assert (shown[0] != shown[1]).any() and (shown[1] != shown[2]).any(), "time and line go on"


def test_the_line_of_the_joint_speed_grows_on_a_common_scale():
    frames, size = 5, (200, 100)
    left = Side(_plain(0, frames, size), "", np.array([0.0, 4.0, 4.0, 4.0, 4.0]))
    right = Side(_plain(0, frames, size), "", np.full(frames, 1.0))
    last = list(side_by_side(left, right, times=range(frames), speed=1.0))[-1]
    strip = last[-40:-10].astype(int)
    blue = np.argwhere((strip[:, :, 2] - strip[:, :, 0] > 100) & (strip.sum(2) < 500))
    red = np.argwhere((strip[:, :, 0] - strip[:, :, 2] > 100) & (strip.sum(2) < 500))
    assert blue[:, 1].max() < 205 <= red[:, 1].min()
    assert blue[:, 0].min() + 5 < red[:, 0].min(), "four times faster is drawn higher"


def test_slower_and_faster_are_said():
    assert split_screen._pace(0.25) == "4 times slower"
    assert split_screen._pace(2.0) == "2 times faster"


# --- motions ---


def test_joint_speed_leaves_the_floating_base_out(pendulum):
    time, qpos = _swinging(pendulum, speed=3.0)
    qpos[:, 1] = 50.0 * time  # the loose body flies away
    speed = scene.joint_speed(pendulum, qpos, time)
    assert speed[0] == 0.0 and speed[1:] == pytest.approx(3.0)


def test_a_motion_that_fails_is_held_at_its_last_pose(pendulum):
    _, qpos = _swinging(pendulum, speed=1.0, steps=5)
    qpos[3, 2] = np.nan
    held = scene.held(qpos)
    assert np.isfinite(held).all() and (held[3:] == qpos[2]).all() and (held[:3] == qpos[:3]).all()
    qpos[0] = np.inf
    with pytest.raises(UserError, match="not finite from its start"):
        scene.held(qpos)


def test_images_of_a_motion(pendulum, opengl):
    _, qpos = _swinging(pendulum, speed=1.0, steps=3, step=0.5)
    view = scene.View(width=96, height=64)
    images = list(scene.frames(pendulum, qpos, step=0.5, module=opengl, view=view))
    assert [image.shape for image in images] == [(64, 96, 3)] * 3
    assert images[0].std() > 5.0, "something is seen"
    assert np.abs(images[2].astype(int) - images[0]).max() > 50, "it moves"
    assert pendulum.vis.global_.offwidth == 640, "the model is left as it was"


def test_a_film_of_two_motions(pendulum, opengl):
    time, still = _swinging(pendulum, speed=0.0)
    _, moving = _swinging(pendulum, speed=2.0)
    moving[60:] = np.nan
    pair = film.Motion("still", time, still), film.Motion("moving", time[:81], moving[:81])
    view = scene.View(width=96, height=64)
    shown = list(film.film(pendulum, *pair, module=opengl, view=view, fps=10.0))
    assert len(shown) == 9, "until the shorter one ends"
    left = [image[:, :96] for image in shown]
    assert np.abs(left[-1][8:64].astype(int) - left[0][8:64]).max() < 10, "this one stands still"
    assert film._failed(pair[1]) == "simulation failed at 0.6 s"


# --- OpenGL ---


def test_opengl_that_is_switched_off_or_unknown_is_said(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    with pytest.raises(UserError, match="switches OpenGL off"):
        scene.backend()
    monkeypatch.setenv("MUJOCO_GL", "elg")
    with pytest.raises(UserError, match="did you mean 'egl'"):
        scene.backend()


def test_without_opengl_the_reasons_are_one_line(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(scene, "_MODULES", dict.fromkeys(scene._MODULES, "jaxact.no_such_opengl"))
    with pytest.raises(UserError, match="no OpenGL to draw with") as told:
        scene.backend()
    assert "No module named" in str(told.value) and "\n" not in str(told.value)


def test_the_environment_chooses_the_opengl(monkeypatch):
    tried = []
    monkeypatch.setattr(scene, "_why_not", lambda module: tried.append(module))
    monkeypatch.setenv("MUJOCO_GL", "OSMesa")
    assert scene.backend() == "mujoco.osmesa"
    monkeypatch.setenv("MUJOCO_GL", "")
    scene.backend()
    assert len(tried) == 2, "the first that works is taken"


# --- files ---


def test_a_gif_shows_every_frame_for_its_time(tmp_path):
    out = tmp_path / "film.gif"
    images = [np.full((20, 30, 3), 250 - 30 * index, np.uint8) for index in range(6)]
    images.insert(3, images[3])  # stands still: one picture, shown twice as long
    images[5][5:9, 5:9] = (255, 0, 0)
    video.write(iter(images), out, fps=25.0)
    with Image.open(out) as gif:
        assert gif.size == (30, 20) and gif.info["loop"] == 0
        until = 0
        for index in range(gif.n_frames):
            gif.seek(index)
            seen = np.asarray(gif.convert("RGB")).astype(int)
            assert np.abs(seen - images[until // 40]).max() < 20
            until += gif.info["duration"]
    assert until == 40 * len(images)
    assert os.listdir(tmp_path) == ["film.gif"]


def test_a_film_that_fails_leaves_nothing_and_spares_the_old_one(tmp_path):
    out = tmp_path / "film.gif"
    out.write_bytes(b"old")

    def images():
        yield np.zeros((4, 4, 3), np.uint8)
        raise UserError("the simulation broke")

    with pytest.raises(UserError, match="broke"):
        video.write(images(), out, fps=10.0)
    assert out.read_bytes() == b"old" and os.listdir(tmp_path) == ["film.gif"]


@pytest.mark.parametrize(
    ("name", "fps", "message"),
    [
        ("film.avi", 25.0, "'.avi' is not a film format"),
        ("film", 25.0, "no ending"),
        ("nowhere/film.gif", 25.0, "does not exist"),
        ("film.gif", 30.0, "cannot show 30 frames"),
        ("film.gif", 100.0, "cannot show 100 frames"),
        ("folder.gif", 25.0, "is a folder"),
    ],
)
def test_an_output_that_cannot_be_is_refused(tmp_path, name, fps, message):
    (tmp_path / "folder.gif").mkdir()
    with pytest.raises(UserError, match=message):
        video.check_output(tmp_path / name, fps)


def test_an_mp4_needs_ffmpeg(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # as if it were not installed
    with pytest.raises(UserError, match=r"needs ffmpeg.*jaxact\[video\].*\.gif"):
        video.check_output(tmp_path / "film.mp4", 25.0)


def _ffmpeg(folder, script, monkeypatch):
    program = folder / "ffmpeg"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(folder), prepend=os.pathsep)


def test_ffmpeg_gets_every_pixel(tmp_path, monkeypatch):
    (tmp_path / "bin").mkdir()
    save = 'for last; do :; done; echo "$@" > "$(dirname "$0")/asked"; cat > "$last"'
    _ffmpeg(tmp_path / "bin", save, monkeypatch)
    images = [np.full((6, 8, 3), index, np.uint8) for index in range(5)]
    video.write(images, tmp_path / "film.mp4", fps=30.0)
    assert (tmp_path / "film.mp4").read_bytes() == b"".join(image.tobytes() for image in images)
    asked = (tmp_path / "bin" / "asked").read_text()
    assert "-s 8x6 -r 30" in asked and "yuv420p" in asked


def test_what_ffmpeg_says_is_passed_on(tmp_path, monkeypatch):
    (tmp_path / "bin").mkdir()
    _ffmpeg(tmp_path / "bin", "echo 'Unknown encoder libx264' >&2; exit 1", monkeypatch)
    images = (np.zeros((600, 800, 3), np.uint8) for _ in range(20))
    with pytest.raises(UserError, match="ffmpeg failed: Unknown encoder"):
        video.write(images, tmp_path / "film.mp4", fps=30.0)
    assert os.listdir(tmp_path) == ["bin"]
