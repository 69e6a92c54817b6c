"""Refinement around a border: few points, the right ones, on theory and in a sweep."""

import json

import numpy as np
import pytest
from exact import growth_rate as exact_growth_rate
from quickly import compiled_quickly as compiled_quickly
from synthetic_store import fake_plan
from test_resume import contents

from jaxact.cli.main import main
from jaxact.cli.sweep import _how_to_resume
from jaxact.errors import InexactWarning, UserError
from jaxact.loops import reading
from jaxact.plotting import even_grid
from jaxact.plotting.panels import arrange
from jaxact.sweeping import adaptive, execution, location, opening, store
from jaxact.sweeping.refinement import Lattice, Refinement
from jaxact.verbs import map_pictures

TEXT = """
[parameters]
actuator = "starleth"
[axes]
delay = [0.0, 0.005]
kp = { min = 10, max = 1e5, num = 13, spacing = "log" }
kd = { min = 0.1, max = 2000, num = 13, spacing = "log" }
"""


def _refined(lattice, inside):
    """Points asked for, with what is there: whether `inside(case, places)`."""
    refinement, points = Refinement(lattice), []
    while refinement.ask().size:
        asked = refinement.ask()
        points.append(asked)
        refinement.tell(inside(*lattice.places(asked)).astype(int))
    points = np.concatenate(points)
    assert np.unique(points).size == points.size, "a point was computed twice"
    return points


def _circle(lattice):
    """A disc, and around it nothing else; in fractions of the square."""
    size = np.array(lattice.shape) - 1

    def inside(case, places):
        at = places / size - 0.5
        return np.hypot(at[:, 0], at[:, 1]) < 0.31 + 0.1 * case

    return inside


def test_a_closed_curve_is_found_to_the_finest_cell_with_few_points():
    lattice = Lattice(cases=2, cells=(8, 8), halvings=(7, 7))
    inside = _circle(lattice)
    points = _refined(lattice, inside)
    share = points.size / (lattice.cases * lattice.size)
    assert share < 0.02
    known = set(points.tolist())
    # every step of the finest lattice at which the answer changes has both its ends computed
    for case in range(2):
        grid = np.stack(np.meshgrid(*map(np.arange, lattice.shape), indexing="ij"), -1)
        flat = grid.reshape(-1, 2)
        answers = inside(np.full(len(flat), case), flat).reshape(lattice.shape)
        for axis in (0, 1):
            change = np.argwhere(np.diff(answers.astype(int), axis=axis) != 0)
            for end in (0, 1):
                ends = change.copy()
                ends[:, axis] += end
                numbers = lattice.points(np.full(len(ends), case), ends)
                assert known.issuperset(numbers.tolist())


def test_a_bulge_between_coarse_points_is_followed_into_its_neighbour():
    lattice = Lattice(cases=1, cells=(4, 4), halvings=(5, 5))

    def inside(case, places):
        x, y = places[:, 0] / 32, places[:, 1] / 32
        # a bump over the edge of the coarse cells at y = 2, between their corners at x = 1 and 2
        return y < 1.7 + 0.8 * np.exp(-(((x - 1.5) / 0.2) ** 2))

    known = set(_refined(lattice, inside).tolist())
    top = np.array([[int(1.5 * 32), int(2.5 * 32) - 1], [int(1.5 * 32), int(2.5 * 32)]])
    assert known.issuperset(lattice.points(np.zeros(2, int), top).tolist())


def _cells_left_coarse(known, codes, halvings):
    """Blocks of points, known and what is there, of all cells that are not halved."""
    for level in range(halvings):
        step = 2 ** (halvings - level)
        corners = known[::step, ::step]
        whole = corners[1:, 1:] & corners[1:, :-1] & corners[:-1, 1:] & corners[:-1, :-1]
        # only the halves of a cell have its centre for a corner
        halved = known[step // 2 :: step, step // 2 :: step]
        for i, j in np.argwhere(whole & ~halved) * step:
            block = slice(i, i + step + 1), slice(j, j + step + 1)
            yield known[block], codes[block]


def test_no_cell_that_stays_coarse_holds_a_point_that_disagrees():
    """Whether the neighbour's finer points were there before the cell, or came after it."""
    lattice = Lattice(cases=1, cells=(7, 7), halvings=(5, 5))
    at = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, n) for n in lattice.shape], indexing="ij"))
    chance = np.random.default_rng(1)
    cells = 0
    for _ in range(6):
        waves, phases = chance.normal(size=(4, 2)) * 15, chance.uniform(0, 6, 4)
        fields = np.sin(np.tensordot(waves, at, 1) + phases[:, None, None])
        codes = fields.sum(axis=0) > 0.7 * chance.normal()
        points = _refined(lattice, lambda case, places, codes=codes: codes[tuple(places.T)])
        known = np.zeros(lattice.size, bool)
        known[points] = True
        for there, inside in _cells_left_coarse(known.reshape(lattice.shape), codes, 5):
            assert np.all(inside[there] == inside[0, 0])
            cells += 1
    assert cells > 1000


@pytest.mark.parametrize("axes", [1, 3])
def test_any_number_of_axes(axes):
    lattice = Lattice(cases=1, cells=(3,) * axes, halvings=(4, 5, 3)[:axes])
    size = np.array(lattice.shape) - 1
    points = _refined(lattice, lambda case, places: (places / size).sum(axis=1) < 0.4 * axes)
    assert points.size < 0.5 * lattice.size


def test_without_a_border_only_the_coarse_grid_is_computed():
    lattice = Lattice(cases=3, cells=(4, 5), halvings=(6, 6))
    points = _refined(lattice, lambda case, places: case == 1)
    assert points.size == 3 * 5 * 6


def _exact(samples):
    v = samples.values
    each = zip(v["kp"], v["kd"], v["delay"], strict=True)
    return np.array(
        [exact_growth_rate([p], [d], 0.7, 110.0, 0.9, delay)[0] for p, d, delay in each]
    )


def _teller(upto=None):
    """Workers that know the exact growth rates, and stop after some chunks."""
    left = [upto]

    def work(work, numbers, begin):
        for count, number in enumerate(numbers):
            if left[0] == 0:
                raise KeyboardInterrupt
            if count == 0:
                begin()
            first, size = work.store.layout.span(number)
            columns = {k: v[first : first + size] for k, v in work.samples.values.items()}
            part = type(work.samples)(columns, ("sample",), (size,), {})
            growth = _exact(part)
            absent = np.full(size, np.nan)
            rows = dict.fromkeys(store.VARIABLES, absent)
            rows |= {"growth_rate": growth, "verdict": np.where(growth < 0, 0, 2)}
            work.store.write(number, rows, work.store.tile)
            left[0] = None if left[0] is None else left[0] - 1
            yield number

    return work


def _sweep(folder, *, text=TEXT, width=0.05, upto=None, **options):
    how = execution.SweepOptions(
        width=width, planner=lambda asked, all_: fake_plan(asked, all_, loops=64),
        workers=_teller(upto), **options,
    )  # fmt: skip
    return execution.sweep(reading.parse(text), location.at(folder), how)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("adaptive")
    _sweep(folder)
    return folder


def test_the_border_of_stability_is_found_to_the_width_asked_for(whole):
    results = opening.open_result(whole).load()
    said = json.loads(results.attrs["adaptive"])
    assert said["refined"] == ["kp", "kd"] and said["cases"] == ["delay"]
    kp, kd = results["kp"].values, results["kd"].values
    stable = results["growth_rate"].values < 0
    for delay in (0.0, 0.005):
        for gain in np.unique(kd)[:: max(1, np.unique(kd).size // 5)]:
            line = (results["delay"].values == delay) & (kd == gain)
            order = np.argsort(kp[line])
            steps = kp[line][order]
            changes = np.flatnonzero(np.diff(stable[line][order].astype(int)))
            assert np.all(steps[changes + 1] / steps[changes] <= 1.05 + 1e-9)
    assert results.attrs["complete"] and "loops" in results.attrs["summary"]
    assert sorted(item.name for item in whole.iterdir()) == [store.STORE]


@pytest.mark.exhaustive
def test_it_is_drawn_as_a_map_of_the_nearest_samples(whole, tmp_path):
    results = opening.open_result(whole).load()
    grid = even_grid.resampled(results)
    assert grid["growth_rate"].dims == ("delay", "kp", "kd") and grid["kp"].attrs["units"] == "N/m"
    chance = np.random.default_rng(0)
    for _ in range(50):
        at = {name: int(chance.integers(grid.sizes[name])) for name in grid.dims}
        cell = grid.isel(at)
        mine = np.flatnonzero(results["delay"].values == float(cell["delay"]))
        far = [
            np.log(results[name].values[mine] / float(cell[name])) / np.log(high / low)
            for name, low, high in (("kp", 10, 1e5), ("kd", 0.1, 2000))
        ]
        nearest = mine[np.argmin(np.hypot(*far))]
        assert float(cell["growth_rate"]) == float(results["growth_rate"].values[nearest])
    assert arrange(grid).kind == "map" and len(arrange(grid).panels) == 2
    assert main(["plot", str(whole), "--out", str(tmp_path / "map.png"), "--quick"]) == 0
    assert (tmp_path / "map.png").stat().st_size > 10_000


@pytest.mark.exhaustive
def test_an_interrupted_refinement_comes_to_the_same_points(whole, tmp_path):
    for upto in (2, 3, 3):
        with pytest.raises(KeyboardInterrupt):
            _sweep(tmp_path, upto=upto, resume=True)
    assert not (tmp_path / store.STORE).exists()
    with pytest.raises(UserError, match="seed = 0 there, 1 here"):
        _sweep(tmp_path, text="seed = 1\n" + TEXT, resume=True)
    _sweep(tmp_path, resume=True)
    assert contents(tmp_path) == contents(whole)
    _sweep(tmp_path, resume=True, upto=0)
    with pytest.raises(UserError, match="width"):
        _sweep(tmp_path, resume=True, width=0.1)


def test_one_begun_by_another_rule_of_refinement_is_not_continued(tmp_path, monkeypatch):
    """Its rounds are of other points, and are known by their numbers only."""
    with monkeypatch.context() as before:
        before.setattr(adaptive, "RULE", 1)
        with pytest.raises(KeyboardInterrupt):
            _sweep(tmp_path, upto=2)
    there = contents(tmp_path)
    with pytest.raises(UserError, match="refinement = 1 there, 2 here; .* begin anew"):
        _sweep(tmp_path, resume=True, upto=0)
    assert contents(tmp_path) == there


@pytest.fixture(scope="module")
def filtered(tmp_path_factory):
    """Of two cutoffs, the second of them infinite, which JSON has as a string."""
    folder = tmp_path_factory.mktemp("filtered")
    text = TEXT.replace("delay = [0.0, 0.005]", "velocity_filter = [100.0, inf]")
    _sweep(folder, text='velocity = "differenced"\n' + text.replace("13", "7"), width=0.3)
    return opening.open_result(folder).load()


def test_a_case_without_a_filter_is_drawn_beside_one_with(filtered):
    grid = even_grid.resampled(filtered)
    assert grid["velocity_filter"].values.tolist() == [100.0, np.inf]
    of_each = [np.sum(filtered["velocity_filter"].values == cutoff) for cutoff in (100.0, np.inf)]
    assert all(of_each) and sum(of_each) == filtered.sizes["sample"]
    panels = arrange(grid).panels
    assert [panel.caption for panel in panels] == [
        "velocity filter 100 rad/s", "velocity filter ∞"
    ]  # fmt: skip


def test_the_small_print_is_of_the_cases_that_are_shown(filtered, monkeypatch):
    compared = []
    monkeypatch.setattr(map_pictures.agreement, "sweep_agreement", compared.append)
    monkeypatch.setattr(map_pictures.map_lines, "boundaries", lambda arrangement: [None])
    mine = int(np.sum(np.isinf(filtered["velocity_filter"].values)))
    _, footer, _ = map_pictures.page(filtered, select={"velocity_filter": np.inf})
    assert f", {mine:,} loops." in footer
    assert [results.sizes["sample"] for results in compared] == [mine]
    assert np.isinf(compared[0]["velocity_filter"].values).all()


def test_a_grid_that_misses_the_stable_region_says_so(tmp_path):
    """Gains of 400 and 20 are stable, between four loops that are not."""
    text = TEXT.replace("[0.0, 0.005]", "[0.005]").replace("num = 13", "num = 2")
    with pytest.warns(InexactWarning, match="no border of stability .* the 4 loops"):
        _sweep(tmp_path, text=text)
    found = opening.open_result(tmp_path).load()
    assert found.sizes["sample"] == 4 and (found["growth_rate"] > 0).all()


def test_an_interrupted_one_says_how_much_is_kept(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        _sweep(tmp_path, upto=2)
    assert "2 chunks are kept, continue with" in _how_to_resume(location.at(tmp_path), begun=True)


def test_a_thousandth_needs_less_than_three_percent_of_that_grid():
    """The acceptance figure, with the exact stability of a first-order boundary in the plane."""
    lattice = adaptive.lattice(reading.parse(TEXT), 0.001)
    assert min(lattice.shape) > 9000
    size = np.array(lattice.shape) - 1

    def inside(case, places):
        at = places / size
        return at[:, 0] < 0.2 + 0.6 * np.sin(2.5 * at[:, 1]) + 0.05 * case

    assert _refined(lattice, inside).size < 0.03 * lattice.cases * lattice.size


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[axes]\nkp=[1, 2]", "no axis is a range"),
        ("[axes]\nkp={min=1,max=2}\n[sampling]\nmethod='sobol'\nsamples=4", "sampling"),
        (
            "[axes]\n"
            + "\n".join(f"{n}={{min=1,max=2,num=3}}" for n in ("kp", "kd", "wn", "zeta")),
            "up to 3",
        ),
    ],
)
def test_what_cannot_be_refined_is_refused(text, words):
    with pytest.raises(UserError, match=words):
        adaptive.check(reading.parse(text))
