"""What is computed nevertheless, and warned of in one line."""

import subprocess
import sys
import warnings
from dataclasses import replace

import pytest
from robots import HOPPER

import jaxact as jx
from jaxact.cli import _warnings
from jaxact.loops import reading, robots
from jaxact.loops.samples import expand
from jaxact.loops.weak_joints import tell_weak
from jaxact.simulation import engines

TEXT = '[plant]\nmodel = "hopper.xml"\n{posture}[parameters]\nkp = 60\n[axes]\nkd = [2.0]\n'


@pytest.fixture
def asked(tmp_path):
    (tmp_path / "hopper.xml").write_text(HOPPER)
    return lambda posture="": reading.parse(TEXT.format(posture=posture), tmp_path)


def _creeping(monkeypatch, residual):
    """Scenes whose posture is left with this acceleration."""
    scene = robots.scene

    def changed(plant):
        found = scene(plant)
        return replace(found, posture=replace(found.posture, residual=residual))

    monkeypatch.setattr(robots, "scene", changed)


def test_a_robot_at_rest_is_not_warned_of(asked, capsys):
    _warnings.posture(asked())
    assert capsys.readouterr() == ("", "")


def test_a_robot_that_creeps_after_settling_is(asked, monkeypatch, capsys):
    _creeping(monkeypatch, 0.054)
    _warnings.posture(asked())
    out, said = capsys.readouterr()
    assert out == "" and said.count("\n") == 1
    assert said.startswith("jaxact: warning: the robot still creeps") and "0.054" in said


def test_one_that_starts_from_its_keyframe_as_it_is_was_asked_for(asked, monkeypatch, capsys):
    _creeping(monkeypatch, 9.8)
    _warnings.posture(asked('posture = "keyframe"\n'))
    assert capsys.readouterr() == ("", "")


def test_no_robot_no_word(tmp_path, capsys):
    _warnings.posture(reading.parse("[axes]\nkp = [100]\nkd = [5]\n", tmp_path))
    assert capsys.readouterr() == ("", "")


FLAT = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 .1"/><body pos="0 0 .1">
<freejoint/><geom name="foot" type="box" size=".1 .1 .02" mass="1"/><body><joint name="hip"
axis="0 1 0"/><geom size=".05" mass="1" pos="0 0 .3" contype="0" conaffinity="0"/></body></body>
</worldbody><actuator><motor joint="hip"/></actuator></mujoco>"""


@pytest.fixture
def flat(tmp_path):
    (tmp_path / "hopper.xml").write_text(FLAT)
    return reading.parse(TEXT.format(posture='posture = "keyframe"\n'), tmp_path)


def test_an_engine_that_is_not_exact_is_warned_of_and_not_chosen(flat):
    with pytest.warns(
        jx.InexactWarning, match="`mjx` leaves out corners .*'floor' and geom 'foot'"
    ):
        engines.tell_inexact(flat.plant)
    assert engines.able(flat) == ("mujoco",)
    assert not engines.compiling_pays(flat, 1e12, 2)


def test_other_robots_are_not_warned_of(flat, tmp_path, recwarn):
    (tmp_path / "hopper.xml").write_text(FLAT.replace('"box"', '"ellipsoid"'))
    engines.tell_inexact(flat.plant)
    engines.tell_inexact(None)
    assert not recwarn.list and "mjx" in engines.able(flat)


def test_warnings_of_the_library_are_lines_on_the_command_line(flat, capsys):
    with _warnings.as_lines():
        engines.tell_inexact(flat.plant)
        with pytest.raises(UserWarning, match="another"):  # as pytest has it, an error
            warnings.warn("another", UserWarning, stacklevel=1)
    out, said = capsys.readouterr()
    assert out == "" and said.count("\n") == 1
    assert said.startswith("jaxact: warning: the engine `mjx` leaves out corners")


INTERRUPTED = """
import sys, threading, warnings
import zarr, zarr.errors
from jaxact.cli import main

def consolidate_metadata(*_, **__):
    # As in Zarr's own thread, which goes on after an interruption.
    of_formats = "Consolidated metadata is currently not part in the Zarr format 3 specification."
    told = lambda: warnings.warn(of_formats, zarr.errors.ZarrUserWarning)
    threading.Timer(0.3, told).start()
    raise KeyboardInterrupt

zarr.consolidate_metadata = consolidate_metadata
sys.argv = ["jaxact", "sweep", "s.toml", "--out", "o"]
main.entry()
"""


@pytest.mark.exhaustive
def test_an_interruption_is_one_line_though_zarr_still_writes(tmp_path):
    (tmp_path / "s.toml").write_text("duration = 0.1\n[axes]\nkp = [100, 200]\nkd = [5]\n")
    ran = subprocess.run(
        [sys.executable, "-c", INTERRUPTED], cwd=tmp_path, capture_output=True, text=True
    )
    assert ran.returncode == 130
    assert ran.stderr.count("\n") == 1 and "interrupted" in ran.stderr


def test_joints_that_a_given_limit_makes_too_weak_are_told_once(tmp_path, capsys):
    """A rod held level, whose weight needs 4.905 N m, behind a motor of 50."""
    (tmp_path / "rod.xml").write_text(ROD)
    text = '[plant]\nmodel = "rod.xml"\nposture = "keyframe"\n[parameters]\n{}\n[axes]\nkp = [90]\n'
    for given, said in (("force_limit = 1", 1), ("force_limit = 9", 0)):
        asked = reading.parse(text.format(f"kd = 9\n{given}"), tmp_path)
        with _warnings.as_lines():
            _warnings.posture(asked)
            tell_weak(asked.plant, expand(asked).along)  # as the verb does
        told = capsys.readouterr().err
        assert told.count("j holds the posture with 4.905 of 1 N m") == told.count("\n") == said


ROD = """<mujoco><worldbody><body><joint name="j" axis="0 1 0"/>
<geom size="0.05" mass="1" pos="0.5 0 0"/></body></worldbody>
<actuator><motor joint="j" ctrlrange="-50 50"/></actuator></mujoco>"""
