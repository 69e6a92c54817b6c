"""Delays beyond the range that is searched at first."""

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.identification.identify import identify
from jaxact.identification.log import Log

TICK, ROWS, LAG = 1e-3, 1500, 8e-3


def _bench(seed, late):
    """A first-order drive that is so many ticks late, in closed form, with a little noise."""
    generator = np.random.default_rng(seed)
    command = np.repeat(generator.choice([-1.0, 1.0], ROWS // 7 + 1), 7)[:ROWS]
    held = np.append(np.full(late, command[0]), command)
    decay, force = np.exp(-TICK / LAG), np.empty(ROWS)
    force[0] = command[0]
    for row in range(1, ROWS):
        force[row] = held[row - 1] + decay * (force[row - 1] - held[row - 1])
    signals = {"command": command, "force": force + 0.01 * generator.normal(size=ROWS)}
    return Log(f"bench_{seed}", np.arange(ROWS) * TICK, signals)


@pytest.mark.parametrize(("late"), [24, pytest.param(50, marks=pytest.mark.exhaustive)])
def test_longer_delays_are_tried_where_a_fit_ends_at_the_longest(late):
    found = identify(_bench(1, late), validate=_bench(2, late))
    delay = found.chosen.knowledge["delay"]
    assert delay.identified and delay.low <= late * TICK <= delay.high
    assert found.verdict.level.value == "good"


@pytest.mark.exhaustive
def test_a_delay_beyond_all_that_are_tried_is_said():
    found = identify(_bench(1, 90), validate=_bench(2, 90))
    said = str(found)
    assert "may be longer than the 60 ms that were tried" in said
    assert "may be longer than the 60 ms that were tried" in found.verdict.sentence
    assert "only delay + 2 zeta/wn" not in said and found.verdict.level.value != "good"
