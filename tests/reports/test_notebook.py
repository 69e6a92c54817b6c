"""Results in a notebook: tables with pictures, and the widget in a browser against a stub model."""

import importlib.util
import json
import time
from pathlib import Path

import pytest
from browser import browser, in_browser
from matplotlib.figure import Figure
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact import files
from jaxact.reports import page as pages
from jaxact.verbs import report_joint
from jaxact.verbs.widget import NAMES, widget

HOSTILE = "<script>alert(1)</script>"
PATIENCE = 60.0  # [s] for what is drawn later

# What a notebook's model has: values by name, and listeners; two widgets on one page.
STUB = """<!doctype html><title>cell</title><div id="first"></div><div id="second"></div>
<script type="module">
MODULE_URL
const module = await import(URL.createObjectURL(new Blob([source], { type: "text/javascript" })));
const data = DATA;
function model() {
  const values = { ...data };
  const listeners = {};
  return {
    saved: 0,
    get: (name) => values[name],
    set(name, value) {
      if (values[name] === value) return;
      values[name] = value;
      (listeners[`change:${name}`] ?? []).forEach((listener) => listener());
    },
    save_changes() { this.saved += 1; },
    on: (event, listener) => (listeners[event] ??= []).push(listener),
    off: (event, one) => (listeners[event] = listeners[event].filter((x) => x !== one)),
  };
}
window.models = [model(), model()];
window.ends = ["first", "second"].map((id, i) =>
  module.default.render({ model: models[i], el: document.getElementById(id) }),
);
window.shadow = (i) => document.getElementById(["first", "second"][i]).firstChild.shadowRoot;
window.ready = true;
</script>"""


@pytest.fixture(scope="module")
def loop():
    return jx.joint(actuator="starleth", delay=2e-3, names=[HOSTILE], kp=[400.0], kd=20,
                    control_rate=500)  # fmt: skip


@pytest.fixture(scope="module")
def page(loop, tmp_path_factory):
    content = report_joint.content(loop)
    first = content.parts["joint"]["loops"][0]["parameters"]
    values = {"_data": json.dumps(files.plain(content.parts["joint"])), "_names": list(NAMES)}
    values |= {name: files.plain(first[name]) for name in NAMES}
    source = json.dumps(pages.widget()).replace("<", "\\u003c")
    text = STUB.replace("MODULE_URL", f"const source = {source};")
    path = tmp_path_factory.mktemp("cell") / "cell.html"
    path.write_text(text.replace("DATA", json.dumps(values).replace("<", "\\u003c")))
    with browser() as opened:
        opened.open(path)
        _until(opened, "window.ready === true")
        yield opened


def _until(page, condition):
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        if page.run(condition):
            return
    assert page.run(condition), (condition, page.said)


@in_browser
def test_the_widget_draws_and_follows_python(page, loop):
    margin = "Number(shadow(0).querySelector('[data-name=gain_margin] td').dataset.value)"
    own = float(jx.margins(loop).gain_margin[0])
    assert page.run(margin) == pytest.approx(own, rel=1e-6)
    page.run("models[0].set('kp', 900); models[0].set('wn', 'inf')")
    moved = jx.joint(kp=900, kd=20, zeta=0.9, delay=2e-3, control_rate=500)
    wanted = float(jx.margins(moved).gain_margin)
    _until(page, f"Math.abs({margin} / {wanted} - 1) < 1e-6")
    # The other widget of the page has a model, ids and a map of its own.
    assert page.run(margin.replace("shadow(0)", "shadow(1)")) == pytest.approx(own, rel=1e-6)
    assert page.run("models[1].saved") == 0 and page.said == []


@in_browser
def test_what_is_moved_in_the_page_reaches_python(page):
    page.run("shadow(1).getElementById('pad').focus()")
    page.press("ArrowRight", shift=True)
    _until(page, "models[1].get('kp') > 450 && models[1].saved > 0")
    assert page.run("models[1].get('kd')") == 20
    page.run("""(() => {
      const slider = shadow(1).getElementById("control-delay");
      slider.value = 500;
      slider.dispatchEvent(new Event("input"));
    })()""")
    _until(page, "models[1].get('delay') > 5e-3")
    page.run("""shadow(1).getElementById("control-wn-infinite").click()""")
    _until(page, "models[1].get('wn') === 'inf'")
    assert page.run("models[0].get('delay')") == 2e-3


@in_browser
def test_the_widget_shows_text_as_text_and_can_be_ended(page):
    assert page.run("shadow(0).getElementById('loop').options[0].text") == HOSTILE
    before = page.run("shadow(0).getElementById('control-mass-number').value")
    page.run("ends[0](); models[0].set('mass', 3)")
    page.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert page.run("shadow(0).getElementById('control-mass-number').value") == before
    assert page.said == []


@pytest.mark.skipif(
    importlib.util.find_spec("anywidget") is None,
    reason="needs anywidget: pip install 'jaxact[notebook]'",
)
def test_the_widgets_traits_are_the_loop(loop):
    chosen = widget(loop[0])
    seen = []
    chosen.observe(lambda change: seen.append(change["new"]), "kp")
    assert chosen.get_state(["velocity_filter"]) == {"velocity_filter": "inf"}
    chosen.set_state({"kp": 123.0, "wn": "inf"})
    assert seen == [123.0]
    own = {name: float(value) for name, value in chosen.loop.parameters.items()}
    assert (own["kp"], own["wn"], own["delay"]) == (123.0, float("inf"), 2e-3)
    wanted = jx.margins(jx.joint(kp=123, kd=20, zeta=0.9, delay=2e-3)).gain_margin
    assert float(jx.margins(chosen.loop).gain_margin) == pytest.approx(float(wanted))


@pytest.mark.skipif(
    importlib.util.find_spec("anywidget") is not None, reason="is of those without anywidget"
)
def test_without_anywidget_it_says_what_to_install(loop):
    with pytest.raises(jx.UserError, match=r"pip install 'jaxact\[notebook\]'"):
        widget(loop[0])


def _results(loop):
    """Results by kind, each with the picture that it has in a notebook."""
    yield "margins", jx.margins(loop)
    yield "both", jx.margins(loop[0], sampled="both")
    yield "tuned", jx.tune(loop[0], max_peak=1.6, starts=1, steps=30, front=2)
    robot = jx.robot(
        "experiments/quadruped/quadruped.xml", actuator="starleth", delay=2e-3, kp=100, kd=3,
        base="fixed",
    )  # fmt: skip
    yield "robot", jx.margins(robot)
    yield "run", jx.simulate(loop[0], setpoint=0.1, duration=0.2).jaxact
    axes = {"kp": jx.log(10, 1e4, 4), "kd": jx.log(1, 100, 3)}
    maps = jx.sweep(loop[0], **axes, duration=0.2).jaxact
    stable = int((maps.dataset.verdict == 0).sum())
    assert repr(maps).startswith(f"12 loops: {100 * stable / 12:.1f} % stable")
    yield "sweep", maps


@pytest.mark.exhaustive
@in_browser
def test_results_are_a_table_and_a_picture(page, loop, tmp_path):
    cells = []
    for kind, result in _results(loop):
        shown = result._repr_html_()
        assert shown.startswith("<pre ") and shown.count("<img") == 1, kind
        assert HOSTILE not in shown and len(shown) < 300_000
        cells.append(f"<div id={kind}>{shown}</div>")
    path = tmp_path / "cells.html"
    path.write_text(f"<!doctype html><title>cells</title>{''.join(cells)}", encoding="utf-8")
    with browser() as other:
        other.open(path)
        sizes = other.run("[...document.images].map((one) => [one.naturalWidth, one.alt])")
    assert len(sizes) == len(cells)
    assert all(width > 400 and words for width, words in sizes)


def test_margins_are_a_table_and_a_picture(loop):
    shown = jx.margins(loop[0])._repr_html_()
    assert shown.startswith("<pre ") and shown.count("<img") == 1


def test_many_loops_are_a_table_alone():
    many = jx.margins(jx.joint(kp=[100.0 + k for k in range(12)]))
    assert "<img" not in many._repr_html_()


def test_a_robots_curves_are_over_one_frequency_axis(tmp_path):
    path = tmp_path / "chain.xml"
    path.write_text((Path(__file__).parents[1] / "data" / "chain.xml").read_text())
    found = jx.margins(jx.robot(path, kp=30, kd=1, control_rate=500))
    upper, lower, _ = jx.plot.robot_margins(found, axes=Figure().subplots(3, 1))
    assert upper.get_xscale() == lower.get_xscale() == "log"
    assert upper.get_xlim() == lower.get_xlim()
