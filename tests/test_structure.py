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


def test_the_names_of_test_files_are_unique():
    """Pytest imports tests by their bare name: of two alike, one is not collected."""
    names = [path.name for path in Path(__file__).parent.rglob("test_*.py")]
    assert sorted(names) == sorted(set(names))
