"""A pendulum in torque mode: commands and positions recorded, no controller."""

from dataclasses import replace

import numpy as np
import pytest

import jaxact as jx
from jaxact.identification import rivals
from jaxact.identification.log import Log
from jaxact.identification.verdict import judge

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


@pytest.fixture(scope="module")
def found(logs):
    return jx.identify(logs[0], "pendulum", validate=logs[1])


@pytest.mark.exhaustive
def test_a_pendulum_is_found_from_the_torques_it_was_told(logs, found):
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


@pytest.mark.exhaustive
def test_a_delay_that_a_better_model_places_elsewhere_is_not_known(found):
    """Behind a second-order drive a mere delay fits with narrow intervals, which do not hold."""
    delays = [one for one in found.ladder.candidates if one.rung.dynamics == "delay"]
    simple = min(delays, key=lambda one: one.fit.square_sum)
    assert simple.knowledge["delay"].low > 1.5 * DELAY
    doubted = rivals.heard(replace(found.ladder, chosen=simple)).chosen.knowledge["delay"]
    assert not doubted.identified and "fits better" in doubted.reason
    assert doubted.low < 1.1 * DELAY < simple.knowledge["delay"].value <= doubted.high
    assert rivals.heard(found.ladder) is found.ladder


@pytest.mark.exhaustive
def test_friction_that_may_be_zero_is_not_identified(found):
    of_the_load = [
        known[name]
        for known in (one.knowledge for one in found.ladder.candidates)
        for name in ("loaded", "stribeck")
        if name in known.names
    ]
    assert any(e.low <= 0.0 for e in of_the_load)
    assert not any(e.identified for e in of_the_load if e.low <= 0.0)


@pytest.mark.exhaustive
def test_commands_of_one_size_leave_a_limit_open(logs, found):
    assert "always asked for" not in found.verdict.sentence
    # The sines are of many sizes: what they show of a limit the steps need not.
    alone = replace(found.ladder, fitted=(logs[1],), validation=(logs[1],))
    assert "if the drive gives the 0.6 N m that was always asked for" in judge(alone).sentence


def _delayed(seed, hold, fine, limit=np.inf, delay=2e-3, size=0.35):
    """A pendulum behind a mere delay, by explicit steps that stop where it turns."""
    rows, inertia, gravity, viscous, coulomb = 6000, 0.02, 0.5, 0.01, 0.05
    rng = np.random.default_rng(seed)
    time = np.arange(rows) * PERIOD
    command = np.repeat(rng.choice([-size, size], rows // hold + 1), hold)[:rows]
    command += 0.3 * np.sin(2.0 * np.pi * 0.4 * time + seed)
    command[:5] = 0.0
    step = PERIOD / fine
    followed = np.clip(command, -limit, limit)
    late = np.concatenate([np.zeros(round(delay / step)), np.repeat(followed, fine)])
    angle, speed, angles = 0.0, 0.0, np.empty(rows)
    for at in range(rows * fine):
        if at % fine == 0:
            angles[at // fine] = angle
        push = late[at] - gravity * np.sin(angle) - viscous * speed
        if speed == 0.0:
            push = np.sign(push) * max(abs(push) - coulomb, 0.0)
        else:
            push -= coulomb * np.sign(speed)
        after = speed + step * push / inertia
        after = 0.0 if speed * after < 0.0 else after
        angle += step * 0.5 * (speed + after)
        speed = after
    counts = np.round(angles / (2.0 * np.pi / 4096))
    signals = {"command": command, "position": counts * 2.0 * np.pi / 4096}
    return Log(f"seed {seed}", time, signals, gains=(None, None))


@pytest.mark.exhaustive
@pytest.mark.parametrize("fine", [40, 160])
def test_richer_models_that_are_ahead_by_chance_are_not_chosen(fine):
    """In coarse steps friction is not quite dry, which what has more unknowns may follow."""
    found = jx.identify(_delayed(1, 30, fine), "pendulum", validate=_delayed(2, 17, fine))
    assert found.chosen.rung.name == "delay, viscous and dry"
    assert found.verdict.level.value == "good"
    for name, value, rel in (("inertia", 0.02, 1e-3), ("gravity", 0.5, 1e-3),
                             ("viscous", 0.01, 0.01), ("coulomb", 0.05, 0.01)):  # fmt: skip
        assert found.chosen.numbers[name] == pytest.approx(value, rel=rel)
    assert found.chosen.numbers["delay"] == pytest.approx(2e-3, abs=5e-5)


@pytest.mark.exhaustive
def test_what_lacks_friction_does_not_mislead_what_has_it():
    """Without friction the search ends at a pendulum too heavy to move; what follows does not."""
    rng = np.random.default_rng(1)
    logs = [
        _log(str(hold), 0.6 * np.repeat(rng.choice([-1.0, 1.0], ROWS // hold + 1), hold)[:ROWS])
        for hold in (35, 25)
    ]
    found = jx.identify(logs[0], "pendulum", validate=logs[1])
    assert found.verdict.level.value == "good"
    assert found.chosen.numbers["inertia"] == pytest.approx(INERTIA, rel=0.01)
    assert found.chosen.numbers["gravity"] == pytest.approx(GRAVITY, rel=0.01)
    assert found.chosen.knowledge.lag[0] == pytest.approx(DELAY + 2.0 * ZETA / WN, abs=1e-3)


def test_a_joint_that_does_not_move_is_said():
    time = np.arange(ROWS) * PERIOD
    signals = {"command": np.sin(time), "position": np.zeros(ROWS)}
    with pytest.raises(jx.UserError, match="position is 0 throughout"):
        jx.identify(Log("stuck", time, signals), "pendulum")
    with pytest.raises(jx.UserError, match="the joint does not move"):
        jx.identify(Log("stuck", time, {**signals, "force": np.cos(time)}), "pendulum")


@pytest.mark.exhaustive
def test_a_limit_that_no_log_says_is_found_behind_commands_that_end_in_a_crest():
    """The crest of a sine stays near its top, as a command at its limit would."""
    logs = [_delayed(seed, hold, 40, limit=0.4) for seed, hold in ((1, 30), (2, 17))]
    found = jx.identify(logs[0], "pendulum", validate=logs[1])
    assert found.verdict.level.value == "good"
    for name, value in (("command_limit", 0.4), ("inertia", 0.02), ("gravity", 0.5)):
        assert found.chosen.numbers[name] == pytest.approx(value, rel=2e-3)
    assert found.chosen.numbers["delay"] == pytest.approx(2e-3, abs=1e-4)


@pytest.mark.exhaustive
def test_a_delay_much_longer_than_usual_is_found():
    logs = [_delayed(seed, hold, 40, delay=40e-3) for seed, hold in ((1, 30), (2, 17))]
    found = jx.identify(logs[0], "pendulum", validate=logs[1])
    assert found.verdict.level.value == "good"
    for name, value in (("inertia", 0.02), ("gravity", 0.5), ("viscous", 0.01), ("coulomb", 0.05)):
        assert found.chosen.numbers[name] == pytest.approx(value, rel=5e-3)
    assert found.chosen.numbers["delay"] == pytest.approx(40e-3, abs=1e-4)


@pytest.mark.exhaustive
def test_a_pendulum_that_turns_over_is_followed():
    """Each time it passes the top a small error in any number sends the simulation another way."""
    logs = [_delayed(seed, hold, 160, size=0.9) for seed, hold in ((1, 30), (2, 17))]
    assert np.ptp(logs[0]["position"]) > 6.0 * np.pi
    found = jx.identify(logs[0], "pendulum", validate=logs[1])
    assert found.verdict.level.value == "good"
    for name, value in (("inertia", 0.02), ("gravity", 0.5), ("viscous", 0.01)):
        assert found.chosen.numbers[name] == pytest.approx(value, rel=5e-3)
    assert found.chosen.numbers["delay"] == pytest.approx(2e-3, abs=5e-5)
