"""Maps of a robot's margins: engine = "linear"."""

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from robots import PENDULUM

import jaxact as jx
from jaxact.analysis.robot import disk, disk_batch
from jaxact.analysis.robot.summits import summits
from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.robot_margins import whole_robot
from jaxact.status import Verdict
from jaxact.sweeping import opening, validation
from jaxact.verbs import map_pictures
from jaxact.verbs.simulate import simulate

MAP = """
engine = "linear"
precision = "float64"
[plant]
model = "pendulum.xml"
keyframe = "home"
[parameters]
actuator = "hyq"
[axes]
kp = { min = 5, max = 500, num = 4, spacing = "log" }
kd = [0.0, 0.3, 1.5]
delay = [0.0, 0.0017]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("margins")
    (folder / "pendulum.xml").write_text(PENDULUM)
    (folder / "map.toml").write_text(MAP)
    return folder


@pytest.fixture(scope="module")
def asked(folder):
    return reading.load(folder / "map.toml")


@pytest.fixture(scope="module")
def maps(asked, folder):
    return jx.sweep(asked, out=folder / "out", progress=False)


@pytest.fixture(scope="module")
def loops(asked):
    """The matrices of every loop; what follows from them is computed here."""
    own = reading.parse(asked.text.replace('"linear"', '"mujoco"'))
    return whole_robot.evaluate(own, expand(own))


def _sensitivity(loop, angle):
    M, N, C = loop.robot.matrices
    return np.eye(len(C)) + C @ np.linalg.solve(np.exp(1j * angle) * np.eye(len(M)) - M, N)


def _peak(loop, shift):
    """By brute force over a fine grid, and once more around its best point."""

    def value(angle):
        return np.linalg.norm(_sensitivity(loop, angle) - shift * np.eye(len(loop.kp)), 2)

    grid = np.geomspace(1e-5, np.pi, 3000)
    top = int(np.argmax([value(angle) for angle in grid]))
    ends = grid[max(top - 1, 0)], grid[min(top + 1, len(grid) - 1)]
    found = scipy.optimize.minimize_scalar(lambda t: -value(t), bounds=ends, method="bounded",
                                           options={"xatol": 1e-12})  # fmt: skip
    return max(-found.fun, value(grid[top]), value(0.0))


def _radius(M):
    return np.abs(scipy.linalg.eigvals(M)).max()


def test_every_loop_is_stable_where_its_roots_are(maps, loops):
    radius = np.array([_radius(loop.robot.matrices[0]) for loop in loops])
    stable = maps["verdict"].values.ravel() == Verdict.STABLE
    np.testing.assert_array_equal(stable, radius <= 1.0 + 1e-9)
    np.testing.assert_allclose(maps["growth_rate"].values.ravel(), 1e3 * np.log(radius), atol=1e-6)
    assert 3 < stable.sum() < stable.size - 3
    assert np.isnan(maps["sensitivity_peak"].values.ravel()[~stable]).all()


def test_peaks_are_those_of_a_fine_grid(maps, loops):
    flat = {name: maps[name].values.ravel() for name in maps.data_vars}
    for number in np.flatnonzero(flat["verdict"] == Verdict.STABLE)[::3]:
        found = [_peak(loops[number], shift) for shift in (0.0, 1.0, 0.5)]
        own = [flat["sensitivity_peak"], flat["complementary_peak"], flat["unscaled_disk_margin"]]
        expected = [found[0], found[1], 1.0 / found[2]]
        np.testing.assert_allclose([values[number] for values in own], expected, rtol=1e-6)
        assert flat["disk_margin"][number] >= flat["unscaled_disk_margin"][number] * (1 - 1e-9)


def test_limits_of_gain_and_delay_are_where_the_roots_leave_the_circle(maps, loops):
    flat = {name: maps[name].values.ravel() for name in maps.data_vars}
    seen = 0
    for number in np.flatnonzero(flat["verdict"] == Verdict.STABLE):
        M, N, C = loops[number].robot.matrices
        for name, inner in (("gain_margin", 0.9999), ("gain_reduction_margin", 1.0001)):
            factor = flat[name][number]
            if not 0.0 < factor < np.inf:
                continue
            seen += 1
            assert _radius(M + (factor * inner - 1.0) * N @ C) < 1.0
            assert _radius(M + (factor / inner - 1.0) * N @ C) > 1.0
        delay, period = flat["delay_margin"][number], loops[number].robot.period
        if delay < period:
            seen += 1
            by = loops[number].robot.later_by
            assert (
                _radius(by(delay * 0.9999)[0]) < 1.0 < _radius(by(min(delay * 1.0001, period))[0])
            )
    assert seen > 8


def test_they_are_the_margins_of_each_loop_by_itself(maps, loops):
    for place, loop in zip(np.ndindex(maps["verdict"].shape), loops, strict=True):
        if loop.margins.whole is None:
            continue
        for name, value in vars(loop.margins.whole).items():
            near = 1e-4 if "frequency" in name else 1e-6
            assert maps[name].values[place] == pytest.approx(value, rel=near, abs=1e-9), name


def test_a_map_of_margins_is_resumed_validated_and_drawn(asked, maps, folder):
    again = jx.sweep(asked, out=folder / "out", resume=True, progress=False)
    np.testing.assert_array_equal(again["disk_margin"].values, maps["disk_margin"].values)
    checked = validation.recompute(opening.find(folder / "out"), 6, seed=1)
    assert (checked.loops, checked.wrong) == (6, 0)
    results = opening.load_result(folder / "out")
    for name in ("delay_margin", "sensitivity_peak", "disk_margin"):
        _, words, kind = map_pictures.page(results, variable=name)
        assert kind == "map" and words.startswith("Exact margins"), words
    with pytest.raises(UserError, match=r"unknown variable 'overshoot'"):
        map_pictures.page(results, variable="overshoot")


def test_what_has_no_margins_is_said(asked, folder):
    loop = jx.robot(folder / "pendulum.xml", keyframe="home", kp=[0.0, 50.0], kd=0.0)
    found = jx.sweep(loop, engine="linear", progress=False)
    assert int(found["verdict"][0]) == Verdict.INVALID and np.isnan(found["disk_margin"][0])
    with pytest.raises(UserError, match=r"refines where verdicts change"):
        jx.sweep(asked, adaptive=True, progress=False)
    with pytest.raises(UserError, match=r"simulates nothing"):
        simulate(loop[1], engine="linear")
    with pytest.raises(UserError, match=r"is for robots"):
        jx.sweep(jx.joint(), engine="linear", kp=[100.0, 200.0], progress=False)


UPRIGHT = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>
<geom size="0.05" pos="0 0 0.5" mass="1"/></body></worldbody>
<actuator><motor joint="hinge"/></actuator></mujoco>"""


def test_gains_that_hardly_hold_a_robot_upright_topple_it_where_gravity_says(tmp_path):
    """What topples so slowly that nothing is seen right beside the crossing; kp = m g l there."""
    (tmp_path / "upright.xml").write_text(UPRIGHT)
    gravity, above = 9.81 * 0.5, np.array([1.0003, 1.001, 1.5])
    loop = jx.robot(tmp_path / "upright.xml", kp=gravity * above, kd=5.0, actuator="hyq")
    found = jx.sweep(loop, engine="linear", progress=False)
    assert (found["verdict"] == Verdict.STABLE).all()
    # Growth of less than 1e-9 in a period is none, which moves the factor by 1e-6 here.
    np.testing.assert_allclose(found["gain_reduction_margin"], 1.0 / above, rtol=2e-6)
    assert (found["gain_reduction_frequency"].values == 0.0).all()


def test_disk_margins_side_by_side_are_those_one_by_one():
    rng = np.random.default_rng(2)
    H = rng.normal(size=(7, 5, 5)) + 1j * rng.normal(size=(7, 5, 5))
    H *= np.exp(rng.normal(size=(7, 5, 1)))
    H[0], H[1] = np.diag(np.arange(5.0)), 0.0
    one_by_one = [disk.bound(one) for one in H]
    np.testing.assert_allclose(disk_batch.bounds(H), one_by_one, rtol=1e-8)
    assert (disk_batch.singular_bound(H) >= np.linalg.norm(H, 2, axis=(1, 2))).all()


def test_summits_are_found_wherever_they_lie_in_their_brackets():
    rng = np.random.default_rng(3)
    centre, width = rng.uniform(0.3, 3.0, 40), 10 ** rng.uniform(-3, 0, 40)
    brackets = centre[:, None] + width[:, None] * rng.uniform(
        [-2, -0.1, 0.3], [-0.3, 0.1, 2], (40, 3)
    )

    def curve(x, number):
        return 1.0 / (1.0 + ((x - centre[number]) / width[number]) ** 2)

    found = summits(brackets, curve)
    np.testing.assert_allclose(found[:, 0], 1.0, rtol=1e-9)
    np.testing.assert_allclose((found[:, 1] - centre) / width, 0.0, atol=1e-4)


def test_the_axes_are_in_the_units_of_the_joints(maps):
    units = {name: maps[name].attrs["units"] for name in ("kp", "kd", "delay")}
    assert units == {"kp": "N m/rad", "kd": "N m s/rad", "delay": "s"}
