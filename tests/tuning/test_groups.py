"""Groups of joints: which joints share their gains, and every way to say it wrongly."""

import numpy as np
import pytest

from jaxact.errors import UserError
from jaxact.tuning.groups import group

NAMES = [("left_hip", "a"), ("left_knee", "b"), ("right_hip", "c"), ("right_knee", "d")]


def test_joints_of_a_pattern_share_their_gains():
    groups = group(["hip", "knee"], NAMES)
    assert groups.names == ("hip", "knee") and list(groups.members) == [0, 1, 0, 1]
    kp, kd = groups.gains(np.log([3.0, 5.0, 0.3, 0.5]))
    np.testing.assert_allclose(kp, [3.0, 5.0, 3.0, 5.0])
    np.testing.assert_allclose(kd, [0.3, 0.5, 0.3, 0.5])
    # And back: the geometric mean of what differs.
    x = groups.log_gains(np.array([2.0, 5.0, 8.0, 5.0]), np.full(4, 0.5))
    np.testing.assert_allclose(np.exp(x), [4.0, 5.0, 0.5, 0.5])


def test_names_of_actuators_match_too_and_patterns_may_be_expressions():
    assert list(group(["^[ac]$", "^[bd]$"], NAMES).members) == [0, 1, 0, 1]


def test_without_patterns_every_joint_is_a_group():
    groups = group([], NAMES)
    assert groups.names == tuple(name for name, _ in NAMES)
    np.testing.assert_array_equal(groups.spread, np.eye(4))


@pytest.mark.parametrize(
    ("patterns", "said"),
    [
        (["hip", "ankle"], "'ankle': matches no driven joint; they are left_hip, left_knee"),
        (["hip", "left"], "joint 'left_hip' matches both 'hip' and 'left'"),
        (["hip"], "joint 'left_knee' is in no group"),
        (["hip", ""], "a pattern is empty"),
        (["hip", "("], "is not a regular expression"),
        (["hip", "hip"], "given twice"),
    ],
)
def test_groups_that_make_no_sense(patterns, said):
    with pytest.raises(UserError) as mistake:
        group(patterns, NAMES)
    assert said in str(mistake.value)
