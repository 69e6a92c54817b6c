"""Gains of legged_gym: a joint takes what its loop over the keys of stiffness gives."""

import random

import pytest

from jaxact.errors import UserError
from jaxact.gains import reading
from jaxact.gains.table import matched


def legged_gym(stiffness, damping, name):
    """Its loop over the keys, as `LeggedRobot._init_buffers` has it."""
    found = None
    for key in stiffness:
        if key in name:
            found = stiffness[key], damping[key]
    return found


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("suffix", ("py", "yaml"))
def test_a_joint_takes_the_damping_of_its_stiffness(tmp_path, seed, suffix):
    rng = random.Random(seed)
    keys = ["joint", "hip", "FL", "FL_hip", "knee"]
    tables = [{key: rng.random() for key in rng.sample(keys, 5)} for _ in range(2)]
    if seed == 0:
        tables = [{"joint": 20.0, "hip": 30.0}, {"hip": 3.0, "joint": 0.5}]
    file = tmp_path / f"gym.{suffix}"
    file.write_text(
        f"class control:\n    stiffness = {tables[0]}\n    damping = {tables[1]}\n"
        if suffix == "py" else f"control: {{stiffness: {tables[0]}, damping: {tables[1]}}}\n"
    )  # fmt: skip
    names = ["FL_hip_joint", "FR_hip_joint", "FL_knee_joint"]
    found = matched(reading.read(file), [(name, name) for name in names]).parameters
    for name in names:
        pair = found["kp"][name], found["kd"][name]
        assert pair == legged_gym(*tables, name)


def test_a_stiffness_without_damping_is_refused_and_one_the_other_way_is_noted(tmp_path):
    text = "class control:\n    stiffness = {%s}\n    damping = {%s}\n"
    file = tmp_path / "gym.py"
    file.write_text(text % ("'hip': 1.0, 'knee': 1.0", "'knee': 1.0"))
    with pytest.raises(UserError, match="'hip' is in stiffness and not in damping"):
        reading.read(file)
    file.write_text(text % ("'knee': 1.0", "'hip': 1.0, 'knee': 1.0"))
    found = reading.read(file)
    assert found.notes == ("not taken from it: damping of 'hip'",)
