"""The report of an identification: its data against the log, and what one can do with the page."""

import json

import numpy as np
import pytest
from browser import in_browser
from quickly import compiled_quickly as compiled_quickly
from test_report_verb import data_of

import jaxact as jx
from jaxact.identification.log import Log
from jaxact.loops import toml
from jaxact.simulation.thinning import thinned
from jaxact.verbs.report_identified import MOST_ROWS

HOSTILE = '<script>alert(1)</script> "it\'s" <b>'
MASS, KP, KD, TICK = 0.7, 400.0, 20.0, 2e-3
LARGEST = 1_000_000  # bytes


def _log(name, seed, rows=500):
    """A mass behind a drive that is one tick late, exact between its ticks."""
    generator = np.random.default_rng(seed)
    goal = np.repeat(generator.choice([-0.05, 0.05], rows // 10 + 1), 10)[:rows]
    position, velocity, command = np.zeros(rows), np.zeros(rows), np.zeros(rows)
    for row in range(rows):
        if row:
            force = command[row - 2] if row > 1 else 0.0
            speed = velocity[row - 1]
            position[row] = position[row - 1] + TICK * speed + 0.5 * TICK**2 * force / MASS
            velocity[row] = speed + TICK * force / MASS
        command[row] = KP * (goal[row] - position[row]) - KD * velocity[row]
    signals = {"setpoint": goal, "position": position + 2e-5 * generator.normal(size=rows)}
    signals |= {"velocity": velocity, "command": command}
    return Log(name, TICK * np.arange(rows), signals, unit="m", gains=(KP, KD))


@pytest.fixture(scope="module")
def found():
    return jx.identify(_log(HOSTILE, 1), "mass", validate=[_log("other", 2)])


@pytest.fixture(scope="module")
def report(found, tmp_path_factory):
    return found.report(tmp_path_factory.mktemp("identified") / "drive.html")


def test_the_page_has_the_logs_the_ladder_the_intervals_and_the_loop(found, report):
    (drive,) = data_of(report, "identified")["drives"]
    fitted, unseen = drive["logs"]
    assert (fitted["title"], fitted["role"], unseen["role"]) == (HOSTILE, "fitted", "not fitted")
    log = _log("other", 2)
    np.testing.assert_allclose(unseen["measured"], log["position"], rtol=1e-5)
    np.testing.assert_allclose(unseen["time"], log.time, rtol=1e-5)
    rest = np.subtract(unseen["measured"], unseen["simulated"])
    assert np.sqrt(np.mean(rest**2)) == pytest.approx(found.chosen.error, rel=1e-3)
    assert unseen["rms"] == pytest.approx(found.chosen.error)
    (chosen,) = [one for one in drive["ladder"] if one["chosen"]]
    assert chosen["name"] == drive["model"] == "delay, no friction"
    delay = next(one for one in drive["estimates"] if one["name"] == "delay")
    assert delay["unit"] == "ms" and delay["low"] < 2.0 < delay["high"]
    known = found.chosen.knowledge
    wanted = [[known.correlation[i, j] for j in range(3)] for i in range(3)]
    np.testing.assert_allclose(drive["correlation"]["rows"], wanted, atol=1e-9)
    for profile, one in zip(drive["profiles"], drive["estimates"], strict=True):
        assert min(profile["rises"]) == pytest.approx(0.0, abs=0.05)
        assert profile["values"][0] <= one["low"] < one["high"] <= profile["values"][-1]
    own = data_of(report)["loops"][0]["parameters"]
    assert own["mass"] == pytest.approx(MASS, rel=1e-3) and own["kp"] == KP
    assert report.path.stat().st_size < LARGEST


def test_a_drives_file_has_all_but_the_logs(found, tmp_path):
    path = tmp_path / "drive.toml"
    path.write_text(toml.dumps(found.document()), encoding="utf-8")
    report = jx.report(path, tmp_path / "drive.html")
    (drive,) = data_of(report, "identified")["drives"]
    (whole,) = data_of(jx.report(found, tmp_path / "whole.html"), "identified")["drives"]
    for name in ("ladder", "estimates", "correlation", "sentence", "model"):
        assert drive[name] == whole[name]
    assert drive["logs"] == [] and "not in the drive's file" in drive["notes"][0]
    assert data_of(report)["points"][0]["kp"] == KP


def test_a_drive_that_is_not_good_enough_has_no_map_that_looks_certain(found, tmp_path):
    document = found.document()
    document["verdict"] = document["verdict"] | {"level": "not good enough"}
    path = tmp_path / "drive.toml"
    path.write_text(toml.dumps(document), encoding="utf-8")
    report = jx.report(path, tmp_path / "drive.html")
    (drive,) = data_of(report, "identified")["drives"]
    assert "does not explain the logs" in drive["notes"][-1]
    with pytest.raises(KeyError):
        data_of(report)


def test_a_long_log_keeps_its_extremes_within_the_budget():
    generator = np.random.default_rng(0)
    first, second = generator.normal(size=(2, 300_000))
    first[123_456], second[54_321] = 50.0, -70.0
    kept = thinned(first, second, MOST_ROWS)
    assert len(kept) <= MOST_ROWS and np.all(np.diff(kept) > 0)
    assert {123_456, 54_321} <= set(kept.tolist())
    # 25 bytes a row, as numbers of six digits: far from the whole megabyte.
    text = json.dumps([float(f"{x:.6g}") for x in first[kept]])
    assert 3 * len(text) < 0.7 * LARGEST


@in_browser
def test_a_drag_and_the_sliders_look_closer(page, report):
    page.open(report)
    assert page.requests == [report.path.as_uri()]
    says = "document.getElementById('log-says').textContent"
    whole = page.run(says)
    assert whole.startswith("0 to 0.998 s")
    place = page.run("""(() => {
      const svg = document.getElementById("log-over");
      svg.scrollIntoView();
      const box = svg.getBoundingClientRect();
      return [box.left, box.top + box.height / 2, box.width];
    })()""")
    page.mouse("mousePressed", place[0] + 0.4 * place[2], place[1])
    page.mouse("mouseMoved", place[0] + 0.5 * place[2], place[1])
    page.mouse("mouseReleased", place[0] + 0.6 * place[2], place[1])
    closer = page.run(says)
    first, last = (float(word) for word in closer.split(" s")[0].split(" to "))
    assert 0.3 < first < 0.45 and 0.55 < last < 0.7
    page.run("document.getElementById('log-from').focus()")
    page.press("ArrowRight")
    page.run("""(() => {
      const slider = document.getElementById("log-from");
      slider.value = 0;
      slider.dispatchEvent(new Event("input"));
    })()""")
    assert page.run(says).startswith("0 to 0.2")
    page.run("document.getElementById('log-whole').click()")
    assert page.run(says) == whole
    assert page.said == []


@in_browser
def test_text_is_shown_as_text(page, report):
    page.open(report)
    names = page.run("[...document.querySelectorAll('#log option')].map((one) => one.text)")
    assert names == [f"{HOSTILE} (fitted)", "other (not fitted)"]
    assert page.run("document.querySelectorAll('b').length") == 0
    assert page.said == []


@pytest.mark.exhaustive
@in_browser
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [1280, 390])
def test_it_fits_the_window_and_axe_finds_no_violation(page, report, width, dark):
    page.open(report, width=width, dark=dark)
    assert page.run("document.documentElement.scrollWidth") <= width
    assert page.violations() == []
