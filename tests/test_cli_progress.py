"""What long work says while it goes on: on a terminal only, and not beside JSON."""

import sys

import numpy as np
import pytest

from jaxact.cli import _progress, status
from jaxact.verbs import showing


@pytest.mark.parametrize("terminal", [True, False])
def test_phases_are_shown_on_a_terminal_only(capsys, monkeypatch, terminal):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    monkeypatch.setenv("TERM", "xterm")
    for quiet in (False, True):
        with _progress.phases(quiet=quiet) as phase:
            phase("certifying", 1, 4)
        said = capsys.readouterr()
        visible = terminal and not quiet
        assert ("certifying" in said.err) == visible and not said.out
        assert ("1/4" in said.err) == visible


def test_what_is_left_is_what_the_other_parts_take_if_each_takes_as_long(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(showing.time, "monotonic", lambda: now[0])
    rate = showing._Rate()
    assert rate.left("settling", 0, 0) == ""
    assert rate.left("simulating", 2, 10) == "2/10"
    now[0] += 9.0
    assert rate.left("simulating", 5, 10) == "5/10, about 15 s at most"
    now[0] += 600.0
    assert rate.left("simulating", 6, 10) == "6/10, about 11 min at most"
    assert rate.left("certifying", 1, 12) == "1/12"


@pytest.mark.parametrize("pauses", [1, 2])
def test_pauses_between_chunks_do_not_count_in_the_rate(capsys, pauses):
    """Chunks of ten loops, a second each, and as many pauses as there are such gaps."""
    written = np.cumsum([0.0] + [1.0] * pauses + [500.0] * pauses)
    status._of_time(written, 10 * len(written), 30)
    said = capsys.readouterr().out
    assert "rate     10 loops/s" in said and "left     3 s" in said
