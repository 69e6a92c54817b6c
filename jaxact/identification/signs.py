"""Signals that contradict each other: one of them has the wrong sign, or another unit."""

from __future__ import annotations

import numpy as np
from scipy import fft

from jaxact.identification import inspection, starts
from jaxact.identification.log import Log
from jaxact.parameters import SETPOINT

# A position follows its setpoint within this time [s], and with such a correlation.
_FOLLOWS, _CLEARLY = 1.0, 0.5
# Correlations of the other sign are this much smaller.
_OTHER_SIGN = 0.6
# A joint does not move by so many times its setpoint, nor so many times less where it follows.
_OTHER_UNIT = 12.0
# A controller that explains so much of a command is the one it comes from.
_NEARLY_ALL = 0.98
_TURN = "has the wrong sign, give it scale = -1.0 in the map"


def opposed(log: Log) -> str:
    """Which of a log's signals contradict each other, and what to do; "" where none do."""
    if "force" in log or "position" not in log:
        return ""
    if SETPOINT in log:
        most, least = _followed(log[SETPOINT], log["position"], log.period)
        if least < -_CLEARLY and most < -_OTHER_SIGN * least:
            return f"position goes against the setpoint: one of the two {_TURN}"
        times = float(np.std(log["position"]) / max(float(np.std(log[SETPOINT])), 1e-300))
        if most > _CLEARLY and not 1.0 / _OTHER_UNIT < times < _OTHER_UNIT:
            return (
                f"position moves {times:.3g} times as far as the setpoint: one of the two is in"
                " another unit, give it a scale in the map"
            )
    controller = inspection.recomputed(log)
    if controller is not None and controller.explained > _NEARLY_ALL:
        if controller.kp < 0.0:
            return (
                "the command goes against setpoint minus position: the command, or each of the"
                f" other two, {_TURN}"
            )
        return ""
    if "command" in log and starts.against_the_command(log):
        return f"position goes against the command: one of the two {_TURN}"
    return ""


def _followed(stimulus: np.ndarray, answer: np.ndarray, period: float) -> tuple[float, float]:
    """The largest and the least correlation of a signal with another one a little before."""
    one, two = stimulus - stimulus.mean(), answer - answer.mean()
    size = float(np.linalg.norm(one) * np.linalg.norm(two))
    if size == 0.0:
        return 0.0, 0.0
    length = fft.next_fast_len(2 * len(one), real=True)
    both = fft.irfft(fft.rfft(two, length) * np.conj(fft.rfft(one, length)), length)
    late = both[: min(max(round(_FOLLOWS / period), 1), len(one) // 4)] / size
    return float(late.max()), float(late.min())
