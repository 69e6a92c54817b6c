"""`jaxact.keep_programs`: what a verb compiles is there in the next process, if that is safe."""

import os
import subprocess
import sys

import pytest

import jaxact as jx
from jaxact.compilation import programs

MARGINS = """
import sys
import jaxact as jx

print(jx.keep_programs(sys.argv[1]))
print(jx.margins(jx.joint(kp=400, kd=20, actuator="starleth", delay=1e-3)).delay_margin)
"""


@pytest.fixture(autouse=True)
def nothing_named(monkeypatch, tmp_path):
    monkeypatch.setenv(programs.FOLDER, "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def margins(folder):
    process = subprocess.run(
        [sys.executable, "-c", MARGINS, str(folder)], capture_output=True, text=True, check=True
    )
    return process.stdout.splitlines()


@pytest.mark.exhaustive
def test_the_next_process_finds_what_was_compiled(tmp_path):
    folder = tmp_path / "mine" / "programs"
    said, first = margins(folder)
    kept = {file.name: file.stat().st_ino for file in folder.iterdir()}
    assert said == str(folder)
    assert kept
    assert all(name.endswith(".program") for name in kept)
    _, second = margins(folder)
    # none was compiled and written anew
    assert {file.name: file.stat().st_ino for file in folder.iterdir()} == kept
    assert second == first


def test_the_folder_is_the_command_lines_or_the_one_that_is_named(tmp_path, monkeypatch):
    assert jx.keep_programs() == tmp_path / "cache" / "jaxact" / "programs"
    assert os.environ[programs.FOLDER] == str(tmp_path / "cache" / "jaxact" / "programs")
    monkeypatch.setenv(programs.FOLDER, str(tmp_path / "named"))
    assert jx.keep_programs() == tmp_path / "named"
    monkeypatch.chdir(tmp_path)
    assert jx.keep_programs("here") == tmp_path / "here"
    assert (tmp_path / "here").stat().st_mode & 0o077 == 0


def test_a_folder_that_cannot_be_used_is_said_in_one_line(tmp_path):
    open_to_all = tmp_path / "open"
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    with pytest.raises(jx.UserError, match=f"folder {open_to_all}: can be written to by others"):
        jx.keep_programs(open_to_all)
    file = tmp_path / "file"
    file.touch()
    for wrong in (file, file / "below", 3):
        with pytest.raises(jx.UserError, match=f"folder {wrong}: "):
            jx.keep_programs(wrong)
    assert not os.environ[programs.FOLDER]
