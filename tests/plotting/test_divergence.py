"""What a picture of a trajectory says of a motion that diverges."""

import numpy as np

from jaxact.plotting.trajectory import Joint, until_divergence


def _run(position, setpoint):
    still = np.zeros_like(position)
    time = np.arange(len(position)) * 1e-3
    return Joint(time, still + setpoint, position, still, still, still, still)


def test_a_joint_at_rest_does_not_diverge_by_rounding():
    assert until_divergence(_run(1e-12 * np.arange(100.0) ** 2, 0.0)) == (100, "")


def test_a_joint_at_rest_diverges_when_it_leaves():
    kept, note = until_divergence(_run(1e-6 * 1.2 ** np.arange(100.0), 0.0))
    assert kept == 76 and note.startswith("diverges: beyond 1 rad or m after")


def test_a_step_is_what_its_response_is_measured_by():
    kept, note = until_divergence(_run(1e-6 * 1.2 ** np.arange(100.0), 0.01))
    assert kept == 67 and "20 times the step" in note
