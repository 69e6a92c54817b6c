"""`jaxact plot` as a user types it."""

import json

import pytest
from quickly import compiled_quickly as compiled_quickly
from synthetic_store import DRAWN, GRID, write

from jaxact.cli.main import main
from jaxact.plotting.panels import arrange
from jaxact.sweeping import opening
from jaxact.verbs.map_lines import nominal


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return write(tmp_path_factory.mktemp("grid"), GRID)


def test_draws_the_map_beside_the_store_and_says_so(results, capsys):
    assert main(["plot", str(results)]) == 0
    said = capsys.readouterr().out
    assert "No verdict differs from the exact stability" in said
    assert f"wrote {results / 'stability_map.png'}" in said
    assert (results / "stability_map.png").stat().st_size > 50_000


def test_replaces_a_picture_and_takes_the_store_itself(results, tmp_path, capsys):
    out = tmp_path / "map.svg"
    out.write_text("old")
    store = str(results / "sweep.zarr")
    assert main(["plot", store, "--out", str(out), "--quick", "--select", "actuator=hyq"]) == 0
    assert "stiffness kp" in out.read_text()
    assert "HyQ (800 rad/s, ζ 0.45)" in capsys.readouterr().out


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "options",
    [
        ["--kind", "lines", "--x", "kd", "--y", "delay", "--select", "kp=400"],
        ["--variable", "overshoot", "--facet", "delay", "actuator"],
        ["--x", "kd", "--y", "kp", "--nominal", "20", "400", "--title", "turned"],
        ["--x", "actuator", "--y", "delay", "--select", "kp=400", "--select", "kd=20"],
    ],
)
def test_other_pictures(results, tmp_path, options):
    out = tmp_path / "picture.pdf"
    assert main(["plot", str(results), "--out", str(out), "--quick", *options]) == 0
    assert out.read_bytes().startswith(b"%PDF")


def test_default_gains_are_marked_for_the_mass_they_are_of_only(results):
    """400 N/m and 20 N s/m are the reference study's, for 0.7 kg."""
    found = opening.load_result(str(results)).load()
    arrangement = arrange(found, select={"delay": "0", "actuator": "hyq"})
    assert nominal(found, arrangement, ()) == (400.0, 20.0)
    found.attrs["parameters"] = json.dumps(json.loads(found.attrs["parameters"]) | {"mass": 0.02})
    assert nominal(found, arrangement, ()) is None
    assert nominal(found, arrangement, (80.0, 1.5)) == (80.0, 1.5)


def test_random_sample(tmp_path, capsys):
    folder = write(tmp_path / "drawn", DRAWN)
    assert main(["plot", str(folder)]) == 0
    assert (folder / "growth_rate_scatter.png").exists()
    assert "without its force limit" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--x", "kpp"], "did you mean 'kp'?"),
        (["--variable", "overshot"], "did you mean 'overshoot'?"),
        (["--facet", "dely"], "did you mean 'delay'?"),
        (["--x", "mass"], "unknown axis 'mass'"),
        (["--select", "delay"], "NAME=VALUE"),
        (["--select", "delay=0", "--x", "delay"], "single value 0 ms"),
        (["--select", "delay=7"], "7 s is outside its axis, which goes from 0 to 0.005 s"),
        (["--out", "map.jpg"], "'.jpg' is not a picture format"),
        (["--out", "map"], "no ending"),
        (["--out", "nowhere/map.png"], "the folder nowhere does not exist"),
        (["--kind", "pie"], "pie"),
        (["--nominal", "1"], "nominal"),
    ],
)
def test_a_mistake_is_one_line_and_writes_nothing(results, tmp_path, monkeypatch, capsys, options,
                                                  message):  # fmt: skip
    monkeypatch.chdir(tmp_path)
    before = sorted(results.iterdir())
    assert main(["plot", str(results), *options]) == 2
    said = capsys.readouterr()
    assert said.out == "" and message in said.err
    assert said.err.startswith("jaxact: ") and said.err.count("\n") == 1
    assert sorted(results.iterdir()) == before and not list(tmp_path.iterdir())


def test_missing_and_foreign_results(tmp_path, capsys):
    assert main(["plot", str(tmp_path / "nothing")]) == 2
    assert "no such result" in capsys.readouterr().err
    assert main(["plot", str(tmp_path)]) == 2
    assert "is not a result of a sweep" in capsys.readouterr().err


def test_help_names_units_and_examples(capsys):
    with pytest.raises(SystemExit) as leaving:
        main(["plot", "--help"])
    said = capsys.readouterr().out
    assert leaving.value.code == 0
    assert "examples:" in said and "kp [N/m]" in said and "is replaced" in " ".join(said.split())
