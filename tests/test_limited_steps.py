"""The physics steps of single joints with limits, by default."""

import warnings

import numpy as np
import pytest

from jaxact.errors import InexactWarning
from jaxact.loops.reading import parse
from jaxact.loops.samples import expand
from jaxact.simulation import plans

LINE = "stall_force = 100\nno_load_speed = 1\n"


def steps(parameters="", axes="kp = [400.0, 500.0]", before=""):
    asked = parse(f"{before}\nduration = 0.5\n[parameters]\n{parameters}\n[axes]\n{axes}\n")
    return [plan.case.drive.substeps for plan in plans.groups(asked, expand(asked))]


@pytest.mark.parametrize(("parameters", "expected"), [
    ("", 1),
    ("wn = 800\nzeta = 0.45", 1),
    ("force_limit = 60", 1),
    ("force_rate_limit = 1000", 1),
    ("force_limit = 60\nwn = 110\nzeta = 0.9", 1),
    ("force_limit = 60\nwn = 800\nzeta = 0.45", 2),
    ("force_rate_limit = 1000\nwn = 110\nzeta = 0.9", 1),
    ("force_rate_limit = 1000\nwn = 800\nzeta = 0.45", 4),
    (f"{LINE}control_rate = 100", 32),
    (f"{LINE}control_rate = 100\nmass = 7", 4),
])  # fmt: skip
def test_steps_are_finer_where_a_limit_acts_within_them(parameters, expected):
    assert steps(parameters) == [expected]


def test_a_step_that_is_given_is_kept():
    assert steps(LINE, before="physics_step = 1e-3") == [1]
    assert steps(before='engine = "mjx"') == [4]
    assert steps(f"{LINE}mass = 0.1", before='engine = "mjx"') == [32]


def test_the_finest_step_that_a_loop_of_a_control_rate_needs_is_that_of_all():
    assert steps(LINE, "control_rate = [100, 1000]\nmass = [0.7, 7.0]") == [4, 32]
    rates = np.array([100.0, 1000.0])
    asked = parse(f"duration = 0.5\n[parameters]\n{LINE}[axes]\ncontrol_rate = [100, 1000]")
    assert plans.substeps(asked, rates, expand(asked).along).tolist() == [32, 4]


def test_a_line_that_is_too_steep_for_the_finest_step_is_said():
    with pytest.warns(InexactWarning, match="torque-speed line .* shorter `physics_step`"):
        assert steps(f"{LINE}control_rate = 100\nmass = 0.01") == [64]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert steps("force_rate_limit = 1000\nwn = 1e6\nzeta = 1") == [64]
