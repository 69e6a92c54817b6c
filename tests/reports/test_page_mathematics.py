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
    "loops", [0, pytest.param(100, marks=pytest.mark.exhaustive)], ids=["alone", "random loops"]
)
def test_the_page_computes_what_python_computes(tmp_path, loops):
    file = tmp_path / "loops.json"
    if loops:
        file.write_text(json.dumps(rows(loops, bounded=5, stepped=4)))
    given = {"JAXACT_LOOPS": str(file) if loops else ""}
    ran = subprocess.run(
        ["node", "--test", str(FOLDER / "mathematics.test.mjs")],
        capture_output=True, text=True, env=os.environ | given,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout
    # Without random loops the three tests that compare them with Python are left out.
    assert f"# skipped {0 if loops else 3}" in ran.stdout
