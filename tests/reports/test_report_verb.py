"""What a report is of, what is embedded in it, and what is refused."""

import base64
import hashlib
import json
import re
from pathlib import Path

import pytest
import xarray as xr
from command_line import jaxact

import jaxact as jx
from jaxact.loops import toml
from jaxact.verbs.report import _is_robot

SWEEP = """
description = "<script>alert(1)</script> & \\"quotes\\""
engine = "mass"
[parameters]
mass = 0.5
[axes]
kp = { min = 10, max = 1e4, num = 3, spacing = "log" }
kd = { min = 0.5, max = 50, num = 3, spacing = "log" }
actuator = ["hyq", "starleth"]
"""


def data_of(report, part="joint"):
    text = Path(report).read_text(encoding="utf-8")
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text)[1]
    return json.loads(found)[part]


def test_a_sweep_has_its_ranges_and_its_other_axes_as_loops(tmp_path):
    (tmp_path / "sweep.toml").write_text(SWEEP)
    path = jx.report(tmp_path / "sweep.toml", tmp_path / "sweep.html")
    data, text = data_of(path), path.text
    assert data["window"] == {"kp": [10.0, 1e4], "kd": [0.5, 50.0]}
    assert [one["parameters"]["wn"] for one in data["loops"]] == [800.0, 110.0]
    assert data["points"] == [{"name": "nominal", "kp": 400.0, "kd": 20.0}]
    assert data["sampled"]
    assert "alert(1)" in text and "<script>alert" not in text
    results = xr.Dataset(attrs={"specification_toml": SWEEP})
    assert data_of(jx.report(results, tmp_path / "again.html")) == data


@pytest.mark.exhaustive
def test_gains_have_their_common_factor_and_rotary_joints_their_units(tmp_path):
    loop = jx.joint(inertia=0.02, kp=80, kd=1.5, gain_scale=2)
    data = data_of(jx.margins(loop).report(tmp_path / "joint.html", title="<b>", command="ls"))
    text = (tmp_path / "joint.html").read_text(encoding="utf-8")
    assert "&lt;b&gt;" in text and "<b>" not in text and ">ls</pre>" in text
    assert data == data_of(jx.margins(loop, sampled="both").report(tmp_path / "both.html"))
    assert data["unit"] == "rad" and not data["sampled"]
    assert (data["loops"][0]["parameters"]["kp"], data["loops"][0]["parameters"]["kd"]) == (160, 3)
    assert data["loops"][0]["parameters"]["wn"] == "inf"


def test_the_policy_allows_the_script_and_the_style_that_are_there_and_no_others(tmp_path):
    text = jx.report(jx.joint(), tmp_path / "joint.html").text
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    assert policy.startswith("default-src 'none'") and "unsafe" not in policy
    script, style = (
        re.search(r"<script>(.*?)</script>", text, re.DOTALL),
        re.search(r"<style>(.*?)</style>", text, re.DOTALL),
    )
    for part in (script, style):
        digest = base64.b64encode(hashlib.sha256(part[1].encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    assert not re.search(
        r"\beval\(|new Function|\bfetch\(|XMLHttp|https?://(?!www.w3.org)", script[1]
    )


def test_tuned_gains_have_the_ends_of_what_was_uncertain_as_loops(tmp_path):
    (tmp_path / "gains.toml").write_text(
        "[gains]\nkp = 80.0\nkd = 11.0\n[assumed]\nmembers = 36\nmass = 0.7\n"
        "natural_frequency = [88.0, 132.0]\ndamping_ratio = 0.9\ndelay = [0.0, 0.005]\n"
        'control_period = 0.002\n[guaranteed]\nverdict = "it holds"\n'
    )
    data = data_of(jx.report(tmp_path, tmp_path / "tuned.html"))
    own = [one["parameters"] for one in data["loops"]]
    assert [(one["wn"], one["delay"]) for one in own] == [
        (88.0, 0.0), (88.0, 0.005), (132.0, 0.0), (132.0, 0.005),
    ]  # fmt: skip
    assert {(one["kp"], one["control_rate"], one["zeta"]) for one in own} == {(80.0, 500.0, 0.9)}
    assert data["points"] == [{"name": "tuned", "kp": 80.0, "kd": 11.0}]
    assert "<h1>Tuned: it holds</h1>" in (tmp_path / "tuned.html").read_text()


@pytest.mark.parametrize(
    ("subject", "out", "words"),
    [
        (jx.joint(), "joint.pdf", "a report is an .html file"),
        (jx.joint(), "nowhere/joint.html", "does not exist"),
        (jx.joint(kp=-10.0, joint_stiffness=40.0), "joint.html", "logarithms"),
        (jx.joint(kp=list(range(1, 300))), "joint.html", "at most 200 loops"),
        (jx.robot("experiments/quadruped/quadruped.xml"), "robot.pdf", "an .html file"),
        ("experiments/quadruped/nothing.xml", "robot.html", "no such model file"),
        (3, "joint.html", "cannot be of a int"),
        (xr.Dataset(), "joint.html", "not of a sweep"),
        ("nothing.toml", "joint.html", "cannot be read"),
    ],
    ids=["suffix", "folder", "negative", "many", "robot", "model", "type", "dataset", "missing"],
)
def test_what_is_refused_leaves_nothing_behind(subject, out, words, tmp_path):
    with pytest.raises(jx.UserError, match=words):
        jx.report(subject, tmp_path / out)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "text",
    [
        'plant = "mass"\nunit = "m"\nestimates = {}\nloop = [{ mass = 1 }]\n',
        '[gains]\nkp = "a"\nkd = 2\n[assumed]\nmass = 1\n',
        "[gains]\nkp = 1\nkd = 2\n[assumed]\nmass = 1\n[[checks]]\n[[loop]]\nmass = {}\n",
    ],
)
def test_a_damaged_result_is_one_line(text, tmp_path):
    (tmp_path / "result.toml").write_text(text)
    with pytest.raises(jx.UserError, match=r"^[^\n]*$"):
        jx.report(tmp_path / "result.toml", tmp_path / "result.html")
    assert not (tmp_path / "result.html").exists()


@pytest.mark.parametrize("key", ["metric", "bound", "value", "member", "met"])
def test_of_a_result_of_another_version_the_key_that_is_missing_is_named(key, tmp_path):
    check = {"metric": "sensitivity_peak", "bound": 2, "value": 1, "member": "a", "met": True}
    del check[key]
    text = toml.dumps({"gains": {"kp": 80, "kd": 11}, "assumed": {"mass": 1}, "checks": [check]})
    (tmp_path / "gains.toml").write_text(text)
    with pytest.raises(jx.UserError, match=rf"^[^\n]*lacks '{key}'[^\n]*$"):
        jx.report(tmp_path, tmp_path / "tuned.html")


def test_a_specification_that_varies_nothing_is_its_loop(tmp_path):
    text = 'description = "the knee"\n[parameters]\nkp = 300\nkd = 9\ndelay = 0.002\n'
    (tmp_path / "knee.toml").write_text(text)
    report = jx.report(tmp_path / "knee.toml", tmp_path / "knee.html")
    data = data_of(report)
    (own,) = data["loops"]
    assert (own["parameters"]["kp"], own["parameters"]["delay"]) == (300, 0.002)
    low, high = data["window"]["kp"]
    assert low < 300 < high and not data["sampled"]
    page = report.path.read_text()
    assert "<h1>the knee</h1>" in page and "feedforward" not in page.split("<footer>")[1]
    (tmp_path / "empty.toml").write_text("")
    with pytest.raises(jx.UserError, match="axes: none given"):
        jx.report(tmp_path / "empty.toml", tmp_path / "empty.html")


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("gains.toml", "no [[ TOML", r"gains\.toml: is damaged"),
        ("notes.txt", "of something else", "the folder of a tuning, an identified drive"),
        (None, "", "no such result.* a robot's model"),
    ],
    ids=["damaged", "other", "missing"],
)
def test_a_folder_of_nothing_that_a_report_is_of(name, text, words, tmp_path):
    folder = tmp_path / "result"
    if name is not None:
        folder.mkdir()
        (folder / name).write_text(text)
    with pytest.raises(jx.UserError, match=f"^[^\n]*{words}[^\n]*$"):
        jx.report(folder, tmp_path / "result.html")
    assert not (tmp_path / "result.html").exists()


def test_the_command_writes_and_says_so(tmp_path):
    out = tmp_path / "joint.html"
    ran = jaxact("report", "--actuator", "hyq", "--out", str(out))
    assert ran.returncode == 0 and ran.stdout == f"wrote {out}\n", ran.stderr
    assert "<h3>Command</h3>" in out.read_text()
    ran = jaxact("report", "sweep.toml", "--kp", "3")
    assert ran.returncode == 2 and ran.stderr.startswith("jaxact: --kp:")


@pytest.mark.parametrize(
    ("text", "robot"),
    [
        ('[plant]\nmodel = "arm.xml"\n', True),
        ('plant = { model = "arm.xml" }\n', True),
        ("# not a robot's: no [plant] here\n[parameters]\nkp = 400\n", False),
        ("[plant\n", False),
    ],
)
def test_a_specification_with_a_plant_is_of_a_robot(tmp_path, text, robot):
    path = tmp_path / "loop.toml"
    path.write_text(text)
    assert _is_robot(path) is robot
