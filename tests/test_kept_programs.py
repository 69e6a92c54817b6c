"""What the tests compile is kept from run to run, but nothing that a later run could not use."""

import os

import kept_programs
import pytest
from jax._src.compilation_cache import compress_executable


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    for number in range(3):
        (folder / f"jit_{number}-cache").write_bytes(compress_executable(os.urandom(1000)))
    return folder


def _names(folder):
    return sorted(program.name for program in folder.glob("*"))


def test_the_next_run_has_what_was_compiled(run, tmp_path):
    kept_programs.keep(run, tmp_path / "kept")
    kept_programs.lend(tmp_path / "kept", tmp_path / "next")
    assert _names(tmp_path / "next") == _names(run)
    for program in run.glob("*"):
        assert (tmp_path / "next" / program.name).read_bytes() == program.read_bytes()
    # A run that has them already, or never had any.
    kept_programs.lend(tmp_path / "kept", tmp_path / "next")
    kept_programs.lend(tmp_path / "none", tmp_path / "first")
    assert _names(tmp_path / "first") == []


def test_half_a_program_is_not_kept(run, tmp_path):
    half = run / "jit_1-cache"
    half.write_bytes(half.read_bytes()[:500])
    kept_programs.keep(run, tmp_path / "kept")
    assert _names(tmp_path / "kept") == ["jit_0-cache", "jit_2-cache"]


def test_the_oldest_make_room(run, tmp_path, monkeypatch):
    for number, seconds in enumerate((30, 10, 20)):
        os.utime(run / f"jit_{number}-cache", (seconds, seconds))
    monkeypatch.setattr(kept_programs, "_MOST", 2500)
    kept_programs.keep(run, tmp_path / "kept")
    assert _names(tmp_path / "kept") == ["jit_0-cache", "jit_2-cache"]


def test_where_nothing_can_be_written_nothing_is_kept(run, tmp_path):
    (tmp_path / "kept").write_text("a file")
    kept_programs.keep(run, tmp_path / "kept")
    assert (tmp_path / "kept").read_text() == "a file"


def test_another_processor_has_its_own(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    here = kept_programs.directory()
    assert here.parent == tmp_path / "jaxact-tests"
    monkeypatch.setattr(kept_programs, "_processor", lambda: "another")
    assert kept_programs.directory() != here


def test_a_cache_folder_that_is_none_is_not_taken(monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "somewhere")
    monkeypatch.setenv("HOME", "/home/user")
    assert kept_programs.directory().is_relative_to("/home/user/.cache/jaxact-tests")
