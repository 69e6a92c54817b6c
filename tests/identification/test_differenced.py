"""Which velocity a controller acts on, as the command that it recorded shows."""

import numpy as np
import pytest

from jaxact.identification.identify import with_gains
from jaxact.identification.log import Log

PERIOD, KP, KD, COUNT = 2e-3, 30.0, 0.8, 2.0 * np.pi / 4096.0


def _signals():
    time = PERIOD * np.arange(2000)
    setpoint = 0.3 * np.sin(2.0 * np.pi * (1.0 + 2.0 * time) * time)
    late = 0.3 * np.sin(2.0 * np.pi * (1.0 + 2.0 * (time - 0.01)) * (time - 0.01))
    position = COUNT * np.round(late / COUNT)
    velocity = 0.3 * 2.0 * np.pi * (1.0 + 4.0 * (time - 0.01)) * np.cos(
        2.0 * np.pi * (1.0 + 2.0 * (time - 0.01)) * (time - 0.01)
    )  # fmt: skip
    return time, setpoint, position, velocity


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.parametrize("differenced", [True, False])
def test_a_recorded_command_shows_whether_the_position_is_differenced(differenced, recorded):
    time, setpoint, position, velocity = _signals()
    seen = np.diff(position, prepend=position[0]) / PERIOD if differenced else velocity
    command = KP * (setpoint - position) - KD * seen
    signals = {"setpoint": setpoint, "position": position, "command": command}
    signals |= {"velocity": velocity} if recorded else {}
    found = with_gains(Log("log.csv", time, signals, gains=(KP, KD)))
    assert found.difference_ticks == int(differenced)
    assert bool(found.notes) == differenced and found.gains == (KP, KD)


def test_what_is_stated_or_not_shown_stays():
    time, setpoint, position, _ = _signals()
    signals = {"setpoint": setpoint, "position": position}
    assert with_gains(Log("log.csv", time, signals, gains=(KP, KD))).difference_ticks == 0
    signals["command"] = KP * (setpoint - position) - KD * np.gradient(position, time)
    stated = Log("log.csv", time, signals, gains=(KP, KD), difference_ticks=3)
    assert with_gains(stated).difference_ticks == 3
