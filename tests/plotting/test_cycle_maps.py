"""Maps of the amplitude and the frequency of limit cycles: only limit cycles are coloured."""

import numpy as np
import pytest
from matplotlib.colors import LogNorm
from synthetic_store import DRAWN, GRID, dataset

from jaxact.errors import UserError
from jaxact.plotting.field import field, settled
from jaxact.plotting.panels import arrange
from jaxact.plotting.scatter import scatter
from jaxact.plotting.stability_map import stability_map
from jaxact.status import Verdict


def _with_cycles(found):
    """With an amplitude over three decades where there is a limit cycle, and 0 elsewhere."""
    cycling = found["verdict"].values == Verdict.LIMIT_CYCLE
    assert cycling.any() and (found["verdict"].values == Verdict.STABLE).any()
    amplitude = np.where(cycling, np.geomspace(1e-5, 1e-2, cycling.size).reshape(cycling.shape), 0)
    frequency = np.where(cycling, 80.0, np.nan)
    frequency[tuple(np.argwhere(cycling)[0])] = np.nan  # an irregular one
    dims = found["verdict"].dims
    return found.assign(
        limit_cycle_amplitude=(dims, amplitude, {"units": "m"}),
        limit_cycle_frequency=(dims, frequency, {"units": "rad/s"}),
    )


@pytest.fixture(scope="module")
def grid():
    return _with_cycles(dataset(GRID))


def _words(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def _meshes(figure):
    return [
        next(c for c in axes.collections if hasattr(c, "get_coordinates"))
        for axes in figure.axes
        if axes.get_label() != "<colorbar>" and axes.get_visible()
    ]


def test_only_limit_cycles_are_coloured_on_a_logarithmic_scale(grid):
    arrangement = arrange(grid)
    figure = stability_map(grid, arrangement, variable="limit_cycle_amplitude")
    for mesh, panel in zip(_meshes(figure), arrangement.panels, strict=True):
        assert isinstance(mesh.norm, LogNorm)
        masked = np.ma.getmaskarray(mesh.get_array())
        np.testing.assert_array_equal(~masked, panel.data["verdict"].values == Verdict.LIMIT_CYCLE)
    assert _words(figure)[:3] == ["limit cycle", "stable: no limit cycle", "unstable"]
    hatches = {
        hatch
        for axes in figure.axes
        for c in axes.collections
        for hatch in getattr(c, "hatches", [])
    }
    assert "...." not in hatches, "dots would only hide the colour"


def test_a_limit_cycle_without_a_frequency_is_told_from_what_settles(grid):
    figure = stability_map(grid, arrange(grid), variable="limit_cycle_frequency")
    words = _words(figure)
    assert "limit cycle without a frequency" in words and "stable: no limit cycle" in words


def test_one_amplitude_alone_has_a_scale(grid):
    amplitude = grid["limit_cycle_amplitude"]
    shown = field(grid.assign(limit_cycle_amplitude=(amplitude * 0.0 + 2e-3)), amplitude.name)
    assert isinstance(shown.norm, LogNorm) and shown.norm.vmin < 2e-3 < shown.norm.vmax


def test_a_sweep_without_a_limit_cycle_says_so(grid):
    stable = grid.copy(deep=True)
    stable["verdict"].values[:] = Verdict.STABLE
    with pytest.raises(UserError, match="no loop of this sweep is a limit cycle"):
        field(stable, "limit_cycle_amplitude")
    assert np.isnan(settled(stable, "limit_cycle_amplitude")).all()


def test_a_random_sample_names_its_grey_points():
    drawn = _with_cycles(dataset(DRAWN))
    figure = scatter(drawn, arrange(drawn), variable="limit_cycle_amplitude")
    assert "grey: no limit cycle" in _words(figure)
    plain = scatter(drawn, arrange(drawn), variable="growth_rate")
    assert "grey: no limit cycle" not in _words(plain)
