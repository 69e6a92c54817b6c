"""Logs that one model is held against: each as its own map says, or refused in one line."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.errors import UserError
from jaxact.identification import motion, supply
from jaxact.identification.identify import identify
from jaxact.identification.log import Log
from jaxact.identification.model import predicted

TICK, KP, KD, VISCOUS = 1e-3, 400.0, 20.0, 3.0


def _slide(mass=0.7, rows=400):
    """A mass with viscous friction under PD control, two ticks late, in closed form."""
    setpoint = np.repeat(np.random.default_rng(2).normal(size=rows // 10) * 1e-2, 10)
    decay = np.exp(-VISCOUS / mass * TICK)
    commands, position, velocity = [0.0, 0.0], 0.0, 0.0
    places = np.empty(rows)
    for row in range(rows):
        places[row] = position
        commands.append(KP * (setpoint[row] - position) - KD * velocity)
        end = commands[row] / VISCOUS
        position += end * TICK + (velocity - end) * mass / VISCOUS * (1.0 - decay)
        velocity = end + (velocity - end) * decay
    signals = {"setpoint": setpoint, "position": places}
    return Log(
        f"slide {mass:g}", np.arange(rows) * TICK, signals, unit="m", gains=(KP, KD),
        details={"inertia": mass},
    )  # fmt: skip


@pytest.mark.exhaustive
@pytest.mark.parametrize("mass", [0.7, 1.4])
def test_each_log_moves_what_its_details_state(mass):
    logs = [_slide(0.7), _slide(1.4)]
    with jax.enable_x64(True):
        family = motion.family(logs, "mass")
        log = next(log for log in logs if log.details["inertia"] == mass)
        assert family.neutral["inertia"] == 0.7
        numbers = {**family.neutral, "viscous": VISCOUS, "delay": 2 * TICK}
        rest = predicted(family, log, numbers) - log["position"]
    assert np.max(np.abs(rest)) < 1e-6 * np.ptp(log["position"])


def _told(log, **changes):
    return replace(log, **{"name": "other", **changes})


WHOLE = _slide()
ALONE = {"position": WHOLE["position"], "command": np.sin(20.0 * WHOLE.time)}


@pytest.mark.parametrize(
    ("first", "other", "said"),
    [
        (WHOLE, _told(WHOLE, gains=(None, None)), "other: its gains are not known"),
        (WHOLE, _told(WHOLE, signals=ALONE), "other: has no setpoint, and slide 0.7 has"),
        (_told(WHOLE, signals=ALONE, name="one"), WHOLE, "slide 0.7: has no command, and one has"),
        (WHOLE, _told(WHOLE, difference_ticks=2), "differences positions over 2 rows"),
        (WHOLE, _told(WHOLE, details={}), "only one states the inertia of its joint"),
    ],
)
@pytest.mark.parametrize("held", [True, False])
def test_logs_that_no_one_model_fits_are_refused(first, other, said, held):
    logs, validate = (first, other) if held else ([first, other], ())
    with pytest.raises(UserError, match=said):
        identify(logs, "mass", validate=validate)


def test_a_log_has_a_number_of_its_own_where_its_details_differ():
    logs = [_slide(0.7), _slide(1.4)]
    family = motion.family(logs, "mass")
    assert [dict(family.inputs(log).stated) for log in logs] == [{}, {"inertia": 1.4}]


def test_a_held_log_of_a_force_loop_needs_its_force():
    time = np.arange(400) * TICK
    command = np.sin(20.0 * time)
    bench = Log("bench", time, {"command": command, "force": np.roll(command, 2)})
    other = Log("other", time, {"command": command, "position": command})
    with pytest.raises(UserError, match="other: has no force; a force loop needs"):
        identify(bench, validate=other)


@pytest.mark.parametrize("more", ["feedforward", "command_limit"])
def test_forces_say_nothing_where_all_is_per_unit_of_the_inertia(more):
    signals = {**WHOLE.signals, "feedforward": np.ones(len(WHOLE))}
    own = {"signals": signals} if more == "feedforward" else {}
    details = {} if more == "feedforward" else {more: 3.0}
    log = _told(WHOLE, gains=(None, None), details=details, **own)
    with pytest.raises(UserError, match=f"other: its {more} is a force"):
        identify(log, "mass")


def test_a_drive_has_its_gain_at_one_voltage():
    volts = {**WHOLE.signals, "supply": np.linspace(20.0, 24.0, len(WHOLE))}
    logs = [_told(WHOLE, signals=volts), WHOLE]
    assert supply.usual_supply(logs) == pytest.approx(22.0)
    np.testing.assert_allclose(supply.strength(logs[0], logs)[[0, -1]], [20 / 22, 24 / 22])
    np.testing.assert_array_equal(supply.strength(WHOLE, logs), 1.0)
    stated = [
        _told(log, details={"usual_supply": v}) for log, v in zip(logs, (24.0, 20.0), strict=True)
    ]
    with pytest.raises(UserError, match="24 V in other and 20 V in other; a drive has its gain at"):
        supply.usual_supply(stated)
