"""The worst points of a box: nothing in it, edges included, is worse than what is certified."""

import numpy as np
import pytest

import jaxact
from jaxact.errors import UserError
from jaxact.tuning.worst import screen, worst

SPRUNG = {"mass": 1.0, "wn": 300.0, "zeta": 0.02, "delay": 0.01,
          "joint_stiffness": 1e4, "joint_damping": 5.0}  # fmt: skip
SPRUNG_BOX = {"wn": (0.3, 1.1), "zeta": (0.7, 1.3), "delay": (0, 0.1), "mass": (0.5, 2)}


def _ridge(turn):
    """A narrow curved ridge whose top is on an edge, and a broad lower hill; value and slope."""

    def rise(u):
        x, y, z = u.T
        bent = y - 0.5 - 0.3 * np.sin(turn * x)
        sharp = 1.0 - z - 40.0 * bent**2 - 0.5 * (x - 0.7) ** 2
        slope = np.stack([24.0 * bent * turn * np.cos(turn * x) - (x - 0.7), -80.0 * bent,
                          -np.ones_like(x)], axis=1)  # fmt: skip
        hill = 0.9 - (1.0 - z) - 2.0 * (x - 0.1) ** 2 - 2.0 * (y - 0.1) ** 2
        low = np.stack([-4.0 * (x - 0.1), -4.0 * (y - 0.1), np.ones_like(x)], axis=1)
        value = np.maximum(sharp, hill)
        slope = np.where((sharp >= hill)[:, None], slope, low)
        return value[:, None], lambda index, row: slope[index]

    return rise


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("turn", [3.0, 9.0])
def test_a_narrow_ridge_along_an_edge_is_climbed_to_its_top(turn, seed):
    found = worst(_ridge(turn), screen(3, seed, 64), seed)
    assert found.largest == pytest.approx(1.0, abs=1e-6)
    assert found.fraction[0, 2] == 0.0 and abs(found.fraction[0, 0] - 0.7) < 1e-2


def test_what_is_screened_stands_at_corners_edges_and_between():
    points = screen(3, 0, 256)
    ends = np.sum((points == 0.0) | (points == 1.0), axis=1)
    assert points.min() == 0.0 and points.max() == 1.0
    assert all(np.mean(ends == number) > 0.05 for number in range(4))


def _peak(kp, kd, plant, wn, zeta, delay, mass):
    """Largest Ms of loops with a sprung joint, shape (n,), on a grid dense at both resonances."""
    own = np.sqrt(plant["joint_stiffness"] / mass)
    near = np.concatenate([-np.geomspace(0.5, 1e-4, 60), [0.0], np.geomspace(1e-4, 0.5, 60)])
    wide = np.broadcast_to(np.geomspace(1.0, 3e3, 200), (len(wn), 200))
    w = np.concatenate([wide, wn[:, None] * (1 + near), own[:, None] * (1 + near)], axis=1)
    s, (wn, zeta, delay, mass) = 1j * w, (a[:, None] for a in (wn, zeta, delay, mass))
    actuator = wn**2 / (s * s + 2 * zeta * wn * s + wn**2) * np.exp(-s * delay)
    joint = mass * s * s + plant["joint_damping"] * s + plant["joint_stiffness"]
    return np.abs(1.0 / (1.0 + (kp + kd * s) * actuator / joint)).max(axis=1)


def _sprung_worst(kp, kd, number=6000):
    """The worst Ms over the box: points at random, half of the coordinates at ends, and climbs."""
    generator = np.random.default_rng(11)
    low, high = np.array([SPRUNG_BOX[name] for name in ("wn", "zeta", "delay", "mass")]).T
    nominal = np.array([SPRUNG["wn"], SPRUNG["zeta"], 1.0, 1.0])

    def peak(u):
        return _peak(kp, kd, SPRUNG, *((low + (high - low) * u) * nominal).T)

    u = generator.random((number, 4))
    u = np.where(generator.random(u.shape) < 0.4, np.round(u), u)
    value = peak(u)
    u, value = u[np.argsort(-value)[:60]], np.sort(value)[::-1][:60]
    for width in np.geomspace(0.1, 1e-4, 100):
        move = width * generator.standard_normal(u.shape) * (generator.random(u.shape) < 0.6)
        trial = np.clip(u + move, 0.0, 1.0)
        there = peak(trial)
        u, value = np.where((there > value)[:, None], trial, u), np.maximum(value, there)
    return float(value.max())


@pytest.mark.exhaustive
@pytest.mark.parametrize(("max_peak", "least"), [(4.0, 9.0), (1.6, 4.0)])
def test_resonances_in_the_box_are_certified_and_no_worse_than_is_said(max_peak, least):
    """A stiffer gain than `least` is known by hand to meet the bound (kd 0.001)."""
    tuned = jaxact.tune(
        jaxact.joint(**SPRUNG), uncertainty=SPRUNG_BOX, max_peak=max_peak, progress=False
    )
    seen = _sprung_worst(tuned.kp, tuned.kd)
    said = next(c for c in tuned.certificate.checks if c.metric == "sensitivity_peak")
    assert tuned.certified and tuned.kp > least
    assert seen <= max_peak * (1 + 1e-6)
    assert said.value >= seen * (1 - 1e-6) and said.value <= max_peak * (1 + 1e-9)
    assert said.member.startswith("interior ") and "wn=" in said.member


@pytest.mark.exhaustive
def test_the_worst_points_on_edges_of_a_sampled_resonance_are_found():
    """Aliased resonances: a peak that is 9 % higher hides on an edge of the box."""
    plant = {"mass": 1.0, "wn": 600.0, "zeta": 0.03, "delay": 0.005, "control_rate": 100.0}
    box = {"wn": (0.7, 1.3), "zeta": (0.5, 1.5), "delay": (0, 0.02)}
    tuned = jaxact.tune(
        jaxact.joint(**plant), uncertainty=box, max_peak=2.5, seed=1, progress=False
    )
    generator = np.random.default_rng(3)
    u = generator.random((2000, 3))
    u = np.where(generator.random(u.shape) < 0.5, np.round(u), u)
    edge = np.linspace(0.0, 1.0, 200)
    u = np.concatenate([u, *(np.stack([0 * edge + a, 0 * edge, edge], 1) for a in (0, 1))])
    wn, zeta, delay = (
        low + (high - low) * c for (low, high), c in zip(box.values(), u.T, strict=True)
    )
    loops = jaxact.joint(**plant | {"wn": 600 * wn, "zeta": 0.03 * zeta, "delay": delay},
                         kp=tuned.kp, kd=tuned.kd)  # fmt: skip
    peak = np.asarray(jaxact.margins(loops, sampled=True).sensitivity_peak)
    assert tuned.certified and tuned.kp > 250.0
    assert peak.max() <= 2.5 * (1 + 1e-9)
    assert peak.max() > 2.4


@pytest.mark.exhaustive
def test_a_box_that_no_search_settles_names_the_point_and_what_to_do(monkeypatch):
    monkeypatch.setattr("jaxact.tuning.joint.exchange._EXCHANGES", 0)
    tuned = jaxact.tune(
        jaxact.joint(**SPRUNG), uncertainty=SPRUNG_BOX, max_peak=1.6, progress=False
    )
    assert not tuned.certified
    assert "interior " in tuned.verdict and "wn=" in tuned.verdict
    assert "more samples" in tuned.verdict and "narrower" in tuned.verdict


def test_a_robot_that_limits_hold_is_not_certified(tmp_path):
    model = tmp_path / "leg.xml"
    model.write_text(
        "<mujoco><worldbody><body><joint name='knee' type='hinge' axis='0 1 0' limited='true' "
        "range='-2.7 -0.8'/><geom type='capsule' size='0.02' fromto='0 0 0 0 0 -0.3'/></body>"
        "</worldbody><compiler angle='radian'/><actuator><motor joint='knee'/></actuator></mujoco>"
    )
    loop = jaxact.robot(str(model), wn=150.0, zeta=0.6, delay=0.003, control_rate=200.0)
    with pytest.raises(UserError, match="knee .* held there by its limit.*keyframe"):
        jaxact.tune(loop, max_peak=2.0, progress=False)
