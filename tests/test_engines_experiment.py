"""The experiment that holds MJX against C MuJoCo: its specifications, and that it runs."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from experiment_modules import imported
from quickly import ENVIRONMENT

from jaxact.loops.samples import expand

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "experiments" / "engines"


@pytest.fixture(scope="module")
def cases():
    with imported(FOLDER, "cases") as (cases,):
        yield cases


def test_every_specification_is_one_and_has_every_drive(cases):
    files = {file.stem for file in FOLDER.glob("*.toml")}
    assert files == set(cases.FREE) | set(cases.STANDING) == set(cases.MODELS)
    for name in cases.STANDING:
        asked = cases.load(name)
        gains = expand(asked).values
        loops = cases.loops(asked, kp=gains["kp"], kd=gains["kd"])
        assert len(gains["kp"]) == 32 * 32 and len(loops) == 3 * 32 * 32
        np.testing.assert_array_equal(loops.values["kp"][: 32 * 32], gains["kp"])
        assert len(np.unique(loops.values["delay"])) == 2
    for name in cases.FREE:
        assert cases.load(name).duration == 0.1


@pytest.mark.exhaustive
def test_a_part_of_it_runs(tmp_path):
    command = [sys.executable, str(FOLDER / "run.py"), "--free", "slide", "--standing"]
    ran = subprocess.run(
        [*command, "--out", "out"],
        capture_output=True, text=True, cwd=tmp_path,
        env=os.environ | ENVIRONMENT | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    found = json.loads((tmp_path / "out" / "numbers.json").read_text())
    exact, rounded = found["motions"]
    assert (exact["precision"], rounded["precision"]) == ("float64", "float32")
    assert exact["apart"] < 1e-12 and 0.0 < rounded["apart"] < 1e-6
    assert exact["moved"] > 0.01 and found["maps"] == []
    page = (tmp_path / "out" / "README.md").read_text()
    assert page in ran.stdout and exact["description"] in page
