"""A keyframe in which driven joints move: what it says of them, and what a user is told."""

import warnings

import pytest

from jaxact.errors import InexactWarning
from jaxact.loops import reading
from jaxact.simulation.keyframe_velocity import tell_keyframe_velocity

MODEL = """<mujoco><worldbody><body><joint name="hip" axis="0 1 0"/><geom size=".1" mass="1"/>
<body pos=".3 0 0"><joint name="knee" axis="0 1 0"/><geom size=".1" mass="1"/></body></body>
</worldbody><actuator><motor joint="hip"/></actuator>
<keyframe><key name="hip" qvel="3 0"/><key name="knee" qvel="0 3"/></keyframe></mujoco>"""
TEXT = """[plant]\nmodel = "robot.xml"\nkeyframe = "{}"\nposture = "keyframe"
[axes]\nkp = [10]\n"""


def test_a_velocity_of_a_driven_joint_that_is_left_out_is_said(tmp_path):
    (tmp_path / "robot.xml").write_text(MODEL)
    with pytest.warns(InexactWarning, match="its velocity of hip is left out.*`initial_velocity`"):
        tell_keyframe_velocity(reading.parse(TEXT.format("hip"), tmp_path))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tell_keyframe_velocity(reading.parse(TEXT.format("knee"), tmp_path))
