"""The arm of two joints that tests of robots' tuning share."""

import robots

from jaxact.loops import reading
from jaxact.tuning.box import read_box
from jaxact.tuning.robot.loops import VARIED, Situation, situation

SPECIFICATION = """
engine = "mujoco"
[plant]
model = '{path}'
keyframe = "home"
[parameters]
actuator = "hyq"
delay = 0.002
[axes]
feedforward = [0.0]
"""


def at_home(folder, spans="") -> Situation:
    """It in its keyframe, its model in a folder, and what is uncertain of its drives."""
    path = folder / "arm.xml"
    path.write_text(robots.PENDULUM)
    box = read_box(spans, VARIED)
    return situation(reading.parse(SPECIFICATION.format(path=path)), "home", box)
