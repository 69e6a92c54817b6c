"""A response has settled where it stays settled, not where it swings through the band."""

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from scipy.linalg import expm

import jaxact as jx

MASS, WN, ZETA = 0.7, 110.0, 0.9
KP, KD = 16.882033167003637, 1.0160851385040377

# A mass on rails behind a servo that hardly damps: it swings once a second.
SLIDER = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
<body><joint name="x" type="slide" axis="1 0 0"/><geom type="sphere" size=".1" mass="1"/></body>
</worldbody><actuator><position joint="x" kp="39.478" kv=".5"/></actuator></mujoco>"""


def settled(duration, step=1e-4):
    """When the joint behind its actuator settles, in continuous time, all else left out."""
    A = np.zeros((4, 4))  # x, v, f, f'
    A[0, 1], A[1, 2], A[2, 3] = 1.0, 1.0 / MASS, 1.0
    A[3] = np.array([-KP, -KD, -1.0, -2.0 * ZETA / WN]) * WN**2
    once, x, last = expm(A * step), np.array([-1.0, 0.0, 0.0, 0.0]), 0.0
    for number in range(round(duration / step)):
        x = once @ x
        last = (number + 1) * step if abs(x[0]) > 0.02 else last
    return last


def test_what_swings_through_the_band_at_the_end_has_not_settled():
    loop = jx.joint(mass=MASS, kp=KP, kd=KD, actuator="starleth")
    times = [jx.simulate(loop, setpoint=0.1, duration=d).settling_time.item() for d in (1, 3, 10)]
    assert np.isnan(times[:2]).all()
    # the controller's sampling takes away half a period's damping
    assert times[2] == pytest.approx(settled(10.0), rel=0.02)


@pytest.mark.exhaustive
def test_a_settling_time_does_not_change_where_the_rollout_is_longer():
    loop = jx.joint(mass=MASS, kp=100, kd=10, actuator="starleth", delay=1e-3)
    axes = {"kp": jx.log(10, 3000, 16), "kd": jx.log(0.3, 200, 16)}
    short, long = (jx.sweep(loop, **axes, duration=d, progress=False) for d in (1.0, 8.0))
    stable = (long.verdict == jx.Verdict.STABLE).values
    brief, known = short.settling_time.values[stable], long.settling_time.values[stable]
    found = np.isfinite(brief)
    assert found.sum() > 25
    np.testing.assert_allclose(brief[found], known[found], atol=1e-6)
    # and little is lost of what has settled well before the end
    assert found[known < 0.8].mean() > 0.95


@pytest.mark.exhaustive
@pytest.mark.parametrize("engine", ["mujoco", "mjx"])
def test_a_robot_that_swings_through_the_band_has_not_settled(engine, tmp_path):
    (tmp_path / "slider.xml").write_text(SLIDER)
    robot = jx.robot(tmp_path / "slider.xml")
    # cos(w t) exp(-t / 4) passes 0 at 0.75 s, and leaves 2 % for good after 4 ln 50 s
    swinging, still = (
        jx.simulate(robot, setpoint=0.1, duration=d, engine=engine).settling_time.item()
        for d in (0.752, 20.0)
    )
    assert np.isnan(swinging)
    assert still == pytest.approx(4.0 * np.log(50.0), abs=0.5)
