"""Roots that grow: computed, shown to decay by powers, and where they begin to."""

import numpy as np
import pytest

from jaxact.analysis.robot import stability
from jaxact.analysis.robot.modes import shaking, toppling


def _of_radius(rng, size, radius):
    """A matrix that is far from normal, of states in very different units."""
    M = np.triu(rng.normal(size=(size, size))) + 0.1 * rng.normal(size=(size, size))
    M *= radius / np.abs(np.linalg.eigvals(M)).max()
    scale = 10.0 ** rng.uniform(-3.0, 3.0, size)
    return M * scale[:, None] / scale


@pytest.mark.parametrize("size", [1, 5, 30])
def test_only_what_decays_is_said_to(size):
    rng = np.random.default_rng(size)
    shown = 0
    for _ in range(50):
        inside, outside = _of_radius(rng, size, 1.0 - 1e-3), _of_radius(rng, size, 1.0 + 1e-7)
        shown += stability.decays(inside)
        assert not stability.decays(outside)
        assert not stability.decays(_of_radius(rng, size, 1.0))
        assert stability.excess(inside) < 0.0 < stability.excess(outside)
    assert shown == 50


def _delayed_oscillator(ahead, gain):
    """A motion whose velocity is in units a million times too small, fed back after a delay."""
    M = np.diag(np.ones(ahead + 1), 1)
    turn = np.array([[1.0, 1e-3], [-40.0, 0.8]])
    M[:2, :2], M[1, 2] = turn, 1e3
    M[-1] = 0.0
    M[-1, :2] = -gain * np.array([1e-2, 1e-6])
    return M


@pytest.mark.parametrize("gain", [0.1, 1.0, 3.0, 4.0, 8.0])
def test_powers_that_grow_at_first_and_motions_that_are_slow_are_still_shown_to_decay(gain):
    M = _delayed_oscillator(6, gain)
    inside = np.abs(np.linalg.eigvals(M)).max() < 1.0
    assert stability.decays(M) == inside
    slow = np.zeros((len(M) + 1,) * 2)
    slow[:-1, :-1], slow[-1, -1] = M, 1.0 - 1e-6
    assert stability.decays(slow) == inside
    slow[-1, -1] = 1.0 + 1e-8
    assert not stability.decays(slow)


def test_only_roots_that_count_grow():
    turn = 1.01 * np.array([[np.cos(0.2), -np.sin(0.2)], [np.sin(0.2), np.cos(0.2)]])
    M = np.zeros((3, 3))
    M[:2, :2], M[2, 2] = turn, 1.02
    beyond = np.array([0.01, 0.02]) - stability.MARGINAL
    assert stability.excess(M, shaking) == pytest.approx(beyond[0], rel=1e-9)
    assert stability.excess(M, toppling) == pytest.approx(beyond[1], rel=1e-9)
    assert stability.excess(M) == pytest.approx(beyond[1], rel=1e-9)
    still = np.eye(1) * (1.0 + 1e-6)
    assert stability.excess(still) > 0.0
    assert stability.excess(still, stability.moving) == -1.0


@pytest.mark.parametrize("at", [1e-6, 0.3, 7.0])
def test_where_a_root_begins_to_grow_is_found_to_rounding(at):
    def growth(value):
        return stability.excess(np.diag([0.5, (1.0 + stability.MARGINAL) * (value / at) ** 3]))

    assert stability.switch(growth, 0.1 * at, 3.0 * at) == pytest.approx(at, rel=1e-12)
    assert stability.switch(lambda value: -growth(value), 0.1 * at, 3.0 * at) == pytest.approx(at)
    assert stability.switch(growth, 0.1 * at, 0.2 * at) == 0.2 * at  # it does not change
