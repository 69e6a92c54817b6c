"""The report of tuned gains: before and after are what Python computes; a front one can click."""

import numpy as np
import pytest
from browser import in_browser
from quickly import compiled_quickly as compiled_quickly
from test_report_verb import data_of

import jaxact as jx
from jaxact.tuning.document import toml_text
from jaxact.verbs import tuning_front

pytestmark = pytest.mark.exhaustive

HOSTILE = '<script>alert(1)</script> \\"it\'s\\" <b>'
LARGEST = 1_000_000  # bytes


@pytest.fixture(scope="module")
def tuned():
    loop = jx.joint(actuator="starleth", delay=1e-3, kp=400, kd=20, control_rate=500)
    return jx.tune(
        loop, max_peak=1.6, uncertainty={"delay": (0, 5e-3)}, samples=2, starts=2, steps=60, front=3
    )


@pytest.fixture(scope="module")
def report(tuned, tmp_path_factory):
    return tuned.report(tmp_path_factory.mktemp("tuned") / "tuned.html")


def test_the_page_has_the_certificate_the_worst_members_and_the_front(tuned, report):
    data = data_of(report, "tuned")
    assert data["certified"] and [one["met"] for one in data["checks"]] == [True, True]
    assert [side["name"] for side in data["sides"]] == ["before", "tuned"]
    assert [one["kp"] for one in data["front"]] == [one.kp for one in tuned.front]
    names = [one["name"] for one in data["loops"]]
    assert names[0] == "nominal" and data["checks"][0]["member"] in names[1:]
    # The worst member's peak is what is certified.
    worst = data["loops"][names.index(data["checks"][0]["member"])]["parameters"]
    own = {name: worst[name] for name in ("kp", "kd", "mass", "wn", "zeta", "delay")}
    peak = jx.margins(jx.joint(**own, control_rate=500), sampled=True).sensitivity_peak
    assert float(peak) == pytest.approx(data["checks"][0]["value"], rel=1e-6)
    assert data_of(report)["loops"] == data["loops"]
    assert report.path.stat().st_size < LARGEST


def test_a_folder_has_the_same(tuned, report, tmp_path):
    (tmp_path / "gains.toml").write_text(toml_text(tuned), encoding="utf-8")
    front = tuning_front.csv_text(tuning_front.front(tuned.front))
    (tmp_path / "front.csv").write_text(front, encoding="utf-8")
    for path in (tmp_path, tmp_path / "gains.toml"):
        again = jx.report(path, tmp_path / "again.html")
        assert data_of(again, "tuned") == data_of(report, "tuned")
    assert len(jx.margins(jx.loop_of(tmp_path / "gains.toml")).gain_margin) > 1
    (tmp_path / "front.csv").write_text("max_peak,kp\n1,2\n")
    with pytest.raises(jx.UserError, match="is damaged; tune anew"):
        jx.report(tmp_path, tmp_path / "damaged.html")
    assert not (tmp_path / "damaged.html").exists()


@in_browser
def test_before_and_after_are_what_python_computes(page, report, tuned):
    page.open(report)
    assert page.requests == [report.path.as_uri()]
    for side, (kp, kd) in (("left", tuned.before), ("right", (tuned.kp, tuned.kd))):
        loop = jx.joint(kp=kp, kd=kd, actuator="starleth", delay=1e-3, control_rate=500)
        own = jx.margins(loop, sampled=True)
        for name in ("gain_margin", "delay_margin", "sensitivity_peak", "disk_margin"):
            cell = f"#tuned-margins [data-name={name}] [data-kind={side}]"
            shown = page.run(f"document.querySelector('{cell}').dataset.value")
            assert float(shown) == pytest.approx(float(getattr(own, name)), rel=1e-6)
    assert page.said == []


@in_browser
def test_a_click_on_the_front_takes_its_gains(page, report, tuned):
    page.open(report)
    place = page.run("""(() => {
      const dot = document.querySelectorAll("#front circle")[2];
      dot.scrollIntoView({ block: "center" });
      const box = dot.getBoundingClientRect();
      return [box.left + box.width / 2, box.top + box.height / 2];
    })()""")
    for kind in ("mousePressed", "mouseReleased"):
        page.mouse(kind, *place)
    last = tuned.front[2]
    text = page.run("document.getElementById('tuned-toml').value")
    assert text == f"[gains]\nkp = {last.kp!r}\nkd = {last.kd!r}"
    command = page.run("document.getElementById('tuned-command').value")
    assert command.startswith(f"jaxact margins --kp {last.kp!r} --kd {last.kd!r}")
    kp = [float(one.kp) for one in tuned.front]
    assert np.all(np.diff(kp) > 0)


@in_browser
def test_text_is_shown_as_text(page, tmp_path):
    (tmp_path / "gains.toml").write_text(
        f'[gains]\nkp = 80.0\nkd = 11.0\n[guaranteed]\nverdict = "{HOSTILE}"\n[assumed]\n'
        f'mass = 0.7\ndelay = [0.0, 0.005]\n[[loop]]\nname = "{HOSTILE}"\nmass = 0.7\n'
        f"delay = 0.002\n[[checks]]\nmetric = 'sensitivity_peak'\nbound = 1.6\nvalue = 1.7\n"
        f'member = "{HOSTILE}"\nmet = false\n'
    )
    page.open(jx.report(tmp_path, tmp_path / "tuned.html").path)
    wanted = HOSTILE.replace("\\", "")
    assert page.run("document.getElementById('tuned-loop').options[0].text") == wanted
    assert page.run("document.getElementById('tuned-sentence').textContent") == (
        f"NOT certified: {wanted}."
    )
    assert page.run("document.querySelectorAll('b').length") == 0
    assert page.said == []


@in_browser
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [1280, 390])
def test_it_fits_the_window_and_axe_finds_no_violation(page, report, width, dark):
    page.open(report, width=width, dark=dark)
    assert page.run("document.documentElement.scrollWidth") <= width
    assert page.violations() == []


def test_a_robots_gains_are_refused_with_what_to_report_instead(tmp_path):
    (tmp_path / "gains.toml").write_text("[kp]\nhip = 30.0\n[kd]\nhip = 1.0\n", encoding="utf-8")
    for path in (tmp_path, tmp_path / "gains.toml"):
        with pytest.raises(jx.UserError, match=r"robot\.xml --gains gains\.toml"):
            jx.report(path, tmp_path / "robot.html")
    assert not (tmp_path / "robot.html").exists()


@in_browser
def test_gains_without_others_before_stand_alone(page, tmp_path):
    loop = jx.joint(actuator="starleth", delay=1e-3, control_rate=500)
    jx.report(jx.tune(loop, max_peak=1.6, starts=2, steps=60), tmp_path / "alone.html")
    page.open(tmp_path / "alone.html")
    seen = page.run(
        '[...document.querySelectorAll("#compared th, #compared label, #compared td")]'
        '.filter((one) => one.checkVisibility()).map((one) => one.tagName)'
    )  # fmt: skip
    assert seen.count("LABEL") == 1
    assert seen.count("TD") == seen.count("TH")
