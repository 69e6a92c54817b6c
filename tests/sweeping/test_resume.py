"""Sweeps that are interrupted, damaged or refused: what is kept, what is mended, what is said."""

import json
import os
import shutil
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from synthetic_store import run

from jaxact.cli.main import main
from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.sweeping import (
    checksums,
    execution,
    location,
    lock,
    opening,
    progress,
    store,
    validation,
)
from jaxact.sweeping.progress import State

TEXT = """
seed = 7
[axes]
actuator = ["ideal", "hyq"]
delay = [0.0, 0.001, 0.002]
kd = { min = 1, max = 100, num = 5, spacing = "log" }
"""
CHUNKS = 12  # of up to 3 samples


def _made(text=TEXT):
    specification = reading.parse(text)
    samples = expand(specification)
    numbers = np.arange(len(samples), dtype=float)
    return specification, samples, {"growth_rate": -numbers, "verdict": numbers % 4}


def _run(folder, *, text=TEXT, upto=None, **options):
    return run(folder, *_made(text), upto=upto, loops=3, **options)


def _begun(folder, upto=5):
    with pytest.raises(KeyboardInterrupt):
        _run(folder, upto=upto)


def contents(folder):
    """Every file by its path; of the root's attributes without what names time and command."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            content = path.read_bytes()
            if path.name == "zarr.json" and path.parent.name == store.STORE:
                root = json.loads(content)
                for name in ("created", "command"):
                    root["attributes"].pop(name)
                content = json.dumps(root, sort_keys=True).encode()
            found[path.relative_to(folder).as_posix()] = content
    return found


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    _run(folder)
    return contents(folder)


def _states(folder):
    there = progress.existing(location.at(folder / store.STORE))
    return [there.look(n).state for n in range(len(there.layout))]


@pytest.mark.parametrize("upto", [1, 5, CHUNKS - 1])
def test_an_interrupted_sweep_is_continued_to_the_same_bytes(upto, tmp_path, whole):
    _begun(tmp_path, upto)
    assert _states(tmp_path) == [State.DONE] * upto + [State.MISSING] * (CHUNKS - upto)
    assert sorted(item.name for item in tmp_path.iterdir()) == [store.STORE]
    calls = []
    _run(tmp_path, resume=True, moved=lambda done, total: calls.append((done, total)))
    assert contents(tmp_path) == whole
    first = calls[0][0]
    assert 0 < first < 30 and calls[-1] == (30, 30), "what is done is not computed again"


def test_interrupted_before_the_first_chunk_it_leaves_nothing_and_the_old_store_whole(tmp_path):
    _begun(tmp_path / "deep" / "er", upto=0)
    assert list(tmp_path.iterdir()) == []
    _run(tmp_path)
    before = contents(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        _run(tmp_path, overwrite=True, upto=0)
    assert contents(tmp_path) == before


def test_resume_begins_where_there_is_nothing_and_keeps_what_is_complete(tmp_path, whole):
    _run(tmp_path, resume=True)
    assert contents(tmp_path) == whole
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    _run(tmp_path, resume=True, upto=0)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_what_is_there_is_neither_continued_nor_replaced_unasked(tmp_path, whole):
    _begun(tmp_path)
    with pytest.raises(UserError, match=r"`resume`.*`overwrite`"):
        _run(tmp_path)
    _run(tmp_path, overwrite=True)
    assert contents(tmp_path) == whole


def test_the_beginning_is_kept_over_a_resume(tmp_path):
    _begun(tmp_path)
    path = tmp_path / store.STORE / "zarr.json"
    root = json.loads(path.read_text())
    root["attributes"]["created"] = "19" + root["attributes"]["created"][2:]
    path.write_bytes(checksums.sealed(root))
    _run(tmp_path, resume=True)
    assert json.loads(path.read_text())["attributes"]["created"].startswith("19")
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b'"complete": true', b'"complete": tru'))
    _run(tmp_path, resume=True)
    assert path.read_bytes() == whole, "a damaged root still says when it was begun"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("seed = 7", "seed = 8", "seed = 7 there, 8 here"),
        ("num = 5", "num = 6", "axes.kd.num = 5 there, 6 here"),
        ("0.002]", "0.003]", "axes.delay"),
        ("seed = 7", "seed = 7\ntile = 8", "tile = 64 there, 8 here"),
        ("seed = 7", "seed = 7\nduration = 3", "duration = 2.0 there, 3.0 here"),
        ("[axes]", "[parameters]\nmass = 2\n[axes]", "mass = not given there, 2.0 here"),
    ],
)
def test_a_changed_specification_is_refused_with_the_differing_keys(old, new, words, tmp_path):
    _begun(tmp_path)
    before = contents(tmp_path)
    with pytest.raises(UserError) as raised:
        _run(tmp_path, text=TEXT.replace(old, new), resume=True)
    assert words in str(raised.value) and "\n" not in str(raised.value)
    assert contents(tmp_path) == before


def test_what_changes_no_result_may_change(tmp_path, whole):
    _begun(tmp_path)
    _run(tmp_path, text="devices = 2\n" + TEXT, resume=True)
    there = contents(tmp_path)
    assert {k: v for k, v in there.items() if "zarr.json" not in k} == (
        {k: v for k, v in whole.items() if "zarr.json" not in k}
    )


def _damage(folder, how):
    inside = folder / store.STORE
    chunk = inside / "growth_rate" / "c.0.1.0"
    if how == "truncated":
        chunk.write_bytes(chunk.read_bytes()[:7])
    elif how == "empty":
        chunk.write_bytes(b"")
    elif how == "flipped":
        content = bytearray(chunk.read_bytes())
        content[5] ^= 4
        chunk.write_bytes(bytes(content))
    elif how == "swapped":
        shutil.copy(inside / "growth_rate" / "c.0.0.0", chunk)
    elif how in ("gone", "folder"):
        chunk.unlink()
        if how == "folder":
            chunk.mkdir()
    elif how == "receipt":
        shutil.copy(inside / "progress/receipt/c.0.0", inside / "progress/receipt/c.2.0")


@pytest.mark.parametrize(
    "how", ["truncated", "empty", "flipped", "swapped", "gone", "folder", "receipt"]
)
@pytest.mark.parametrize("finished", [True, False])
def test_a_damaged_chunk_is_told_and_mended_and_nothing_else_lost(how, finished, tmp_path, whole):
    if finished:
        _run(tmp_path)
    else:
        _begun(tmp_path, 8)
    kept = _states(tmp_path).count(State.DONE)
    _damage(tmp_path, how)
    assert _states(tmp_path)[2] is State.DAMAGED
    assert _states(tmp_path).count(State.DONE) == kept - 1
    checked = validation.checksums(opening.find(tmp_path))
    assert checked.done == kept - 1 and any("chunk 2 damaged" in line for line in checked.wrong)
    _run(tmp_path, resume=True)
    assert contents(tmp_path) == whole


@pytest.mark.parametrize(
    "lost",
    ["zarr.json", "progress/zarr.json", "progress/receipt/zarr.json", "verdict/zarr.json",
     "kd/zarr.json", "kd/c/0", "progress"],
)  # fmt: skip
def test_lost_metadata_is_written_again(lost, tmp_path, whole):
    _run(tmp_path)
    path = tmp_path / store.STORE / lost
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.write_text("{")
    _run(tmp_path, resume=True)
    there = contents(tmp_path)
    assert there.keys() == whole.keys()
    assert all(there[key] == whole[key] for key in whole if key != "sweep.zarr/zarr.json")
    assert opening.open_result(tmp_path)["growth_rate"].size == 30


def test_results_that_are_damaged_or_unfinished_are_not_drawn(tmp_path):
    _begun(tmp_path)
    with pytest.raises(UserError, match="resume"):
        opening.open_result(tmp_path)
    assert np.isnan(
        opening.open_result(tmp_path, unfinished=True)["growth_rate"].values[-1, -1, -1]
    )
    _run(tmp_path, resume=True)
    _damage(tmp_path, "flipped")
    with pytest.raises(UserError, match="validate"):
        opening.loaded(opening.open_result(tmp_path))


def test_temporary_files_of_a_killed_process_are_removed(tmp_path, whole):
    _begun(tmp_path)
    inside = tmp_path / store.STORE
    (inside / "verdict" / ".c.1.2.0.99.partial").write_text("half")
    (tmp_path / ".sweep.zarr.99.partial").mkdir()
    _run(tmp_path, resume=True)
    assert contents(tmp_path) == whole


@pytest.mark.parametrize("kind", ["folder", "file", "link"])
def test_nothing_but_a_result_is_ever_continued_or_replaced(kind, tmp_path):
    path = tmp_path / store.STORE
    if kind == "folder":
        path.mkdir()
        (path / "thesis.txt").write_text("years of work")
    elif kind == "file":
        path.write_text("work")
    else:
        (tmp_path / "elsewhere").mkdir()
        path.symlink_to(tmp_path / "elsewhere")
    for options in ({"resume": True}, {"overwrite": True}, {}):
        with pytest.raises(UserError, match="stays"):
            _run(tmp_path, **options)
    assert path.exists()


def test_a_second_process_is_refused_with_the_first_ones_id_and_host(tmp_path):
    with lock.held(location.at(tmp_path)):
        said = lock.holder(location.at(tmp_path))
        assert said == f"process {os.getpid()} on {socket.gethostname()}"
        with pytest.raises(UserError, match=said):
            _run(tmp_path)
    assert list(tmp_path.iterdir()) == [] and lock.holder(location.at(tmp_path)) == ""


def test_the_lock_of_a_killed_process_is_known_for_one(tmp_path):
    code = (
        "import sys, time; from jaxact.sweeping import lock, location\n"
        "with lock.held(location.at(sys.argv[1])):\n print('held', flush=True)\n time.sleep(60)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, tmp_path], stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "held\n"
        with pytest.raises(UserError, match=f"process {other.pid} on"):
            _run(tmp_path)
        other.kill()
    assert (tmp_path / lock.NAME).exists() and lock.holder(location.at(tmp_path)) == ""
    _run(tmp_path)
    assert sorted(item.name for item in tmp_path.iterdir()) == [store.STORE]


def test_a_lock_of_another_host_is_respected(tmp_path):
    (tmp_path / lock.NAME).write_text('{"pid": 4, "host": "elsewhere"}')
    with pytest.raises(UserError, match="process 4 on elsewhere"):
        _run(tmp_path)
    (tmp_path / lock.NAME).write_text("{")
    _run(tmp_path)


@pytest.fixture
def mounted(tmp_path):
    """A file system of two megabytes; skipped where none can be mounted."""
    folder = tmp_path / "small"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=2m,nr_inodes=2000", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("this user may not mount a file system")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.parametrize("room", [0, 6 * 4096])
def test_a_full_disk_keeps_what_is_done(room, mounted, whole):
    (mounted / "filler").write_bytes(b"x" * 1_000_000)
    _begun(mounted / "out", upto=2)
    done = _states(mounted / "out").count(State.DONE)
    with open(mounted / "filler", "ab", buffering=0) as filler:
        with pytest.raises(OSError):
            while True:
                filler.write(b"x" * 4096)
        filler.truncate(filler.tell() - room)
    with pytest.raises(UserError, match=r"No space left.*2 of 12 chunks are kept.*`resume`"):
        _run(mounted / "out", resume=True)
    assert _states(mounted / "out").count(State.DONE) == done
    assert not list(mounted.rglob("*.partial"))
    (mounted / "filler").unlink()
    _run(mounted / "out", resume=True)
    assert contents(mounted / "out") == whole


def test_a_read_only_folder_is_refused_before_the_work(mounted):
    _begun(mounted / "out", upto=2)
    subprocess.run(["mount", "-o", "remount,ro", str(mounted)], check=True)
    for folder in ("out", "new"):
        with pytest.raises(UserError, match=r"cannot be written \(Read-only file system\)"):
            _run(mounted / folder, resume=True, upto=0)
    assert _states(mounted / "out").count(State.DONE) == 2, "it can still be looked at"


def test_a_url_holds_a_store_as_a_folder_does(tmp_path, whole):
    fsspec = pytest.importorskip("fsspec")
    url = f"memory://test-{time.time_ns()}"
    specification, samples, results = _made()

    def filled(upto, **options):
        from synthetic_store import fake_plan, teller

        how = execution.SweepOptions(
            planner=lambda asked, every: fake_plan(asked, every, loops=3),
            workers=teller(results, upto=upto), **options,
        )  # fmt: skip
        return execution.sweep(specification, location.at(url), how)

    with pytest.raises(KeyboardInterrupt):
        filled(4)
    with pytest.raises(UserError, match="resume"):
        filled(None)
    filled(None, resume=True)
    opened = opening.open_result(url).load()
    np.testing.assert_array_equal(opened["growth_rate"].values.ravel(), results["growth_rate"])
    there = opening.find(url).entries()
    assert {f"sweep.zarr/{key}" for key in there} == set(whole)
    system = fsspec.filesystem("memory")
    root = url.removeprefix("memory://")
    for key, content in whole.items():
        if not key.endswith("zarr.json"):
            assert system.cat_file(f"/{root}/{key}") == content
    assert not system.exists(f"/{root}/{lock.NAME}")


def test_a_url_that_cannot_be_is_one_line():
    with pytest.raises(UserError, match="nonsense"):
        location.at("nonsense://bucket/name")


def test_what_a_remote_store_complains_of_is_one_line(monkeypatch, capsys):
    """Its library's own exceptions are not OSErrors."""
    pytest.importorskip("fsspec")
    memory = pytest.importorskip("fsspec.implementations.memory").MemoryFileSystem

    class NoCredentialsError(Exception):
        pass

    def refused(*_, **__):
        raise NoCredentialsError("Unable to locate credentials\nand more")

    for name in ("cat_file", "find", "exists", "pipe"):
        monkeypatch.setattr(memory, name, refused)
    for command in (["status"], ["validate"], ["plot"], ["export"]):
        more = ["out.nc"] if command == ["export"] else []
        assert main([*command, "memory://refused/one", *more]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and "(Unable to locate credentials)" in said, said


def test_what_room_does_not_mend_is_not_said_to_need_room(tmp_path):
    _begun(tmp_path, upto=2)
    chunk = min((tmp_path / store.STORE / "verdict").glob("c.*"))
    chunk.unlink()
    chunk.mkdir()
    (chunk / "mine").touch()
    with pytest.raises(
        UserError, match=r"Directory not empty.*kept: put that right, then.*`resume`"
    ):
        _run(tmp_path, resume=True)
