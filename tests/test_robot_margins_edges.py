"""Margins of robots with joints that nothing moves, and with objects that nothing holds."""

import numpy as np
import pytest

from jaxact.errors import UserError
from jaxact.robot_margins import robot_margins
from jaxact.robot_modes import Robot


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
