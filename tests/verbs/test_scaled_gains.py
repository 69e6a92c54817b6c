"""Loops whose gains arrive at the joint by a factor: against the same ones with other gains."""

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx

WINDOW = {"kp": (40.0, 4000.0), "kd": (2.0, 200.0)}


@pytest.mark.parametrize("sampled", (False, True))
@pytest.mark.parametrize("scale", (3.0, 0.25))
def test_the_boundary_is_of_the_gains_before_the_factor(scale, sampled):
    loop = jx.joint(kp=400, kd=20, actuator="starleth", delay=5e-3, control_rate=1000)
    ends = {name: (scale * low, scale * high) for name, (low, high) in WINDOW.items()}
    plain = jx.boundary(loop, sampled=sampled, **ends)
    scaled = jx.boundary(loop.replace(gain_scale=scale), sampled=sampled, **WINDOW)
    assert plain and len(plain) == len(scaled)
    for one, other in zip(scaled, plain, strict=True):
        np.testing.assert_allclose(scale * one.kp, other.kp, rtol=1e-12)
        np.testing.assert_allclose(scale * one.kd, other.kd, rtol=1e-12)
        assert (one.separates, one.stable_side) == (other.separates, other.stable_side)


def test_gains_on_the_boundary_are_marginal():
    loop = jx.joint(kp=400, kd=20, actuator="starleth", delay=5e-3, gain_scale=3.0)
    (curve,) = (one for one in jx.boundary(loop, **WINDOW) if one.separates)
    middle = len(curve.kp) // 2
    kp, kd = curve.kp[middle], curve.kd[middle]
    sides = [jx.margins(loop.replace(kp=f * kp, kd=f * kd)).stable for f in (0.98, 1.02)]
    assert sides == [True, False]


def test_a_loop_without_gains_has_no_boundary():
    with pytest.raises(jx.UserError, match="`gain_scale` = 0: no gains arrive at the joint"):
        jx.boundary(jx.joint(gain_scale=0.0))
