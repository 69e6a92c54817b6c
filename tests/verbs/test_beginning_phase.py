"""Where the phases of pictures begin, against the loop at a low frequency."""

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.verbs.responses import _beginning, responses

# kp, kd, k, c, and the phase that a reader expects [deg].
BEGINNINGS = (
    (400.0, 20.0, 100.0, 0.0, 0.0),
    (400.0, 20.0, 100.0, 3.0, 0.0),
    (400.0, 20.0, 0.0, 0.0, -180.0),
    (400.0, 20.0, -100.0, 0.0, -180.0),
    (400.0, 0.0, 0.0, 0.0, -180.0),
    (0.0, 20.0, 0.0, 0.0, -90.0),
    (0.0, 20.0, 100.0, 0.0, 90.0),
    (-50.0, 20.0, 100.0, 0.0, 180.0),
)


@pytest.mark.parametrize("kp, kd, k, c, expected", BEGINNINGS)
def test_a_phase_begins_with_the_gains_over_the_joint(kp, kd, k, c, expected):
    values = {"kp": kp, "kd": kd, "mass": 1.0, "joint_stiffness": k, "joint_damping": c}
    for w, near in ((1e-6, 1e-3), (0.5, 20.0)):
        found = _beginning(values, w)
        assert found == pytest.approx(expected, abs=near)
        seen = np.angle((kp + 1j * kd * w) / (k - w * w + 1j * c * w), deg=True)
        assert (found - seen + 180.0) % 360.0 == pytest.approx(180.0)


@pytest.mark.exhaustive
@pytest.mark.parametrize("kp, kd, k", [(400.0, 20.0, 100.0), (-50.0, 20.0, 100.0)])
def test_sampled_and_continuous_phases_begin_together(kp, kd, k):
    loop = jx.joint(mass=1, kp=kp, kd=kd, joint_stiffness=k, control_rate=1000, actuator="hyq")
    continuous, sampled = responses(loop, sampled=True)
    assert sampled.phase[0] == pytest.approx(continuous.phase[0], abs=1.0)
