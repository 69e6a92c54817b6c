"""One thread of linear algebra for a robot, as the process had it before and after."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info

from jaxact.analysis.robot import one_thread
from jaxact.analysis.robot.one_thread import CHOSEN

ROOT = Path(__file__).resolve().parent.parent
OF_A_ROBOT = """
import numpy, scipy.linalg, sys
from threadpoolctl import threadpool_info
import jaxact as jx
from jaxact.robot_margins import whole_robot

threads = lambda: {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}
before, margins, meanwhile = threads(), whole_robot.robot_margins, []
def watched(robot):
    meanwhile.append(threads())
    return margins(robot)
whole_robot.robot_margins = watched
jx.margins(jx.robot("experiments/quadruped/quadruped.xml", keyframe="stand", kp=600, kd=30))
print(before, meanwhile, threads())
"""


def _threads():
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


@pytest.fixture
def unchosen(monkeypatch):
    for name in CHOSEN:
        monkeypatch.delenv(name, raising=False)


def test_the_last_to_end_puts_the_number_back(unchosen, monkeypatch):
    calls = []
    restored = threading.Event()

    class Limits:
        def __init__(self, **given):
            calls.append(given)

        def restore_original_limits(self):
            restored.set()

    monkeypatch.setattr("threadpoolctl.threadpool_limits", Limits)
    first, second = one_thread.one_thread(), one_thread.one_thread()
    with first:
        second.__enter__()
    assert not restored.is_set()  # the second one still computes
    second.__exit__(None, None, None)
    assert restored.is_set() and calls == [{"limits": 1, "user_api": "blas"}]


def test_an_error_puts_it_back_too(unchosen):
    before = _threads()
    with pytest.raises(ZeroDivisionError), one_thread.one_thread():
        assert _threads() == {1}
        raise ZeroDivisionError
    assert _threads() == before


def test_a_number_that_the_user_has_chosen_stays(monkeypatch):
    def refused(**given):
        raise AssertionError(given)

    monkeypatch.setattr("threadpoolctl.threadpool_limits", refused)
    monkeypatch.setenv(CHOSEN[0], "3")
    with one_thread.one_thread():
        pass


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="OpenBLAS has one thread here anyway")
def test_margins_of_a_robot_in_somebody_elses_process():
    environment = {name: value for name, value in os.environ.items() if name not in CHOSEN}
    ran = subprocess.run(
        [sys.executable, "-c", OF_A_ROBOT],
        capture_output=True, text=True, check=True, cwd=ROOT, env=environment,
    )  # fmt: skip
    before, meanwhile, after = ran.stdout.split()
    assert before == after != "{1}" and meanwhile == "[{1}]"
