"""The report of a simulation: every joint over time, as `jaxact.simulate` gave it."""

import numpy as np
import pytest
from browser import in_browser
from quickly import compiled_quickly as compiled_quickly
from random_robots import QUADRUPED
from test_report_verb import data_of

import jaxact as jx

LARGEST = 3_000_000  # bytes
HOSTILE = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def run():
    loop = jx.robot(QUADRUPED, keyframe="stand", base="fixed", kp=100, kd=3, delay=[2e-3, 30e-3],
                    control_rate=500)  # fmt: skip
    return jx.simulate(loop, setpoint=0.05, duration=0.5, engine="mujoco")


@pytest.fixture(scope="module")
def report(run, tmp_path_factory):
    return run.jaxact.report(tmp_path_factory.mktemp("run") / "run.html", title=HOSTILE)


def test_the_page_has_every_joint_of_every_loop_with_its_extremes(run, report):
    data = data_of(report, "run")
    assert data["joints"] == [str(name) for name in run.joint.values]
    assert len(data["loops"]) == 2 and report.path.stat().st_size < LARGEST
    assert data["units"]["position"] == "rad" and data["units"]["force"] == "N m"
    for index, loop in enumerate(data["loops"]):
        own = run.isel(delay=index)
        for name, joint in zip(data["joints"], loop["joints"], strict=True):
            one = own.sel(joint=name)
            end = np.searchsorted(run.time, joint["time"][-1] * (1 + 1e-4), side="right")
            whole = one.position.values[:end]
            np.testing.assert_allclose(min(joint["position"]), whole.min(), rtol=1e-4, atol=1e-9)
            np.testing.assert_allclose(max(joint["position"]), whole.max(), rtol=1e-4, atol=1e-9)
            places = np.searchsorted(run.time, np.array(joint["time"]) * (1 - 1e-4) - 1e-9)
            np.testing.assert_allclose(joint["force"], one.force.values[places], rtol=1e-4)


def test_too_many_are_refused_in_one_line(run, tmp_path):
    many = run.isel(delay=[0] * 63)
    with pytest.raises(jx.UserError, match="too many for one report"):
        many.jaxact.report(tmp_path / "many.html")
    assert not list(tmp_path.iterdir())


@in_browser
def test_one_chooses_loop_and_joint(page, report, run):
    page.open(report.path)
    assert page.run("document.querySelector('h1').textContent") == HOSTILE
    page.run("""(() => {
      for (const [id, value] of [["run-loop", 1], ["run-joint", 3]]) {
        document.getElementById(id).value = value;
        document.getElementById(id).dispatchEvent(new Event("change"));
      }
    })()""")
    says = page.run("document.getElementById('run-verdict').textContent")
    assert str(run.joint.values[3]) in says and "delay 30 ms" in says
    assert len(page.run("document.querySelector('#run-force .sampled').getAttribute('d')")) > 100
    assert page.requests == [report.path.as_uri()] and page.said == []
    for width in (1280, 390):
        page.resize(width, 900, dark=width == 390)
        assert page.violations() == []
        assert page.run("document.documentElement.scrollWidth") <= width
