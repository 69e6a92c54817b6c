"""Joints with damping and stiffness of their own, through the verbs: simulation against theory."""

import jax
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.errors import UserError
from jaxact.sweeping import agreement

UPRIGHT = {"mass": 0.7, "actuator": "starleth", "joint_damping": 2.0, "joint_stiffness": -300.0}
STIFFNESSES, DELAYS = np.array([-600.0, -390.0, 0.0, 300.0]), np.array([0.0, 3e-3, 0.15])


@pytest.mark.exhaustive
def test_growth_rates_over_stiffness_are_those_of_exact_theory_at_long_delays_too():
    maps = jx.sweep(
        jx.joint(**UPRIGHT, kp=400, kd=20), duration=0.2,
        joint_stiffness=STIFFNESSES.tolist(), delay=DELAYS.tolist(),
    )  # fmt: skip
    loops = jx.joint(**UPRIGHT | {"joint_stiffness": STIFFNESSES[:, None]}, delay=DELAYS)
    exact = jx.margins(loops, sampled=True)
    np.testing.assert_allclose(maps.growth_rate, exact.growth_rate, rtol=1e-4, atol=1e-3)
    assert maps.joint_stiffness.attrs["units"] == "N/m"
    # Held by less than what topples it, a joint falls whatever its damping.
    assert not exact.stable[0].any() and exact.stable[1, 0]


@pytest.mark.exhaustive
def test_verdicts_of_a_map_are_those_of_exact_theory():
    maps = jx.sweep(
        jx.joint(**UPRIGHT, delay=1e-3), kp=jx.log(30, 3e4, 12), kd=jx.log(0.3, 300, 12),
        duration=0.3,
    )  # fmt: skip
    found = agreement.sweep_agreement(maps)
    assert found.compared == 144 and found.disagreements == 0
    stable = (maps.verdict == 0).values
    assert stable.any() and not stable[maps.kp.values < 300.0].any()


@pytest.mark.exhaustive
def test_margins_map_and_differentiate_by_stiffness():
    def margin(stiffness):
        own = UPRIGHT | {"joint_stiffness": stiffness}
        return jx.margins(jx.joint(**own, kp=400, kd=20, delay=1e-3)).gain_reduction_margin

    with jax.enable_x64(True):
        at = np.array([-300.0, -200.0])
        np.testing.assert_allclose(jax.vmap(margin)(at), -at / 400.0, rtol=1e-12)
        np.testing.assert_allclose(jax.vmap(jax.grad(margin))(at), -1.0 / 400.0, rtol=1e-9)


def test_the_boundary_has_the_line_where_the_joint_topples():
    loop = jx.joint(**UPRIGHT, kp=400, kd=20, delay=1e-3)
    curves = jx.boundary(loop, kp=(100.0, 5000.0), kd=(1.0, 200.0), sampled=True)
    lines = [curve for curve in curves if curve.kind == "line" and curve.separates]
    assert lines and all(np.all(curve.kp == 300.0) for curve in lines if curve.frequency[0] == 0)


@pytest.mark.exhaustive
def test_mjx_has_the_same_joint():
    gains = {"kp": np.array([100.0, 400.0, 2000.0]), "kd": 20.0}
    loop = jx.joint(**UPRIGHT, delay=1e-3)
    maps = jx.sweep(loop, kp=gains["kp"].tolist(), engine="mjx", duration=0.05)
    exact = jx.margins(loop.replace(**gains), sampled=True).growth_rate
    # MuJoCo's step of 0.25 ms is semi-implicit: half a step of lead.
    np.testing.assert_allclose(maps.growth_rate, exact, rtol=1e-2, atol=0.05)


def test_a_robot_has_the_springs_of_its_model():
    with pytest.raises(UserError, match="springs are those of its model"):
        jx.robot("experiments/quadruped/quadruped.xml", joint_stiffness=1.0)
    with pytest.raises(UserError, match="-1.0 is out of range"):
        jx.joint(joint_damping=-1.0)


@pytest.mark.exhaustive
def test_a_limited_force_does_not_keep_a_toppling_joint_bounded():
    hit = {"kp": 900.0, "kd": 20.0, "force_limit": 30.0, "initial_velocity": [0.1, 20.0]}
    found = jx.simulate(jx.joint(**UPRIGHT, **hit), setpoint=0.0, duration=1.0)
    position = np.abs(found.position.values)
    assert position[0, -1] < 1e-3 < 100.0 < position[1, -1]
