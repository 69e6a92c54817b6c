"""`jaxact.sweep`: the command line's results in memory or in a folder, and what is refused."""

import numpy as np
import pytest
from quickly import optimised_fully

import jaxact as jx
from jaxact.cli.main import main
from jaxact.errors import UserError
from jaxact.loops import reading

TOML = """
engine = "mass"
duration = 0.25
[parameters]
actuator = "starleth"
[axes]
delay = [0.0, 0.005]
kp = { min = 10, max = 1e5, num = 6, spacing = "log" }
kd = { min = 0.1, max = 2000, num = 5, spacing = "log" }
"""
GAINS = {"kp": jx.log(10, 1e5, 6), "kd": jx.log(0.1, 2000, 5)}


@pytest.fixture(scope="module", autouse=True)
def compiled_as_users_have_it():
    """Results are compared to the last bit, whatever was compiled before, and how."""
    with optimised_fully():
        yield


@pytest.fixture(scope="module")
def loop():
    return jx.joint(actuator="starleth", delay=[0.0, 0.005])


@pytest.fixture(scope="module")
def maps(loop):
    return jx.sweep(loop, duration=0.25, **GAINS)


def test_it_gives_what_the_command_line_gives(maps, tmp_path):
    (tmp_path / "map.toml").write_text(TOML)
    assert (
        main(["sweep", str(tmp_path / "map.toml"), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    )
    theirs = jx.load_result(tmp_path / "out")
    assert dict(theirs.sizes) == {"delay": 2, "kp": 6, "kd": 5}
    for name in theirs.data_vars:
        assert np.array_equal(maps[name], theirs[name], equal_nan=True), name


@pytest.mark.exhaustive
def test_growth_rates_are_those_of_the_sampled_margins(loop, maps):
    gains = np.meshgrid(maps.kp.values, maps.kd.values, indexing="ij")
    exact = jx.margins(loop[1].replace(kp=gains[0], kd=gains[1]), sampled=True).growth_rate
    assert maps.growth_rate.values[1] == pytest.approx(exact, rel=1e-3, abs=0.02)


@pytest.mark.exhaustive
def test_a_specification_can_be_swept_and_changed(maps, tmp_path):
    (tmp_path / "map.toml").write_text(TOML)
    one = jx.sweep(tmp_path / "map.toml", delay=[0.005])
    assert np.array_equal(one.growth_rate[0], maps.growth_rate[1])
    read = jx.sweep(reading.parse(TOML), delay=[0.005], kp=[100.0])
    assert dict(read.sizes) == {"delay": 1, "kp": 1, "kd": 5}


def test_results_are_kept_resumed_and_not_replaced(loop, maps, tmp_path):
    kept = jx.sweep(loop, out=tmp_path / "out", duration=0.25, **GAINS)
    assert np.array_equal(kept.verdict.values, maps.verdict.values)
    with pytest.raises(UserError, match="exists"):
        jx.sweep(loop, out=tmp_path / "out", duration=0.25, **GAINS)
    again = jx.sweep(loop, out=tmp_path / "out", duration=0.25, resume=True, **GAINS)
    assert np.array_equal(again.verdict.values, maps.verdict.values)
    assert jx.load_result(tmp_path / "out").attrs["complete"]


@pytest.mark.exhaustive
def test_presets_are_an_axis():
    found = jx.sweep(jx.joint(), duration=0.25, actuator=["hyq", "ideal"], kp=[100.0])
    assert list(found.actuator.values) == ["hyq", "ideal"]
    own = jx.sweep(jx.joint(actuator=["hyq", "ideal"]), duration=0.25, kp=[100.0])
    assert np.array_equal(own.growth_rate, found.growth_rate)


@pytest.mark.exhaustive
def test_ranges_are_drawn_from(loop):
    found = jx.sweep(
        loop[0], duration=0.25, sampling="latin-hypercube", number=7, kp=jx.log(10, 1e4)
    )
    assert found.sizes["sample"] == 7 and (found.kp >= 10.0).all()


def test_progress_is_told(loop):
    seen = []
    jx.sweep(loop, duration=0.25, progress=lambda done, total: seen.append((done, total)), **GAINS)
    assert seen[-1] == (60, 60)


@pytest.mark.parametrize(
    "given, said",
    [
        ({"kq": [1.0]}, "unknown parameter"),
        ({"stifness": [1.0]}, "stifness: unknown parameter; did you mean 'stiffness'"),
        ({"duraton": 1.0}, "duraton: unknown parameter; did you mean 'duration'"),
        ({"kp": {"min": 0.0, "max": 1.0, "num": 3, "spacing": "log"}}, "no logarithm"),
        ({"kp": [-1e12]}, "out of range"),
        ({"kp": [1.0], "width": 0.1}, "adaptive"),
        ({"kp": [1.0], "resume": True}, "give out"),
        ({"kp": [1.0], "duration": -1.0}, "duration"),
    ],
)
def test_what_makes_no_sense_is_refused(loop, given, said):
    with pytest.raises(UserError, match=said):
        jx.sweep(loop, **given)


def test_parameters_that_vary_together_are_no_axes():
    with pytest.raises(UserError, match="same dimension"):
        jx.sweep(jx.joint(kp=[1.0, 2.0], kd=[1.0, 2.0]), mass=[1.0])
