"""The page's mathematics: node's tests of it, among them one against Python on random loops."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from quickly import compiled_quickly as compiled_quickly
from random_loops import rows

FOLDER = Path(__file__).parent


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node to run the page's JavaScript")
@pytest.mark.parametrize(
    ("loops", "bounded", "stepped"),
    [(12, 1, 1), pytest.param(100, 5, 4, marks=pytest.mark.exhaustive)],
)
def test_the_page_computes_what_python_computes(tmp_path, loops, bounded, stepped):
    file = tmp_path / "loops.json"
    file.write_text(json.dumps(rows(loops, bounded=bounded, stepped=stepped)))
    ran = subprocess.run(
        ["node", "--test", str(FOLDER / "mathematics.test.mjs")],
        capture_output=True, text=True, env=os.environ | {"JAXACT_LOOPS": str(file)},
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout
    assert "# skipped 0" in ran.stdout
