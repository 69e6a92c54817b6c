"""A pendulum in torque mode: commands and positions recorded, no controller."""

import numpy as np
import pytest

import jaxact as jx
from jaxact.identification.log import Log

ROWS, PERIOD, FINE = 2000, 2e-3, 40
INERTIA, GRAVITY, VISCOUS, COULOMB = 0.06, 1.6, 0.03, 0.15
WN, ZETA, DELAY = 150.0, 0.8, 3e-3


def _swing(command):
    """Angles in steps of a fortieth of a row: drive, pendulum and friction, each explicit."""
    step = PERIOD / FINE
    held = np.repeat(command, FINE)
    late = np.concatenate([np.full(round(DELAY / step), command[0]), held])
    angle, speed, force, rate = 0.0, 0.0, 0.0, 0.0
    angles = np.empty(ROWS)
    for at in range(ROWS * FINE):
        if at % FINE == 0:
            angles[at // FINE] = angle
        rate += step * (WN**2 * (late[at] - force) - 2.0 * ZETA * WN * rate)
        force += step * rate
        pushed = speed + step * (force - GRAVITY * np.sin(angle) - VISCOUS * speed) / INERTIA
        speed = np.sign(pushed) * max(abs(pushed) - step * COULOMB / INERTIA, 0.0)
        angle += step * speed
    return np.round(angles / 3.8e-4) * 3.8e-4


def _log(name, command):
    time = np.arange(ROWS) * PERIOD
    return Log(name, time, {"command": command, "position": _swing(command)})


@pytest.fixture(scope="module")
def logs():
    time = np.arange(ROWS) * PERIOD
    sines = sum(0.3 * np.sin(2.0 * np.pi * f * time + f) for f in (0.3, 0.9, 2.3, 5.1))
    steps = 0.6 * np.repeat(np.random.default_rng(2).choice([-1.0, 1.0], ROWS // 40), 40)
    return _log("sines", sines), _log("steps", steps)


def test_a_pendulum_is_found_from_the_torques_it_was_told(logs):
    found = jx.identify(logs[0], "pendulum", validate=logs[1])
    numbers = found.chosen.numbers
    assert numbers["inertia"] == pytest.approx(INERTIA, rel=0.02)
    assert numbers["gravity"] == pytest.approx(GRAVITY, rel=0.02)
    assert numbers["viscous"] == pytest.approx(VISCOUS, rel=0.1)
    assert numbers["coulomb"] == pytest.approx(COULOMB, rel=0.05)
    # Stopping and turning within rows is not taken for a delay.
    known = found.chosen.knowledge
    for name, value in (("delay", DELAY), ("wn", WN), ("zeta", ZETA)):
        estimate = known[name]
        room = 0.2 * (estimate.high - estimate.low)
        assert estimate.low - room < value < estimate.high + room
    assert found.chosen.knowledge.lag[0] == pytest.approx(DELAY + 2.0 * ZETA / WN, abs=1e-3)
    assert min(found.chosen.scores) > 95.0
    # About its hanging position gravity is a spring.
    assert found.loop.joint_stiffness == pytest.approx(GRAVITY, rel=0.02)
    again = jx.replay(found, logs[1])
    assert again.driven_by == "command" and again.nrmse < 0.05
