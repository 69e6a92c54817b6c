"""Processes that help: what they compute, and what becomes of the tasks of one that is lost."""

import contextlib
import os
import subprocess
import sys
import time

import numpy as np
import pytest

from jaxact.analysis.robot.processes import Helpers, helping
from jaxact.loops.samples import Samples
from jaxact.robot_margins import families


def tenfold(shared):
    """Says where it is computed, and prints, which must not get between the results."""

    def compute(task):
        print("a word")
        time.sleep(0.02)
        return os.getpid(), shared * task

    return compute


def lost(shared):
    def compute(task):
        if os.getpid() != shared:
            os._exit(3)
        time.sleep(0.2)
        return task

    return compute


def refusing(shared):
    if os.getpid() != shared:
        raise ValueError("not here")
    return lambda task: task


def _ready(pool, tasks):
    """The results of the same tasks again and again, until a helper took part."""
    end = time.monotonic() + 120.0
    while time.monotonic() < end:
        found = pool.map(tasks)
        if len({pid for pid, _ in found}) > 1:
            return found
    raise AssertionError("no helper computed anything")


def test_helpers_compute_beside_this_process_and_end():
    with helping(1, tenfold, 10) as pool:
        found = _ready(pool, range(40))
        (other,) = {pid for pid, _ in found} - {os.getpid()}
    assert [value for _, value in found] == [10 * task for task in range(40)]
    with pytest.raises(ProcessLookupError):
        os.kill(other, 0)


@pytest.mark.parametrize("prepare", [lost, pytest.param(refusing, marks=pytest.mark.exhaustive)])
def test_what_a_lost_helper_did_not_compute_is_computed_here(prepare):
    with helping(2, prepare, os.getpid()) as pool:
        end = time.monotonic() + 60.0
        while any(one.poll() is None for one in pool._running) and time.monotonic() < end:
            assert pool.map(range(10)) == list(range(10))
        assert pool.map(range(10)) == list(range(10))


def test_what_cannot_be_sent_is_computed_here():
    pool = Helpers(2, lambda shared: lambda task: shared + task, 5)
    assert pool.map([1, 2]) == [6, 7] and not pool._running


def test_tasks_whose_results_nobody_asks_for_are_not_begun():
    begun = []
    with helping(0, lambda shared: begun.append, None) as pool:
        with contextlib.closing(pool.each(range(5))) as results:
            next(results), next(results)
        assert pool.map([7]) == [None]
    assert begun == [0, 1, 7]


def test_what_is_raised_is_raised_here():
    with helping(0, lambda shared: lambda task: 1 // task, None) as pool:
        with pytest.raises(ZeroDivisionError):
            pool.map([1, 0])


def test_a_script_without_a_guard_is_not_run_again_by_its_helpers(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import functools, operator, time\n"
        "print('once')\n"
        "from jaxact.analysis.robot.processes import helping\n"
        "with helping(1, functools.partial(functools.partial, operator.mul), 3) as pool:\n"
        "    end = time.monotonic() + 3.0\n"
        "    while time.monotonic() < end:\n"
        "        assert pool.map([1, 2]) == [3, 6]\n"
    )
    ran = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    assert (ran.returncode, ran.stdout) == (0, "once\n"), ran.stderr


def test_parts_hold_every_sample_once_and_loops_that_differ_in_gains_together():
    kp, kd, delay = np.geomspace(1, 10, 7), np.geomspace(0.1, 1, 5), np.array([0.0, np.nan, 1e-3])
    along = {
        "kp": kp[:, None, None],
        "kd": kd[:, None],
        "delay": delay[None, None, :].reshape(1, 1, 3),
    }
    samples = Samples(along | {"kd": kd[None, :, None]}, ("kp", "kd", "delay"), (7, 5, 3), {})
    numbers = np.arange(3, 105)
    parts = families.parts(samples, numbers)
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), numbers)
    for part in parts:
        assert (np.diff(part) > 0).all()
        assert len({int(number) % 3 for number in part}) == 1  # one delay
    assert len(parts) == 6
