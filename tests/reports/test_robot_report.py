"""The report of a robot: its mathematics in node, the page in a browser, and what is refused."""

import json
import os
import shlex
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from browser import in_browser
from command_line import jaxact
from quickly import compiled_quickly as compiled_quickly
from random_robots import CASES, PUBLIC, PUBLIC_CASES, QUADRUPED, random_cases, rows

import jaxact as jx
from jaxact.verbs import report_robot

FOLDER = Path(__file__).parent
LARGEST = 3_000_000  # bytes
FEW, MANY = 4, 100
EXACT = 1e-6
RANDOM_POINTS = 40  # of each robot
PATIENCE = 60.0  # [s] for numbers in full

MARGINS = (
    "sensitivity_peak", "complementary_peak", "unscaled_disk_margin", "disk_margin", "gain_margin",
    "delay_margin",
)  # fmt: skip

needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="needs node")

TYPE = """(() => {
  for (const [name, value] of Object.entries(VALUES)) {
    const input = document.getElementById(`control-${name}-number`);
    input.value = value;
    input.dispatchEvent(new Event("change"));
  }
})()"""
READ = """(() => {
  const row = { says: document.getElementById("robot-verdict").textContent };
  for (const line of document.querySelectorAll("#robot-margins tr")) {
    row[line.dataset.name] = line.querySelector("td").dataset.value;
  }
  return row;
})()"""


def checked_by_node(cases, folder):
    file = folder / "robots.json"
    file.write_text(json.dumps(rows(cases)))
    ran = subprocess.run(
        ["node", "--test", str(FOLDER / "robots.test.mjs")],
        capture_output=True, text=True, env=os.environ | {"JAXACT_ROBOTS": str(file)},
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout
    assert "# skipped 0" in ran.stdout


@pytest.mark.exhaustive
@needs_node
def test_the_page_computes_what_python_computes(tmp_path):
    checked_by_node(CASES, tmp_path)


@needs_node
@pytest.mark.exhaustive
@pytest.mark.skipif(not PUBLIC.is_dir(), reason="needs the public robots in .robots")
def test_the_page_computes_what_python_computes_of_public_robots(tmp_path):
    checked_by_node(PUBLIC_CASES, tmp_path)


@needs_node
@pytest.mark.exhaustive
def test_the_page_computes_what_python_computes_at_random_points(tmp_path):
    checked_by_node(random_cases(RANDOM_POINTS), tmp_path)


@pytest.fixture(scope="module")
def loop():
    return jx.robot(
        QUADRUPED, keyframe="stand", base="fixed", kp=100, kd=3, delay=2e-3, wn=400, zeta=0.6,
        control_rate=500,
    )  # fmt: skip


@pytest.fixture(scope="module")
def report(loop, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "robot.html"
    return jx.report(loop, path, title="<script>alert(1)</script>").path


def settled(page, name="settled"):
    """Wait for the numbers in full."""
    deadline = time.monotonic() + PATIENCE
    asked = f"document.getElementById('robot-verdict').dataset.{name}"
    while time.monotonic() < deadline:
        # just after a move the numbers may still be those from before it, or its quick ones
        if page.run(asked) == "true" and "…" not in (found := page.run(READ))["says"]:
            return found
        time.sleep(0.05)
    raise AssertionError("the numbers in full do not come")


@pytest.mark.exhaustive
@in_browser
@pytest.mark.parametrize("points", [FEW, MANY])
def test_the_page_follows_its_sliders_as_python_does(page, report, loop, points):
    page.open(report)
    rng = np.random.default_rng(1)
    moved = {
        "gain_scale": np.exp(rng.uniform(np.log(0.3), np.log(3.0), points)).round(3),
        "delay": rng.uniform(0.0, 8.0, points).round(3),
        "wn": rng.uniform(150.0, 900.0, points).round(1),
        "zeta": rng.uniform(0.3, 1.2, points).round(3),
    }
    found = []
    for point in range(points):
        values = {name: float(column[point]) for name, column in moved.items()}
        page.run(TYPE.replace("VALUES", json.dumps(values)))
        time.sleep(0.05)
        found.append(settled(page, "joints"))
    theirs = jx.margins(loop.replace(**moved | {"delay": 1e-3 * moved["delay"]}))
    compared = 0
    for own, detail in zip(found, theirs.details, strict=True):
        margins = detail.margins
        assert own["stable"] == str(margins.stable).lower()
        assert float(own["growth_rate"]) == pytest.approx(margins.growth_rate, rel=EXACT)
        if margins.whole is None:
            continue
        for name in MARGINS:
            assert float(own[name]) == pytest.approx(getattr(margins.whole, name), rel=EXACT), name
        compared += 1
    assert compared > 0
    assert page.requests == [report.as_uri()] and page.said == []
    assert report.stat().st_size < LARGEST


LEFT = """[...document.querySelectorAll(
  "#robot-margins td, #robot-joints td, #robot-shape-says, #robot-step-says"
)].map((one) => one.textContent)"""


@pytest.mark.exhaustive
@in_browser
def test_nothing_of_before_a_move_is_left_as_if_it_were_of_now(page, report):
    page.open(report)
    settled(page, "joints")
    page.run("document.querySelectorAll('details').forEach((one) => one.open = true)")
    before = page.run(LEFT)
    # In one step with the move: at once, and with the first picture.
    left = page.run(
        f"(async () => {{ {TYPE.replace('VALUES', json.dumps({'wn': 300}))};"
        f" await new Promise((done) => requestAnimationFrame(done)); return {LEFT}; }})()"
    )
    assert len(left) == len(before) > 100
    assert set(left) == {"…"}
    assert page.run("document.querySelectorAll('.outdated').length") == 3
    after = settled(page, "joints")
    assert "…" not in page.run(LEFT) and "disk_margin" in after
    # Another width draws again, and interrupts nothing.
    page.run(TYPE.replace("VALUES", json.dumps({"wn": 350})))
    time.sleep(0.05)
    settled(page)
    page.run("document.getElementById('robot-pad').style.width = '80%'")
    settled(page, "joints")
    deadline = time.monotonic() + PATIENCE
    drawing = "document.getElementById('robot-drawing').textContent"
    while page.run(drawing) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert page.run(drawing) == ""
    assert page.run("document.querySelectorAll('.outdated').length") == 0


STEPPED = """[...document.querySelectorAll("#robot-step-data tbody tr")].map(
  (row) => [...row.cells].map((cell) => Number(cell.textContent)))"""


@in_browser
def test_the_joint_that_steps_is_chosen_and_reaches_its_setpoint(page, report):
    page.open(report)
    settled(page, "joints")
    page.run("document.getElementById('robot-step-data').open = true")
    says = "document.getElementById('robot-step-says').textContent"
    before = page.run(says)
    assert before.startswith("A step of 0.01 rad of the setpoint of ")
    joint = "document.getElementById('robot-step-joint')"
    page.run(f"{joint}.value = '2'; {joint}.dispatchEvent(new Event('change'))")
    deadline = time.monotonic() + PATIENCE
    while page.run(says) in ("…", before) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert page.run(f"{joint}.selectedOptions[0].textContent") in page.run(says)
    rows = page.run(STEPPED)
    assert len(rows) > 20 and rows[0][1] == 0.0
    # On the stand the legs bear no load but their own weight, which the posture carries already.
    assert rows[-1][1] == pytest.approx(0.01, rel=0.2)


@in_browser
def test_what_is_copied_computes_the_same(page, report, tmp_path):
    page.open(report)
    page.run(TYPE.replace("VALUES", json.dumps({"kp_0": 0.5, "delay": 3})))
    time.sleep(0.05)
    own = settled(page)
    command = shlex.split(page.run("document.getElementById('robot-command').value"))
    (tmp_path / "robot.toml").write_text(page.run("document.getElementById('robot-toml').value"))
    for arguments in (command[2:], ["--spec", str(tmp_path / "robot.toml")]):
        ran = jaxact("margins", *arguments, "--json")
        assert ran.returncode == 0, ran.stderr
        theirs = json.loads(ran.stdout)["growth_rate"]
        assert float(own["growth_rate"]) == pytest.approx(theirs, rel=EXACT)
    again = jx.report(tmp_path / "robot.toml", tmp_path / "again.html")
    page.open(again.path)
    assert float(settled(page)["growth_rate"]) == pytest.approx(
        float(own["growth_rate"]), rel=EXACT
    )


@pytest.mark.exhaustive
@in_browser
def test_a_robot_without_gains_moves_as_it_would_alone(page, tmp_path):
    loop = jx.robot(QUADRUPED, kp=0, kd=0, control_rate=500)
    page.open(jx.report(loop, tmp_path / "limp.html").path)
    own = settled(page, "joints")
    (detail,) = jx.margins(loop.replace(kp=1e-9, kd=1e-9)).details  # which asks for some
    assert float(own["growth_rate"]) == pytest.approx(detail.margins.growth_rate, rel=EXACT)
    assert page.run("document.getElementById('robot-groups-head').hidden")
    assert page.said == []


@pytest.mark.exhaustive
@in_browser
def test_keys_and_pointer_move_the_point_and_widths_and_colours_are_accessible(page, report):
    page.open(report)
    settled(page, "joints")
    number = "Number(document.getElementById('control-gain_scale-number').value)"
    page.run("document.getElementById('robot-pad').focus()")
    page.press("ArrowUp", shift=True)
    assert page.run(number) > 1.5
    assert "shake" in settled(page)["says"] or "Stable" in settled(page)["says"]
    page.run("document.getElementById('robot-again').click()")
    assert page.run(number) == 1
    assert page.run("document.querySelector('h1').textContent") == "<script>alert(1)</script>"
    assert page.run("document.querySelectorAll('#robot-joints tbody tr').length") == 12
    for width in (1280, 390):
        for dark in (False, True):
            page.open(report, width=width, dark=dark)
            settled(page, "joints")
            assert page.violations() == []
            assert page.run("document.documentElement.scrollWidth") <= width


def test_joints_that_differ_in_their_side_only_are_a_group():
    names = ["FL_hip_joint", "FR_hip_joint", "left_knee", "right_knee", "l_sho_pitch", "waist"]
    assert report_robot.groups(names) == {
        "hip_joint": [0, 1], "knee": [2, 3], "sho_pitch": [4], "waist": [5],
    }  # fmt: skip


MESH = '<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody><body><joint name="j"/>' \
    '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>'  # fmt: skip
PASSIVE = '<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody></mujoco>'


@pytest.mark.parametrize(
    ("text", "arguments", "words"),
    [
        (MESH, (), "gone.stl"),
        (PASSIVE, (), "actuator"),
        ("not XML", (), "robot.xml"),
        (PASSIVE, ("--mass", "3"), "--mass"),
        (None, (), "no such file"),
        (None, ("--spec", "nothing.toml"), "nothing.toml"),
    ],
    ids=["mesh", "passive", "damaged", "mass", "missing", "both"],
)
def test_a_robot_that_cannot_be_used_is_one_line(text, arguments, words, tmp_path):
    model = tmp_path / "robot.xml"
    if text is not None:
        model.write_text(text)
    ran = jaxact("report", str(model), *arguments, "--out", str(tmp_path / "robot.html"))
    assert ran.returncode == 2 and ran.stderr.count("\n") == 1
    assert ran.stderr.startswith("jaxact: ") and words in ran.stderr
    assert not (tmp_path / "robot.html").exists()
