"""Logs are read as they are, and what cannot be used is said in one line."""

from dataclasses import replace

import numpy as np
import pytest

from jaxact.errors import UserError
from jaxact.identification.identify import with_gains
from jaxact.identification.log import Log, missing, renewed, stretches
from jaxact.identification.reading import read, read_columns
from jaxact.identification.report import units

ROWS = 300
TIME = np.arange(ROWS) * 0.002
COMMAND = np.sin(20.0 * TIME)


def _write(path, **columns):
    names = list(columns)
    rows = zip(*columns.values(), strict=True)
    path.write_text("\n".join([",".join(names), *(",".join(map(repr, map(float, row)))
                                                  for row in rows)]) + "\n")  # fmt: skip
    return path


def _good(path, **changes):
    columns = {"time": TIME, "command": COMMAND, "force": 0.9 * COMMAND} | changes
    return _write(path, **columns)


def test_columns_with_the_names_of_the_signals_need_no_map(tmp_path):
    (log,) = read(_good(tmp_path / "log.csv"))
    np.testing.assert_array_equal(log.time, TIME)
    np.testing.assert_array_equal(log["command"], COMMAND)
    assert log.period == pytest.approx(0.002)


def test_a_map_names_scales_and_takes_what_differs_between_files(tmp_path):
    _write(tmp_path / "slow_1.csv", ms=1e3 * TIME, u=COMMAND, i=COMMAND)
    (tmp_path / "map.toml").write_text(
        'time = "ms"\ntime_unit = "ms"\nstamp = "end"\ncommand = "u"\nkp = 3.0\nposition = "i"\n'
        'force = { column = "i", scale = 2.0, offset = 1.0 }\n[files."slow*.csv"]\nkp = 5.0\n'
    )
    (log,) = read(tmp_path / "slow_1.csv", read_columns(tmp_path / "map.toml"))
    np.testing.assert_allclose(log.time, TIME)
    np.testing.assert_allclose(log["force"], 2.0 * COMMAND + 1.0)
    assert log.gains == (5.0, None) and log.stamp == "end"


def test_details_of_a_file_or_a_joint_add_to_those_of_all(tmp_path):
    for name in ("slow_1.csv", "other.csv"):
        _write(tmp_path / name, t=TIME, u=COMMAND, q=COMMAND)
    (tmp_path / "map.toml").write_text(
        'time = "t"\ncommand = "u"\nposition = "q"\n[details]\nmass = 0.5\nlength = 0.1\n'
        "[joints.hip.details]\nlength = 0.2\n[joints.knee]\nkp = 3.0\n"
        '[files."slow*.csv".details]\ncommand_limit = 1.0\n[files."*_1.csv".details]\nmass = 0.6\n'
    )
    columns = read_columns(tmp_path / "map.toml")
    hip, knee = read(tmp_path / "slow_1.csv", columns)
    assert hip.details == {"mass": 0.6, "length": 0.2, "command_limit": 1.0}
    assert knee.details == {"mass": 0.6, "length": 0.1, "command_limit": 1.0}
    assert read(tmp_path / "other.csv", columns)[0].details == {"mass": 0.5, "length": 0.2}


def test_an_npz_of_several_joints_gives_a_log_for_each(tmp_path):
    np.savez(tmp_path / "log.npz", t=TIME, tau=np.stack([COMMAND, 2.0 * COMMAND], axis=1))
    (tmp_path / "map.toml").write_text(
        'time = "t"\n[joints.hip]\ncommand = "tau[0]"\nforce = "tau[1]"\n'
        '[joints.knee]\ncommand = "tau[1]"\nforce = "tau[0]"\n'
    )
    hip, knee = read(tmp_path / "log.npz", read_columns(tmp_path / "map.toml"))
    np.testing.assert_array_equal(hip["force"], knee["command"])
    assert (hip.joint, knee.joint) == ("hip", "knee")


_BROKEN = COMMAND.copy()
_BROKEN[[4, 9]] = np.nan
_BACK = TIME.copy()
_BACK[7] = _BACK[6]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"force": _BROKEN}, "force is not a number in rows 6 and 11"),
        ({"time": _BACK}, "time does not rise in row 9"),
        ({"force": np.zeros(ROWS)}, "force is 0 throughout"),
        ({"command": np.full(ROWS, 2.0)}, "command is 2 throughout"),
    ],
)
def test_what_cannot_be_used_is_named_with_its_rows(tmp_path, changes, said):
    with pytest.raises(UserError, match=said):
        read(_good(tmp_path / "log.csv", **changes))


def test_columns_of_one_name_are_refused(tmp_path):
    (tmp_path / "log.csv").write_text("time,force,,,force\n" + "0,1,,,2\n" * 300)
    with pytest.raises(UserError, match="has several columns 'force'"):
        read(tmp_path / "log.csv")


def test_a_short_log_is_refused(tmp_path):
    path = _write(tmp_path / "log.csv", time=TIME[:50], command=COMMAND[:50], force=COMMAND[:50])
    with pytest.raises(UserError, match="50 rows are too few"):
        read(path)


@pytest.mark.parametrize(
    ("name", "said"),
    [("a.pkl", "pickle"), ("a.pt", "PyTorch"), ("a.npy", "numpy.savez"), ("a.bag", "CSV")],
)
def test_files_that_are_not_read_say_how_to_convert_them(tmp_path, name, said):
    (tmp_path / name).write_bytes(b"anything")
    with pytest.raises(UserError, match=said):
        read(tmp_path / name)


def test_objects_in_an_npz_are_not_unpickled(tmp_path):
    np.savez(tmp_path / "log.npz", time=np.array([{}], dtype=object))
    with pytest.raises(UserError, match="plain arrays"):
        read(tmp_path / "log.npz")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('comand = "u"', "comand is not known; did you mean 'command'"),
        ('stamp = "middle"', "stamp"),
        ("joints = 3", "must be tables"),
        ("kp = inf", "kp = inf must be 0 or more, and finite"),
        ("kp = -5.0", "kp = -5 must be 0 or more"),
        ("difference_ticks = -2", "difference_ticks = -2 must be 0 or more"),
        ("details = { command_limit = 0.0 }", "command_limit = 0 must be finite, and more than 0"),
        ("details = { other = nan }", "other = nan must be finite"),
        ("time = ", "is not TOML"),
    ],
)
def test_a_wrong_map_is_named(tmp_path, text, said):
    (tmp_path / "map.toml").write_text(text)
    with pytest.raises(UserError, match=said):
        read_columns(tmp_path / "map.toml")


def test_a_missing_column_is_named_with_the_nearest(tmp_path):
    (tmp_path / "map.toml").write_text('command = "comand"\nforce = "force"\n')
    with pytest.raises(UserError, match="command: there is no column 'comand'.*'command'"):
        read(_good(tmp_path / "log.csv"), read_columns(tmp_path / "map.toml"))


def test_a_row_with_a_value_too_many_is_named(tmp_path):
    path = _good(tmp_path / "log.csv")
    lines = path.read_text().splitlines()
    lines[3] += ",1"
    path.write_text("\n".join(lines))
    with pytest.raises(UserError, match="row 4 has 4 values, the head 3 names"):
        read(path)


def test_a_spreadsheet_writes_semicolons_decimal_commas_and_a_mark(tmp_path):
    rows = zip(TIME, COMMAND, 0.9 * COMMAND, strict=True)
    lines = [";".join(repr(float(x)).replace(".", ",") for x in row) for row in rows]
    text = "\r\n".join(['"time";"command";"force"', *lines]) + "\r\n"
    (tmp_path / "log.csv").write_text(text, encoding="utf-8-sig")
    (log,) = read(tmp_path / "log.csv")
    np.testing.assert_array_equal(log.time, TIME)
    np.testing.assert_array_equal(log["force"], 0.9 * COMMAND)


@pytest.mark.parametrize(
    "head", ["# run 7\n#\ntime,command,force\n", "# run 7\n# time,command,force\n"]
)
def test_lines_of_comment_before_the_names_are_skipped(tmp_path, head):
    path = _good(tmp_path / "log.csv")
    path.write_text(head + path.read_text().partition("\n")[2])
    (log,) = read(path)
    np.testing.assert_array_equal(log.time, TIME)
    np.testing.assert_array_equal(log["force"], 0.9 * COMMAND)


def test_columns_between_spaces_are_said_to_need_a_separator(tmp_path):
    path = _good(tmp_path / "log.csv")
    path.write_text(path.read_text().replace(",", " "))
    with pytest.raises(UserError, match="columns are separated by ',', ';' or a tab"):
        read(path)


@pytest.mark.parametrize("factor", [1e3, 1e6, 1e-6])
def test_stamps_in_another_unit_are_refused(tmp_path, factor):
    with pytest.raises(UserError, match="s apart, which tells nothing.*time_unit"):
        read(_good(tmp_path / "log.csv", time=factor * TIME))


def _swings(rows=1000, **signals):
    time = 2e-3 * np.arange(rows)
    command = np.sin(20.0 * time)
    return Log("log.csv", time, {"command": command, "position": np.cos(20.0 * time), **signals})


def test_a_log_is_cut_where_time_is_missing():
    log = _swings()
    late = np.where(np.arange(1000) < 400, 0.0, 0.1) + np.where(np.arange(1000) < 450, 0.0, 0.1)
    first, last = stretches(replace(log, time=log.time + late))
    assert (first.title, len(first)) == ("log.csv, rows 2 to 401", 400)
    assert (last.title, last.row) == ("log.csv, rows 452 to 1001", 452)
    assert stretches(log) == [log]
    with pytest.raises(UserError, match="missing in 9 places, as before row"):
        stretches(replace(log, time=log.time + 0.1 * (np.arange(1000) // 100)))


def test_rows_that_are_missing_one_at_a_time_are_said_where_they_are_many():
    log = _swings()
    kept = np.ones(1000, bool)
    kept[[100, 300]] = False
    few = replace(log, time=log.time[kept], signals={n: v[kept] for n, v in log.signals.items()})
    assert missing(few).tolist() == [100, 299] and stretches(few) == [few]
    kept[np.arange(20, 1000, 97)] = False
    many = replace(log, time=log.time[kept], signals={n: v[kept] for n, v in log.signals.items()})
    (found,) = stretches(many)
    assert found.notes[0].startswith("rows are missing at 13 places, where what was commanded")
    # Stamps that are up to 0.45 of a row early or late miss nothing.
    shaken = log.time + 2e-3 * np.random.default_rng(1).uniform(-0.45, 0.45, 1000)
    assert np.max(np.diff(shaken)) > 1.7 * 2e-3 and not missing(replace(log, time=shaken)).size


def test_a_position_that_is_new_in_every_third_row_lies_on_lines_between():
    log = _swings()
    held = log["position"][np.maximum((np.arange(1000) + 1) // 3 * 3 - 1, 0)]
    mended = renewed(replace(log, signals={**log.signals, "position": held}))
    assert "position is new once in 3 rows" in mended.notes[0]
    inside = slice(2, -3)
    np.testing.assert_allclose(mended["position"][inside], log["position"][inside], atol=2e-3)
    assert np.max(np.abs(held - log["position"])) > 0.05
    rounded = np.round(log["position"] / 0.05) * 0.05  # an encoder is not a slower clock
    coarse = replace(log, signals={**log.signals, "position": rounded})
    assert renewed(coarse) is coarse


def test_columns_in_other_units_are_named():
    log = _swings()
    speed = -20.0 * np.sin(20.0 * log.time)
    fine = replace(log, signals={**log.signals, "velocity": speed})
    assert units(fine) == []
    rpm = replace(log, signals={**log.signals, "velocity": 9.549 * speed})
    assert "velocity is 9.55" in units(rpm)[0]
    degrees = replace(log, signals={**log.signals, "position": 57.3 * log["position"]})
    assert "position spans 114.6 rad; if these are degrees" in units(degrees)[0]


def test_gains_that_the_command_is_made_of_are_taken_from_it():
    log = _swings(velocity=-20.0 * np.sin(20.0 * 2e-3 * np.arange(1000)))
    setpoint = np.sin(7.0 * log.time)
    asked = 30.0 * (setpoint - log["position"]) - 0.8 * log["velocity"]
    told = replace(log, signals={**log.signals, "setpoint": setpoint, "command": asked})
    kp, kd = with_gains(told).gains
    assert kp == pytest.approx(30.0) and kd == pytest.approx(0.8)
    spoiled = {**told.signals, "command": asked + np.sin(41.0 * log.time)}
    assert with_gains(replace(told, signals=spoiled)).gains == (None, None)
