"""`jaxact tune` as a user types it."""

import json
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.cli.main import main

STARLETH = ["tune", "--no-cache", "--mass", "0.7", "--actuator", "starleth"]
# With a start of one's own as many as without one, so that nothing is compiled anew.
START = ["--kp", "400", "--kd", "20", "--starts", "7"]


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def _said(capsys, *arguments):
    assert main(list(arguments)) == 0
    return capsys.readouterr().out


@pytest.mark.exhaustive
def test_the_stiffest_gains_as_json(capsys):
    row = json.loads(_said(capsys, *STARLETH, "--delay", "1e-3", "--max-peak", "1.6", *START,
                           "--json"))  # fmt: skip
    assert row["kp"] == pytest.approx(184.754, rel=1e-3) and row["certified"] is True
    assert row["objective"] == row["kp"]
    assert row["margins"]["before"]["sensitivity_peak"] == pytest.approx(2.307, rel=1e-3)
    assert row["margins"]["after"]["sensitivity_peak"] <= 1.6 * (1 + 1e-9)
    assert row["iterations"] > 0 and row["seconds"] > 0 and row["feasible"] is True
    assert not list(Path().iterdir())


@pytest.mark.exhaustive
def test_a_folder_of_gains_and_pictures(capsys):
    said = _said(capsys, *STARLETH, "--delay", "1e-3", *START, "--pareto", "4",
                 "--joint", "knee", "--out", "tuned")  # fmt: skip
    names = {path.name for path in Path("tuned").iterdir()}
    assert names == {"gains.toml", "gains.xml", "stability_map.png", "sensitivity.png",
                     "convergence.png", "step.png", "front.png", "front.csv"}  # fmt: skip
    assert "certified: every constraint holds" in said and "wrote tuned" in said
    document = tomllib.loads(Path("tuned/gains.toml").read_text())
    assert document["guaranteed"]["certified"] is True
    assert document["asked"] == {"max_peak": 1.6} and document["versions"]["jaxact"]
    position = ET.parse("tuned/gains.xml").getroot().find("actuator/position")
    assert position.get("joint") == "knee"
    assert float(position.get("kp")) == document["gains"]["kp"]
    assert float(position.get("kv")) == document["gains"]["kd"]
    assert len(Path("tuned/front.csv").read_text().splitlines()) == 5
    assert main([*STARLETH, "--delay", "1e-3", "--out", "tuned"]) == 2


@pytest.mark.exhaustive
def test_an_uncertain_actuator_names_what_binds(capsys):
    row = json.loads(_said(capsys, *STARLETH, "--delay", "1e-3", "--uncertainty",
                           "wn=0.8..1.2,delay=0..5e-3", "--ensemble", "8", "--json"))  # fmt: skip
    assert row["certified"] and row["corners"] == 4 and row["worst_interior_excess"] <= 1e-10
    assert any("corner wn- delay+" in name for name in row["binding"])
    assert row["margins"]["before"] is None


@pytest.mark.exhaustive
def test_what_cannot_be_met_is_a_result(capsys):
    with pytest.raises(SystemExit) as left:
        main([*STARLETH, "--delay", "5e-3", "--min-kp", "400", "--json"])
    row = json.loads(capsys.readouterr().out)
    assert left.value.code == 1 and "does not prove" in row["verdict"]
    assert row["certified"] is row["feasible"] is False
    assert "infeasible" in row["verdict"] and "2.976" in row["verdict"]


@pytest.mark.exhaustive
def test_tracking_a_file(capsys):
    lines = [f"{0.01 * i},{0.1 * min(i / 20, 1.0)}" for i in range(60)]
    Path("path.csv").write_text("# time, setpoint\n" + "\n".join(lines))
    row = json.loads(_said(capsys, *STARLETH, "--delay", "1e-3", "--objective", "tracking:path.csv",
                           "--steps", "40", "--json"))  # fmt: skip
    assert row["certified"] and 0 < row["objective"] < 0.1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--max-peak", "0.9"], "--max-peak 0.9"),
        (["--objective", "speed"], "objective 'speed'"),
        (["--objective", "tracking:nowhere.csv"], "nowhere.csv"),
        (["--objective", "bandwidth:x"], "only tracking"),
        (["--risk", "often"], "risk 'often'"),
        (["--uncertainty", "wn=1"], "--uncertainty"),
        (["--uncertainty", "masss=1..2"], "did you mean 'mass'"),
        (["--kp", "400"], "--kd"),
        (["--kp", "-1", "--kd", "2"], "--kp"),
        (["--starts", "0"], "--starts"),
        (["--seed", "-1"], "--seed -1"),
        (["--ensemble", "4"], "--ensemble 4: nothing is uncertain; give --uncertainty"),
        (["--uncertainty", "mass=0.7..0.7", "--ensemble", "4"], "--ensemble 4: nothing"),
        (["--min-disk-margin", "2"], "--min-disk-margin 2"),
        (["--pareto", "1"], "--pareto"),
        (["--min-kp", "5", "--max-kp", "4"], "above"),
        (["--mass", "-1"], "--mass"),
        (["--out", "nowhere/there"], "does not exist"),
        (["--velocity", "seen"], "--velocity"),
        (["--actuator", "ideal"], "nothing limits"),
        (["--max-peak", "nan"], "nan"),
    ],
)
def test_mistakes_are_one_line(capsys, arguments, said):
    assert main(["tune", "--no-cache", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("jaxact: ") and error.count("\n") == 1 and said in error
    assert not list(Path().iterdir())


def test_help_names_units_examples_and_defaults(capsys):
    with pytest.raises(SystemExit) as leaving:
        main(["tune", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert leaving.value.code == 0 and "examples:" in said and "[N/m]" in said
