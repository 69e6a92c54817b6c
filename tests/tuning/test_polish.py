"""Linear programmes of many problems at once: each as SciPy solves it alone."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from jaxact.tuning import polish

_RANDOM = np.random.default_rng(3)
SIZE, VALUES, BOUNDS = 3, 4, 6


@pytest.fixture(scope="module")
def problems():
    """Cuts about the present point, sides, and violations, of problems of all kinds."""
    cuts, sides = [], []
    for number in range(12):
        # Met, not met but within reach, and out of reach.
        beyond = (-0.5, 0.1, 5.0)[number % 3]
        rows = VALUES + number, BOUNDS if number else 0
        slopes = [_RANDOM.normal(size=(count, SIZE)) for count in rows]
        cuts.append(
            polish._Cuts(
                _RANDOM.normal(size=rows[0]), slopes[0],
                beyond + 0.3 * _RANDOM.random(rows[1]), slopes[1],
            )
        )  # fmt: skip
        radius = _RANDOM.uniform(0.05, 0.5)
        sides.append([np.full(SIZE, -radius), np.full(SIZE, radius)])
    violation = np.array([cut.excess.max(initial=0.0) for cut in cuts])
    return cuts, np.array(sides), violation


def _alone(cuts, sides):
    """Step, smallest value and largest excess there, by unknowns (step, t, e)."""
    rows = np.r_[
        np.c_[-cuts.value_slope, np.ones(len(cuts.value)), np.zeros(len(cuts.value))],
        np.c_[cuts.excess_slope, np.zeros(len(cuts.excess)), -np.ones(len(cuts.excess))],
    ]
    found = scipy.optimize.linprog(
        [*np.zeros(SIZE), -1.0, polish._ELASTIC], rows, np.r_[cuts.value, -cuts.excess],
        bounds=[*sides.T, (None, None), (0.0, None)], method="highs-ipm",
    )  # fmt: skip
    return found.x[:SIZE], found.x[SIZE], found.x[SIZE + 1]


def test_each_step_is_that_of_the_problem_alone(problems):
    cuts, sides, violation = problems
    step, weight, gain = polish._linear_steps(cuts, sides, violation)
    unmet = 0
    for i, cut in enumerate(cuts):
        want, target, slack = _alone(cut, sides[i])
        np.testing.assert_allclose(step[i], want, atol=1e-7)
        assert (weight[i] == polish._ELASTIC) == (slack > 1e-6)
        promised = target - cut.value.min() + weight[i] * (max(violation[i], 0.0) - slack)
        assert gain[i] == pytest.approx(promised, abs=1e-5)
        unmet += slack > 1e-6
    assert 0 < unmet < len(cuts)


def test_one_that_cannot_be_solved_stops_no_other(problems):
    cuts, sides, violation = problems
    want, _, _ = polish._linear_steps(cuts, sides, violation)
    wrong = sides.copy()
    wrong[5] = wrong[5, ::-1]  # the smallest step is larger than the largest
    last = cuts[9]
    nothing = replace(last, value=last.value[:0], value_slope=last.value_slope[:0])
    cuts = [*cuts[:9], nothing]
    step, weight, gain = polish._linear_steps(cuts, wrong[:10], violation[:10])
    rest = np.delete(np.arange(10), [5, 9])
    np.testing.assert_allclose(step[rest], want[rest], atol=1e-9)
    assert not step[[5, 9]].any() and not gain[[5, 9]].any() and np.all(weight[[5, 9]] == 1.0)
