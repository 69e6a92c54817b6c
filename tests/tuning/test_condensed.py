"""Responses without the states of delay lines, against solving with all of them."""

import contextlib
import os
import time

import numpy as np
import pytest

from jaxact.analysis.robot.processes import Helpers
from jaxact.tuning.robot import cores, peaks
from jaxact.tuning.robot.condensed import condensed, together
from jaxact.tuning.robot.open_loops import OpenLoops


def _loop(seed, states, delays, ahead, behind, joints=2):
    """A random loop whose inputs, an inner coupling and outputs come late, and its matrices."""
    random = np.random.default_rng(seed)
    n = states + joints * (ahead + delays + behind)
    A, B, Y = np.zeros((n, n)), np.zeros((n, joints)), np.zeros((joints, 2, n))
    A[:states, :states] = random.normal(size=(states, states)) * 0.9 / np.sqrt(states)
    first, into, out = states, random.normal(size=(2, states, joints)), random.normal(
        size=(2, states, joints)
    )  # fmt: skip

    def line(length, drive, seen):
        """A shift register after what drives it; what sees its end."""
        nonlocal first
        for place in range(length):
            own = np.arange(first, first + joints)
            if place == 0:
                drive(own)
            else:
                A[own, own - joints] = 1.0
            first += joints
        seen(np.arange(first - joints, first))

    line(ahead, lambda own: B.__setitem__((own, np.arange(joints)), 1.0),
         lambda end: A.__setitem__((slice(states), end), into[0]))  # fmt: skip
    line(delays, lambda own: A.__setitem__((own, slice(states)), out[0].T),
         lambda end: A.__setitem__((slice(states), end), 0.1 * into[1]))  # fmt: skip
    line(behind, lambda own: A.__setitem__((own, slice(states)), out[1].T),
         lambda end: Y.__setitem__((np.arange(joints), 0, end), 1.0))  # fmt: skip
    Y[:, 1, :states] = random.normal(size=(joints, states))
    return A, B, Y


@pytest.mark.parametrize("lines", [(1, 1, 1), (3, 2, 1), (2, 5, 4)])
def test_a_response_is_what_all_states_give(lines):
    A, B, Y = _loop(1, 5, lines[1], lines[0], lines[2])
    angle = np.pi * np.geomspace(1e-4, 1.0, 30)
    found = condensed(A[None], B[None], Y[None])
    assert found.A.shape[-1] == 5
    full = np.linalg.solve(
        np.exp(1j * angle)[:, None, None] * np.eye(len(A)) - A, B.astype(complex)
    )
    expected = (Y.reshape(-1, len(A)) @ full).reshape(-1, 2, 2, 2)
    np.testing.assert_allclose(found.response(np.zeros(30, int), angle), expected, rtol=1e-11,
                               atol=1e-12 * np.abs(expected).max())  # fmt: skip


def test_loops_of_different_size_are_filled_up():
    one, other = _loop(2, 4, 1, 1, 1), _loop(3, 7, 3, 2, 2)
    apart = [condensed(*(array[None] for array in loop)) for loop in (one, other)]
    both = together(apart)
    angle = np.array([0.01, 1.0, 3.0])
    for number, alone in enumerate(apart):
        np.testing.assert_allclose(
            both.response(np.full(3, number), angle), alone.response(np.zeros(3, int), angle),
            rtol=1e-12,
        )  # fmt: skip
        few = both.take(np.array([number]))
        np.testing.assert_array_equal(
            few.response(np.zeros(3, int), angle), both.response(np.full(3, number), angle)
        )


def test_states_in_a_circle_and_behind_it_stay():
    A = np.array([[0.0, 1.0, 0.0], [-0.5, 0.0, 0.0], [1.0, 0.0, 0.0]])
    found = condensed(A[None], np.eye(3)[None, :, :1], np.ones((1, 1, 2, 3)))
    assert found.A.shape[-1] == 3
    z = np.exp(0.3j)
    expected = np.ones(3) @ np.linalg.solve(z * np.eye(3) - A, np.eye(3)[:, 0].astype(complex))
    np.testing.assert_allclose(found.response(np.zeros(1, int), np.array([0.3]))[0, 0, :, 0],
                               [expected, expected], rtol=1e-13)  # fmt: skip


def test_loops_that_are_taken_for_stable_are():
    loops = [_loop(seed, 5, 1, 1, 1) for seed in range(6)]
    A, B, Y = (np.stack(arrays) for arrays in zip(*loops, strict=True))
    A *= 0.5
    names = tuple(map(str, range(6)))
    opened = OpenLoops(names, np.zeros(6, int), np.zeros((6, 0)), A, B, Y, np.ones(6),
                       condensed(A, B, Y))  # fmt: skip
    table = peaks.tabulate(opened)
    random, taken, refused = np.random.default_rng(0), 0, 0
    for _ in range(300):
        first = random.normal(size=(2, 2)) * random.uniform(0.0, 0.3)
        if not (peaks.growth_rates(opened, *first) < 0.0).all():
            continue
        second = first + random.normal(size=(2, 2)) * 10.0 ** random.uniform(-3.0, 0.5)
        S = peaks.sensitivity(table.response, *second)
        stable = (peaks.growth_rates(opened, *second) < 0.0).all()
        if peaks.beside(table, S, second, first):
            assert stable
            taken += 1
        refused += not stable
    assert taken > 50 and refused > 20


@pytest.mark.parametrize("number", [1, 2, 3, 5])
def test_parts_of_a_stack_give_what_the_whole_gives(number, monkeypatch):
    random = np.random.default_rng(0)
    stack = random.normal(size=(7, 12, 12))
    monkeypatch.setattr(cores, "number", lambda: number)
    monkeypatch.setattr(cores, "_LEAST", 0.0)
    np.testing.assert_array_equal(cores.stacked(np.linalg.inv, stack), np.linalg.inv(stack))
    assert cores.each(lambda item: item * item, range(9)) == [k * k for k in range(9)]
    with pytest.raises(ZeroDivisionError):
        cores.each(lambda item: 1 / (item - 4), range(9))


def inverted(matrix):
    time.sleep(0.02)
    return os.getpid(), np.linalg.inv(matrix)


def test_processes_that_help_give_what_this_one_gives(monkeypatch):
    stack = np.random.default_rng(0).normal(size=(24, 12, 12))
    monkeypatch.setattr(cores, "number", lambda: 2)
    whole = [np.linalg.inv(matrix) for matrix in stack]
    end, one = time.monotonic() + 120.0, [(matrix,) for matrix in stack]
    with cores.helped(worthwhile=True), cores.helped(worthwhile=True):
        others = set()
        while not others and time.monotonic() < end:
            for found in (cores.many(inverted, list(stack)), list(cores.spread(inverted, one))):
                np.testing.assert_array_equal([inverse for _, inverse in found], whole)
                others |= {pid for pid, _ in found} - {os.getpid()}
        assert len(others) == 1
        with contextlib.closing(cores.spread(inverted, one)) as results:
            np.testing.assert_array_equal(next(results)[1], whole[0])
    assert {pid for pid, _ in cores.many(inverted, list(stack))} == {os.getpid()}


def twice(matrix):
    """Work that is spread itself, within what is spread."""
    return [one for _, one in cores.spread(inverted, [(matrix,), (matrix,)])]


def test_what_is_spread_may_spread_again_and_many_cores_start_few_processes(monkeypatch):
    started = []

    @contextlib.contextmanager
    def none(count, prepare, shared):
        started.append(count)
        yield Helpers(0, prepare, shared)

    monkeypatch.setattr(cores, "helping", none)
    monkeypatch.setattr(cores, "number", lambda: 64)
    matrix = np.diag([1.0, 2.0])
    with cores.helped(worthwhile=True):
        found = list(cores.spread(twice, [(matrix,)] * 3))
    assert started == [7]
    np.testing.assert_array_equal(found, np.tile(np.linalg.inv(matrix), (3, 2, 1, 1)))


def test_what_is_too_short_starts_no_process():
    with cores.helped(worthwhile=False):
        assert next(cores.spread(inverted, [(np.eye(2),)]))[0] == os.getpid()
