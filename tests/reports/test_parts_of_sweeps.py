"""Reports of sweeps whose gains are scaled, listed in any order, drawn, refined, or a part."""

import json
import shutil
import subprocess

import numpy as np
import pytest
import xarray as xr
from quickly import compiled_quickly as compiled_quickly
from test_report_verb import data_of

import jaxact as jx
from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.sweeping import variables
from jaxact.verbs import report_joint

DRIVE = {"actuator": "starleth", "delay": 5e-3}
KPS, KDS = [400.0, 100.0, 3000.0, 12.0], [60.0, 5.0, 20.0, 150.0]
CELL = """
import { cellAt, cellWords } from "PAGE/cells.js";
import { readFileSync } from "node:fs";
const [cells, loop, points] = JSON.parse(readFileSync(0, "utf8"));
console.log(JSON.stringify(points.map((one) => cellAt(cells, loop, one))));
"""


SCALED = f"""
[parameters]
actuator = "starleth"
delay = 0.005
[axes]
gain_scale = [1, 4]
kp = {KPS}
kd = {KDS}
"""
DRAWN = """
[parameters]
actuator = "starleth"
[axes]
delay = [0.001, 0.005]
kp = { min = 10, max = 1e4, spacing = "log" }
kd = { min = 1, max = 200, spacing = "log" }
[sampling]
method = "sobol"
samples = 4
"""


def results_of(text):
    """A sweep's results whose verdicts follow from the gains at the joint, without simulation."""
    samples = expand(reading.parse(text))
    values = {name: value.reshape(samples.shape) for name, value in samples.values.items()}
    verdict = np.where(holds(values["gain_scale"] * values["kp"], values["kd"]), 0, 2)
    coords = {name: (one.dims, one.values) for name, one in samples.coords.items()}
    return xr.Dataset({"verdict": (samples.dims, verdict)}, coords, {"specification_toml": text})


def holds(kp, kd):
    return kp < 40.0 * kd


@pytest.fixture(scope="module")
def scaled():
    return results_of(SCALED)


def page_of(results):
    return report_joint.content(results).parts["joint"]


def test_cells_window_and_star_have_the_gains_that_arrive_at_the_joint(scaled):
    page = page_of(scaled)
    assert [one["parameters"]["kp"] for one in page["loops"]] == [400.0, 1600.0]
    assert page["points"] == [{"name": "nominal", "kp": 400.0, "kd": 20.0}]
    assert page["window"] == {"kp": [12.0, 12_000.0], "kd": [5.0, 600.0]}
    cells = page["cells"]
    assert cells["kp"] == sorted(KPS) and cells["kd"] == sorted(KDS)
    assert cells["scale"] == [1.0, 4.0]
    kd, kp = np.meshgrid(cells["kd"], cells["kp"], indexing="ij")
    for factor, codes in zip(cells["scale"], cells["verdicts"], strict=True):
        assert [code == "0" for code in codes] == holds(factor * kp, kd).ravel().tolist()
    of_four = page_of(scaled.isel(gain_scale=1))
    assert of_four["window"] == {"kp": [48.0, 12_000.0], "kd": [20.0, 600.0]}
    assert of_four["points"] == [{"name": "nominal", "kp": 1600.0, "kd": 80.0}]


@pytest.mark.exhaustive
def test_scaled_cells_agree_with_exact_theory_of_the_gains_on_the_page():
    loop = jx.joint(**DRIVE, gain_scale=[1.0, 4.0])
    maps = jx.sweep(loop, kp=KPS, kd=KDS, duration=0.3, progress=False)
    cells = page_of(maps)["cells"]
    kd, kp = np.meshgrid(cells["kd"], cells["kp"], indexing="ij")
    for factor, codes in zip(cells["scale"], cells["verdicts"], strict=True):
        gains = {"kp": factor * kp.ravel(), "kd": factor * kd.ravel()}
        own = jx.margins(jx.joint(**DRIVE, **gains, control_rate=1000), sampled=True).stable
        assert [code == "0" for code in codes] == np.asarray(own).tolist()


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_the_cell_beneath_a_point_is_found_at_the_loops_own_gains(scaled, tmp_path):
    script = tmp_path / "cell.mjs"
    page = report_joint.__file__.replace("verbs/report_joint.py", "reports/page")
    script.write_text(CELL.replace("PAGE", page))
    points = [{"kp": 4 * kp * 1.1, "kd": 4 * kd / 1.1} for kp in KPS for kd in KDS]
    ran = subprocess.run(
        ["node", str(script)], capture_output=True, text=True,
        input=json.dumps([page_of(scaled)["cells"], 1, points]),
    )  # fmt: skip
    found = json.loads(ran.stdout)
    own = scaled.verdict.sel(gain_scale=4.0)
    for (kp, kd), cell in zip([(kp, kd) for kp in KPS for kd in KDS], found, strict=True):
        assert (cell["kp"], cell["kd"]) == (4 * kp, 4 * kd)
        assert cell["verdict"] == jx.Verdict(int(own.sel(kp=kp, kd=kd))).label


def test_a_part_of_a_sweep_has_the_loops_of_that_part(scaled):
    whole = page_of(scaled)
    part = page_of(scaled.isel(gain_scale=1))
    assert part["cells"]["verdicts"] == whole["cells"]["verdicts"][1:]
    assert [one["parameters"] for one in part["loops"]] == [whole["loops"][1]["parameters"]]
    turned = page_of(scaled.isel(gain_scale=[1, 0]))
    assert turned["cells"]["verdicts"] == whole["cells"]["verdicts"][::-1]
    assert [one["parameters"]["kp"] for one in turned["loops"]] == [1600.0, 400.0]
    alone = page_of(scaled.isel(kp=2))
    assert alone["cells"] is None
    assert [one["parameters"]["kp"] for one in alone["loops"]] == [3000.0, 12_000.0]


@pytest.mark.parametrize(
    ("take", "words"),
    [
        (lambda maps: maps.mean("gain_scale", keep_attrs=True), "gain_scale was swept"),
        (lambda maps: maps.isel(kp=0, drop=True), "kp was swept"),
        (lambda maps: maps.isel(kp=slice(0, 0)), "of no loops"),
    ],
    ids=["mean", "dropped", "empty"],
)
def test_a_part_that_does_not_say_which_it_is_is_refused(scaled, take, words, tmp_path):
    with pytest.raises(jx.UserError, match=f"^[^\n]*{words}[^\n]*$"):
        jx.report(take(scaled), tmp_path / "part.html")
    assert not (tmp_path / "part.html").exists()


def test_of_drawn_gains_there_is_the_map_alone(tmp_path):
    drawn = results_of(DRAWN)
    page = data_of(jx.report(drawn, tmp_path / "drawn.html"))
    assert page["cells"] is None and page["window"] == {"kp": [10.0, 1e4], "kd": [1.0, 200.0]}
    assert [one["parameters"]["delay"] for one in page["loops"]] == [1e-3, 5e-3]
    (one,) = page_of(drawn.isel(delay=1, sample=2))["loops"]
    assert one["parameters"]["kp"] == float(drawn.kp[2]) and one["parameters"]["delay"] == 5e-3


@pytest.mark.exhaustive
def test_of_a_refined_sweep_every_cell_is_that_of_the_nearest_loop(tmp_path):
    loop = jx.joint(delay=5e-3, actuator=["hyq", "starleth"])
    maps = jx.sweep(loop, kp=jx.log(10, 1e4, 6), kd=jx.log(1, 200, 6), adaptive=True, width=0.3,
                    duration=0.3, progress=False)  # fmt: skip
    cells = data_of(jx.report(maps, tmp_path / "refined.html"))["cells"]
    assert cells["near"] and len(cells["verdicts"]) == 2
    own = maps.where(maps.actuator == "starleth", drop=True)
    spans = np.log([1e3, 200.0])
    there = np.stack([np.log(own.kp.values), np.log(own.kd.values)], -1) / spans
    for column in range(3, len(cells["kp"]), 20):
        for row in range(3, len(cells["kd"]), 20):
            at = np.log([cells["kp"][column], cells["kd"][row]]) / spans
            distance = np.linalg.norm(there - at, axis=1)
            nearest = own.verdict.values[distance < distance.min() + 1e-9].astype(int)
            assert int(cells["verdicts"][1][row * len(cells["kp"]) + column]) in nearest
    assert page_of(maps.isel(sample=slice(0, 30)))["cells"] is None


def test_of_margins_nothing_is_said_to_be_simulated(scaled):
    page = page_of(scaled.assign_attrs({variables.KIND: "continuous"}))
    assert page["cells"] is None and not page["sampled"]
    assert page["window"] == page_of(scaled)["window"]
