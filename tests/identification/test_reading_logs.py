"""Logs are read as they are, and what cannot be used is said in one line."""

import numpy as np
import pytest

from jaxact.errors import UserError
from jaxact.identification.reading import read, read_columns

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
