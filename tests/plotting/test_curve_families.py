"""Bode, Nyquist and sensitivity of several loops: whose curve is whose, and what they are of."""

import math

import numpy as np
import pytest
from matplotlib.colors import rgb_to_hsv, to_rgb
from quickly import compiled_quickly as compiled_quickly

from jaxact.cli.main import main
from jaxact.plotting import page, theme
from jaxact.plotting.bode import bode
from jaxact.plotting.nyquist import nyquist
from jaxact.plotting.response import LoopResponse, curve_styles

W = np.geomspace(1.0, 1e3, 200)


def _response(loop, rate=math.inf, **changes):
    open_loop = (400.0 + 20.0j * W) / (-0.7 * W**2)
    phase = np.degrees(np.arctan(0.05 * W)) - 180.0
    fields = {"label": f"loop {loop}", "frequency": W, "open_loop": open_loop, "phase": phase}
    return LoopResponse(**fields | {"loop": loop, "nyquist_frequency": rate} | changes)


def _hue(color):
    return float(rgb_to_hsv(to_rgb(color))[0])


def _light(color):
    return float(np.dot(to_rgb(color), (0.299, 0.587, 0.114)))


def test_curves_of_one_loop_share_a_hue_and_loops_do_not():
    pairs = [(0, math.inf), (0, 3000.0), (1, math.inf), (1, 3000.0), (2, math.inf), (2, 3000.0)]
    styles = curve_styles([_response(loop, rate) for loop, rate in pairs])
    hues = np.reshape([_hue(style["color"]) for style in styles], (3, 2))
    np.testing.assert_allclose(hues[:, 0], hues[:, 1], atol=0.01)
    assert np.diff(np.sort(hues[:, 0])).min() > 0.05
    for continuous, sampled in zip(styles[::2], styles[1::2], strict=True):
        assert _light(continuous["color"]) > _light(sampled["color"]) + 0.2
        assert continuous["linewidth"] > 2.0 and continuous["zorder"] < sampled["zorder"]


def test_rates_of_one_loop_get_darker_and_other_loops_keep_their_colour():
    rates = [math.inf, 600.0, 3000.0, 30000.0]
    styles = curve_styles([_response(0, rate) for rate in rates] + [_response(1)])
    lightness = [_light(style["color"]) for style in styles[:4]]
    assert lightness == sorted(lightness, reverse=True) and len(set(lightness)) == 4
    assert styles[4]["color"] == theme.style(1)["color"]
    assert "linewidth" not in styles[4], "a loop with one curve is drawn as ever"


def test_curves_of_nobody_in_particular_each_have_their_own_colour():
    styles = curve_styles([_response(None), _response(None), _response(None)])
    assert [style["color"] for style in styles] == [theme.style(i)["color"] for i in range(3)]


def test_minus_one_is_above_every_disk_and_curve():
    margins = {"disk_margin": 0.9, "gain_margin": 2.0, "phase_margin": 40.0}
    figure = nyquist([_response(loop, margins=margins) for loop in range(5)])
    (axes,) = figure.axes
    (label,) = [text for text in axes.texts if text.get_text() == "−1"]
    others = [*axes.patches, *axes.lines, *(t for t in axes.texts if t is not label)]
    assert all(label.get_zorder() > other.get_zorder() for other in others)
    assert label.get_path_effects(), "a white halo, where it stands on a line"
    assert not any(patch.get_fill() for patch in axes.patches), "five fills would mix to mud"


def test_few_disks_are_filled():
    figure = nyquist([_response(0, margins={"disk_margin": 0.9})])
    assert any(patch.get_fill() for patch in figure.axes[0].patches)


def test_a_long_legend_stays_on_the_page():
    label = "a loop with a long name, velocity filter 300 rad/s, sampled at 1 kHz: unstable, and so"
    figure = bode([_response(0, label=f"{label}, {label}")])
    words = figure.legends[0].get_texts()[0].get_text()
    assert words.count("\n") >= 1
    assert page.lines([words]) == words.count("\n") + 1
    figure.canvas.draw()
    box = figure.legends[0].get_window_extent()
    assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Run a command; returns its figure, and the words of its legend and small print."""

    def run(*command):
        figures = []
        monkeypatch.setattr(theme, "write", lambda figure, path, title: figures.append(figure))
        assert main([*command, "--out", str(tmp_path / "picture.png")]) in (0, None)
        (figure,) = figures
        legend = [text.get_text() for text in figure.legends[0].get_texts()]
        return figure, legend, figure.texts[-1].get_text()

    return run


@pytest.mark.exhaustive
def test_captions_name_filter_differencing_actuator_and_delay(drawn):
    figure, legend, footer = drawn(
        *"bode --actuator starleth --delay 0.001 --control-rate 200 1000".split(),
        *"--velocity differenced --velocity-filter 300".split(),
    )
    assert [words.split(":")[0] for words in legend] == [
        "continuous time", "sampled at 200 Hz", "sampled at 1 kHz"
    ]  # fmt: skip
    for words in ("StarLETH", "delay 1 ms", "velocity differenced and filtered at 300 rad/s"):
        assert words in footer
    curves = [line for line in figure.axes[1].lines if len(line.get_xdata()) > 100]
    assert np.ptp([_hue(curve.get_color()) for curve in curves]) < 0.02


@pytest.mark.exhaustive
def test_a_filter_in_continuous_time_is_named(drawn):
    _, _, footer = drawn(*"nyquist --velocity differenced --velocity-filter 300".split())
    assert "filtered at 300 rad/s" in footer


@pytest.mark.exhaustive
def test_filters_that_differ_are_named_with_their_loops(drawn, tmp_path):
    (tmp_path / "loops.toml").write_text(
        '[[loop]]\nname = "old"\nvelocity_filter = 100\n[[loop]]\nname = "new"\n'
    )
    _, legend, footer = drawn(
        "sensitivity", "--loops", str(tmp_path / "loops.toml"), "--velocity", "differenced"
    )
    assert legend[0].startswith("old, velocity filter 100 rad/s")
    assert legend[1].startswith("new, no velocity filter") and "differenced" in footer
