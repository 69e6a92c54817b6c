"""What is said of a robot's gains that cannot be met, against random search over four decades."""

import numpy as np
import pytest
import robots

from jaxact.loops import reading
from jaxact.tuning.box import NOMINAL
from jaxact.tuning.goal import Goal
from jaxact.tuning.groups import group
from jaxact.tuning.robot import search as robot
from jaxact.tuning.robot.loops import situation
from jaxact.tuning.robot.open_loops import open_loops

QUICK = {"starts": 2, "steps": 30}
# The arm standing on its shoulder: without gains it topples, with its own it shakes.
SPECIFICATION = """
engine = "mujoco"
[plant]
model = '{path}'
keyframe = "up"
posture = "keyframe"
[parameters]
actuator = "ideal"
delay = 0.01
[axes]
feedforward = [0.0]
"""


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    path = tmp_path_factory.mktemp("standing") / "arm.xml"
    key = '<key name="up" qpos="-1.5708 0" ctrl="-1.5708 0"/></keyframe>'
    path.write_text(robots.PENDULUM.replace("</keyframe>", key))
    return situation(reading.parse(SPECIFICATION.format(path=path)), "up")


def _peak(loops, kp, kd):
    """Largest singular value of S and T, by dense solves; infinite of an unstable loop."""
    M, N, C = loops.closed(0, kp, kd)
    if np.abs(np.linalg.eigvals(M)).max() >= 1.0:
        return np.inf
    z = np.exp(1j * np.pi * np.geomspace(1e-4, 1.0, 150))[:, None, None]
    L = -C @ np.linalg.solve(z * np.eye(len(M)) - loops.A[0], N[None].astype(complex))
    S = np.linalg.inv(np.eye(len(kp)) + L)
    return max(np.linalg.svd(X, compute_uv=False)[:, 0].max() for X in (S, np.eye(len(kp)) - S))


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "patterns",
    [pytest.param(["shoulder|elbow"], id="one group"), pytest.param([], id="every joint")],
)
def test_random_search_contradicts_no_statement(standing, patterns):
    """From gains with which it shakes, as the model has them; bounds that nothing meets."""
    groups = group(patterns, standing.names)
    tuned = robot.tune(
        [standing], Goal(max_peak=1.05), groups, start=(standing.kp, standing.kd), **QUICK
    )
    assert not tuned.certified and "does not prove" in tuned.verdict and "2 starts" in tuned.verdict
    found = max(check.value for check in tuned.closest)
    assert f"{found:.6g}" in tuned.verdict
    loops, generator = open_loops([standing], NOMINAL), np.random.default_rng(7)
    own = groups.log_gains(standing.kp, standing.kd)
    decades = generator.uniform(-2.5, 1.5, (1500, len(own))) * np.log(10.0)
    peaks = [_peak(loops, *groups.gains(own + offset)) for offset in decades]
    # Some are stable, or nothing would be looked at.
    assert 20 < np.isfinite(peaks).sum() and min(peaks) > found * 0.999
