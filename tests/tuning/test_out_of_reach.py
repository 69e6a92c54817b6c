"""Bounds that no gains of a robot meet: the search ends soon, and says where they are missed."""

import numpy as np
import pytest
from arms import at_home

from jaxact.tuning.goal import Goal
from jaxact.tuning.groups import group
from jaxact.tuning.polish import Polished
from jaxact.tuning.robot import polishing
from jaxact.tuning.robot import search as robot

LEAST = 300.0


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return at_home(tmp_path_factory.mktemp("robots"), "wn=0.8..1.2,delay=0.001..0.003")


def _tuned(arm, peak, **options):
    doing = []
    tuned = robot.tune(
        [arm], Goal(max_peak=peak, min_kp=LEAST), group([], arm.names), number=2, starts=2,
        steps=30, told=lambda text, done=0, total=0: doing.append(text), **options,
    )  # fmt: skip
    return tuned, doing


def _peaks(loops, index, kp, kd):
    """Left singular vectors and values of S and of T on a fine grid, by dense solves."""
    M, N, C = loops.closed(index, kp, kd)
    z = np.exp(1j * np.pi * np.geomspace(1e-4, 1.0, 4000))[:, None, None]
    S = np.eye(len(kp)) + C @ np.linalg.solve(z * np.eye(len(M)) - M, N[None].astype(complex))
    return [np.linalg.svd(X)[:2] for X in (S, np.eye(len(kp)) - S)]


@pytest.fixture(scope="module")
def far(arm):
    return _tuned(arm, 1.05)


@pytest.mark.exhaustive
def test_what_is_far_out_of_reach_is_evaluated_exactly_and_not_looked_into(far):
    tuned, doing = far
    assert not tuned.feasible and not tuned.certified
    assert not any("worst point" in text for text in doing)
    worst = max(tuned.closest, key=lambda check: check.excess)
    highest = [
        max(values[:, 0].max() for _, values in _peaks(tuned.members, i, tuned.kp, tuned.kd))
        for i in range(len(tuned.members))
    ]
    assert worst.value == pytest.approx(max(highest), rel=1e-4)
    assert worst.member == tuned.members.names[int(np.argmax(highest))]


@pytest.mark.exhaustive
def test_the_joint_at_which_a_bound_is_missed_most_is_named(far):
    tuned, _ = far
    worst = max(tuned.closest, key=lambda check: check.excess)
    index = tuned.members.names.index(worst.member)
    of_S, of_T = _peaks(tuned.members, index, tuned.kp, tuned.kd)
    left, values = of_S if worst.metric == "sensitivity_peak" else of_T
    joint = np.abs(left[values[:, 0].argmax(), :, 0]).argmax()
    metric = worst.metric.replace("_", " ")
    assert tuned.verdict.endswith(f"most of that {metric} is at joint {_joint(tuned, joint)}")


def _joint(tuned, number):
    """Name of a joint by its number."""
    return tuned.robot.situations[0].names[number][0]


@pytest.mark.exhaustive
def test_a_bound_just_out_of_reach_ends_too(arm, far):
    nearest = max(check.value for check in far[0].closest)
    tuned, doing = _tuned(arm, 0.97 * nearest)
    assert not tuned.feasible
    assert 1 <= sum("worst point" in text for text in doing) <= 3
    assert max(check.value for check in tuned.closest) == pytest.approx(nearest, rel=5e-3)


@pytest.mark.exhaustive
def test_where_a_few_frequencies_do_not_show_that_a_loop_is_lost_all_are_looked_at(
    far, monkeypatch
):
    case = far[0].robot.case
    x = case.groups.log_gains(far[0].kp, far[0].kd)
    stage, seen = polishing._stage, []

    def lost_at_first(case, near, kept, x, *others):
        seen.append(kept.copy())
        if len(seen) > 1:
            return stage(case, near, kept, x, *others)
        assert not case.stable(x + 6.0)
        return Polished(x[None] + 6.0, np.zeros(1), np.zeros(1), 1), 1

    monkeypatch.setattr(polishing, "_stage", lost_at_first)
    assert case.stable(polishing.polished(case, x, fine=False).x)
    assert not seen[0].all() and seen[1].all()
