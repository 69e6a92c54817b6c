"""Sequential quadratic programming, where the optimum is known in closed form or to SciPy."""

import numpy as np
import pytest
from scipy.optimize import minimize

from jaxact.tune.newton import inside, newton
from jaxact.tune.polish import MET, Rows, polish

Q = np.array([[2.0, 0.3, 0.0], [0.3, 1.0, -0.4], [0.0, -0.4, 3.0]])
SIDE = np.array([1.0, -0.5, 0.2])
BOUND = 10.0 * np.ones(3)


def _rows(value, slope):
    """An ellipsoid and a half-space, with some value."""

    def of(points):
        (x,) = points
        excess = np.array([0.5 * x @ Q @ x - 1.0, SIDE @ x - 0.4, -np.inf])
        slopes = np.stack([Q @ x, SIDE, np.zeros(3)])
        return Rows(np.array([[value(x)]]), slope(x)[None, None], excess[None], slopes[None],
                    np.ones(1, bool))  # fmt: skip

    return of


def _curvature(x, weights):
    return weights[0] * Q


@pytest.mark.parametrize("start", [np.zeros(3), np.array([0.2, -0.3, 0.1])])
def test_a_straight_value_ends_on_the_ellipsoid_to_the_last_digits(start):
    along = np.array([-1.0, 2.0, 0.7])
    found = newton(_rows(lambda x: along @ x, lambda x: along), _curvature, start, -BOUND, BOUND)
    best = np.linalg.solve(Q, along)
    best *= np.sqrt(2.0 / (best @ Q @ best))
    assert SIDE @ best < 0.4 and found.violation[0] <= MET
    np.testing.assert_allclose(found.x[0], best, atol=1e-5)
    assert found.value[0] == pytest.approx(along @ best, abs=1e-9)


def test_a_curved_value_is_learnt_on_the_way():
    centre = np.array([1.0, 0.4, -0.2])

    def value(x):
        return -np.sum((x - centre) ** 2) - 0.1 * np.sum(x**4)

    def slope(x):
        return -2.0 * (x - centre) - 0.4 * x**3

    found = newton(_rows(value, slope), _curvature, np.zeros(3), -BOUND, BOUND)
    limits = [{"type": "ineq", "fun": lambda x: 1.0 - 0.5 * x @ Q @ x},
              {"type": "ineq", "fun": lambda x: 0.4 - SIDE @ x}]  # fmt: skip
    best = minimize(lambda x: -value(x), np.zeros(3), constraints=limits, tol=1e-12)
    assert found.violation[0] <= MET
    assert found.value[0] == pytest.approx(-best.fun, abs=1e-6)


def test_bounds_are_never_left():
    along = np.array([1.0, 0.0, 0.0])
    high = np.array([0.1, 0.2, 0.2])
    found = newton(_rows(lambda x: along @ x, lambda x: along), _curvature, np.zeros(3),
                   -high, high)  # fmt: skip
    assert found.value[0] == pytest.approx(0.1, abs=1e-9) and np.all(np.abs(found.x[0]) <= high)


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_constraints_that_a_point_does_not_show_are_remembered(seed):
    """Many valleys in 12 dimensions, of which a point shows the two that are worst there.

    So are the singular values of a robot with many joints; the optimum is SciPy's, who sees all.
    """
    random, size, number = np.random.default_rng(seed), 12, 40
    A = random.normal(size=(number, size))
    level, bend = random.uniform(0.3, 1.0, number), random.uniform(1.0, 6.0, number)
    up, bound = np.ones(size) / size, np.full(size, 5.0)

    def excess(x):
        along = A @ x
        return 0.5 * bend * along**2 + 0.6 * along - level

    def two(points):
        (x,) = points
        worst = np.argsort(-excess(x))[:2]
        slope = (bend * (A @ x) + 0.6)[worst, None] * A[worst]
        return Rows(np.array([[up @ x]]), up[None, None], excess(x)[worst][None], slope[None],
                    np.ones(1, bool))  # fmt: skip

    def reached(memory):
        x = np.zeros((1, size))
        for steps, radius in ((8, 0.15), (40, 0.05)):
            found = polish(two, x, -bound[None], bound[None], steps=steps, worth=3e-4,
                           radius=radius, kinks=False, memory=memory)  # fmt: skip
            x = inside(two, found.end[0], found, -bound, bound).x
        assert excess(x[0]).max() <= MET
        return up @ x[0]

    best = -minimize(lambda x: -up @ x, np.zeros(size), method="SLSQP",
                     constraints={"type": "ineq", "fun": lambda x: -excess(x)}).fun  # fmt: skip
    assert 0.85 * best < reached(12) <= best * 1.001
    assert reached(0) < 0.8 * best
