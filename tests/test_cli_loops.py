"""The verbs that work on single loops, as a user types them: simulate, step, margins, pictures."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from robots import PENDULUM

import jaxact as jx
from jaxact.cli.main import main
from jaxact.loops import reading
from jaxact.verbs.naming import in_common, loop_name
from jaxact.verbs.responses import responses

CASES = {
    case["name"]: case
    for case in json.loads((Path(__file__).parent / "data" / "paper_loop.json").read_text())[
        "paper_cases"
    ]
}
KEYS = (
    "stable unstable_roots gain_margin phase_crossover phase_margin gain_crossover delay_margin "
    "sensitivity_peak sensitivity_peak_frequency complementary_peak complementary_peak_frequency "
    "modulus_margin disk_margin spectral_abscissa gain_reduction_margin log_gain_to_boundary"
).split()


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def _said(capsys, *arguments):
    assert main(list(arguments)) == 0
    return capsys.readouterr().out


def _mistake(capsys, *arguments):
    assert main(list(arguments)) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("jaxact: ") and said.err.count("\n") == 1
    assert not list(Path().iterdir())
    return said.err


NAMES = {
    "HyQ, delay 1.5 ms": {"delay": 0.001, "output_delay": 0.0005},
    "HyQ, delays as each joint has them": {"delay": math.nan},
    "ideal actuator, delay 0 ms": {"wn": math.inf, "zeta": math.nan},
    "actuators as each joint has them, delay 0 ms": {"wn": math.nan},
}


@pytest.mark.parametrize("name", NAMES)
def test_a_loop_is_called_by_what_is_known_of_it(name):
    """A robot's model may say of each joint what one number cannot."""
    specification = reading.parse('[parameters]\nactuator = "hyq"\n[axes]\nfeedforward = [0.0]\n')
    assert loop_name(specification, specification.nominal | NAMES[name]) == name


@pytest.mark.parametrize("actuator", ["ideal", "hyq", "starleth"])
def test_margins_equal_the_oracle(capsys, actuator):
    said = _said(
        capsys, "margins", "--actuator", actuator, "--delay", "0", "0.001", "0.005", "--json"
    )
    rows = [json.loads(line) for line in said.splitlines()]
    assert len(rows) == 3
    for row, milliseconds in zip(rows, (0, 1, 5), strict=True):
        case = CASES[f"{actuator} {milliseconds} ms"]
        assert set(KEYS) < set(row)
        assert row["stable"] is True and row["unstable_roots"] == 0
        names = {"phase_margin": "phase_margin_deg", "disk_margin": "disk_margin_balanced"}
        for name in ("gain_margin", "phase_margin", "gain_crossover", "delay_margin", "disk_margin",
                     "sensitivity_peak", "complementary_peak", "spectral_abscissa"):  # fmt: skip
            expected = case[names.get(name, name)]
            assert row[name] == (
                expected if expected == "inf" else pytest.approx(expected, rel=1e-8)
            )


@pytest.mark.exhaustive
def test_margins_of_an_unstable_loop_are_null(capsys):
    said = _said(capsys, "margins", "--actuator", "starleth", "--delay", "0.005", "--kp", "1200",
                 "--kd", "60", "--control-rate", "1000", "--json")  # fmt: skip
    row = json.loads(said)
    for figures in (row, row["sampled"]):
        assert figures["stable"] is False and figures["unstable_roots"] == 2
        assert figures["gain_margin"] is figures["disk_margin"] is figures["delay_margin"] is None
        assert figures["log_gain_to_boundary"] < 0 < figures["spectral_abscissa"]
    # tripled gains are beyond the boundary by as much as the gain margin is short of three
    expected = math.log(CASES["starleth 5 ms"]["gain_margin"] / 3.0)
    assert row["log_gain_to_boundary"] == pytest.approx(expected, rel=1e-8)


@pytest.mark.exhaustive
def test_margins_table_shows_both_kinds_side_by_side(capsys):
    said = _said(
        capsys, "margins", "--actuator", "starleth", "--delay", "5e-3", "--control-rate", "1000"
    )
    for words in ("continuous", "sampled", "2.402 (7.6 dB)", "10.41 ms", "in control periods",
                  "rightmost root", "guarantees gains"):  # fmt: skip
        assert words in said
    wide = _said(capsys, "margins", "--kp", "100", "200", "400", "800", "1600")
    assert len([line for line in wide.splitlines() if line.startswith(" kp")]) == 5


def test_a_delay_longer_than_a_loop_keeps_is_refused_in_a_file_of_loops_too(capsys, tmp_path):
    path = tmp_path.parent / "late.toml"
    path.write_text("[[loop]]\nkp = 1\n[[loop]]\nkp = 1\ndelay = 10\ncontrol_rate = 1e6\n")
    said = _mistake(capsys, "margins", "--loops", str(path))
    assert "late.toml: loop[1]: delay = 10: a loop's history holds 4096 control periods" in said


@pytest.mark.exhaustive
def test_margins_of_a_file_of_loops(capsys, tmp_path):
    rows = [f'[[loop]]\nname = "loop {i}"\nkp = {100 + i}\nactuator = "hyq"' for i in range(1500)]
    Path("loops.toml").write_text("\n".join(rows))
    said = _said(capsys, "margins", "--loops", "loops.toml", "--delay", "0.001", "--json",
                 "--csv", "out.csv", "--store", "out.zarr")  # fmt: skip
    found = [json.loads(line) for line in said.splitlines()]
    assert len(found) == 1500 and found[7]["loop"]["name"] == "loop 7"
    assert found[300]["gain_margin"] == pytest.approx(CASES["hyq 1 ms"]["gain_margin"], rel=1e-8)
    with open("out.csv") as file:
        table = list(csv.DictReader(file))
    assert float(table[300]["gain_margin"]) == found[300]["gain_margin"]
    assert table[300]["name"] == "loop 300" and float(table[300]["kp"]) == 400.0
    import xarray

    store = xarray.open_zarr("out.zarr")
    assert float(store["gain_margin"][300]) == found[300]["gain_margin"]
    assert store["delay_margin"].attrs["units"] == "s"


def test_margins_of_a_sweeps_specification(capsys):
    Path("spec.toml").write_text('[axes]\nactuator = ["hyq", "starleth"]\ndelay = [0.0, 0.001]\n')
    said = _said(capsys, "margins", "--loops", "spec.toml", "--json")
    names = [json.loads(line)["loop"]["name"] for line in said.splitlines()]
    assert names == [
        "HyQ, delay 0 ms", "HyQ, delay 1 ms", "StarLETH, delay 0 ms", "StarLETH, delay 1 ms"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["margins", "--mass", "0"], "--mass = 0.0 is out of range"),
        (["margins", "--kp"], "give at least one value"),
        (["margins", "--kp", "1", "1"], "more than once"),
        (["margins", "--actuator", "hyk"], "did you mean 'hyq'?"),
        (["margins", "--actuator", "hyq", "--wn", "100"], "preset sets it already"),
        (["margins", "--loops", "nothing.toml"], "nothing.toml: cannot be read"),
        (["margins", "--velocity", "guessed"], "allowed: sampled, differenced"),
        (["margins", "--csv", "table.txt"], "must end in .csv"),
        (["margins", "--csv", "nowhere/table.csv"], "does not exist"),
        (["margins", "--control-rate", "0"], "--control-rate = 0.0 is out of range"),
        (["margins", "--control-rate", "1000", "--delay", "0", "5"], "4096 control periods"),
        (["tune", "--control-rate", "1000", "--delay", "5"], "4096 control periods"),
        (["bode", "--kp", *map(str, range(1, 20))], "too many for one picture"),
        (["bode", "--out", "bode.jpg"], "not a picture format"),
        (["nyquist", "--delay", "-1"], "--delay = -1.0 is out of range"),
        (["sensitivity", "--zeta", "0"], "--zeta = 0.0 is out of range"),
        (["step", "--duration", "0"], "duration = 0.0"),
        (["step", "--engine", "bullet"], "allowed: mass, mjx"),
        (["step", "--kp", *map(str, range(1, 20))], "too many for one picture"),
        (["simulate", "--mass", "-1"], "--mass = -1.0 is out of range"),
        (["simulate", "--duration", "1e4"], "can be kept"),
        (["simulate", "--csv", "run.txt"], "must end in .csv"),
        (["simulate", "--npz", "nowhere/run.npz"], "does not exist"),
        (["simulate", "--set", "kp=3"], "give one with --spec"),
        (["simulate", "--spec", "nothing.toml"], "no such file"),
        (
            ["simulate", "--engine", "mjx", "--model", "nothing.xml"],
            "jaxact: --model = 'nothing.xml': no such file\n",
        ),
        (["simulate", "--engine", "foo"], "engine = 'foo'; allowed: mass, mjx\n"),
        (["simulate", "--joint", "3"], "the driven joints are joint"),
        (["simulate", "--seed", "-1"], "seed = -1"),
        (["simulate", "--velocity", "guessed"], "allowed: sampled, differenced"),
        (["margins", "--stiffness", "300"], "did you mean `--kp`"),
    ],
)
def test_a_mistake_is_one_line_and_writes_nothing(capsys, arguments, message):
    assert message in _mistake(capsys, *arguments)


@pytest.mark.parametrize(
    "arguments",
    [
        ("simulate", "--engine", "foo"),
        ("simulate", "--set", "engine=foo"),
        ("simulate", "--set", 'engine = "foo"'),
        ("render", "--engine", "foo"),
    ],
)
def test_an_unknown_engine_is_answered_with_those_that_simulate_a_robot(
    capsys, tmp_path_factory, arguments
):
    verb, *options = arguments
    model = tmp_path_factory.mktemp("robot") / "arm.xml"
    model.write_text(PENDULUM)
    said = _mistake(capsys, verb, "--model", str(model), *options)
    assert said == "jaxact: engine = 'foo'; allowed: mjx, mujoco, warp, auto\n"


def test_a_scale_of_the_gains_makes_other_loops():
    scale = np.array([1.0, 2.0, 4.0])
    own = {"actuator": "starleth", "delay": 1e-3}
    scaled = responses(jx.joint(gain_scale=scale, kp=400, kd=20, **own), sampled=False)
    gains = jx.joint(kp=400 * scale, kd=20 * scale, **own)
    wanted = responses(gains, sampled=False)
    assert len(scaled) == len(wanted) == 3
    for one, other in zip(scaled, wanted, strict=True):
        np.testing.assert_array_equal(one.frequency, other.frequency)
        np.testing.assert_allclose(one.open_loop, other.open_loop, rtol=1e-12)
        assert one.stable == other.stable
    assert [curve.stable for curve in scaled] == [True, True, False]


def test_gains_are_said_with_their_scale():
    said = in_common(jx.joint(gain_scale=2.0, kp=400, kd=20, actuator="starleth"))
    assert "kp 400 N/m, kd 20 N s/m" in said and "gain scale 2" in said
    assert "scale" not in in_common(jx.joint(actuator="starleth"))


def test_the_control_rate_is_said_of_loops_that_are_simulated():
    loop = jx.joint(actuator="starleth", control_rate=500.0)
    assert "control at 500 Hz" in in_common(loop, simulated=True)
    assert "500" not in in_common(loop)
    rates = jx.joint(actuator="starleth", control_rate=[500.0, 1000.0])
    assert "control at" not in in_common(rates, simulated=True)


@pytest.mark.exhaustive
@pytest.mark.parametrize("verb", ["bode", "nyquist", "sensitivity"])
def test_pictures_of_several_loops(capsys, verb):
    said = _said(capsys, verb, "--actuator", "hyq", "starleth", "--delay", "0.005", "--kp", "400",
                 "1200", "--kd", "60", "--control-rate", "1000", "--out",
                 f"{verb}.svg")  # fmt: skip
    assert said == f"wrote {verb}.svg\n"
    text = Path(f"{verb}.svg").read_text()
    assert "StarLETH" in text and "sampled at 1 kHz" in text and "unstable" in text


def test_curves_of_one_picture_end_together():
    """An ideal actuator without delay has no high frequency of its own to end at."""
    loops = jx.joint(actuator=["ideal", "starleth"], delay=[[0.0], [0.004]])
    drawn = responses(loops, sampled=False)
    ends = {(curve.frequency[0], curve.frequency[-1]) for curve in drawn}
    assert len(drawn) == 4 and len(ends) == 1 and ends.pop()[1] >= 3.0 / 0.004


@pytest.mark.exhaustive
def test_step_responses(capsys):
    said = _said(capsys, "step", "--actuator", "hyq", "starleth", "--delay", "0.005", "--kp", "400",
                 "--kd", "20", "400", "--duration", "0.2", "--out", "step.pdf")  # fmt: skip
    assert "StarLETH, kd 20 N s/m: overshoot" in said and "kd 400 N s/m: unstable" in said
    assert Path("step.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.exhaustive
def test_a_step_that_diverges_has_a_verdict_and_no_times(capsys):
    said = _said(capsys, "step", "--kp", "400", "1e5", "--kd", "20", "--actuator", "starleth",
                 "--delay", "0.005", "--duration", "0.2", "--out", "step.png")  # fmt: skip
    lines = said.splitlines()
    assert lines[0].startswith("kp 400 N/m: overshoot") and "rise time" in lines[0]
    assert lines[1] == "kp 1e+05 N/m: unstable"
    lost = _said(capsys, "simulate", "--kp", "1e5", "--kd", "20", "--actuator", "starleth",
                 "--delay", "0.005", "--duration", "0.2")  # fmt: skip
    assert "unstable" in lost and "rise time" not in lost


@pytest.mark.exhaustive
def test_simulate_writes_picture_and_numbers(capsys):
    arguments = ["simulate", "--actuator", "starleth", "--delay", "0.005", "--csv", "run.csv",
                 "--npz", "run.npz", "--duration", "0.2"]  # fmt: skip
    said = _said(capsys, *arguments)
    assert (
        "verdict" in said and "stable" in said and "wrote simulation.png, run.csv, run.npz" in said
    )
    with open("run.csv") as file:
        rows = list(csv.DictReader(file))
    with np.load("run.npz") as file:
        arrays = dict(file)
    assert len(rows) == 200 and arrays["position"].shape == (200, 1)
    column = [float(row["position [m]"]) for row in rows]
    np.testing.assert_allclose(column, arrays["position"][:, 0], rtol=1e-8)
    assert json.loads(str(arrays["parameters"]))["delay"] == 0.005
    assert "overshoot" in said
    assert "exists" in _again(capsys, arguments)
    lost = _said(capsys, *arguments, "--kd", "400", "--overwrite")
    assert "unstable" in lost and "overshoot" not in lost and "time" not in lost
    assert main([*arguments, "--overwrite", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["verdict"] == "stable" and figures["parameters"]["wn"] == 110.0


def _again(capsys, arguments):
    before = {path: path.read_bytes() for path in Path().iterdir()}
    assert main(arguments) == 2
    assert {path: path.read_bytes() for path in Path().iterdir()} == before
    return capsys.readouterr().err


@pytest.mark.exhaustive
def test_simulate_takes_a_specification_then_set_then_options(capsys):
    Path("spec.toml").write_text(
        'duration = 0.1\n[parameters]\nactuator = "hyq"\nkp = 300\n[axes]\nkd = [10, 20]\n'
    )
    said = _said(
        capsys, "simulate", "--spec", "spec.toml", "--set", "kp=500", "--wn", "200", "--json"
    )
    own = json.loads(said)["parameters"]
    assert (own["kp"], own["kd"], own["wn"], own["zeta"]) == (500.0, 20.0, 200.0, 0.45)
    said = _said(capsys, "simulate", "--spec", "spec.toml", "--actuator", "starleth", "--json")
    assert json.loads(said)["parameters"]["wn"] == 110.0


@pytest.mark.parametrize("verb", ["simulate", "step", "margins", "bode", "nyquist", "sensitivity"])
def test_help_names_units_examples_and_defaults(capsys, verb):
    with pytest.raises(SystemExit) as leaving:
        main([verb, "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert leaving.value.code == 0
    assert "examples:" in said and "[N/m]" in said and "(default: 400)" in said


LOOP = ("--mass", "0.02", "--wn", "300", "--zeta", "0.7", "--delay", "0.002", "--kp", "80",
        "--kd", "1.5")  # fmt: skip


@pytest.mark.exhaustive
def test_margins_know_of_the_filter_in_continuous_time_and_sampled(capsys):
    filtered = ("--velocity", "differenced", "--velocity-filter", "300", "inf")
    said = _said(capsys, "margins", *LOOP, *filtered, "--control-rate", "2000", "--json")
    rows = [json.loads(line) for line in said.splitlines()]
    assert [row["loop"]["velocity_filter"] for row in rows] == [300.0, "inf"]
    gain = [row["gain_margin"] for row in rows]
    assert gain == pytest.approx([1.384931, 2.438635], rel=1e-6)
    # Slower sampling only takes from it: 0.25 ms of hold, 0.25 ms of differencing.
    sampled = [row["sampled"]["gain_margin"] for row in rows]
    assert 0.8 * gain[0] < sampled[0] < gain[0] and 0.7 * gain[1] < sampled[1] < gain[1]


FILTER = 'velocity = "differenced"\n[axes]\nvelocity_filter = [300.0]\n'


@pytest.mark.exhaustive
def test_a_file_says_which_velocity_and_what_linear_loops_leave_out(capsys, tmp_path):
    file = tmp_path / "sweep.toml"
    file.write_text(f"{FILTER}control_rate = [2000]\n[parameters]\nforce_limit = 9\n")
    assert main(["margins", *("--loops", str(file)), "--json"]) == 0
    said = capsys.readouterr()
    assert "linear loops are without force_limit" in said.err and said.err.count("\n") == 1
    row = json.loads(said.out)
    same = ("--velocity", "differenced", "--velocity-filter", "300", "--control-rate", "2000")
    typed = json.loads(_said(capsys, "margins", *same, "--json"))
    assert row["sampled"] == typed["sampled"] and row["gain_margin"] == typed["gain_margin"]
    file.write_text("[[loop]]\nvelocity_filter = 300\n")
    file.rename(tmp_path.parent / "loops.toml")
    loops = str(tmp_path.parent / "loops.toml")
    said = _mistake(capsys, "margins", "--loops", loops)
    assert 'allowed: with velocity "differenced"' in said
    assert "Mt" in _said(capsys, "margins", "--loops", loops, "--velocity", "differenced")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("margins", "--velocity-filter", "300"), "--velocity-filter: filters differenced"),
        (("bode", "--velocity-filter", "300", "--control-rate", "1000"), "--velocity-filter:"),
        (("simulate", "--velocity-filter", "300"), "--velocity-filter: filters differenced"),
        (("step", "--velocity-filter", "300"), "--velocity-filter: filters differenced"),
        (("tune", "--velocity-filter", "300"), "--velocity-filter: filters differenced"),
        (("simulate", "--velocity", "differenced", "--velocity-noise", "0.1"), "--velocity-noise:"),
        (("margins", "--velocity", "differenced"), "--velocity differenced: has no effect"),
        (("tune", "--velocity", "differenced"), "--velocity differenced: has no effect"),
    ],
)  # fmt: skip
def test_what_the_velocity_does_not_have_is_refused_by_name(capsys, arguments, message):
    assert message in _mistake(capsys, *arguments)


@pytest.mark.exhaustive
def test_margins_of_a_specification_are_a_map_to_plot(capsys):
    Path("s.toml").write_text(
        "[parameters]\nkp = 800\nkd = 40\nzeta = 0.9\ncontrol_rate = 500\n[axes]\n"
        "wn = { min = 50, max = 1000, num = 4, spacing = 'log' }\n"
        "delay = { min = 0, max = 0.02, num = 3 }\n"
    )
    said = _said(capsys, "margins", "--loops", "s.toml", "--store", "m.zarr", "--json")
    rows = [json.loads(line) for line in said.splitlines()]
    import xarray

    store = xarray.open_zarr("m.zarr")
    assert store["gain_margin"].dims == ("wn", "delay") and store.sizes == {"wn": 4, "delay": 3}
    for index, row in enumerate(rows):
        place = dict(zip(("wn", "delay"), divmod(index, 3), strict=True))
        here = store.isel(place)
        assert (
            float(here["wn"]) == row["loop"]["wn"] and float(here["delay"]) == row["loop"]["delay"]
        )
        assert (int(here["verdict"]) == 0) == row["sampled"]["stable"]
        expected = row["sampled"]["sensitivity_peak"]
        found = float(here["sampled_sensitivity_peak"])
        assert math.isnan(found) if expected is None else found == expected
    for variable in ("sampled_delay_margin", "growth_rate"):
        said = _said(capsys, "plot", "m.zarr", "--variable", variable, "--out", "map.png")
        assert "Exact margins, sampled, control at 500 Hz" in said


@pytest.mark.exhaustive
def test_a_store_of_margins_has_the_velocity_that_they_are_of(capsys):
    Path("s.toml").write_text(
        '[parameters]\nactuator = "starleth"\ncontrol_rate = 200.0\n[axes]\nkp = [100.0, 400.0]\n'
    )
    _said(capsys, "margins", "--loops", "s.toml", "--velocity", "differenced", "--store", "m.zarr")
    import xarray

    store = xarray.open_zarr("m.zarr")
    assert reading.parse(store.attrs["specification_toml"]).velocity == "differenced"
    own = jx.joint(kp=[100.0, 400.0], actuator="starleth", control_rate=200, velocity="differenced")
    found = jx.margins(own, sampled=True).sensitivity_peak
    np.testing.assert_allclose(store["sampled_sensitivity_peak"], found)
