"""What long work says while it goes on: on a terminal only, and not beside JSON."""

import sys

import pytest

from jaxact.cli import _progress


@pytest.mark.parametrize("terminal", [True, False])
def test_phases_are_shown_on_a_terminal_only(capsys, monkeypatch, terminal):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    monkeypatch.setenv("TERM", "xterm")
    for quiet in (False, True):
        with _progress.phases(quiet=quiet) as phase:
            phase("certifying")
        said = capsys.readouterr()
        assert ("certifying" in said.err) == (terminal and not quiet) and not said.out
