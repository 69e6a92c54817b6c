"""Columns that were not written at the same instant: by the command, and by what the fit leaves."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

from jaxact.identification import motion, skew
from jaxact.identification.alignment import UNSEEN, agree, aligned
from jaxact.identification.identify import with_gains
from jaxact.identification.ladder import climb
from jaxact.identification.log import Log
from jaxact.identification.verdict import judge

TRUTH = {"inertia": 0.05, "viscous": 0.05, "wn": 200.0, "zeta": 0.7, "delay": 3e-3}
KP, KD, PERIOD, ROWS = 20.0, 1.2, 1e-3, 2000
RUNG = "second order with delay, viscous"


@pytest.fixture(scope="module", autouse=True)
def double():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def signals():
    return _signals(1, 40)


def _signals(seed, hold):
    """A joint behind a drive, by matrix exponentials; the delay is three rows."""
    wn, zeta, inertia = TRUTH["wn"], TRUTH["zeta"], TRUTH["inertia"]
    matrix = np.zeros((5, 5))
    matrix[0, 1] = matrix[2, 3] = 1.0
    matrix[1, 1:3] = -TRUTH["viscous"] / inertia, 1.0 / inertia
    matrix[3, 2:] = -(wn**2), -2.0 * zeta * wn, wn**2
    onward = expm(matrix * PERIOD)
    setpoint = np.repeat(np.random.default_rng(seed).choice([-0.1, 0.1], ROWS // hold + 1), hold)[
        :ROWS
    ]
    setpoint[:5] = 0.0
    state, states, commands = np.zeros(5), np.zeros((ROWS, 5)), np.zeros(ROWS)
    for row in range(ROWS):
        states[row] = state
        commands[row] = KP * (setpoint[row] - state[0]) - KD * state[1]
        state[4] = commands[row - 3] if row >= 3 else 0.0
        state = onward @ state
    angle = states[:, 0] + 1e-5 * np.random.default_rng(2).normal(size=ROWS)
    return {
        "setpoint": setpoint, "position": angle, "velocity": states[:, 1], "command": commands,
    }  # fmt: skip


def _log(signals, *names, late=None, gains=(KP, KD)):
    """A log in which columns are so many rows late, in between by a spline."""
    rows = np.arange(ROWS)
    own = {}
    for name in names:
        by = (late or {}).get(name, 0)
        at = np.clip(rows - by, 0, ROWS - 1)
        own[name] = signals[name][at] if isinstance(by, int) else CubicSpline(
            rows, signals[name])(at)  # fmt: skip
    return Log("joint", rows * PERIOD, own, gains=gains)


@pytest.mark.parametrize("hold", [20, 40, 70, 200])
def test_a_late_position_is_found_by_the_stated_gains(hold):
    names, signals = ("setpoint", "position", "velocity", "command"), _signals(hold, hold)
    found = aligned(_log(signals, *names, late={"position": 1}))
    assert found.notes[0].startswith("position is logged 1 row later than the setpoint")
    np.testing.assert_array_equal(found["position"][:-1], signals["position"][: ROWS - 2])


@pytest.mark.parametrize("rows", [-1, 1, 2])
@pytest.mark.parametrize("gains", [(KP, KD), (None, None)])
@pytest.mark.parametrize("column", ["command", "velocity"])
def test_a_column_that_the_command_shows_to_be_late_is_moved(signals, column, gains, rows):
    names = ("setpoint", "position", "velocity", "command")
    found = aligned(_log(signals, *names, late={column: rows}, gains=gains))
    many, side = abs(rows), "later" if rows > 0 else "earlier"
    said = f"{column} is logged {many} row{'' if many == 1 else 's'} {side} than the setpoint"
    assert any(note.startswith(said) and note.endswith("it is moved") for note in found.notes)
    first = max(0, -rows)
    # Whole rows are moved, so that nothing of them changes.
    inside = slice(5, 1900)
    for name in names:
        np.testing.assert_array_equal(found[name][inside], signals[name][first:][inside])
    assert found.row == 2 + first
    assert (UNSEEN in found.notes) == (gains[0] is None)


def test_columns_that_agree_stay_as_they_are(signals):
    log = _log(signals, "setpoint", "position", "velocity", "command")
    assert aligned(log) is log or not aligned(log).notes
    np.testing.assert_array_equal(aligned(log)["position"], log["position"])


def test_commands_alone_do_not_show_what_is_late(signals):
    log = _log(signals, "position", "command", gains=(None, None))
    assert UNSEEN in aligned(log).notes
    assert UNSEEN not in aligned(log, moves=False).notes  # of a force alone it says nothing


def _ladder(log):
    """The ladder of the true model alone."""
    family = motion.family([log], "mass")
    only = tuple(rung for rung in family.rungs if rung.name == RUNG)
    return climb(replace(family, rungs=only), [log], [])


@pytest.fixture(scope="module")
def without(signals):
    return _ladder(_log(signals, "setpoint", "position"))


@pytest.mark.exhaustive
@pytest.mark.parametrize("late", [1, -1, 0.5])
def test_what_a_late_position_is_taken_for_is_said_and_by_how_much(signals, without, late):
    ladder = _ladder(_log(signals, "setpoint", "position", late={"position": late}))
    said = skew.moved_by(without.chosen.fit, without.fitted)
    for name, truth in TRUTH.items():
        apart = ladder.chosen.knowledge[name].value - truth
        assert apart == pytest.approx(late * said[name], rel=0.2, abs=0.012 * truth), name
    sentence = judge(ladder).sentence
    assert "if position and setpoint are written at the same instant" in sentence
    assert "more viscous" in sentence
    assert "more delay" in sentence
    assert said["viscous"] == pytest.approx(KP * PERIOD, rel=0.1)  # as kp's share of damping


def test_a_command_that_shows_the_instant_leaves_nothing_to_be_assumed(signals):
    names = ("setpoint", "position", "velocity", "command")
    assert agree(_log(signals, *names))
    late = _log(signals, *names, late={"position": 1})
    assert not agree(late)
    assert agree(aligned(late))
    assert not agree(_log(signals, "setpoint", "position"))


def test_gains_that_are_taken_from_the_command_do_not_show_the_instant(signals):
    names = ("setpoint", "position", "velocity", "command")
    taken = with_gains(aligned(_log(signals, *names, late={"position": 1}, gains=(None, None))))
    assert taken.gains[1] == pytest.approx(KD + KP * PERIOD, rel=1e-2)  # not the true one
    assert not agree(taken)
