"""What `simulate` says of a loop's starts."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxact.simulation.single import Joint, Single, Start
from jaxact.status import Verdict
from jaxact.verbs import starts


def _run(verdict, growth_rate, *starts, duration=2.0, moved=0.0):
    made = tuple(Start(name, end, moving, not moving, 0.0, 0.0) for name, end, moving in starts)
    results = {"verdict": float(verdict), "growth_rate": growth_rate}
    of_robot = SimpleNamespace(
        configuration=np.zeros((1, 1)),
        time=np.array([0.0, duration]),
        position=np.array([[0.0], [moved]]),
    )
    return Single(of_robot, results, {}, (Joint("hip", True),), made)


@pytest.mark.parametrize(
    ("verdict", "growth_rate", "slide", "moving", "said"),
    [
        (Verdict.STABLE, -1.0, Verdict.STABLE, False, Verdict.STABLE.advice),
        (Verdict.UNSTABLE, 1.0, Verdict.UNSTABLE, True, Verdict.UNSTABLE.advice),
        (Verdict.UNSTABLE, 1.0, Verdict.UNSTABLE, False, "dry friction ended the motion"),
        (Verdict.UNSTABLE, -1.0, Verdict.UNSTABLE, True, "Small perturbations decay, but"),
    ],
)
def test_advice_is_that_of_what_happened(verdict, growth_rate, slide, moving, said):
    own = Verdict.STABLE if growth_rate < 0.0 else Verdict.UNSTABLE
    run = _run(verdict, growth_rate, ("", own, False), ("slide", slide, moving))
    assert said in starts.advice(run)


def test_a_growth_rate_of_the_posture_is_not_said_to_be_that_of_the_setpoint():
    own = ("", Verdict.UNSTABLE, False)
    said = starts.advice(_run(Verdict.UNSTABLE, 1.0, own, moved=0.287))
    assert "the posture. The robot came to rest 0.29 rad from it" in said
    assert "came to rest" not in starts.advice(_run(Verdict.UNSTABLE, 1.0, own, moved=1e-3))
    going_on = ("", Verdict.UNSTABLE, True)
    assert "came to rest" not in starts.advice(_run(Verdict.UNSTABLE, 1.0, going_on, moved=0.3))


def test_a_run_that_was_too_short_to_tell_is_said_to_be():
    lost = ("", Verdict.UNSTABLE, True)
    assert "too short" not in starts.advice(_run(Verdict.UNSTABLE, -1.0, lost))
    said = starts.advice(_run(Verdict.UNSTABLE, -1.0, lost, duration=0.1))
    assert "Or 0.1 s are too short to tell" in said and "decays by 10% in them" in said


def test_what_is_still_under_way_at_the_end_is_said():
    for frequency, said in ((float("nan"), True), (3.0, False)):
        own = (Start("", Verdict.STABLE, False, False, 0.1, frequency),)
        run = Single(None, {"verdict": 0.0}, {}, (Joint("joint", False),), own)
        assert ("a longer one tells" in " ".join(starts.lines(run))) == said
