"""`jaxact.plot`: pictures on the caller's axes."""

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot

import jaxact as jx
from jaxact.errors import UserError


@pytest.fixture(autouse=True)
def closed():
    assert matplotlib.get_backend().lower() == "agg"
    yield
    pyplot.close("all")


@pytest.fixture(scope="module")
def loop():
    return jx.joint(actuator="starleth", delay=[0.0, 5e-3])


@pytest.fixture(scope="module")
def maps(loop):
    return jx.sweep(loop, duration=0.25, kp=jx.log(10, 1e5, 6), kd=jx.log(0.1, 2000, 5))


def test_the_open_loop_is_drawn_on_given_axes(loop):
    axes = pyplot.figure().subplots(2, 1)
    assert jx.plot.bode(loop, axes=axes) is axes
    lines = [line for line in axes[0].lines if len(line.get_xdata()) > 100]
    assert len(lines) == 2
    # |L| from its definition, at the lowest frequency.
    w, decibel = lines[0].get_xdata()[0], lines[0].get_ydata()[0]
    assert decibel == pytest.approx(20 * np.log10(abs((400 + 20j * w) / (0.7 * w**2))), abs=0.01)
    upper, lower = jx.plot.sensitivity(loop, axes=pyplot.figure().subplots(2, 1))
    assert (upper.get_ylabel(), lower.get_ylabel()) == ("|S(jω)|", "|T(jω)|")
    ax = pyplot.figure().subplots()
    assert jx.plot.nyquist(loop, sampled=True, ax=ax) is ax


@pytest.mark.exhaustive
def test_trajectories_and_steps(loop):
    run = jx.simulate(loop, duration=0.3)
    upper, _ = jx.plot.step(run)
    labels = [text.get_text() for text in upper.get_legend().get_texts()]
    assert "delay 5 ms" in labels
    top, _, bottom = jx.plot.trajectory(run.isel(delay=0))
    assert (top.get_ylabel(), bottom.get_ylabel()) == ("position [m]", "force [N]")
    with pytest.raises(UserError, match="of one loop"):
        jx.plot.trajectory(run)


def test_a_map_on_given_axes(maps):
    figure, ax = pyplot.subplots()
    drawn = jx.plot.stability_map(maps, select={"delay": 0.005}, ax=ax)
    assert drawn is ax and ax.get_xscale() == "log"
    mesh = ax.collections[0]
    expected = maps.growth_rate.sel(delay=0.005).transpose("kd", "kp").values
    assert np.asarray(mesh.get_array()).reshape(expected.shape) == pytest.approx(expected)
    assert len(figure.axes) == 2  # with its colour bar


def test_several_maps_need_as_many_axes(maps):
    assert len(jx.plot.stability_map(maps)) == 2
    with pytest.raises(UserError, match="there are 2 maps, and 1 axes"):
        jx.plot.stability_map(maps, ax=pyplot.subplots()[1])


def test_the_boundary_separates_stable_from_unstable(loop):
    ax = jx.plot.boundary(loop[1])
    kp, kd = ax.lines[0].get_data()
    middle = len(kp) // 2
    near = loop[1].replace(kp=kp[middle], kd=kd[middle] * np.array([0.99, 1.01]))
    assert jx.margins(near).stable.sum() == 1


def test_pictures_of_joints_are_not_of_robots(tmp_path):
    from robots import PENDULUM

    path = tmp_path / "pendulum.xml"
    path.write_text(PENDULUM)
    with pytest.raises(UserError, match="joint's loop"):
        jx.plot.bode(jx.robot(path))
