"""What a tuning says is to come does come, in this order, and nothing after the last of it."""

import pytest
import robots

import jaxact as jx
from jaxact.tuning.course import ahead
from jaxact.verbs import showing


def _loop(tmp_path, whole):
    if not whole:
        return jx.joint(mass=0.7, actuator="starleth", delay=1e-3)
    (tmp_path / "arm.xml").write_text(robots.PENDULUM)
    return jx.robot(tmp_path / "arm.xml", keyframe="home", actuator="hyq", delay=2e-3)


@pytest.mark.exhaustive
@pytest.mark.parametrize("whole", [True, False])
def test_what_is_to_come_comes(tmp_path, whole):
    told = []
    own = {"samples": 2} if whole else {}
    jx.tune(
        _loop(tmp_path, whole), max_peak=1.8, uncertainty="delay=1e-3..3e-3", starts=1, steps=20,
        front=0 if whole else 2, progress=lambda text, done, total: told.append(text), **own,
    )  # fmt: skip
    doing, coming = zip(*(text.partition(", then ")[::2] for text in told), strict=True)
    assert coming[0], "the first text says what is to come"
    for number, words in enumerate(coming):
        after = iter(doing[number + 1 :])
        for phase in filter(None, words.split(", ")):
            assert any(text.startswith(phase) for text in after), f"{phase} after {doing[number]}"
    assert not coming[-1]
    assert any(text.startswith("certifying") for text in doing)


def test_a_phase_of_no_name_belongs_to_the_one_before_and_an_end_has_nothing_after_it():
    told = []
    tell = ahead(ahead(lambda *said: told.append(said), ["", "simulating"]), ["descending", "end"])
    tell("descending from 3 starts", 1, 3)
    tell("looking around")
    tell("end of it")
    tell("interrupted, certifying")
    assert told == [
        ("descending from 3 starts, then end, then simulating", 1, 3),
        ("looking around, then end, then simulating", 0, 0),
        ("end of it, then simulating", 0, 0),
        ("interrupted, certifying", 0, 0),
    ]


def test_what_is_to_come_has_a_line_of_its_own(capsys, monkeypatch):
    monkeypatch.setattr(showing.sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    with showing.steps() as told:
        told("descending from 8 starts, then polishing, certifying", 1, 4)
    lines = capsys.readouterr().err.splitlines()
    (first,) = {line for line in lines if "descending" in line and "1/4" in line}
    assert "certifying" not in first
    assert any("then polishing, certifying" in line for line in lines)
