"""How the package is put together: the bounds that the scripts under `tools/` count."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from quickly import ENVIRONMENT

TOOLS = Path(__file__).resolve().parent.parent / "tools"


@pytest.mark.parametrize(
    "tool", ["counts.py", pytest.param("walks.py", marks=pytest.mark.exhaustive)]
)
def test_the_structure_keeps_its_bounds(tool):
    done = subprocess.run(
        [sys.executable, str(TOOLS / tool)],
        env={**os.environ, **ENVIRONMENT},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
