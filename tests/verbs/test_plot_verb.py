"""`jaxact.plot`: pictures on the caller's axes."""

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from quickly import compiled_quickly as compiled_quickly

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


@pytest.mark.exhaustive
def test_a_map_on_given_axes(maps):
    figure, ax = pyplot.subplots()
    drawn = jx.plot.stability_map(maps, select={"delay": 0.005}, ax=ax)
    assert drawn is ax and ax.get_xscale() == "log"
    words = [text.get_text() for text in ax.get_legend().get_texts()]
    assert {"exact boundary, sampled", "exact, continuous time"} < set(words)
    mesh = ax.collections[0]
    expected = maps.growth_rate.sel(delay=0.005).transpose("kd", "kp").values
    assert np.asarray(mesh.get_array()).reshape(expected.shape) == pytest.approx(expected)
    assert len(figure.axes) == 2  # with its colour bar


def test_a_map_of_the_nearest_value_within_the_axis(maps):
    drawn = jx.plot.stability_map(maps, select={"delay": 0.004}, exact=False)
    nearest = jx.plot.stability_map(maps, select={"delay": 0.005}, exact=False)
    shown = [np.asarray(ax.collections[0].get_array()) for ax in (drawn, nearest)]
    np.testing.assert_array_equal(*shown)
    # What is drawn is said, not what was asked for.
    assert drawn.get_title() == nearest.get_title() == "delay 5 ms"
    with pytest.raises(UserError, match="delay: 7 s is outside its axis"):
        jx.plot.stability_map(maps, select={"delay": 7})


def test_several_maps_need_as_many_axes(maps):
    assert len(jx.plot.stability_map(maps)) == 2
    swept = maps.delay.values[-1].item()
    with pytest.raises(UserError, match=f"there are 2 maps, and 1 axes; .*'delay': {swept}"):
        jx.plot.stability_map(maps, ax=pyplot.subplots()[1])
    with pytest.raises(UserError, match="there are 1 maps, and 2 axes; give as many$"):
        jx.plot.stability_map(maps.isel(delay=0), axes=pyplot.subplots(1, 2)[1])


def test_a_map_to_select_may_have_a_name(loop):
    ends = {"kp": jx.log(100, 1000, 3), "kd": jx.log(1, 10, 3)}
    maps = jx.sweep(loop[1], actuator=["hyq", "starleth"], duration=0.1, **ends)
    with pytest.raises(UserError, match="select={'actuator': 'starleth'}"):
        jx.plot.stability_map(maps, ax=pyplot.subplots()[1])


@pytest.mark.parametrize(
    "given, said",
    [
        (lambda: {"ax": pyplot.figure()}, "ax: a value of type Figure is not Matplotlib's axes"),
        (lambda: {"ax": pyplot.subplots(1, 2)[1]}, "ax: a value of type ndarray .*one of them"),
        (lambda: {"axes": "ax"}, "axes: a value of type .*str.* a list of them"),
        (lambda: {"ax": pyplot.subplot(projection="polar")}, "these axes are polar"),
    ],
)
def test_what_are_no_axes_is_said_in_one_line(maps, given, said):
    with pytest.raises(UserError, match=said):
        jx.plot.stability_map(maps.isel(delay=0), **given())


@pytest.mark.parametrize(
    "taken", [lambda maps: maps.mean("delay"), lambda maps: maps.isel(delay=1, drop=True)]
)
def test_maps_that_have_lost_a_value_are_not_drawn_with_another_ones_boundary(maps, taken):
    with pytest.raises(UserError, match=r"maps: delay was swept, .* maps.isel\(delay=0\)"):
        jx.plot.stability_map(taken(maps))


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


@pytest.fixture(scope="module")
def tuned():
    loop = jx.joint(actuator="starleth", delay=1e-3, kp=100.0, kd=10.0)
    return jx.tune(loop, max_peak=1.6, front=2, steps=20, starts=1)


@pytest.mark.exhaustive
def test_the_plane_of_the_gains_has_the_bound_where_the_margins_have_it(tuned):
    ax = pyplot.figure().subplots()
    assert jx.plot.tuning_map(tuned, ax=ax) is ax
    (bound,) = (one for one in ax.collections if hasattr(one, "allsegs") or "Contour" in str(one))
    kp, kd = bound.get_paths()[0].vertices[::7].T
    found = jx.margins(tuned.loop.replace(kp=kp, kd=kd))
    peaks = np.maximum(found.sensitivity_peak, found.complementary_peak)
    assert peaks == pytest.approx(1.6, rel=2e-2)  # between the cells of the plane
    stars = [line for line in ax.lines if line.get_marker() == "*"]
    assert stars[0].get_xydata()[0] == pytest.approx([tuned.kp, tuned.kd])


@pytest.mark.exhaustive
def test_responses_before_and_after_end_at_the_setpoint(tuned):
    ax = jx.plot.step_band(tuned, ax=pyplot.figure().subplots())
    curves = [line.get_ydata() for line in ax.lines if len(line.get_ydata()) > 100]
    assert len(curves) == 2 and all(abs(curve[-1] - 1.0) < 0.05 for curve in curves)
    upper, _ = jx.plot.tuned_sensitivity(tuned)
    assert [text.get_text()[:5] for text in upper.get_legend().get_texts()] == ["after", "befor"]


@pytest.mark.exhaustive
def test_convergence_and_the_front_are_the_results(tuned):
    upper, lower = jx.plot.convergence(tuned, axes=pyplot.figure().subplots(2, 1))
    assert "stiffness" in upper.get_ylabel() and lower.get_xlabel() == "step"
    upper, lower = jx.plot.front(tuned, axes=pyplot.figure().subplots(2, 1))
    peaks, values = upper.lines[0].get_data()
    assert list(peaks) == [one.goal.max_peak for one in tuned.front]
    assert list(values) == [one.kp for one in tuned.front]
    assert list(lower.lines[0].get_ydata()) == [one.kd for one in tuned.front]


@pytest.mark.exhaustive
def test_pictures_of_a_tuning_say_what_they_are_of(tuned):
    with pytest.raises(UserError, match="of a robot's tuned gains"):
        jx.plot.robot_gains(tuned)


@pytest.mark.exhaustive
def test_curves_and_samples_of_a_sweep(loop, maps):
    ax = jx.plot.lines(maps.isel(kd=2), x="kp", y="delay", ax=pyplot.figure().subplots())
    expected = maps.growth_rate.isel(kd=2).sel(delay=0.005).values
    assert any(np.array_equal(line.get_ydata(), expected) for line in ax.lines)
    drawn = jx.sweep(loop[1], duration=0.25, sampling="sobol", number=16,
                     kp=jx.log(10, 1e5), kd=jx.log(0.1, 2000))  # fmt: skip
    ax = jx.plot.scatter(drawn, ax=pyplot.figure().subplots())
    points = np.concatenate([one.get_offsets() for one in ax.collections])
    assert sorted(points[:, 0]) == pytest.approx(sorted(drawn.kp.values))


@pytest.mark.exhaustive
def test_sensitivities_of_a_robot(tmp_path):
    from robots import PENDULUM

    path = tmp_path / "pendulum.xml"
    path.write_text(PENDULUM)
    found = jx.margins(jx.robot(path, keyframe="home", delay=1e-3))
    upper, _, bars = jx.plot.robot_margins(found)
    (largest,) = (line for line in upper.lines if line.get_label() == "all joints: σmax")
    assert largest.get_ydata().max() == pytest.approx(float(found.sensitivity_peak), rel=1e-3)
    assert [text.get_text() for text in bars.get_yticklabels()] == list(found.joints)
