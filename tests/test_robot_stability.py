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
    assert shown > (0 if size == 30 else 25)


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
