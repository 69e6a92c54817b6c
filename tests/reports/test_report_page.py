"""Reports in a real browser: what the page computes, how it is used, and what it must not do."""

import json
import time

import numpy as np
import pytest
from browser import in_browser
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.verbs.margins import of_values

pytestmark = in_browser

POINTS = 100
HOSTILE = "<script>alert(1)</script>"
NAMES = ['it\'s "quoted" </script>', "<b>other</b>"]
LARGEST = 1_000_000  # bytes
TOLERANCE = 1e-6
WIDTHS = (1280, 390)
PATIENCE = 60.0  # [s] for what is drawn or spoken later

# Types numbers into the page, waits for it, and reads the table of margins.
MOVE = """(async () => {
  const found = [];
  const type = (name, value) => {
    const input = document.getElementById(`control-${name}-number`);
    input.value = value;
    input.dispatchEvent(new Event("change"));
  };
  for (const [kp, kd] of POINTS) {
    type("kp", kp);
    type("kd", kd);
    await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
    const row = {};
    for (const cell of document.querySelectorAll("#margins td")) {
      row[`${cell.dataset.kind} ${cell.parentElement.dataset.name}`] = cell.dataset.value;
    }
    found.push(row);
  }
  return found;
})()"""


@pytest.fixture(scope="module")
def loop():
    return jx.joint(
        actuator="starleth", delay=2e-3, measurement_delay=1e-3, kp=[400.0, 300.0],
        names=NAMES, control_rate=500,
    )  # fmt: skip


@pytest.fixture(scope="module")
def report(loop, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "joint.html"
    return jx.report(loop, path, title=HOSTILE).path


def test_it_asks_for_nothing_and_says_nothing(page, report):
    page.open(report)
    assert page.requests == [report.as_uri()]
    assert page.said == []
    assert report.stat().st_size < LARGEST


@pytest.mark.exhaustive
def test_it_computes_what_python_computes(page, report, loop):
    page.open(report)
    rng = np.random.default_rng(0)
    kp, kd = (400.0 * 20.0 ** rng.uniform(-1, 1, POINTS), 20.0 * 20.0 ** rng.uniform(-1, 1, POINTS))
    found = page.run(MOVE.replace("POINTS", json.dumps(np.stack([kp, kd], 1).tolist())))
    own = {name: np.full(POINTS, float(value)) for name, value in loop[0].parameters.items()}
    values = own | {"kp": kp, "kd": kd}
    compared = 0
    for kind, velocity in (("continuous", None), ("sampled", "sampled")):
        own = of_values(values, velocity)
        own["phase_margin"] = np.radians(own["phase_margin"])
        own["growth_rate"] = own.pop("spectral_abscissa")
        for index, row in enumerate(found):
            assert row[f"{kind} stable"] == str(bool(own["stable"][index])).lower()
            for name, column in own.items():
                text = row.get(f"{kind} {name}")
                if text is None or name == "stable" or np.isnan(column[index]):
                    continue
                assert float(text) == pytest.approx(column[index], rel=TOLERANCE), (name, index)
                compared += 1
    assert compared > 5 * POINTS  # many are unstable


def test_text_is_shown_as_text(page, report):
    page.open(report)
    assert page.run("document.querySelector('h1').textContent") == HOSTILE
    assert (
        page.run("[...document.querySelectorAll('#loop option')].map((one) => one.text)") == NAMES
    )
    assert page.run("document.querySelectorAll('b').length") == 0
    assert page.said == []


def test_keys_pointer_and_choices_move_the_point(page, report):
    page.open(report)
    kp, kd = (
        f"Number(document.getElementById('control-{name}-number').value)" for name in ("kp", "kd")
    )
    page.run("document.getElementById('pad').focus()")
    page.press("ArrowRight")
    page.press("ArrowUp", shift=True)
    assert 400 < page.run(kp) < 500 and 20 < page.run(kd) < 60
    place = page.run("""(() => {
      const svg = document.getElementById("map");
      svg.scrollIntoView();
      const box = svg.getBoundingClientRect();
      return [box.left + box.width / 2, box.top + box.height / 4];
    })()""")
    page.mouse("mousePressed", *place)
    page.mouse("mouseMoved", place[0] + 80, place[1])
    page.mouse("mouseReleased", place[0] + 80, place[1])
    dragged = page.run(kp)
    assert dragged > 500 and page.run(kd) > 60
    page.run("document.getElementById('again').click()")
    assert page.run(kp) == 400
    page.run("""(() => {
      const choice = document.getElementById("loop");
      choice.value = 1;
      choice.dispatchEvent(new Event("change"));
    })()""")
    assert page.run(kp) == 300


def test_sliders_change_the_margins_and_the_words_are_spoken(page, report):
    page.open(report)
    margin = "Number(document.querySelector('[data-name=delay_margin] td').dataset.value)"
    before = page.run(margin)
    page.run("""(() => {
      const slider = document.getElementById("control-delay");
      slider.value = 1000;
      slider.dispatchEvent(new Event("input"));
    })()""")
    deadline, spoken = time.monotonic() + PATIENCE, ""
    while not spoken.startswith("Unstable") and time.monotonic() < deadline:
        spoken = page.run("document.getElementById('spoken').textContent")
    # The loop takes 18 ms more: less is left, or it is unstable.
    after = page.run(margin)
    assert after is None or before - after == pytest.approx(0.018, abs=1e-9)
    assert spoken.startswith("Unstable")


def test_what_is_copied_gives_the_same_margins(page, report, tmp_path):
    page.open(report)
    (tmp_path / "loop.toml").write_text(page.run("document.getElementById('toml').value"))
    shown = page.run("document.querySelector('[data-name=gain_margin] td').dataset.value")
    again = jx.loop_of(tmp_path / "loop.toml")
    assert jx.margins(again).gain_margin[0] == pytest.approx(float(shown), rel=TOLERANCE)
    command = page.run("document.getElementById('command').value")
    assert command.startswith("jaxact margins --kp 400 --kd 20") and "--delay 0.002" in command


@pytest.mark.exhaustive
def test_the_boundary_is_where_python_has_it(page, report, loop):
    page.open(report)
    of_page = """(kind) => {
      const { window, loops } = in_main.read(document.getElementById("data").textContent).joint;
      const loop = in_loops[`${kind}Loop`](loops[0].parameters);
      const cached = in_frequencies.responses(loop, in_frequencies.frequencyGrid(loop, window));
      return in_boundary.boundary(loop, cached, window).filter(({ separates }) => separates);
    }"""
    edges = {kind: page.run(f"({of_page})('{kind}')") for kind in ("continuous", "sampled")}
    # In continuous time by the closed form, at the page's own frequencies.
    mass, wn, zeta, late = 0.7, 110.0, 0.9, 3e-3
    for edge in edges["continuous"]:
        kp, kd, w = (np.array(edge[name], float) for name in ("kp", "kd", "w"))
        real, imaginary, turned = wn**2 - w**2, 2.0 * zeta * wn * w, w * late
        own = mass * (w / wn) ** 2 * (real * np.cos(turned) - imaginary * np.sin(turned))
        np.testing.assert_allclose(kp, own, rtol=TOLERANCE, atol=TOLERANCE)
        own = mass * w / wn**2 * (real * np.sin(turned) + imaginary * np.cos(turned))
        np.testing.assert_allclose(kd, own, rtol=TOLERANCE)
    # Sampled, where the loop neither grows nor decays.
    points = [
        (kp, kd) for edge in edges["sampled"] for kp, kd in zip(edge["kp"], edge["kd"], strict=True)
    ]
    assert len(points) > 50
    kp, kd = np.array(points[:: len(points) // 20]).T
    own = {name: np.full(len(kp), float(value)) for name, value in loop[0].parameters.items()}
    found = of_values(own | {"kp": kp, "kd": kd}, "sampled")
    np.testing.assert_allclose(found["spectral_radius"], 1.0, atol=1e-8)


def test_every_text_to_take_along_can_be_copied(page, report):
    page.open(report)
    ids = page.run("[...document.querySelectorAll('button.copy')].map((one) => one.dataset.of)")
    assert ids == ["command", "toml", "made-0"]
    for which in ids:
        page.run(f"document.querySelector('[data-of={which}]').click()")
        said = f"document.querySelector('[data-of={which}]').textContent"
        deadline = time.monotonic() + PATIENCE
        while page.run(said).startswith("copy") and time.monotonic() < deadline:
            time.sleep(0.05)
        assert page.run(said) in ("copied", "selected: press Ctrl+C")
        wanted = page.run(
            f"(document.getElementById('{which}').value ??"
            f" document.getElementById('{which}').textContent).trim()"
        )
        assert wanted and page.run("getSelection().toString()").strip() == wanted


@pytest.mark.parametrize("width", WIDTHS)
def test_it_fits_the_window(page, report, width):
    page.open(report, width=width)
    assert page.run("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", WIDTHS)
def test_axe_finds_no_violation(page, report, width, dark):
    page.open(report, width=width, dark=dark)
    assert page.violations() == []


def test_a_notebook_shows_the_page_in_a_frame(page, loop, tmp_path):
    shown = jx.report(loop[0], tmp_path / "joint.html")._repr_html_()

    def drawn(frame, least):
        cell = tmp_path / "cell.html"
        cell.write_text(f"<!doctype html><title>cell</title>{frame}", encoding="utf-8")
        page.open(cell)
        deadline, size = time.monotonic() + PATIENCE, 0
        while size <= least and time.monotonic() < deadline:
            size = len(page.picture())
        return size

    # Without leave to run its script it has no map, no margins and no words; an empty one, less.
    still = drawn(shown.replace("allow-scripts", ""), 2 * drawn("", 0))
    assert drawn(shown, 1.5 * still) > 1.5 * still
