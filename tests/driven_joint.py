"""A joint behind its drive under a PD controller, by matrix exponentials between switches."""

import numpy as np
from scipy.linalg import expm

from jaxact.identification.log import Log

ROWS = 2500
TICK = 1e-3
INERTIA, VISCOUS, WN, ZETA, DELAY = 0.05, 0.05, 200.0, 0.7, 3.4e-3
GAINS = (20.0, 1.2)


def prbs(seed, hold, rows=ROWS):
    """A setpoint of +-0.1 rad, held for so many rows, that begins at rest."""
    levels = np.random.default_rng(seed).choice([-0.1, 0.1], rows // hold + 1)
    setpoint = np.repeat(levels, hold)[:rows]
    setpoint[:5] = 0.0
    return setpoint


def log(seed, setpoint, *, limit=np.inf, inertia=INERTIA):
    """Its log: setpoint, position with noise of 1e-5 rad, and command within a limit."""
    # Of position, velocity, force, its rate, and the command that acts.
    matrix = np.zeros((5, 5))
    matrix[0, 1], matrix[1, 1:3], matrix[2, 3] = 1.0, (-VISCOUS / inertia, 1.0 / inertia), 1.0
    matrix[3, 2:] = -(WN**2), -2.0 * ZETA * WN, WN**2
    late = int(DELAY // TICK)
    first, last = expm(matrix * (DELAY - late * TICK)), expm(matrix * ((late + 1) * TICK - DELAY))
    rows = len(setpoint)
    state, position = np.zeros(5), np.empty(rows)
    commands = np.zeros(rows + late + 1)  # those before the log began are zero
    for row in range(rows):
        position[row] = state[0]
        asked = GAINS[0] * (setpoint[row] - state[0]) - GAINS[1] * state[1]
        commands[row + late + 1] = np.clip(asked, -limit, limit)
        state[4] = commands[row]
        state = first @ state
        state[4] = commands[row + 1]
        state = last @ state
    noise = 1e-5 * np.random.default_rng(seed + 100).normal(size=rows)
    signals = {
        "setpoint": setpoint, "position": position + noise, "command": commands[late + 1 :],
    }  # fmt: skip
    return Log(f"joint_{seed}", np.arange(rows) * TICK, signals, gains=GAINS)
