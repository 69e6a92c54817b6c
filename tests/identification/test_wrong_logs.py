"""Logs with something wrong: it is found, or said, or nothing is called identified."""

import re
from dataclasses import replace

import numpy as np
import pytest
from driven_joint import DELAY, INERTIA, WN, ZETA, log, prbs

from jaxact.errors import UserError
from jaxact.identification import inspection, starts
from jaxact.identification.identify import identify
from jaxact.identification.log import Log


def _joint(seed, hold, **given):
    return log(seed, prbs(seed, hold), **given)


def _with(whole, **changes):
    signals = {**whole.signals, **changes}
    return replace(whole, signals={n: rows for n, rows in signals.items() if rows is not None})


@pytest.mark.exhaustive
@pytest.mark.parametrize("recorded", [True, False])
def test_a_command_at_its_limit_for_most_of_the_rows(recorded):
    logs = [_joint(1, 40, limit=0.5), _joint(2, 70, limit=0.5)]
    held = np.abs(logs[0]["command"]) > 0.499
    assert held.mean() > 0.6
    logs = logs if recorded else [_with(one, command=None) for one in logs]
    found = identify(logs[0], "mass", validate=logs[1])
    known = found.chosen.knowledge
    assert known["inertia"].value == pytest.approx(INERTIA, rel=1e-3)
    assert known["wn"].value == pytest.approx(WN, rel=0.02)
    assert known["zeta"].value == pytest.approx(ZETA, abs=0.02)
    assert known["delay"].value == pytest.approx(DELAY, abs=1e-4)
    assert found.verdict.score > 99.0
    if recorded:
        assert found.inspections[0].saturated["command"] == pytest.approx(0.5)
        assert "command stays at 0.5 for part of the time" in str(found)
    else:
        assert known["command_limit"].value == pytest.approx(0.5, rel=1e-3)
        assert "in proportion to the gains that the map states" in str(found)
    assert "a limit of its command of 0.5 N m" in found.drive.left_out()
    assert "force_limit" not in found.loop.values  # what is behind it may overshoot


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("position", "position goes against the setpoint"),
        ("unit", "position moves [0-9.]+ times as far as the setpoint"),
        ("joint", ""),
    ],
)
def test_what_no_model_explains_is_not_identified(wrong, said):
    logs = [_with(_joint(seed, hold), command=None) for seed, hold in ((3, 40), (4, 70))]
    others = [_joint(5, 55, inertia=0.02), _joint(6, 35, inertia=0.02)]
    turned = {
        "position": lambda own, _: -own["position"],
        "unit": lambda own, _: np.degrees(own["position"]),
        "joint": lambda _, other: other["position"],
    }[wrong]
    bad = [_with(a, position=turned(a, b)) for a, b in zip(logs, others, strict=True)]
    found = identify(bad[0], "mass", validate=bad[1])
    assert found.verdict.level.value == "not good enough"
    assert not any(
        estimate.identified
        for one in found.ladder.candidates
        for estimate in one.knowledge.estimates
    )
    assert re.search(said, found.verdict.sentence)


@pytest.mark.exhaustive
def test_a_command_of_the_wrong_sign_is_said():
    right = _joint(7, 40)
    turned = _with(right, command=-right["command"])
    with pytest.raises(UserError, match="command goes against setpoint minus position.*wrong sign"):
        identify(turned, "mass")
    alone = _with(turned, setpoint=None)
    verdict = identify(replace(alone, gains=(None, None)), "mass").verdict
    assert "position goes against the command" in verdict.sentence
    assert verdict.level.value == "not good enough"


def _told(frequencies, *, inertia, coulomb, gravity=0.0, late=0.0, sign=1.0):
    """A log of a swinging joint and of the command that makes it swing so."""
    time = 1e-3 * np.arange(6000)

    def motion(order, time):
        turns = 2.0 * np.pi * np.asarray(frequencies)[:, None]
        return np.sum(0.1 * turns**order * np.sin(turns * time + order * np.pi / 2.0), axis=0)

    position, speed, acceleration = (motion(order, time + late) for order in range(3))
    friction = 0.02 * speed + coulomb * np.sign(speed)
    command = inertia * acceleration + friction + gravity * np.sin(position)
    noise = 1e-4 * np.random.default_rng(1).normal(size=len(time))
    return Log("told", time, {"position": motion(0, time) + noise, "command": sign * command})


@pytest.mark.parametrize(
    ("frequencies", "joint"),
    [
        ((0.22,), {"inertia": 0.011, "coulomb": 0.5, "gravity": 6.0, "late": 3e-3}),
        ((2.4,), {"inertia": 0.14, "coulomb": 0.0, "gravity": 6.7, "late": 3e-3}),
        ((10.0,), {"inertia": 0.05, "coulomb": 0.0, "late": 0.05}),  # half a turn late
    ],
)
def test_a_sine_alone_does_not_tell_the_sign_of_its_command(frequencies, joint):
    assert not starts.against_the_command(_told(frequencies, **joint))


def test_what_moves_one_way_at_one_speed_does_not_tell_it_either():
    time = 1e-3 * np.arange(40)
    position = time + 1e-6 * np.random.default_rng(0).normal(size=40)
    one_way = Log("one way", time, {"position": position, "command": time})
    assert not starts.against_the_command(one_way)  # nor warns, though columns are the same


def test_several_sines_tell_the_sign_of_their_command():
    joint = {"inertia": 0.14, "coulomb": 0.1, "gravity": 1.0, "late": 3e-3}
    assert not starts.against_the_command(_told((0.7, 2.9, 6.3), **joint))
    assert starts.against_the_command(_told((0.7, 2.9, 6.3), sign=-1.0, **joint))


def test_positions_in_degrees_contradict_the_command():
    right = _joint(8, 40)
    degrees = {name: np.degrees(right[name]) for name in ("setpoint", "position")}
    with pytest.raises(UserError, match="kp 57[0-9.]* times smaller .* positions are in degrees"):
        identify(_with(right, **degrees), "mass")


def test_the_crest_of_a_sine_is_no_limit_at_which_a_command_stays():
    time = 2e-3 * np.arange(4000)
    steps = np.repeat(np.random.default_rng(5).choice([-0.35, 0.35], 134), 30)[:4000]
    command = steps + 0.3 * np.sin(2.0 * np.pi * 0.4 * time)
    assert inspection.saturation(command) is None
    assert inspection.saturation(np.clip(command, -0.5, 0.5)) == 0.5
