"""Controllers that difference positions, against a loop of plain NumPy."""

from dataclasses import replace

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.identification import inspection
from jaxact.identification.identify import with_gains
from jaxact.identification.log import Log
from jaxact.loops.drives import of_document

INERTIA, VISCOUS = 0.7, 3.0
DRIVE = of_document("slide", {
    "plant": "mass", "unit": "m", "loop": [{}], "estimates": {},
    "numbers": {"inertia": INERTIA, "viscous": VISCOUS},
})  # fmt: skip


def _slide(rate, over, gains, rows=400):
    """A mass with viscous friction under a PD controller that differences over so many rows."""
    (kp, kd), period = gains, 1.0 / rate
    setpoint = np.repeat(np.random.default_rng(2).normal(size=rows // 20) * 1e-2, 20)
    decay = np.exp(-VISCOUS / INERTIA * period)
    position, velocity, places, commands = 0.0, 0.0, np.zeros(rows + over), np.empty(rows)
    for row in range(rows):
        places[row + over] = position
        seen = (position - places[row]) / (over * period)
        commands[row] = kp * (setpoint[row] - position) - kd * seen
        end = commands[row] / VISCOUS
        position += end * period + (velocity - end) * INERTIA / VISCOUS * (1.0 - decay)
        velocity = end + (velocity - end) * decay
    signals = {"setpoint": setpoint, "position": places[over:], "command": commands}
    time = np.arange(rows) * period
    return Log("slide", time, signals, unit="m", gains=gains, difference_ticks=over)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("rate", "over"), [(1000, 2), (200, 1), (100, 1), (100, 2)])
def test_the_velocity_is_over_the_period_of_the_controller(rate, over):
    log = _slide(rate, over, (100.0, 6.0))
    found = jx.replay(DRIVE, log)
    assert found.driven_by == "setpoint" and found.largest < 1e-6 * np.ptp(log["position"])


def test_a_replay_takes_gains_and_differences_from_the_command():
    log = replace(_slide(500, 1, (200.0, 12.0)), gains=(None, None), difference_ticks=0)
    found = jx.replay(DRIVE, log)
    assert found.driven_by == "setpoint" and found.log.difference_ticks == 1
    assert found.largest < 1e-6 * np.ptp(log["position"])
    assert "kp 200 and kd 12 are taken from the command" in str(found)


def test_a_replay_moves_a_position_that_is_written_late():
    log = _slide(500, 1, (200.0, 12.0))
    late = np.append(log["position"][0], log["position"][:-1])
    found = jx.replay(DRIVE, replace(log, signals={**log.signals, "position": late}))
    assert "position is logged 1 row later than the setpoint; it is moved" in str(found)
    assert found.largest < 1e-6 * np.ptp(late)


@pytest.mark.parametrize("over", [1, 2])
def test_gains_are_found_with_the_differences_that_are_stated(over):
    log = replace(_slide(1000, over, (400.0, 20.0)), gains=(None, None))
    found = with_gains(log)
    assert found.gains == pytest.approx((400.0, 20.0)) and found.difference_ticks == over
    np.testing.assert_array_equal(inspection.velocity(found), inspection.velocity(log))
    unsaid = replace(log, difference_ticks=0)
    if over == 1:
        assert with_gains(unsaid).difference_ticks == 1
