"""A small campaign of tools/survival.py: kills and damages at random; and what it cannot draw."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import synthetic_store
from hypothesis import given
from hypothesis import strategies as st

from jaxact.cli.main import main
from jaxact.errors import UserError
from jaxact.sweeping import atomic_store, checksums, execution, location, lock, opening
from jaxact.sweeping.checksums import ChecksumState

ROOT = Path(__file__).resolve().parent.parent
SMALL = "[axes]\nkp = [1, 2, 3]\nkd = [1, 2]"


@pytest.mark.exhaustive
@pytest.mark.parametrize(("what", "number"), [("kills", 8), ("damages", 16)])
def test_a_small_campaign_finds_nothing_wrong(what, number, tmp_path):
    ran = subprocess.run(
        [sys.executable, str(ROOT / "tools/survival.py"), what, "--number", str(number)],
        capture_output=True, text=True, cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT), "JAX_DISABLE_MOST_OPTIMIZATIONS": "1"},
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr


@given(
    st.dictionaries(st.text(max_size=8), st.text(max_size=8) | st.floats(allow_nan=False)),
    st.data(),
)
def test_any_changed_bit_of_a_sealed_file_is_found(more, data):
    document = {"zarr_format": 3, "attributes": more | {"created": "now", "command": "jaxact x"}}
    content = checksums.sealed(document)
    assert checksums.state(content) is ChecksumState.INTACT
    assert checksums.sealed(json.loads(content)) == content
    changed = bytearray(content)
    changed[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    assert checksums.state(bytes(changed)) is not ChecksumState.INTACT


def test_when_a_sweep_was_begun_changes_no_other_checksum():
    one, other = (
        json.loads(checksums.sealed({"attributes": {"created": when, "command": "jaxact", "a": 1}}))
        for when in ("monday", "friday")
    )
    assert one["attributes"].pop("created") != other["attributes"].pop("created")
    assert one == other


def _refused(folder, capsys):
    """The line with which a damaged store is refused by all who show it."""
    lines = []
    for command in (["status"], ["validate", "--samples", "0"], ["plot"]):
        capsys.readouterr()
        assert main([command[0], str(folder), *command[1:]]) == 2
        said = capsys.readouterr().err
        assert said.startswith("jaxact: ") and said.count("\n") == 1
        lines.append(said)
    return lines


def test_a_file_in_the_place_of_another_is_found(tmp_path, capsys):
    folder = synthetic_store.write(tmp_path, SMALL)
    inside = folder / "sweep.zarr"
    (inside / "kd/c/0").write_bytes((inside / "kp/c/0").read_bytes())
    assert all("kd/c/0" in line for line in _refused(folder, capsys))


def test_files_that_are_no_part_of_it_change_nothing(tmp_path, capsys):
    folder = synthetic_store.write(tmp_path, SMALL)
    (folder / "sweep.zarr" / "notes.txt").write_text("mine")
    assert main(["validate", str(folder), "--samples", "0"]) == 0
    assert "notes.txt" in capsys.readouterr().out
    assert opening.load_result(folder).sizes == {"kp": 3, "kd": 2}


def test_an_older_store_is_read_with_a_word_and_sealed_by_resume(tmp_path, capsys):
    specification, samples, results = synthetic_store.exact(SMALL)
    synthetic_store.run(tmp_path, specification, samples, results)
    whole = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for path in (tmp_path / "sweep.zarr/zarr.json", tmp_path / "sweep.zarr/progress/zarr.json"):
        root = json.loads(path.read_text())
        root["attributes"] = checksums.plain(root["attributes"])
        path.write_text(json.dumps(root, indent=2))
    assert main(["status", str(tmp_path)]) == 0
    said = capsys.readouterr().err
    assert "older jaxact" in said and said.count("\n") == 1
    assert opening.load_result(tmp_path).sizes == {"kp": 3, "kd": 2}
    synthetic_store.run(tmp_path, specification, samples, results, resume=True)
    assert {path: path.read_bytes() for path in whole} == whole


@pytest.mark.parametrize("within, named", [("", "sweep.zarr"), ("sweep.zarr", ".")])
def test_a_running_sweep_is_one_from_within_its_folder_too(
    within, named, tmp_path, capsys, monkeypatch
):
    with pytest.raises(KeyboardInterrupt):
        synthetic_store.run(tmp_path, *synthetic_store.exact(SMALL), loops=2, upto=1)
    monkeypatch.chdir(tmp_path / within)
    assert main(["status", named]) == 0
    assert "not running" in capsys.readouterr().out
    with lock.held(location.at(tmp_path)):
        assert main(["status", named]) == 0
    assert f"running: process {os.getpid()} on" in capsys.readouterr().out.splitlines()[-1]


def test_a_store_that_is_written_at_once_has_checksums_too(tmp_path, capsys):
    results = synthetic_store.dataset(SMALL).drop_vars("verdict")
    with atomic_store.destination(tmp_path / "margins.zarr") as folder:
        atomic_store.write(results, folder)
    assert main(["status", str(tmp_path / "margins.zarr")]) == 0
    path = tmp_path / "margins.zarr/growth_rate/c/0/0"
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    assert all("growth_rate/c/0/0" in line for line in _refused(path.parents[3], capsys))


def test_what_is_named_rounds_and_is_not_ours_stays(tmp_path):
    (tmp_path / "rounds").mkdir()
    (tmp_path / "rounds/thesis.txt").write_text("years of work")
    synthetic_store.write(tmp_path, SMALL)
    assert (tmp_path / "rounds/thesis.txt").read_text() == "years of work"
    specification, _, _ = synthetic_store.exact(SMALL)
    with pytest.raises(UserError, match="stays"):
        execution.sweep(
            specification, location.at(tmp_path), execution.SweepOptions(width=0.1, overwrite=True)
        )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_a_command_is_imported_is_one_line(number):
    # Where the tests run without a terminal (`nohup`, a shell's background job) it is ignored.
    taken = "signal.default_int_handler" if number == signal.SIGINT else "signal.SIG_DFL"
    code = (
        "import os, signal, sys\n"
        f"signal.signal({int(number)}, {taken})\n"
        "class Sends:\n"
        "    def find_spec(self, name, *_):\n"
        f"        if name == 'jaxact.errors': os.kill(os.getpid(), {int(number)})\n"
        "sys.meta_path.insert(0, Sends())\n"
        "from jaxact.cli import main\n"
        "sys.argv[1:] = ['parameters']\n"
        "main.entry()"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert ran.returncode == 128 + number
    assert ran.stderr.startswith("jaxact: interrupted") and ran.stderr.count("\n") == 1
