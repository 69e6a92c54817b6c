"""A robot's certificate holds all over its box, edges included, as its margins have it there."""

import numpy as np
import pytest

import jaxact

ARM = """<mujoco><option timestep="0.001"/><compiler angle="radian"/><worldbody><body>
<joint name="shoulder" axis="0 1 0" damping="0.05" armature="0.02"/>
<geom type="capsule" size=".03" fromto="0 0 0 .4 0 0" mass="2" contype="0"/>
<body pos=".4 0 0"><joint name="elbow" axis="0 1 0" damping="0.05" armature="0.02"/>
<geom type="capsule" size=".025" fromto="0 0 0 .3 0 0" mass="1" contype="0"/></body></body>
</worldbody><actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>
<keyframe><key name="home" qpos="0.5 0.8"/></keyframe></mujoco>"""
SPANS = {
    "both": {"wn": (0.7, 1.3), "zeta": (0.5, 1.5), "delay": (0.0, 0.02)},
    "apart": {"wn@shoulder": (0.7, 1.3), "wn@elbow": (0.7, 1.3), "delay": (0.0, 0.02)},
    "body": {"wn": (0.7, 1.3), "zeta": (0.5, 1.5), "delay": (0.0, 0.02),
             "output_delay": (0.0, 0.01), "joint_armature": (0.0, 0.05)},
}  # fmt: skip
DRIVES = {
    "both": {"wn": 600.0, "control_rate": 100.0},
    "apart": {"wn": 600.0, "control_rate": 100.0},
    "body": {"wn": 300.0, "control_rate": 200.0},
}
BOUND = 2.5


def _tuned_and_points(folder, name, number):
    """A tuned arm with light actuators, and Ms and Mt at points of its box, shape (n,) each."""
    (folder / "arm.xml").write_text(ARM)
    given = {"keyframe": "home", "zeta": 0.03, "delay": 0.005} | DRIVES[name]
    model, span = str(folder / "arm.xml"), SPANS[name]
    tuned = jaxact.tune(
        jaxact.robot(model, **given), uncertainty=span, max_peak=BOUND, progress=False
    )
    generator = np.random.default_rng(7)
    u = generator.random((number, len(span)))
    u = np.where(generator.random(u.shape) < 0.5, np.round(u), u)
    low, high = np.array(list(span.values())).T
    scale = [given[key.split("@")[0]] if key.startswith(("wn", "zeta")) else 1.0 for key in span]
    values = dict(zip(span, ((low + (high - low) * u) * scale).T, strict=True))
    gains = {
        f"{gain}@{joint}": float(value)
        for gain, own in (("kp", tuned.kp), ("kd", tuned.kd))
        for joint, value in zip(("shoulder", "elbow"), own, strict=True)
    }
    found = jaxact.margins(jaxact.robot(model, **(given | gains | values)))
    return tuned, np.asarray(found.sensitivity_peak), np.asarray(found.complementary_peak)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", list(SPANS))
def test_nothing_in_the_box_is_worse_than_what_is_certified(tmp_path, name):
    """Points at random, half of the coordinates at ends: unstable ones would be NaN."""
    tuned, sensitivity, complementary = _tuned_and_points(tmp_path, name, 300)
    said = {check.metric: check.value for check in tuned.certificate.checks}
    assert tuned.certified
    for metric, peaks in (
        ("sensitivity_peak", sensitivity), ("complementary_peak", complementary)
    ):  # fmt: skip
        assert peaks.shape == (300,) and peaks.max() <= said[metric] * (1 + 1e-6) <= BOUND * 1.00001
    assert max(sensitivity.max(), complementary.max()) > 0.97 * BOUND
    names = [tuned.members.name(i) for i in range(len(tuned.members))]
    assert any(name.startswith("interior ") and "wn" in name for name in names)
