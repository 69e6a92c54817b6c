"""Tuned gains of joints with damping and stiffness of their own, against all gains of a grid."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.analysis.joint.frequency import JointLoop
from jaxact.analysis.joint.margins import margins
from jaxact.tuning.joint.ensemble import Sampling
from jaxact.tuning.joint.metrics import evaluate
from jaxact.tuning.joint.response import step_responses

JOINT = {"mass": 0.7, "actuator": "starleth", "delay": 1e-3, "joint_damping": 2.0}
PEAK = 2.5


def _stiffest(stiffness):
    """The stiffest gains of a grid that keep both peaks, by the exact margins."""
    kp, kd = np.meshgrid(np.geomspace(30.0, 3e3, 150), np.geomspace(3.0, 100.0, 150))
    with jax.enable_x64(True):
        loop = JointLoop(
            *map(jnp.asarray, (kp, kd, 0.7, 110.0, 0.9, 1e-3)),
            joint_damping=jnp.asarray(2.0), joint_stiffness=jnp.asarray(stiffness),
        )  # fmt: skip
        found = jax.jit(margins)(loop)
    peak = np.maximum(found.sensitivity_peak, found.complementary_peak)
    return kp[np.asarray(found.stable) & (peak <= PEAK)].max()


@pytest.mark.exhaustive
@pytest.mark.parametrize("stiffness", [-300.0, 900.0])
def test_gains_are_the_stiffest_there_are(stiffness):
    loop = jx.joint(**JOINT, joint_stiffness=stiffness)
    best = jx.tune(loop, max_peak=PEAK, sampled=False)
    assert best.feasible
    expected = _stiffest(stiffness)
    assert 0.999 * expected <= best.loop.kp <= 1.05 * expected
    found = jx.margins(best.loop)
    assert max(found.sensitivity_peak, found.complementary_peak) <= PEAK * (1 + 1e-6)


@pytest.mark.exhaustive
def test_uncertain_stiffness_is_certified_at_its_worst():
    loop = jx.joint(**JOINT, joint_stiffness=-200.0)
    box = {"joint_stiffness": (-300, -100), "joint_damping": (0, 4)}
    best = jx.tune(loop, max_peak=3.0, uncertainty=box, samples=8, sampled=False)
    assert best.feasible
    ends = jx.margins(best.loop.replace(joint_stiffness=np.array([-300.0, -100.0])[:, None],
                                        joint_damping=np.array([0.0, 4.0])))  # fmt: skip
    worst = np.maximum(ends.sensitivity_peak, ends.complementary_peak).max()
    assert 2.9 < worst <= 3.0 * (1 + 1e-6)


@pytest.mark.exhaustive
def test_metrics_have_derivatives_by_damping_and_stiffness():
    plant = {"mass": 0.7, "natural_frequency": 110.0, "damping_ratio": 0.9, "delay": 1e-3}
    at, gains = np.array([3.0, -250.0]), np.log([500.0, 25.0])
    extra = ("noise_gain", "bandwidth")

    def metrics(joint):
        own = plant | dict(zip(("joint_damping", "joint_stiffness"), joint, strict=True))
        rows = {name: np.array([value]) for name, value in own.items()}
        return evaluate(gains[:1], gains[1:], rows, Sampling(1e-3), extra)

    exact = metrics(at)
    for number, step in ((0, 1e-4), (1, 1e-2)):
        ends = [metrics(at + s * step * np.eye(2)[number]).log for s in (1, -1)]
        for name in ("sensitivity_peak", "delay_margin", "gain_margin", *extra):
            expected = (ends[0][name] - ends[1][name]) / (2 * step)
            np.testing.assert_allclose(exact.slope[name][0, 6 + number], expected, rtol=1e-4)
    still = metrics(np.zeros(2))
    assert not still.slope["gain_margin"][0, 6:].any()


@pytest.mark.exhaustive
def test_step_responses_sag_by_the_stiffness():
    loop = jx.joint(**JOINT, joint_stiffness=200.0)
    members = jx.tune(loop, max_peak=PEAK, sampled=False).members
    _, positions = step_responses(members, 800.0, 30.0, 2.0)
    assert positions[0, -1] == pytest.approx(800.0 / 1000.0, rel=1e-4)
