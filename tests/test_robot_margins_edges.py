"""Margins of robots with joints that nothing moves, and with objects that nothing holds."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import brentq

import jaxact as jx
from jaxact.analysis.robot import disk, limits, multiloop
from jaxact.analysis.robot.margins import _of_joint, robot_margins
from jaxact.analysis.robot.modes import Robot
from jaxact.errors import UserError

QUADRUPED = Path(__file__).resolve().parents[1] / "experiments" / "quadruped" / "quadruped.xml"


def _robot(reach, inertias=(1.0, 1.0), coupling=0.0):
    """x+ = M x + N d, u = C x: two integrators, the second one moved by its command times reach."""
    N = np.diag([1.0, reach])
    C = np.array([[0.1, coupling], [0.0, 0.1]])
    M = np.eye(2) - N @ C
    matrices = M, N, C
    return Robot(
        matrices, np.eye(2), np.eye(2), np.array(inertias), ("hip", "knee"), 1e-3,
        lambda _: matrices,
    )  # fmt: skip


def test_a_joint_whose_command_moves_nothing_is_named():
    with pytest.raises(UserError, match=r"knee: the joint's command moves nothing"):
        robot_margins(_robot(0.0, coupling=0.1))


def test_an_infinite_inertia_takes_no_part_in_a_motion():
    found = robot_margins(_robot(0.5, inertias=(1.0, np.inf)))
    np.testing.assert_array_equal(found.slowest.participation, [0.5, 0.5])  # the knee's alone
    np.testing.assert_array_equal(found.critical.participation, [1.0, 0.0])


def test_a_root_at_one_leaves_the_figures_finite():
    # A third state is seen by the hip's controller, and nothing holds it.
    M = np.array([[0.9, 0.0, -0.1], [0.0, 0.9, 0.0], [0.0, 0.0, 1.0]])
    C = np.array([[0.1, 0.0, 0.1], [0.0, 0.1, 0.0]])
    N = np.array([[1.0, 0.0], [0.0, 1.0], [1e-9, 0.0]])
    matrices = M, N, C
    robot = Robot(
        matrices, np.eye(2, 3), np.eye(2, 3), np.ones(2), ("hip", "knee"), 1e-3, lambda _: matrices
    )
    assert np.isfinite(robot_margins(robot).whole.sensitivity_peak)


def _direct(matrices, angle):
    """S from its definition, by a dense solution at every frequency."""
    M, N, C = matrices
    z = np.exp(1j * angle)[:, None, None]
    return np.eye(N.shape[1]) + C @ np.linalg.solve(z * np.eye(len(M)) - M, N.astype(complex))


def _random(seed, states, joints, delays):
    """Stable matrices with commands that come several periods late, whose roots are defective."""
    random = np.random.default_rng(seed)
    M = random.normal(size=(states, states))
    M *= 0.97 / np.abs(np.linalg.eigvals(M)).max()
    line = np.kron(np.eye(delays, k=-1), np.eye(joints))
    into = np.zeros((states, delays * joints))
    into[:, -joints:] = random.normal(size=(states, joints))
    whole = np.block([[M, into], [np.zeros_like(into.T), line]])
    N = np.zeros((len(whole), joints))
    N[states : states + joints] = np.eye(joints)
    C = np.zeros((joints, len(whole)))
    C[:, :states] = 0.1 * random.normal(size=(joints, states))
    return whole, N, C


@pytest.mark.parametrize(("seed", "states", "joints", "delays"), [(0, 9, 3, 5), (1, 20, 6, 1)])
def test_the_sum_of_modes_is_the_sensitivity(seed, states, joints, delays):
    matrices, angle = _random(seed, states, joints, delays), np.geomspace(1e-3, np.pi, 40)
    loop = multiloop.multiloop(*matrices, 1e-3)
    assert loop.terms is not None
    S, joint = _direct(matrices, angle), np.arange(40) % joints
    np.testing.assert_allclose(multiloop.sensitivity(loop, angle), S, atol=1e-11)
    own = multiloop.own_sensitivity(loop, angle, joint)
    np.testing.assert_allclose(own, S[np.arange(40), joint, joint], atol=1e-11)


def test_defective_roots_that_last_are_no_sum_of_modes_and_the_sensitivity_is_right():
    M = np.array([[0.9, 1.0, 0.0], [0.0, 0.9, 1.0], [0.0, 0.0, 0.9]])
    matrices = M, np.array([[0.0], [0.0], [1.0]]), np.array([[1e-3, 0.0, 0.0]])
    loop, angle = multiloop.multiloop(*matrices, 1e-3), np.geomspace(1e-3, np.pi, 40)
    assert loop.terms is None
    np.testing.assert_allclose(multiloop.sensitivity(loop, angle), _direct(matrices, angle))
    own = multiloop.own_sensitivity(loop, angle, np.zeros(40, int))
    np.testing.assert_allclose(own, _direct(matrices, angle)[:, 0, 0])


def test_the_centre_of_the_disk_margins_bound_is_stationary():
    """Where log det(b P - H* P H) is stationary for P of one trace, by differences."""
    random = np.random.default_rng(3)
    H = random.normal(size=(4, 4)) + 1j * random.normal(size=(4, 4))
    H /= np.linalg.norm(H, 2)
    weights = np.ones(4)
    for _ in range(3):  # Newton's method stops near the centre each time
        weights = disk._centre(H, weights, 1.5)

    def value(weights):
        P = np.diag(weights)
        return np.linalg.slogdet(1.5 * P - H.conj().T @ P @ H)[1]

    slope = [(value(weights + 1e-6 * e) - value(weights - 1e-6 * e)) / 2e-6 for e in np.eye(4)]
    np.testing.assert_allclose(slope, np.mean(slope), rtol=1e-6)


def test_a_gain_limit_that_no_crossing_shows_has_the_frequency_of_the_root_that_leaves(monkeypatch):
    """Two joints of which each turns by an angle and grows with the gains; one crossing is seen."""
    turn = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in (0.3, 0.7)]
    rise = 0.05, 0.04  # of the roots' size with the factor: 0.9 + rise (factor - 1)
    M = 0.9 * block_diag(*turn)
    C = block_diag(*(b * R for b, R in zip(rise, turn, strict=True)))
    first, second = (1.0 + 0.1 / b for b in rise)
    value = complex(second / (second - 1.0))
    seen = limits.Crossing(0.7, 0.7, value, value, 0.7, value)
    monkeypatch.setattr(limits, "refined", lambda loop, crossing: crossing)
    found = limits.gain_limit(None, (M, np.eye(4), C), [seen], up=True)
    assert found == pytest.approx((first, 0.3), rel=1e-6)


def test_of_legs_that_are_alike_the_first_to_shake_bounds_the_gains():
    # Rounding in the model parts the four legs by 5e-7 of their gain margin.
    loop = jx.robot(
        QUADRUPED, keyframe="stand", base="fixed", control_rate=500.0, kp=72.888, kd=2.18664,
        delay=5.228e-3, wn=329.617, zeta=0.642243,
    )  # fmt: skip
    (found,) = jx.margins(loop).details
    M, N, C = found.robot.matrices

    def radius(factor):
        return np.abs(np.linalg.eigvals(M + (factor - 1.0) * N @ C)).max() - 1.0

    first = brentq(radius, 1.2, 1.4, xtol=1e-12)
    assert found.margins.whole.gain_margin == pytest.approx(first, rel=1e-7)


def test_a_factor_on_gains_that_is_rounding_is_none():
    """-1/L = S / (S - 1) where S is 0 but for its last digits."""
    at, none = np.array([0.1, 0.2]), (np.array([]), np.array([]))
    for small, expected in ((-1e-14, 0.0), (-1e-6, 1e-6)):
        crossed = at, np.array([small, 2.0])
        peak = np.array([1.5, 1.2, 1.0])
        found = _of_joint("j", 1e-3, crossed, none, peak, at[[0, 1, 1]])
        assert found.gain_reduction_margin == pytest.approx(expected, rel=1e-5)
        assert found.gain_margin == 2.0
