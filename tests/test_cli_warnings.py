"""What is computed nevertheless, and warned of in one line."""

from dataclasses import replace

import pytest
from robots import HOPPER

from jaxact.cli import _warnings
from jaxact.loops import reading, robots

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
    _warnings.posture(asked().plant)
    assert capsys.readouterr() == ("", "")


def test_a_robot_that_creeps_after_settling_is(asked, monkeypatch, capsys):
    _creeping(monkeypatch, 0.054)
    _warnings.posture(asked().plant)
    out, said = capsys.readouterr()
    assert out == "" and said.count("\n") == 1
    assert said.startswith("jaxact: warning: the robot still creeps") and "0.054" in said


def test_one_that_starts_from_its_keyframe_as_it_is_was_asked_for(asked, monkeypatch, capsys):
    _creeping(monkeypatch, 9.8)
    _warnings.posture(asked('posture = "keyframe"\n').plant)
    assert capsys.readouterr() == ("", "")


def test_no_robot_no_word(tmp_path, capsys):
    _warnings.posture(reading.parse("[axes]\nkp = [100]\nkd = [5]\n", tmp_path).plant)
    assert capsys.readouterr() == ("", "")
