"""The simulated cells of a sweep beneath the exact boundary, and what is said of the nearest."""

import json

import numpy as np
import pytest
import xarray as xr
from browser import in_browser
from quickly import compiled_quickly as compiled_quickly
from test_report_verb import data_of

import jaxact as jx

LARGEST = 1_000_000  # bytes
SAYS = "document.getElementById('cell-says').textContent"
HIDDEN = "document.getElementById('cell-says').hidden"
GO = """(async () => {
  for (const [name, value] of [["kp", KP], ["kd", KD]]) {
    const input = document.getElementById(`control-${name}-number`);
    input.value = value;
    input.dispatchEvent(new Event("change"));
  }
  await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
})()"""


@pytest.fixture(scope="module")
def maps():
    # A limit keeps what is unstable bounded: some cells are limit cycles.
    loop = jx.joint(mass=0.7, actuator=["hyq", "starleth"], delay=3e-3, force_limit=20.0)
    return jx.sweep(loop, kp=jx.log(10, 1e5, 9), kd=jx.log(0.5, 2e3, 8))


@pytest.fixture(scope="module")
def report(maps, tmp_path_factory):
    return maps.jaxact.report(tmp_path_factory.mktemp("sweep") / "sweep.html")


@pytest.mark.exhaustive
def test_cells_are_the_sweeps_in_the_order_of_the_loops(maps, report):
    data = data_of(report)
    cells = data["cells"]
    assert [one["name"] for one in data["loops"]] == ["HyQ", "StarLETH"]
    for index in range(2):
        own = maps.isel(actuator=index)
        wanted = own.verdict.transpose("kd", "kp").values.ravel()
        assert [int(code) for code in cells["verdicts"][index]] == wanted.tolist()
        rates = [np.nan if x is None else x for x in cells["growth_rate"][index]]
        wanted = own.growth_rate.transpose("kd", "kp").values.ravel()
        np.testing.assert_allclose(rates, wanted, rtol=6e-3)
    assert {code for row in cells["verdicts"] for code in row} >= {"0", "1"}


@pytest.mark.exhaustive
def test_a_large_sweep_is_thinned_out_to_the_budget(maps, tmp_path):
    generator = np.random.default_rng(0)
    shape = (500, 400, 2)
    kp, kd = np.geomspace(10, 1e5, 500), np.geomspace(0.5, 2e3, 400)
    names = ("verdict", "growth_rate", "limit_cycle_amplitude", "limit_cycle_frequency")
    columns = {name: (("kp", "kd", "actuator"), generator.normal(size=shape)) for name in names[1:]}
    columns["verdict"] = (("kp", "kd", "actuator"), generator.integers(-1, 4, size=shape))
    large = xr.Dataset(columns, {"kp": kp, "kd": kd, "actuator": maps.actuator}, maps.attrs)
    report = jx.report(large, tmp_path / "large.html")
    assert report.path.stat().st_size < LARGEST
    cells = data_of(report)["cells"]
    step = round(500 / len(cells["kp"]))
    wanted = large.verdict[::step, ::step, 1].values.T.ravel()
    said = [-1 if code == "-" else int(code) for code in cells["verdicts"][1]]
    assert cells["kp"] == kp[::step].tolist() and said == wanted.tolist()


@in_browser
def test_the_nearest_cell_is_said_as_it_was_simulated(page, report, maps):
    page.open(report)
    assert page.requests == [report.path.as_uri()]
    said = set()
    for index in range(2):
        page.run(
            f"document.getElementById('loop').value = {index};"
            "document.getElementById('loop').dispatchEvent(new Event('change'))"
        )
        for kp, kd in ((10.0, 2e3), (400.0, 20.0), (9e4, 0.5), (1e3, 150.0)):
            page.run(GO.replace("KP", json.dumps(kp)).replace("KD", json.dumps(kd)))
            row = int(np.abs(np.log(maps.kp.values / kp)).argmin())
            column = int(np.abs(np.log(maps.kd.values / kd)).argmin())
            one = maps.isel(actuator=index, kp=row, kd=column)
            verdict = jx.Verdict(int(one.verdict)).label
            assert f"nearest cell: {verdict}" in page.run(SAYS)
            said.add(verdict)
    assert {"stable", "limit cycle"} <= said
    assert page.said == []


@in_browser
def test_cells_go_with_the_loop_that_was_simulated(page, report):
    page.open(report)
    cells = "document.querySelectorAll('#map .cell').length"
    assert page.run(cells) >= 2 and not page.run(HIDDEN)
    page.run("document.getElementById('cells').click()")
    page.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert page.run(cells) == 0 and page.run(HIDDEN)
    page.run("document.getElementById('cells').click()")
    page.run("""(async () => {
      const slider = document.getElementById("control-delay");
      slider.value = 800;
      slider.dispatchEvent(new Event("input"));
      await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
    })()""")
    assert page.run(cells) == 0 and page.run(HIDDEN)


@in_browser
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [1280, 390])
def test_it_fits_the_window_and_axe_finds_no_violation(page, report, width, dark):
    page.open(report, width=width, dark=dark)
    assert page.run("document.documentElement.scrollWidth") <= width
    assert page.violations() == []
