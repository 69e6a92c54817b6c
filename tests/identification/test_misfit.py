"""Numbers whose model lacks something: what goes with the motion is seen, and allowed for."""

from dataclasses import replace

import driven_joint
import numpy as np
import pytest
from linear_fits import Linear, Solved
from scipy.signal import lfilter

import jaxact as jx
from jaxact.identification import knowledge, misfit, uncertainty
from jaxact.identification.problem import Unknown

ROWS, SEEDS = 2000, 60


def _regression(seed, lacking, logs=1):
    """Least squares of a number of 1 beside an offset, whose model lacks what is given.

    Args:
        seed: of the motion and of the noise, both of the same spectrum.
        lacking: of the motion, what is measured and not modelled.
        logs: that are fitted together.
    """
    generator = np.random.default_rng(seed)
    white = generator.normal(size=(2, ROWS + 200))
    motion, noise = lfilter([1.0], [1.0, -0.9], white, axis=1)[:, 200:]
    slopes = np.stack([motion, np.ones(ROWS)], axis=1)
    measured = motion + 0.5 * noise + lacking(motion)
    point = np.linalg.lstsq(slopes, measured, rcond=None)[0]
    unknowns = tuple(Unknown(name, "1", -9.0, 9.0, (0.0,)) for name in ("gain", "offset"))
    problem = Linear(unknowns, (ROWS // logs,) * logs)
    return Solved(problem, point, slopes @ point - measured, slopes)


def _nothing(motion):
    return 0.0 * motion


def _echo(motion):
    """The motion of twelve rows before, which is like that now: 0.9^12 of it goes into the gain."""
    return np.concatenate([np.zeros(12), motion[:-12]])


def _saturation(motion):
    return np.tanh(3.0 * np.concatenate([np.zeros(6), motion[:-6]]))


@pytest.mark.parametrize("logs", [1, 4])
def test_noise_of_the_same_spectrum_does_not_go_with_the_motion(logs):
    shares = np.array([misfit.share(_regression(seed, _nothing, logs)) for seed in range(SEEDS)])
    assert np.mean(shares == 0.0) >= 0.85 and np.median(shares) == 0.0 and np.max(shares) < 0.25


@pytest.mark.parametrize(("lacking", "logs"), [(_echo, 1), (_echo, 4), (_saturation, 1)])
def test_what_a_model_lacks_goes_with_the_motion(lacking, logs):
    shares = np.array([misfit.share(_regression(seed, lacking, logs)) for seed in range(SEEDS)])
    assert np.mean(shares > 0.3) >= 0.95 and np.max(shares) <= 1.0


def test_the_share_is_that_of_the_power():
    # Of what is left of an echo after the fit, this much is known in closed form.
    alike = 0.9**12
    noise, echo = 0.25, 1.0 - alike**2
    expected = np.sqrt(echo / (noise + echo))
    shares = [misfit.share(_regression(seed, _echo)) for seed in range(SEEDS)]
    assert np.mean(shares) == pytest.approx(expected, abs=0.05)


def test_intervals_that_allow_for_it_contain_the_truth():
    """Those for noise alone hardly ever do: the echo is taken for a larger gain."""
    inside, noise_alone = 0, 0
    for seed in range(SEEDS):
        fit = _regression(seed, _echo)
        plain = float(np.sqrt(uncertainty.naive(fit)[0, 0]))
        wider = float(np.sqrt(uncertainty.robust(fit)[0, 0])) / plain
        off = abs(float(fit.point[0]) - 1.0)
        bias = misfit.bias(fit, misfit.share(fit))
        noise_alone += off <= knowledge.half_width(fit, wider, 0.0) * plain
        inside += off <= knowledge.half_width(fit, wider, bias) * plain
    assert noise_alone / SEEDS < 0.2 and inside / SEEDS > 0.9


def _slow(seed, count):
    """A log of the driven joint that follows slow waves, by an encoder of this count [rad]."""
    rows = driven_joint.ROWS
    time = np.arange(rows) * driven_joint.TICK
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 4)
    waves = [
        np.sin(2.0 * np.pi * f * time + p) - np.sin(p)
        for f, p in zip((0.5, 1.3, 2.9, 4.3), phases, strict=True)
    ]
    log = driven_joint.log(seed, 0.05 * sum(waves) * np.minimum(time / 0.3, 1.0))
    position = np.round(log["position"] / count) * count
    return replace(log, signals={"setpoint": log["setpoint"], "position": position})


@pytest.mark.exhaustive
def test_a_delay_that_slow_motion_cannot_tell_from_a_loop_is_not_known():
    """A mere delay is chosen, and three times as long as the delay; joint and sum are known."""
    count = 2.0 * np.pi / 16384
    found = jx.identify(_slow(1, count), "mass", validate=_slow(2, count))
    assert found.chosen.rung.name == "delay, viscous"
    known = found.chosen.knowledge
    alone = knowledge.of_fit(found.chosen.fit)["delay"]
    assert alone.identified and alone.low > 2.5 * driven_joint.DELAY
    assert not known["delay"].identified and "cannot be told from the lag" in str(found)
    assert known["delay"].low <= driven_joint.DELAY <= known["delay"].high
    for name, truth in (("inertia", driven_joint.INERTIA), ("viscous", driven_joint.VISCOUS)):
        assert known[name].identified and known[name].value == pytest.approx(truth, rel=0.02)
    late = driven_joint.DELAY + 2.0 * driven_joint.ZETA / driven_joint.WN
    assert known.lag[0] == pytest.approx(late, rel=0.01)
    assert found.verdict.level.value == "good"
