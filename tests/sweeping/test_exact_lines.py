"""The exact boundary over any two parameters: closed forms, scipy's matrices, the gains' plane."""

import numpy as np
import pytest
import theory
from quickly import compiled_quickly as compiled_quickly
from synthetic_store import dataset

from jaxact.sweeping.exact_lines import Window, exact_lines
from jaxact.sweeping.tracing import trace

PLANES = {
    "delay over wn": (("wn", 20.0, 2e3, True), ("delay", 0.0, 0.02, False)),
    "mass over gain_scale": (("gain_scale", 0.1, 30.0, True), ("mass", 0.05, 5.0, True)),
    "zeta over control_rate": (("control_rate", 50.0, 2e3, True), ("zeta", 0.05, 2.0, True)),
}


def slice_of(velocity="sampled", **parameters):
    """A sweep of one cell, whose fixed values are those given."""
    given = {"kp": 800.0, "kd": 40.0, "wn": 110.0, "zeta": 0.9, "delay": 0.003} | parameters
    lines = "\n".join(f"{name} = {value}" for name, value in given.items())
    text = f'velocity = "{velocity}"\n[parameters]\n{lines}\n[axes]\nfeedforward = [0.0, 1.0]\n'
    return dataset(text).isel(feedforward=0), {"mass": 0.7, "control_rate": 1000.0} | given


def sampled_growth(given, **kinds):
    """Logarithm of the spectral radius by scipy's matrix exponential."""
    values = np.array([given[n] for n in ("kp", "kd", "mass", "wn", "zeta", "delay")])
    values[:2] *= given.get("gain_scale", 1.0)
    matrix = theory.sampled_matrix(values, 1.0 / given["control_rate"], **kinds)
    return np.log(np.abs(np.linalg.eigvals(matrix)).max())


def count(given):
    values = np.array([[given[n]] for n in ("kp", "kd", "mass", "wn", "zeta", "delay")])
    values[:2] *= given.get("gain_scale", 1.0)
    return int(theory.collocation_count(values)[0])


def test_a_circle_and_a_saddle_are_traced_to_a_millionth():
    nodes = np.linspace(-1.0, 1.0, 12)
    (circle,) = trace(lambda x, y: x * x + y * y < 0.5, nodes, nodes)
    np.testing.assert_allclose(np.hypot(*circle), np.sqrt(0.5), atol=1e-6)
    assert circle[0][0] == circle[0][-1] and circle[1][0] == circle[1][-1]
    cross = trace(lambda x, y: (x - 0.03) * (y + 0.02) > 0.001, nodes, nodes)
    assert len(cross) == 2
    for x, y in cross:
        np.testing.assert_allclose((x - 0.03) * (y + 0.02), 0.001, atol=1e-6)
    assert trace(lambda x, y: x > 9.0, nodes, nodes) == []


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", PLANES)
def test_the_line_is_where_exact_stability_changes(name):
    part, given = slice_of()
    x, y = (Window(*window) for window in PLANES[name])
    found = exact_lines(part, x, y)
    assert found.sampled and found.continuous
    for first, second in found.sampled:
        for index in range(0, len(first), 9):
            at = given | {x.name: first[index], y.name: second[index]}
            assert abs(sampled_growth(at)) < 1e-4
    for first, second in found.continuous:
        for index in range(4, len(first), 25):
            counts = {
                count(given | {x.name: first[index] * a, y.name: second[index] * b}) > 0
                for a in (0.999, 1.001) for b in (0.999, 1.001)
            }  # fmt: skip
            assert counts == {True, False}


@pytest.mark.exhaustive
def test_a_traced_line_in_the_plane_of_the_gains_is_the_d_partition_curve():
    """Scaled gains are traced, those as they are follow the formula: the same curve."""
    x, y = Window("kp", 100.0, 1e4, True), Window("kd", 10.0, 300.0, True)
    formula = exact_lines(slice_of()[0], x, y)
    traced = exact_lines(slice_of(gain_scale=2.0)[0], x, y)
    assert formula.sampled and traced.sampled
    for kp, kd in traced.sampled:
        for index in range(0, len(kp), 5):
            distances = [
                np.hypot(np.log(a / (2.0 * kp[index])), np.log(b / (2.0 * kd[index]))).min()
                for a, b in formula.sampled
            ]
            inside = 2.0 * kp[index] < 0.9e4 and 2.0 * kd[index] < 270.0
            assert min(distances) < 0.02 or not inside


@pytest.mark.exhaustive
def test_the_filter_and_the_differences_of_the_velocity_are_in_both():
    part, given = slice_of("differenced", velocity_filter=400.0)
    x, y = Window("gain_scale", 0.1, 30.0, True), Window("mass", 0.05, 5.0, True)
    found = exact_lines(part, x, y)
    plain = exact_lines(slice_of("differenced")[0], x, y)
    for first, second in found.sampled:
        for index in range(0, len(first), 9):
            at = given | {"gain_scale": first[index], "mass": second[index]}
            assert abs(sampled_growth(at, differenced=True, cutoff=400.0)) < 1e-4
    assert np.abs(found.continuous[0][1][0] / plain.continuous[0][1][0] - 1.0) > 0.02


def test_no_line_where_it_would_not_be_true():
    part, _ = slice_of()
    kp = Window("kp", 100.0, 1e4, True)
    setpoint, payload = Window("setpoint", 0.1, 1.0, False), Window("payload", 0.0, 1.0, False)
    assert exact_lines(part, setpoint, payload) is None
    whole = dataset("[axes]\nkd = [5.0, 50.0]\nmass = [0.5, 1.0]\n")
    assert exact_lines(whole, kp, Window("delay", 0.0, 0.01, False)) is None
