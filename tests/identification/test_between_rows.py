"""Logs thinner than their loop, and gains beside friction that cannot be told from them."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxact.identification import between_rows, motion
from jaxact.identification.ladder import climb
from jaxact.identification.log import Log
from jaxact.identification.verdict import judge

INERTIA, VISCOUS, DELAY, KP, KD = 0.05, 0.05, 8e-3, 30.0, 0.8
FINE = 1e-4


@pytest.fixture(scope="module", autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def _log(seconds, noise):
    """A joint under a controller of 1 kHz, each row of it, in explicit steps of 0.1 ms."""
    rows, ticks = round(seconds * 1e3), round(1e-3 / FINE)
    time = np.arange(rows) * 1e-3
    generator = np.random.default_rng(4)
    setpoint = 0.1 * np.repeat(generator.choice([-1.0, 1.0], rows // 170 + 1), 170)[:rows]
    setpoint += sum(0.1 * np.sin(2.0 * np.pi * f * time + f) for f in (0.5, 1.1, 2.3, 4.7, 9.0))
    setpoint[:50] = 0.0
    angle, speed, angles = 0.0, 0.0, np.empty(rows)
    commands = [0.0] * round(DELAY / FINE)
    for row in range(rows):
        angles[row] = angle
        commands += [KP * (setpoint[row] - angle) - KD * speed] * ticks
        for at in range(ticks):
            before = speed
            speed += FINE * (commands[row * ticks + at] - VISCOUS * speed) / INERTIA
            angle += FINE * 0.5 * (before + speed)
    angles += noise * generator.normal(size=rows)
    return Log("servo", time, {"setpoint": setpoint, "position": angles}, gains=(KP, KD))


@pytest.fixture(scope="module")
def log():
    return _log(4.0, 1e-4)


def _thinned(log, rows):
    return replace(
        log, time=log.time[::rows], signals={n: v[::rows] for n, v in log.signals.items()}
    )


def _climbed(log, rung, control_rate=None, **changes):
    """The ladder of one rung."""
    family = motion.family([log], "mass", control_rate)
    only = tuple(one for one in family.rungs if one.name == rung)
    ladder = climb(replace(family, rungs=only, **changes), [log], [])
    return between_rows.doubted(ladder, "mass", control_rate)


@pytest.mark.exhaustive
@pytest.mark.parametrize("control_rate", [None, 1000.0])
def test_what_a_log_of_every_twentieth_row_says_is_not_taken_for_known(log, control_rate):
    ladder = _climbed(_thinned(log, 20), "delay, viscous", control_rate)
    known = ladder.chosen.knowledge
    assert not any(one.identified for one in known.estimates)
    assert known["inertia"].low < INERTIA < known["inertia"].high
    assert known["delay"].low < DELAY < known["delay"].high
    verdict = judge(ladder)
    assert verdict.below is None or verdict.below <= 5.0
    assert "rows are too far apart" in verdict.sentence


@pytest.mark.exhaustive
def test_rows_that_show_all_of_the_loop_are_believed(log):
    known = _climbed(log, "delay, viscous").chosen.knowledge
    assert known.identified
    assert known["inertia"].value == pytest.approx(INERTIA, rel=1e-2)
    assert between_rows.widest((_thinned(log, 20),), 50.0) is None
    assert between_rows.widest((_thinned(log, 20),), None) == pytest.approx(0.02)


@pytest.mark.exhaustive
def test_unknown_gains_allow_for_viscous_friction_that_the_drive_does_not_delay(log):
    unknown = replace(log, gains=(None, None))
    known = _climbed(unknown, "delay, no friction").chosen.knowledge
    for name, truth in (("kp", KP / INERTIA), ("kd", KD / INERTIA), ("viscous", 1.0)):
        assert known[name].low < truth < known[name].high
    without = _climbed(unknown, "delay, no friction", beside=()).chosen.knowledge
    assert without["kp"].high < KP / INERTIA  # taken for damping that is late, it costs inertia
