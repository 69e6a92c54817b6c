"""The pictures of a sweep: what is drawn, and that it can be read without colour."""

import itertools
import json

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm, Normalize, SymLogNorm, to_rgb
from quickly import compiled_quickly as compiled_quickly
from synthetic_store import DRAWN, GRID, dataset

from jaxact.errors import UserError
from jaxact.plotting import caption, theme
from jaxact.plotting.field import field
from jaxact.plotting.lines import lines
from jaxact.plotting.panels import arrange
from jaxact.plotting.scatter import scatter
from jaxact.plotting.stability_map import cell_edges, stability_map
from jaxact.plotting.zero_line import zero_line
from jaxact.status import Verdict
from jaxact.sweeping import agreement
from jaxact.sweeping.exact_lines import Window, exact_lines


@pytest.fixture(scope="module")
def grid():
    return dataset(GRID)


def _boundaries(arrangement):
    return [
        exact_lines(panel.data, Window("kp", 10.0, 1e5, True), Window("kd", 0.1, 2000.0, True))
        for panel in arrangement.panels
    ]


def _panels(figure):
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>" and axes.get_visible()]


def _inside_the_page(figure):
    """Every text lies on the page, and no two texts of the figure itself overlap."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    page, renderer = figure.bbox, canvas.get_renderer()
    own = [text.get_window_extent(renderer) for text in figure.texts if text.get_text().strip()]
    own += [legend.get_window_extent(renderer) for legend in figure.legends]
    for box in own:
        assert page.x0 - 1 <= box.x0 and box.x1 <= page.x1 + 1
        assert page.y0 - 1 <= box.y0 and box.y1 <= page.y1 + 1
    for first, second in itertools.combinations(own, 2):
        assert not first.overlaps(second)
    for axes in _panels(figure):
        tight = axes.get_tightbbox(renderer)
        assert not any(tight.overlaps(box) for box in own)


@pytest.mark.exhaustive
def test_map_draws_field_border_boundary_and_star(grid):
    arrangement = arrange(grid)
    figure = stability_map(
        grid, arrangement, boundaries=_boundaries(arrangement), nominal=(400.0, 20.0),
        title="A title that is so long that it has to be cut " * 6, footer="words " * 80,
    )  # fmt: skip
    panels = _panels(figure)
    assert len(panels) == 4
    for axes, panel in zip(panels, arrangement.panels, strict=True):
        mesh = next(c for c in axes.collections if hasattr(c, "get_coordinates"))
        np.testing.assert_array_equal(mesh.get_array(), panel.data["growth_rate"])
        assert isinstance(mesh.norm, SymLogNorm) and mesh.norm.vmin == -mesh.norm.vmax
        styles = {line.get_linestyle() for line in axes.lines}
        assert {"-", "--"} <= styles
        assert any(line.get_marker() == "*" for line in axes.lines)
        assert axes.get_xscale() == axes.get_yscale() == "log"
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[:3] == ["stable", "limit cycle", "unstable"]
    assert "nominal: kp 400 N/m, kd 20 N s/m" in labels
    _inside_the_page(figure)


def test_map_says_units_and_where_the_cells_are(grid):
    arrangement = arrange(grid)
    axes = _panels(stability_map(grid, arrangement))[2]
    assert axes.get_xlabel() == "stiffness kp [N/m]"
    assert axes.get_ylabel() == "damping kd [N s/m]"
    edges = cell_edges(arrangement.x)
    centres = np.sqrt(edges[1:] * edges[:-1])
    np.testing.assert_allclose(centres, arrangement.x.values, rtol=1e-12)


def test_verdicts_are_hatched_differently(grid):
    figure = stability_map(grid, arrange(grid))
    hatches = {
        hatch for axes in _panels(figure) for c in axes.collections for hatch in [c.get_hatch()]
    } | {h for axes in _panels(figure) for c in axes.collections for h in getattr(c, "hatches", [])}
    assert {"....", "////"} <= hatches


def test_growth_colours_differ_in_grey_and_are_centred():
    colors = theme.diverging()
    grey = [np.dot(to_rgb(colors(x)), (0.299, 0.587, 0.114)) for x in np.linspace(0, 1, 201)]
    assert np.argmax(grey) == 100
    assert np.all(np.diff(grey[:101]) > -1e-3) and np.all(np.diff(grey[100:]) < 1e-3)
    steps = np.diff(look_at := [np.dot(to_rgb(theme.sequential()(x)), (0.3, 0.59, 0.11))
                                for x in np.linspace(0, 1, 51)])  # fmt: skip
    assert np.all(steps < 1e-3) and look_at[-1] > 0.3


def test_colours_of_other_results_leave_out_what_exploded(grid):
    figure = stability_map(grid, arrange(grid), variable="overshoot")
    mesh = next(c for c in _panels(figure)[0].collections if hasattr(c, "get_coordinates"))
    verdict = arrange(grid).panels[0].data["verdict"].values
    assert np.ma.getmaskarray(mesh.get_array())[verdict == 2].all()


def test_peaks_are_drawn_on_a_logarithmic_scale(grid):
    """What matters of Ms lies between 1 and 3; beside the boundary it has any value."""
    for name, kind in (("sensitivity_peak", LogNorm), ("overshoot", Normalize)):
        drawn = grid.copy(deep=True)
        drawn[name] = drawn["verdict"] * 0.0 + np.linspace(
            1.1, 20.0, drawn["verdict"].size
        ).reshape(drawn["verdict"].shape)
        drawn["verdict"][:] = int(Verdict.STABLE)
        assert type(field(drawn, name).norm) is kind


def test_caption_of_a_loop_says_what_is_left_of_its_motion():
    static = {"engine": "mass", "velocity": "sampled"}
    values = {"control_rate": 500.0, "kp": 80.0, "kd": 1.5, "mass": 0.02, "gain_scale": 1.0,
              "position_resolution": 0.0015}  # fmt: skip
    found = {"growth_rate": -4.7, "overshoot": 0.5, "settling_time": 0.7,
             "limit_cycle_amplitude": 0.00156, "limit_cycle_frequency": 103.0}  # fmt: skip
    words = {kind: caption.loop(values, found | {"verdict": int(kind)}, static, "rad")
             for kind in (Verdict.STABLE, Verdict.LIMIT_CYCLE, Verdict.UNSTABLE)}  # fmt: skip
    assert all("position resolution 0.0015 rad" in text for text in words.values())
    assert "limit cycle of 0.00156 rad at 103 rad/s" in words[Verdict.LIMIT_CYCLE]
    assert [("overshoot" in text, "settled" in text) for text in words.values()] == [
        (True, True), (False, False), (False, False)
    ]  # fmt: skip


def test_scale_without_any_spread(grid):
    flat = grid.assign(overshoot=grid["overshoot"] * 0.0 + 0.25)
    _inside_the_page(stability_map(flat, arrange(flat), variable="overshoot"))


@pytest.mark.parametrize("name", ["overshot", "verdict", ""])
def test_unknown_variable(grid, name):
    with pytest.raises(UserError, match="unknown variable"):
        field(grid, name)


def test_variable_without_a_finite_value(grid):
    with pytest.raises(UserError, match="no finite value"):
        field(grid.assign(overshoot=grid["overshoot"] * np.nan), "overshoot")


def test_invalid_loops_are_shown_as_such(grid):
    broken = grid.copy(deep=True)
    broken["verdict"].values[:, :, -2:, :] = 3
    broken["growth_rate"].values[:, :, -2:, :] = np.nan
    figure = stability_map(broken, arrange(broken))
    assert "invalid" in [text.get_text() for text in figure.legends[0].get_texts()]


def test_scatter_draws_every_loop_once():
    drawn = dataset(DRAWN)
    arrangement = arrange(drawn)
    figure = scatter(drawn, arrangement, boundaries=_boundaries(arrangement), nominal=(400.0, 20.0))
    for axes in _panels(figure):
        assert sum(len(c.get_offsets()) for c in axes.collections) == 40
    _inside_the_page(figure)


def test_lines_draw_every_value(grid):
    arrangement = arrange(grid, kind="lines", x="kd", y="delay", select={"kp": "400"})
    figure = lines(grid, arrangement, nominal=20.0, title="t", footer="f")
    axes = _panels(figure)[0]
    drawn = [line for line in axes.lines if len(line.get_xdata()) == 10]
    np.testing.assert_array_equal(
        drawn[0].get_ydata(), arrangement.panels[0].data["growth_rate"].isel(delay=0)
    )
    assert axes.get_yscale() == "symlog"
    _inside_the_page(figure)
    other = lines(grid, arrangement, variable="settling_time")
    assert _panels(other)[0].get_ylabel() == "settling time [s]"


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_files_are_whole_and_the_same_each_time(grid, tmp_path, ending):
    path = tmp_path / f"map.{ending}"
    arrangement = arrange(grid, select={"actuator": "hyq", "delay": "0"})
    theme.write(stability_map(grid, arrangement), path, title="t")
    first = path.read_bytes()
    theme.write(stability_map(grid, arrangement), path, title="t")
    assert path.read_bytes() == first and len(first) > 5000
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_small_print_counts_and_places_disagreements():
    one = agreement.Agreement(1000, 1000, 1, 0, 0.004, 0.3)
    assert caption.compared(one) == (
        "1 verdict (0.1 %) differs from the exact stability of the sampled loop: within 0.4 % of "
        "the boundary in gain, exact growth rate within ±0.3/s."
    )
    none = agreement.Agreement(1000, 500, 0, 0, 0.0, 0.0)
    assert "of 500 compared" in caption.compared(none)
    far = agreement.Agreement(1000, 1000, 5, 5, float("inf"), 3.0)
    assert "up to a factor inf" in caption.compared(far)


def test_small_print_says_what_theory_leaves_out(grid):
    assert caption.linear_only(grid) == ""
    older = json.loads(grid.attrs["parameters"])
    del older["stall_force"], older["position_bias_walk"]  # newer than the store
    assert caption.linear_only(grid.assign_attrs(parameters=json.dumps(older))) == ""
    assert "without its force limit" in caption.linear_only(dataset(DRAWN))
    assert caption.simulated(grid).startswith("Simulated: exact mass plant, control at 1 kHz")


def test_a_linearised_boundary_is_a_smooth_line_where_the_growth_rate_is_zero():
    """Of exact growth rates on a grid: near the exact boundary, far nearer than a cell."""
    found = dataset(
        "[parameters]\nactuator = 'starleth'\ndelay = 0.005\n[axes]\n"
        "kp = { min = 100, max = 1e4, num = 21, spacing = 'log' }\n"
        "kd = { min = 5, max = 500, num = 21, spacing = 'log' }\n"
    )
    arrangement = arrange(found)
    lines_found = zero_line(arrangement, arrangement.panels[0])
    window = Window("kp", 100.0, 1e4, True), Window("kd", 5.0, 500.0, True)
    exact = exact_lines(arrangement.panels[0].data, *window).sampled
    assert lines_found
    cell = np.log(100.0) / 20.0
    for kp, kd in lines_found:
        for x, y in zip(kp, kd, strict=True):
            near = [np.hypot(np.log(a / x), np.log(b / y)).min() for a, b in exact]
            assert min(near) < 0.25 * cell
    figure = stability_map(found, arrangement, linearised=True)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "linearised boundary" in labels
    # A loop without a growth rate leaves a gap, and no line around itself.
    holed = found.copy(deep=True)
    holed["growth_rate"][3, 3] = np.nan
    arrangement = arrange(holed)
    pieces = zero_line(arrangement, arrangement.panels[0])
    assert sum(np.isfinite(kp).sum() for kp, _ in pieces) <= sum(len(kp) for kp, _ in lines_found)


def test_a_short_logarithmic_axis_is_labelled_within_its_decades():
    found = dataset(
        "[parameters]\nactuator = 'hyq'\n[axes]\nkp = [50, 100, 200, 400, 800]\n"
        "kd = { min = 1, max = 1e4, num = 5, spacing = 'log' }\n"
    )
    figure = stability_map(found, arrange(found))
    FigureCanvasAgg(figure).draw()
    axes = _panels(figure)[0]
    kp = [text.get_text() for text in axes.get_xticklabels(which="both")]
    assert {"50", "100", "200", "500"} <= set(kp)
    kd = [text.get_text() for text in axes.get_yticklabels(which="both")]
    assert [word for word in kd if word] == ["1", "10", "100", "1000", "10000"]
