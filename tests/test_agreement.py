"""The comparison of verdicts with exact theory, against scipy and against planted mistakes."""

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from synthetic_store import DRAWN, GRID, dataset, radius

from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.sweeping import agreement


@pytest.fixture(scope="module")
def whole():
    return dataset(GRID)


@pytest.fixture
def results(whole):
    """A dataset of one's own, to be changed at will."""
    return whole.copy(deep=True)


@pytest.mark.parametrize("text", [GRID, DRAWN])
def test_spectral_radii_equal_scipys(text):
    values = expand(reading.parse(text)).values
    found = agreement.spectral_radii(values)
    expected = [radius(values, index) for index in range(len(found))]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_exact_verdicts_agree(results):
    found = agreement.sweep_agreement(results)
    assert found.disagreements == 0
    assert found.furthest == 0.0
    assert found.compared == found.samples == 480


def test_planted_mistakes_are_counted_and_placed(results):
    growth, verdict = results["growth_rate"].values, results["verdict"].values
    stable, unstable = np.argwhere(growth < -5)[0], np.argwhere(growth > 5)[0]
    verdict[tuple(stable)], verdict[tuple(unstable)] = 2, 0
    found = agreement.sweep_agreement(results)
    assert (found.pessimistic, found.optimistic) == (1, 1)
    worst = max(abs(growth[tuple(stable)]), growth[tuple(unstable)])
    np.testing.assert_allclose(found.fastest, worst, rtol=1e-6)
    assert found.furthest > 0.0


def test_invalid_loops_are_not_compared(results):
    results["verdict"].values[0, 0, 0, :] = 3
    found = agreement.sweep_agreement(results)
    assert found.samples - found.compared == 10
    assert found.disagreements == 0


def test_gain_distance_brackets_the_border():
    values = expand(reading.parse(GRID)).values
    values = {name: np.array(array[200:230]) for name, array in values.items()}
    stable = agreement.spectral_radii(values) < 1.0
    distance = agreement.gain_distances(values, stable)
    reached = np.isfinite(distance)
    assert reached.any()

    def changes(share):
        """Whether any of the six directions leaves the loop's side of the border."""
        changed = np.zeros(len(stable), dtype=bool)
        for on_kp, on_kd in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1)):
            factor = 1.0 + share * np.where(reached, distance, 0.0)
            moved = values | {
                "kp": values["kp"] * factor**on_kp,
                "kd": values["kd"] * factor**on_kd,
            }
            changed |= (agreement.spectral_radii(moved) < 1.0) != stable
        return changed

    assert changes(1.0)[reached].all()
    assert not changes(0.79)[reached].any()


def test_boundary_only_where_nothing_else_varies(results):
    window = ((10.0, 1e5), (0.1, 2000.0))
    part = results.isel(actuator=1, delay=0)
    found = agreement.exact_boundary(part, *window)
    assert any(curve.separates for curve in found.sampled)
    assert any(curve.separates for curve in found.continuous)
    assert agreement.exact_boundary(results, *window) is None


def test_boundary_separates_the_exact_verdicts(results):
    part = results.isel(actuator=1, delay=0)
    found = agreement.exact_boundary(part, (10.0, 1e5), (0.1, 2000.0))
    curve = next(curve for curve in found.sampled if curve.separates)
    middle = len(curve.kp) // 2
    values = {name: np.array([float(agreement.store.parameter(part, name))] * 2)
              for name in agreement.LINEAR_PARAMETERS[2:]}  # fmt: skip
    inside_out = np.array([0.999, 1.001])
    radii = agreement.spectral_radii(
        values | {"kp": curve.kp[middle] * inside_out, "kd": curve.kd[middle] * inside_out}
    )
    assert (radii < 1.0).sum() == 1


@pytest.mark.exhaustive
def test_of_very_many_loops_an_even_part_is_looked_at(results, monkeypatch):
    results["verdict"].values[..., ::7] = 2
    whole = agreement.sweep_agreement(results)
    monkeypatch.setattr(agreement, "_LOOKED_AT", 100)
    found = agreement.sweep_agreement(results)
    verdict = results["verdict"].values.ravel()[::5]
    values = expand(reading.parse(GRID)).values
    unstable = np.array([radius(values, index) >= 1.0 for index in range(0, 480, 5)])
    assert (found.samples, found.compared) == (480, 96)
    assert found.disagreements == np.sum((verdict != 0) != unstable)
    assert 0 < found.disagreements < whole.disagreements
