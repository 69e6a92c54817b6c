"""A drive over a log, against logs that something else simulated."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from scipy.linalg import expm

import jaxact as jx
from jaxact.cli.main import main
from jaxact.errors import UserError
from jaxact.identification.log import Log

TICK = 1e-3
BENCH = """
plant = "none"
unit = "rad"
loop = [{ wn = 110.0, zeta = 0.9, delay = 0.002, control_rate = 1000.0 }]
[estimates]
[numbers]
gain = 0.8
offset = 0.1
wn = 110.0
zeta = 0.9
delay = 0.002
"""
MASS = """
plant = "mass"
unit = "m"
loop = [{ delay = 0.002, mass = 0.7, joint_damping = 3.0, kp = 400.0, kd = 20.0 }]
[estimates]
[numbers]
inertia = 0.7
viscous = 3.0
delay = 0.002
"""


def _force():
    """A log of the force loop, by the matrix exponential."""
    command = np.repeat(np.random.default_rng(1).normal(size=100), 5)
    matrix = np.zeros((3, 3))
    matrix[0, 1], matrix[1] = 1.0, [-(110.0**2), -2.0 * 0.9 * 110.0, 110.0**2]
    over = expm(matrix * TICK)
    late = np.concatenate([[command[0]] * 2, command])
    state, force = np.array([0.8 * command[0], 0.0]), np.empty(500)
    for row in range(500):
        force[row] = state[0] + 0.1
        state = over[:2, :2] @ state + over[:2, 2] * 0.8 * late[row]
    return Log("bench", np.arange(500) * TICK, {"command": command, "force": force})


def _motion(kp=400.0, kd=20.0):
    """A log of a mass with viscous friction under PD control, two ticks late, in closed form."""
    setpoint = np.repeat(np.random.default_rng(2).normal(size=50) * 1e-2, 10)
    decay = np.exp(-3.0 / 0.7 * TICK)
    commands, position, velocity = [0.0, 0.0], 0.0, 0.0
    places = np.empty(500)
    for row in range(500):
        places[row] = position
        commands.append(kp * (setpoint[row] - position) - kd * velocity)
        end = commands[row] / 3.0
        position += end * TICK + (velocity - end) * 0.7 / 3.0 * (1.0 - decay)
        velocity = end + (velocity - end) * decay
    signals = {"setpoint": setpoint, "position": places, "command": np.array(commands[2:])}
    return Log("slide", np.arange(500) * TICK, signals, unit="m", gains=(kp, kd))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    (tmp_path / "bench.toml").write_text(BENCH)
    (tmp_path / "mass.toml").write_text(MASS)
    for name, log in (("bench", _force()), ("slide", _motion())):
        rows = np.stack([log.time, *log.signals.values()], axis=1)
        head = ",".join(["time", *log.signals])
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header=head, comments="")
    (tmp_path / "slide.toml").write_text(
        'unit = "m"\nsetpoint = "setpoint"\nposition = "position"\ncommand = "command"\n'
        "kp = 400.0\nkd = 20.0\n"
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_force_loop_follows_the_commands_of_its_log():
    found = jx.replay("bench.toml", _force())
    assert found.driven_by == "command" and found.unit == "N m"
    assert found.largest < 1e-9
    slower = jx.replay("bench.toml", _force(), wn=60.0)
    assert slower.nrmse > 0.05
    assert slower.rms == pytest.approx(np.sqrt(np.mean(slower.rest**2)))


def test_a_force_goes_with_the_supply_and_is_none_where_the_drive_is_off():
    """Commands that make up for both leave the force as it was."""
    log = _force()
    supply = np.linspace(24.0, 16.0, 500)
    signals = {**log.signals, "command": log["command"] * 20.0 / supply, "supply": supply}
    sinking = replace(log, signals=signals, details={"usual_supply": 20.0})
    assert jx.replay("bench.toml", sinking).largest < 1e-9
    late = np.arange(500) >= 400
    off = {**log.signals, "command": np.where(late, 7.0, log["command"]), "powered": 1.0 - late}
    quiet = jx.replay("bench.toml", replace(log, signals=off)).simulated
    assert np.ptp(quiet[490:]) < 1e-3 and quiet[-1] == pytest.approx(0.1, abs=1e-3)


@pytest.mark.exhaustive
def test_a_joint_follows_setpoints_under_the_gains_of_its_log():
    found = jx.replay("mass.toml", _motion())
    assert found.driven_by == "setpoint" and found.largest < 1e-6 * np.ptp(found.measured)
    other = jx.replay("mass.toml", _motion(kp=200.0), kp=200.0)
    assert other.largest < 1e-6 * np.ptp(other.measured)
    assert jx.replay("mass.toml", _motion(), mass=0.9).nrmse > 0.01


@pytest.mark.exhaustive
def test_a_joint_follows_recorded_commands():
    log = _motion()
    told = Log("told", log.time, {k: log[k] for k in ("position", "command")}, unit="m")
    found = jx.replay("mass.toml", told)
    # But for the two commands that were on their way when the log began.
    assert found.driven_by == "command" and found.largest < 1e-3 * np.ptp(found.measured)


def test_gains_that_the_log_does_not_know_are_the_drives():
    log = _motion()
    told = Log("told", log.time, {k: log[k] for k in ("position", "setpoint")}, unit="m")
    assert jx.replay("mass.toml", told).largest < 1e-6 * np.ptp(log["position"])


@pytest.mark.exhaustive
def test_a_delay_longer_than_the_fit_would_look_for_is_kept():
    """A delay of thirty ticks does to commands thirty ticks early what two do to those in time."""
    log = _motion()
    early = np.roll(log["command"], -28)
    signals = {"position": log["position"][30:450], "command": early[30:450]}
    late = Log("late", log.time[30:450], signals, unit="m")
    found = jx.replay("mass.toml", late, delay=0.03)
    # Until the first command arrives none is known; from then on they are those of the log.
    speed = np.diff(found.simulated[31:]) - np.diff(log["position"][61:450])
    np.testing.assert_allclose(speed[1:] / speed[:-1], np.exp(-3.0 / 0.7 * TICK), rtol=1e-6)


def test_the_command_writes_picture_columns_and_errors(folder, capsys):
    given = ["simulate", "--drive", "mass.toml", "--replay", "slide.csv", "--map", "slide.toml"]
    assert main([*given, "--csv", "rows.csv", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["driven_by"] == "setpoint" and found["nrmse"] < 1e-6 and found["rows"] == 500
    assert (folder / "simulation.png").stat().st_size > 10_000
    with open("rows.csv") as file:
        rows = list(csv.DictReader(file))
    rest = np.array([float(row["residual [m]"]) for row in rows])
    assert np.max(np.abs(rest)) == pytest.approx(found["max"], rel=1e-6)
    assert main(given) == 0
    assert "position for the log's setpoint, 500 rows" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--replay", "bench.csv"], "--replay: needs an identified drive"),
        (["--map", "slide.toml"], "--map: says what the columns of a log are"),
        (["--drive", "bench.toml", "--replay", "none.csv"], "none.csv: no such file"),
        (["--drive", "bench.toml", "--replay", "bench.csv", "--kp", "1"], "--kp: changes nothing"),
        (["--drive", "bench.toml", "--replay", "bench.csv", "--engine", "mjx"], "--engine: is not"),
        (
            ["--drive", "bench.toml", "--replay", "bench.csv", "--duration", "3"],
            "--duration: is not",
        ),
        (["--drive", "mass.toml", "--replay", "bench.csv"], "is in rad, and mass.toml in m"),
    ],
)
def test_what_does_not_fit_is_one_line_and_writes_nothing(folder, capsys, options, said):
    assert main(["simulate", *options]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not list(folder.glob("*.png"))


def test_a_log_with_time_missing_is_replayed_in_parts():
    log = _force()
    kept = np.r_[0:230, 270:500]
    gap = replace(log, time=log.time[kept], signals={n: v[kept] for n, v in log.signals.items()})
    found = jx.replay("bench.toml", gap)
    # Until the first commands after the gap have arrived, those before it are not known.
    assert len(found.rest) == len(found.log) == 460
    assert np.max(np.abs(np.delete(found.rest, np.r_[230:330]))) < 1e-3
    assert found.log.notes[0].startswith("time is missing: its rows 2 to 231; 232 to 461 are")
    assert found.log.notes[0] in str(found) and found.document()["notes"] == list(found.log.notes)


def test_a_force_that_is_new_once_in_five_rows_lies_on_lines_between():
    log = _force()
    held = log["force"][np.arange(500) // 5 * 5]
    found = jx.replay("bench.toml", replace(log, signals={**log.signals, "force": held}))
    assert "force is new once in 5 rows" in str(found)
    assert found.rms < 0.3 * np.sqrt(np.mean((held - log["force"]) ** 2))


def test_a_log_without_gains_or_command_says_what_is_missing():
    log = _motion()
    told = Log("told", log.time, {k: log[k] for k in ("position", "setpoint")}, unit="m")
    drive = jx.load_drive("mass.toml")
    bare = type(drive)(
        **{**vars(drive), "joint": {n: v for n, v in drive.joint.items() if n not in ("kp", "kd")}}
    )
    with pytest.raises(UserError, match="the gains are not known and there is no command"):
        jx.replay(bare, told)
