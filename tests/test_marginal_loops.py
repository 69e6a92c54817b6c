"""Loops with roots on the imaginary axis are not stable, held against roots of polynomials."""

import numpy as np
import pytest

import jaxact as jx

MASS, WN, ZETA = 0.7, 800.0, 0.45
EDGE = 1e-9


def poles(kp, kd, joint_damping=0.0, joint_stiffness=0.0, *, servo=False):
    """Roots of (m s^2 + c s + k) D(s) + kp + kd s by NumPy."""
    denominator = [1 / WN**2, 2 * ZETA / WN, 1.0] if servo else [1.0]
    plant = np.polymul([MASS, joint_damping, joint_stiffness], denominator)
    return np.roots(np.polyadd(plant, [kd, kp]))


@pytest.mark.parametrize("servo", [False, True], ids=["ideal", "servo"])
@pytest.mark.parametrize(
    "given",
    [
        {"kp": 0, "kd": 0},
        {"kp": 0, "kd": 5},
        {"kp": 0, "kd": -5},
        {"kp": 400, "kd": 0},
        {"kp": 0, "kd": 0, "joint_damping": 3},
        {"kp": 0, "kd": 0, "joint_stiffness": 3},
        {"kp": 0, "kd": 0, "joint_stiffness": 3, "joint_damping": 1},
        {"kp": 0, "kd": 0, "joint_stiffness": -3},
        {"kp": 400, "kd": 0, "joint_stiffness": 100},
        {"kp": 400, "kd": 0, "joint_stiffness": 1000},
        {"kp": 400, "kd": 0, "joint_stiffness": -100},
        {"kp": 100, "kd": 0, "joint_stiffness": -100},
        {"kp": 100, "kd": 5, "joint_stiffness": -100},
        {"kp": 100, "kd": -5, "joint_stiffness": -100},
    ],
    ids=str,
)
def test_roots_on_the_axis_count_as_unstable(given, servo):
    own = poles(**given, servo=servo)
    found = jx.margins(jx.joint(mass=MASS, actuator="hyq" if servo else "ideal", **given))
    assert found.unstable_roots == np.sum(own.real >= -EDGE)
    assert found.stable == (own.real.max() < -EDGE)
    assert np.isnan(found.gain_margin) != found.stable
    assert found.growth_rate == pytest.approx(own.real.max(), abs=1e-6)


def test_the_table_of_a_joint_that_nothing_holds_says_so():
    text = " ".join(str(jx.margins(jx.joint(mass=MASS, kp=0, kd=0, actuator="starleth"))).split())
    assert "unstable roots 2" in text
    assert "rightmost root 0 1/s" in text
