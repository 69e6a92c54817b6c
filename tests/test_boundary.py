"""Boundary curves: marginal everywhere, stable on the side they say, and the oracle's limits."""

import math

import numpy as np
import pytest
import theory
from gain_limits import continuous_limits, first_lobe, sampled_limits
from quickly import compiled_quickly as compiled_quickly

from jaxact.analysis.boundary.boundary import BoundaryCurve, continuous_boundary, sampled_boundary

PERIOD = 1e-3
WINDOW = {"kp_range": (10.0, 1e5), "kd_range": (0.1, 2000.0)}
PLANTS = {
    "ideal 1 ms": (0.7, math.inf, 1.0, 0.001),
    "ideal 2.37 ms": (0.7, math.inf, 1.0, 0.00237),
    "hyq 5 ms": (0.7, 800.0, 0.45, 0.005),
    "starleth 0 ms": (0.7, 110.0, 0.9, 0.0),
    "light 20 ms": (0.7, 60.0, 0.1, 0.02),
    "fast and light": (0.7, 2000.0, 0.05, 0.005),
}


def beside(curve, index, window, distance=1e-3):
    """Gains a little to the left and right of points of a curve, in the logarithmic plane."""
    width = [math.log(high / low) for low, high in (window["kp_range"], window["kd_range"])]
    x, y = np.log(curve.kp) / width[0], np.log(curve.kd) / width[1]
    dx, dy = x[index + 1] - x[index - 1], y[index + 1] - y[index - 1]
    length = np.hypot(dx, dy)
    for sign in (1.0, -1.0):
        shift_kp, shift_kd = -sign * distance * dy / length, sign * distance * dx / length
        yield (
            curve.kp[index] * np.exp(shift_kp * width[0]),
            curve.kd[index] * np.exp(shift_kd * width[1]),
        )


def check_sides(curves, unstable, window):
    """`unstable(kp, kd)` counts roots independently; every part must be what it says it is."""
    for curve in curves:
        assert isinstance(curve, BoundaryCurve)
        assert curve.separates == (curve.stable_side != "")
        if len(curve.kp) < 30:
            continue
        index = np.linspace(10, len(curve.kp) - 11, 7).astype(int)
        left, right = (unstable(kp, kd) for kp, kd in beside(curve, index, window))
        if curve.stable_side == "left":
            assert (left == 0).all() and (right > 0).all()
        elif curve.stable_side == "right":
            assert (right == 0).all() and (left > 0).all()
        else:
            assert (left > 0).all() and (right > 0).all()


@pytest.mark.parametrize("name", PLANTS)
def test_continuous_curves_are_marginal_and_know_their_stable_side(name):
    plant = PLANTS[name]
    curves = continuous_boundary(*plant, **WINDOW)
    assert any(curve.separates for curve in curves)
    for curve in curves:
        values = [curve.kp, curve.kd, *plant]
        np.testing.assert_allclose(theory.response(values, curve.frequency), -1.0, atol=1e-7)

    def unstable(kp, kd):
        values = np.array([kp, kd, *(np.full_like(kp, v) for v in plant)])
        return theory.collocation_count(values)

    check_sides(curves, unstable, WINDOW)


@pytest.mark.parametrize("kinds", [{}, {"velocity": "differenced", "velocity_filter": 500.0}])
@pytest.mark.parametrize("name", PLANTS)
def test_sampled_curves_are_marginal_and_know_their_stable_side(name, kinds):
    plant = PLANTS[name]
    curves = sampled_boundary(*plant, PERIOD, **WINDOW, **kinds)
    assert any(curve.separates for curve in curves)

    def moduli(kp, kd):
        matrix = theory.sampled_matrix(
            (kp, kd, *plant),
            PERIOD,
            differenced="velocity" in kinds,
            cutoff=kinds.get("velocity_filter", np.inf),
        )
        return np.abs(np.linalg.eigvals(matrix))

    for curve in curves:
        for i in range(0, len(curve.kp), 97):
            assert np.abs(moduli(curve.kp[i], curve.kd[i]) - 1.0).min() < 1e-7

    def unstable(kp, kd):
        return np.array([np.sum(moduli(*pair) > 1.0) for pair in zip(kp, kd, strict=True)])

    check_sides(curves, unstable, WINDOW)


def test_curves_are_dense_in_the_picture_and_end_on_its_edges():
    for plant in PLANTS.values():
        for curve in continuous_boundary(*plant, **WINDOW):
            x = np.log(curve.kp / 10.0) / math.log(1e4)
            y = np.log(curve.kd / 0.1) / math.log(2e4)
            assert x.min() >= -1e-9 and x.max() <= 1 + 1e-9
            assert y.min() >= -1e-9 and y.max() <= 1 + 1e-9
            assert np.hypot(np.diff(x), np.diff(y)).max() < 0.01


def test_all_lobes_are_there():
    """High gains at a long delay: every lobe 2 pi k < w td < 2 pi k + pi/2 in the window."""
    curves = continuous_boundary(0.7, math.inf, 1.0, 0.02, kp_range=(1.0, 1e6), kd_range=(1, 3000))
    lobes = {int(curve.frequency.mean() * 0.02 / (2 * math.pi)) for curve in curves}
    # kd = m w at the end of lobe k: w = (2 k + 1/2) pi / td.
    last = int((3000 / 0.7 * 0.02 / math.pi - 0.5) / 2)
    assert lobes == set(range(last + 1))
    assert {curve.separates for curve in curves if curve.frequency.mean() * 0.02 > 7} == {False}


def test_linear_windows_show_the_line_of_zero_stiffness():
    window = {"kp_range": (-100.0, 2000.0), "kd_range": (0.0, 100.0)}
    curves = continuous_boundary(0.7, 110.0, 0.9, 0.005, **window)
    lines = [curve for curve in curves if curve.kind == "line"]
    assert lines and all((line.kp == 0).all() and (line.frequency == 0).all() for line in lines)
    assert {line.separates for line in lines} == {True, False}
    stable = [line for line in lines if line.separates]
    # Upwards along the line, positive stiffness is on the right.
    assert stable[0].stable_side == "right"
    assert stable[0].kd.max() == pytest.approx(73.2335, rel=5e-3)


def test_the_alternating_root_of_the_ideal_actuator_is_a_line():
    """v is lost at z = -1: kp T^2 / 4 + kd T / 2 = m... checked on the eigenvalues."""
    curves = sampled_boundary(
        0.7, math.inf, 1.0, 0.0, PERIOD, kp_range=(10.0, 1e6), kd_range=(0.1, 2000.0)
    )
    lines = [curve for curve in curves if curve.kind == "line"]
    assert len(lines) == 1 and lines[0].separates
    np.testing.assert_allclose(lines[0].kd, 1400.0, rtol=1e-9)
    np.testing.assert_allclose(lines[0].frequency, math.pi / PERIOD)


def close(found, expected, tolerance=1e-9):
    expected = float(expected)
    if math.isinf(expected) or expected == 0.0:
        assert found == expected
    else:
        assert found == pytest.approx(expected, rel=tolerance)


@pytest.mark.parametrize("number", range(9))
def test_axis_limits_of_the_oracle(number):
    limits = theory.ORACLE["axis_limits"][number]
    plant = [
        theory.plant_values(theory.ORACLE["paper_cases"], name)[number] for name in theory.NAMES[2:]
    ]
    gains = {"kp": 400.0, "kd": 20.0}
    for key, found in (
        ("cont", continuous_limits(*plant, **gains)),
        ("zoh_true_v", sampled_limits(*plant, PERIOD, **gains)),
        ("zoh_diff_v", sampled_limits(*plant, PERIOD, velocity="differenced", **gains)),
    ):
        for name in ("kp_max", "kd_min", "kd_max"):
            close(getattr(found, name), limits[key][name])
        assert 0.0 <= found.kp_min < 400.0


@pytest.mark.parametrize("number", range(9))
def test_first_lobes_of_the_oracle(number):
    expected = theory.ORACLE["first_lobe"][number]
    plant = [
        theory.plant_values(theory.ORACLE["paper_cases"], name)[number] for name in theory.NAMES[2:]
    ]
    found = first_lobe(*plant)
    close(found.kp_max, expected["kp_max"])
    close(found.kd_max, expected["kd_max_kp0"])
    close(found.frequency_at_kd_max, expected["w_kp0"])
    # Where a flat maximum lies is known to half the digits only; the oracle's is good to 6e-9.
    close(found.frequency_at_kp_max, expected["w_kpmax"], 1e-8)
    close(found.kd_at_kp_max, expected["kd_at_kpmax"], 1e-8)


def test_only_the_sum_of_the_delays_matters():
    split = sampled_boundary(
        0.7, 110.0, 0.9, 1e-3, PERIOD, measurement_delay=5e-4, output_delay=1.1e-3, **WINDOW
    )
    whole = sampled_boundary(0.7, 110.0, 0.9, 2.6e-3, PERIOD, **WINDOW)
    assert len(split) == len(whole)
    np.testing.assert_allclose(split[0].kp, whole[0].kp, rtol=1e-9)


@pytest.mark.exhaustive
def test_the_euler_boundary_approaches_the_exact_one():
    exact = sampled_limits(0.7, 110.0, 0.9, 1e-3, PERIOD, kp=400.0, kd=20.0).kd_max
    window = {"kp_range": (399.0, 401.0), "kd_range": (20.0, 400.0)}
    for substeps, tolerance in ((1, 2e-2), (8, 3e-3)):
        curves = sampled_boundary(
            0.7, 110.0, 0.9, 1e-3, PERIOD, integrator="euler", substeps=substeps, **window
        )
        assert curves[-1].kd.mean() == pytest.approx(exact, rel=tolerance)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": 0.0}, "must be positive"),
        ({"natural_frequency": -1.0}, "must be positive"),
        ({"delay": -1e-3}, "not negative"),
        ({"delay": math.nan}, "not negative"),
        ({"kp_range": (5.0, 5.0)}, "low < high"),
        ({"kd_range": (1.0, math.inf)}, "low < high"),
    ],
)
def test_nonsense_is_refused(change, message):
    arguments = {
        "mass": 0.7, "natural_frequency": 110.0, "damping_ratio": 0.9, "delay": 0.0, **WINDOW
    }  # fmt: skip
    with pytest.raises(ValueError, match=message):
        continuous_boundary(**{**arguments, **change})
    with pytest.raises(ValueError, match=message):
        sampled_boundary(control_period=PERIOD, **{**arguments, **change})


def test_limits_of_an_unstable_loop_are_not_numbers():
    assert math.isnan(continuous_limits(0.7, 110.0, 0.9, 0.005, kp=1200.0, kd=60.0).kp_max)
    with pytest.raises(ValueError, match="positive"):
        sampled_limits(0.7, 110.0, 0.9, 0.005, PERIOD, kp=-1.0, kd=60.0)
    with pytest.raises(ValueError, match="control_period"):
        sampled_limits(0.7, 110.0, 0.9, 0.005, 0.0, kp=1.0, kd=60.0)
