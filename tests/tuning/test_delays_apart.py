"""Where a delay is in the loop: margins do without, responses and ranges of `delay` do not."""

import jax
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from scipy.linalg import expm

import jaxact as jx
from jaxact.tuning.goal import Goal
from jaxact.tuning.joint.ensemble import Sampling, ensemble
from jaxact.tuning.joint.response import step_responses, timed

MASS, DAMPING, WN, ZETA = 1.8, 3.0, 800.0, 0.45
KP, KD = 3000.0, 119.35453411
COMMAND, MEASUREMENT, OUTPUT = 3e-3, 2e-3, 1e-3
STEP = 1e-5


def plant(period=None):
    total = COMMAND + MEASUREMENT + OUTPUT
    return ensemble(MASS, WN, ZETA, total, DAMPING, sampling=Sampling(period),
                    measurement_delay=MEASUREMENT, output_delay=OUTPUT)  # fmt: skip


def simulated(duration, hold):
    """Positions after a step to 1 by the matrix exponential in small steps, delays as they are.

    hold: steps between the ticks of the controller.
    """
    continuous = np.zeros((5, 5))
    continuous[0, 1] = continuous[2, 3] = 1.0
    continuous[1, 1:3] = -DAMPING / MASS, 1.0 / MASS
    continuous[3, 2:] = -(WN**2), -2.0 * ZETA * WN, WN**2
    over = expm(continuous * STEP)[:4]
    late, forward = round(MEASUREMENT / STEP), round((COMMAND + OUTPUT) / STEP)
    steps = round(duration / STEP)
    commands, path, state = np.zeros(steps + forward), np.zeros((steps + late, 2)), np.zeros(5)
    for k in range(steps):
        path[k + late] = state[:2]
        if k % hold == 0:
            position, velocity = path[k]
            commands[k + forward : k + forward + hold] = KP * (1.0 - position) - KD * velocity
        state[4] = commands[k]
        state[:4] = over @ state
    return path[late:, 0]


def test_a_setpoint_is_not_late_by_the_delay_of_the_measurement():
    time, rows = step_responses(plant(), KP, KD, 0.2)
    own = simulated(0.2, 1)
    np.testing.assert_allclose(rows[0], np.interp(time, STEP * np.arange(len(own)), own), atol=1e-3)
    tick = 1e-3
    time, rows = step_responses(plant(tick), KP, KD, 0.2)
    own = simulated(0.2, round(tick / STEP))
    ticks = own[:: round(tick / STEP)]
    every = round(tick / (time[1] - time[0]))
    np.testing.assert_allclose(rows[0][::every], ticks[: len(rows[0][::every])], atol=1e-8)
    np.testing.assert_allclose(rows[0], np.interp(time, STEP * np.arange(len(own)), own), atol=1e-4)


def test_the_settling_time_is_that_of_the_loop():
    outside = np.flatnonzero(abs(simulated(0.4, 1) - 1.0) > 0.02)
    how = timed(Goal("settling", max_kp=KP), [plant()])
    gains = np.full((2, 1), [[KP], [KD]])
    columns = [MASS, WN, ZETA, COMMAND + MEASUREMENT + OUTPUT, DAMPING, 0.0]
    with jax.enable_x64(True):
        found = float(how.of_loops(*gains, np.array(columns)[:, None])[0])
    assert found == pytest.approx(STEP * outside[-1], abs=2e-4)


def test_a_range_of_the_command_delay_is_beside_the_other_delays():
    loop = jx.joint(actuator="hyq", delay=1e-3, measurement_delay=2e-3, output_delay=5e-4)
    tuned = jx.tune(loop, max_peak=1.6, uncertainty={"delay": (0.0, 3e-3)}, samples=4)
    worst = jx.margins(tuned.loop.replace(delay=np.array([0.0, 1e-3, 3e-3])))
    peaks = np.maximum(worst.sensitivity_peak, worst.complementary_peak)
    assert (
        tuned.certified and peaks.max() == pytest.approx(1.6, rel=1e-6) and peaks[2] == peaks.max()
    )
    # A factor is one of the command's delay.
    tuned = jx.tune(loop, max_peak=1.6, uncertainty={"delay": "0.5x..2x"}, samples=4)
    worst = jx.margins(tuned.loop.replace(delay=2e-3))
    assert max(worst.sensitivity_peak, worst.complementary_peak) == pytest.approx(1.6, rel=1e-6)


def test_loops_that_are_simulated_together_have_one_measurement_delay():
    loop = jx.joint(actuator="hyq", delay=1e-3, measurement_delay=2e-3)
    drawn = loop.replace(measurement_delay=np.array([1e-3, 3e-3]))
    with pytest.raises(jx.UserError, match="measurement_delay is not that of the loop"):
        jx.tune(loop, "settling", max_peak=1.6, uncertainty=drawn)
