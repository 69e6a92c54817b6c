"""Logs with something wrong: it is found, or said, or nothing is called identified."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from jaxact.errors import UserError
from jaxact.identification.identify import identify
from jaxact.identification.log import Log

ROWS = 2500
TICK = 1e-3
INERTIA, VISCOUS, WN, ZETA, DELAY = 0.05, 0.05, 200.0, 0.7, 3.4e-3
GAINS = (20.0, 1.2)


def _joint(seed, hold, limit=np.inf, inertia=INERTIA):
    """A joint behind its drive under a PD controller, by matrix exponentials between switches."""
    generator = np.random.default_rng(seed)
    setpoint = np.repeat(generator.choice([-0.1, 0.1], ROWS // hold + 1), hold)[:ROWS]
    setpoint[:5] = 0.0
    # Of position, velocity, force, its rate, and the command that acts.
    matrix = np.zeros((5, 5))
    matrix[0, 1], matrix[1, 1:3], matrix[2, 3] = 1.0, (-VISCOUS / inertia, 1.0 / inertia), 1.0
    matrix[3, 2:] = -(WN**2), -2.0 * ZETA * WN, WN**2
    late = int(DELAY // TICK)
    first, last = expm(matrix * (DELAY - late * TICK)), expm(matrix * ((late + 1) * TICK - DELAY))
    state, position = np.zeros(5), np.empty(ROWS)
    commands = np.zeros(ROWS + late + 1)  # those before the log began are zero
    for row in range(ROWS):
        position[row] = state[0]
        asked = GAINS[0] * (setpoint[row] - state[0]) - GAINS[1] * state[1]
        commands[row + late + 1] = np.clip(asked, -limit, limit)
        state[4] = commands[row]
        state = first @ state
        state[4] = commands[row + 1]
        state = last @ state
    signals = {
        "setpoint": setpoint, "position": position + 1e-5 * generator.normal(size=ROWS),
        "command": commands[late + 1 :],
    }  # fmt: skip
    return Log(f"joint_{seed}", np.arange(ROWS) * TICK, signals, gains=GAINS)


def _with(log, **changes):
    signals = {**log.signals, **changes}
    return replace(log, signals={n: rows for n, rows in signals.items() if rows is not None})


@pytest.mark.parametrize("recorded", (True, False))
def test_a_command_at_its_limit_for_most_of_the_rows(recorded):
    logs = [_joint(1, 40, limit=0.5), _joint(2, 70, limit=0.5)]
    held = np.abs(logs[0]["command"]) > 0.499
    assert held.mean() > 0.6
    logs = logs if recorded else [_with(log, command=None) for log in logs]
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
        assert "a limit of its command" in found.drive.left_out()


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
        "position": lambda log, _: -log["position"],
        "unit": lambda log, _: np.degrees(log["position"]),
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


def test_a_command_of_the_wrong_sign_is_said():
    log = _joint(7, 40)
    turned = _with(log, command=-log["command"])
    with pytest.raises(UserError, match="command goes against setpoint minus position.*wrong sign"):
        identify(turned, "mass")
    alone = _with(turned, setpoint=None)
    verdict = identify(replace(alone, gains=(None, None)), "mass").verdict
    assert "position goes against the command" in verdict.sentence
    assert verdict.level.value == "not good enough"


def test_positions_in_degrees_contradict_the_command():
    log = _joint(8, 40)
    degrees = {name: np.degrees(log[name]) for name in ("setpoint", "position")}
    with pytest.raises(UserError, match="kp 57[0-9.]* times smaller .* positions are in degrees"):
        identify(_with(log, **degrees), "mass")
