"""The report of a robot's tuned gains: certificate, gains before and after, worst rollout."""

import re

import numpy as np
import pytest
from browser import in_browser
from random_robots import ROOT
from test_report_verb import data_of

import jaxact as jx

HOSTILE = '<script>alert(1)</script> "it\'s"'
NAMES = ("hip", HOSTILE)
CHECKS = [
    {"metric": "sensitivity_peak", "bound": 4.0, "value": 3.9, "member": HOSTILE, "met": True}
]
LARGEST = 3_000_000  # bytes
POINTS = 200


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """As `jaxact tune --model --out` writes it."""
    path = tmp_path_factory.mktemp("tuned")
    gains = {"kp": dict.fromkeys(NAMES, 30.0), "kd": dict.fromkeys(NAMES, 1.5)}
    about = {"member": HOSTILE, "unit": "rad"}
    about |= {"before": "unstable: motion grows", "tuned": "stable: comes to rest"}
    document = gains | {
        "checks": CHECKS,
        "before": {
            name: {joint: 0.5 * x for joint in NAMES} for name, x in (("kp", 80), ("kd", 4))
        },
        "guaranteed": {"certified": True, "verdict": HOSTILE},
        "assumed": {"models": ["robot.xml"], "loops": 4},
        "motion": about,
    }
    (path / "gains.toml").write_text(jx.loops.toml.dumps(document), encoding="utf-8")
    time = np.linspace(0.0, 2.0, POINTS)
    lines = ["gains,joint,time,setpoint,position,force"]
    for side, rate in (("before", 1.0), ("tuned", -3.0)):
        for joint in NAMES:
            moved = 0.01 * np.exp(rate * time) * np.sin(20 * time)
            name = joint.replace('"', '""')
            lines += [
                f'{side},"{name}",{t},0.0,{q},{-30 * q}' for t, q in zip(time, moved, strict=True)
            ]
    (path / "motion.csv").write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def report(folder):
    return jx.report(folder, folder / "tuned.html")


def test_the_page_has_gains_before_and_after_and_the_worst_rollout(report):
    gains = data_of(report, "tuned_robot")["gains"]
    assert gains[0] == {"name": "hip", "kp": 30.0, "kd": 1.5, "before": [40.0, 2.0]}
    run = data_of(report, "run")
    assert [one["name"] for one in run["loops"]] == ["tuned", "before"]
    for loop, rate in zip(run["loops"], (-3.0, 1.0), strict=True):
        own = loop["joints"][1]
        time = np.array(own["time"])
        moved = 0.01 * np.exp(rate * time) * np.sin(20 * time)
        np.testing.assert_allclose(own["position"], moved, rtol=1e-3, atol=1e-4)
    assert report.path.stat().st_size < LARGEST


def test_gains_without_rollouts_have_no_motion(tmp_path):
    text = (ROOT / "results" / "tuning" / "quadruped" / "gains.toml").read_text()
    (tmp_path / "gains.toml").write_text(re.sub(r"\n\[motion\]\n(.+\n)+", "\n", text))
    page = jx.report(tmp_path / "gains.toml", tmp_path / "t.html")
    assert data_of(page, "tuned_robot")["certified"]
    assert '"run":' not in page.text


@in_browser
def test_both_motions_are_drawn_and_text_is_shown_as_text(page, report):
    page.open(report.path)
    sentence = page.run("document.getElementById('tuned-robot-sentence').textContent")
    assert sentence == f"Certified: {HOSTILE}."
    assert page.run("document.getElementById('run-head').textContent").endswith(HOSTILE)
    for signal in ("position", "force"):
        for kind in ("sampled", "continuous"):
            drawn = f"document.querySelector('#run-{signal} .{kind}').getAttribute('d').length"
            assert page.run(drawn) > 5 * POINTS
    assert not page.run("document.getElementById('run-velocity').checkVisibility()")
    page.run("""(() => {
      const beside = document.getElementById("run-beside");
      beside.value = "";
      beside.dispatchEvent(new Event("change"));
    })()""")
    assert page.run("document.querySelectorAll('#run-position .continuous').length") == 0
    assert page.requests == [report.path.as_uri()] and page.said == []
    for width in (1280, 390):
        for dark in (False, True):
            page.resize(width, 900, dark=dark)
            assert page.run("document.documentElement.scrollWidth") <= width
            assert page.violations() == []
