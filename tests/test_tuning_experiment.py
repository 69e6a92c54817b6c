"""The experiment that tunes the quadruped runs, and writes what its page shows."""

import json
import sys
from pathlib import Path

import pytest
from experiment_modules import imported
from quickly import compiled_quickly as compiled_quickly

FOLDER = Path(__file__).resolve().parent.parent / "experiments" / "tuning"


@pytest.mark.exhaustive
def test_it_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["quadruped.py", "--quick", "--out", str(tmp_path)])
    monkeypatch.setattr(sys, "path", list(sys.path))
    with imported(FOLDER, "quadruped") as (experiment,):
        experiment.main()
    page = (tmp_path / "README.md").read_text()
    found = json.loads((tmp_path / "quadruped.json").read_text())
    assert found["verdict"] in page and "wrote" in capsys.readouterr().out
    for name in ("sensitivity.png", "gains.png", "convergence.png"):
        assert name in page and (tmp_path / name).stat().st_size > 1000
    assert (tmp_path / "gains.toml").is_file() and (tmp_path / "gains.xml").is_file()
