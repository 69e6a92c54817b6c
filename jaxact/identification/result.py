"""What came out of an identification: a loop, an ensemble, a report, a file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxact.errors import UserError
from jaxact.identification import inspection, starts, supply
from jaxact.identification.alike import stated
from jaxact.identification.choice import Candidate
from jaxact.identification.inspection import Inspection
from jaxact.identification.joint_motion import COMMAND_LIMIT
from jaxact.identification.ladder import Ladder
from jaxact.identification.problem import Unknown, effective_lag
from jaxact.identification.verdict import Verdict
from jaxact.loops import drives
from jaxact.loops.building import joint
from jaxact.loops.control_loop import ControlLoop
from jaxact.loops.drives import IdentifiedDrive
from jaxact.loops.model_numbers import NO_LIMIT, parameters_of
from jaxact.parameters import (
    CONTROL_RATE,
    FORCE_LIMIT,
    GAIN_SCALE,
    KD,
    KP,
    POSITION_RESOLUTION,
    SETPOINT,
    WN,
)
from jaxact.reportable import Reportable

# Of a loop only one controller's gains can be, and one load.
_OTHER_GAINS = "the gains of other logs than the first"
_OTHER_LOADS = "the {} of other logs than the first"
# What a log may state of its joint: no number of its model is neutral then.
_STATED = ("inertia", "gravity")


@dataclass(frozen=True)
class Identified(Reportable):
    """An identified drive; printed, it is what was found in words and a table.

    Attributes:
        plant: "none" for the force loop alone, "mass" or "pendulum".
        ladder: every model that was tried.
        inspections: of the logs, the fitted ones first.
        verdict: whether it can be used.
        control_rate: of the drive's own controller [Hz], None for once a row.
    """

    plant: str
    ladder: Ladder
    inspections: tuple[Inspection, ...]
    verdict: Verdict
    control_rate: float | None = None

    @property
    def chosen(self) -> Candidate:
        """The chosen model."""
        return self.ladder.chosen

    @property
    def drive(self) -> IdentifiedDrive:
        """The drive as its file has it, for `jaxact.joint`, `jaxact.robot` and `jaxact.tune`."""
        return drives.of_document("identified", self.document())

    @property
    def loop(self) -> ControlLoop:
        """The loop with the identified numbers; gains of the log where they are known.

        Of the force loop alone the plant is the default one.
        """
        return joint(drive=self)

    def samples(self, number: int = 32, *, seed: int = 0) -> ControlLoop:
        """Loops drawn from what is known of the numbers, an ensemble for `jaxact.tune`.

        Args:
            number: of loops.
            seed: of the draws.

        Returns:
            Loops of shape (number,).
        """
        return joint(drive=self, samples=number, seed=seed)

    def _loop_values(self) -> dict[str, float]:
        """The parameters of the loop: the model's, the controller's and the sensor's."""
        log, numbers = self.ladder.fitted[0], self._numbers()
        values = parameters_of(numbers, self.plant)
        gain, (kp, kd) = abs(numbers.get("gain", 1.0)), log.gains
        if self.plant != "none" and kp is not None:
            # A controller whose command was not recorded may have units of its own.
            own, gain = (1.0, gain) if "command" in log else (gain, 1.0)
            values |= {KP: own * kp, KD: own * (kd or 0.0)}
        if gain != 1.0:
            values[GAIN_SCALE] = gain
        limit = self._command_limit()
        if limit is not None and WN not in values:  # nothing but a delay and a gain behind it
            strength = abs(numbers.get("gain", 1.0))
            values[FORCE_LIMIT] = min(strength * limit, values.get(FORCE_LIMIT, math.inf))
        quanta = self.inspections[0].quanta
        if "position" in quanta:
            values[POSITION_RESOLUTION] = quanta["position"]
        values[CONTROL_RATE] = self.control_rate or float(f"{1.0 / log.period:.4g}")
        return values

    def _command_limit(self) -> float | None:
        """The largest command of the first log's controller [N or N m]; None for no limit."""
        log = self.ladder.fitted[0]
        if self.plant == "none":
            return None
        # Without a controller what a log shows may be no more than how it was excited.
        own = starts.command_limit(log) if SETPOINT in log else log.details.get(COMMAND_LIMIT)
        limit = min(own or math.inf, self.chosen.numbers.get(COMMAND_LIMIT, math.inf))
        return limit if limit < NO_LIMIT else None

    def _left_out(self) -> list[str]:
        """What differs between logs, of which a loop has the first's."""
        logs = self.ladder.fitted
        said = [_OTHER_GAINS] if len({log.gains for log in logs}) > 1 else []
        loads = [stated(log, self.plant == "pendulum") for log in logs]
        differ = [name for name in loads[0] if any(one[name] != loads[0][name] for one in loads)]
        return [*said, *(_OTHER_LOADS.format(name) for name in differ)]

    def _difference_ticks(self) -> int:
        """Rows over which the controller differenced positions, 0 where it did not."""
        log = self.ladder.fitted[0]
        return log.difference_ticks if self.plant != "none" and SETPOINT in log else 0

    def _numbers(self) -> dict[str, float]:
        """The model's numbers by name, without those that change nothing."""
        chosen, neutral = self.chosen, self.ladder.family.neutral
        free = {u.model_name for u in chosen.fit.problem.unknowns if not u.nuisance}
        return {
            name: value
            for name, value in chosen.numbers.items()
            if not math.isnan(value)  # where a log begins is not the model's
            and (name in free or value != neutral.get(name) or (value and name in _STATED))
        }

    def _spread(self) -> dict[str, Any]:
        """What is known of the model's numbers together, of all logs."""
        known, unknowns = self.chosen.knowledge, self.chosen.fit.problem.unknowns
        kept = [index for index, unknown in enumerate(unknowns) if not unknown.nuisance]
        own = [unknowns[index] for index in kept]
        ends = [sorted(_model_value(u, end) for end in (u.low, u.high)) for u in own]
        return {
            "names": [u.model_name for u in own],
            "logarithms": [u.positive for u in own],
            "low": [low for low, _ in ends],
            "high": [high for _, high in ends],
            "rows": known.covariance[np.ix_(kept, kept)].tolist(),
        }

    def _tried(self) -> list[dict[str, Any]]:
        """The models of the ladder that could be fitted."""
        return [
            {
                "name": one.rung.name,
                "unknowns": one.size,
                "error": one.error,
                "score": min(one.scores),
                "identified": one.knowledge.identified,
                "chosen": one is self.chosen,
            }
            for one in self.ladder.candidates
            if math.isfinite(one.error)
        ]

    def document(self) -> dict[str, Any]:
        """Everything as plain numbers and words, for TOML and JSON."""
        chosen, known = self.chosen, self.chosen.knowledge
        logs = self.ladder.fitted
        ticks, limit, left_out = self._difference_ticks(), self._command_limit(), self._left_out()
        models = {u.name: u.model_name for u in chosen.fit.problem.unknowns}
        estimates = {
            e.name: {
                "value": e.value, "unit": e.unit, "low": e.low, "high": e.high,
                "identified": e.identified, "reason": e.reason, "wider_than_naive": e.wider,
                **({"number": models[e.name]} if models[e.name] != e.name else {}),
            }
            for e in known.estimates
        }  # fmt: skip
        return {
            # A list of one, as files of loops have it: `jaxact margins --loops` reads it.
            "loop": [
                {
                    "name": "identified",
                    **self._loop_values(),
                    **({"velocity": "differenced"} if ticks else {}),
                }
            ],
            "model": chosen.rung.name,
            "plant": self.plant,
            **({drives.DIFFERENCE_TICKS: ticks} if ticks else {}),
            **({} if self.control_rate is None else {"control_rate": self.control_rate}),
            **supply.document(logs),
            "unit": logs[0].unit,
            **({"left_out": left_out} if left_out else {}),
            **({} if limit is None else {COMMAND_LIMIT: limit}),
            "verdict": {
                "level": self.verdict.level.value,
                "sentence": self.verdict.sentence,
                "score": self.verdict.score,
                **({} if self.verdict.below is None else {"below": self.verdict.below}),
            },
            "estimates": estimates,
            "effective_lag": {
                "value": effective_lag(chosen.numbers),
                "deviation": 0.0 if known.lag is None else known.lag[1],
            },
            "numbers": self._numbers(),
            "covariance": self._spread(),
            "ladder": self._tried(),
            "signal": self.ladder.family.signal,
            "signal_unit": self.ladder.family.unit,
            "logs": {
                "fitted": [log.title for log in self.ladder.fitted],
                "validation": [log.title for log in self.ladder.validation],
            },
        }

    def __str__(self) -> str:
        """What was found, in words and a table."""
        from jaxact.identification.report import text

        return text(self)


def _model_value(unknown: Unknown, value: float) -> float:
    """The model's number for a value of an unknown."""
    return unknown.inverse_of[1] / value if unknown.inverse_of else value


def inspected(ladder: Ladder) -> tuple[Inspection, ...]:
    """The inspections of a ladder's logs, the fitted ones first."""
    return tuple(inspection.inspect(log) for log in (*ladder.fitted, *ladder.validation))


# Stated gains that explain less of a command, where others explain nearly all of it, are wrong.
_CONTRADICTS = 0.9
# Gains that are the same but for noise.
_SAME = 0.03


def check_gains(ladder_logs: Any) -> None:
    """That the gains a map states are those that the command follows from.

    Raises:
        UserError: they contradict the command.
    """
    for log in ladder_logs:
        found = inspection.recomputed(log)
        kp = log.gains[0]
        if found is None or kp is None or found.explained < 0.98:
            continue
        if kp and -1.25 < found.kp / kp < -0.8:
            raise UserError(
                f"{log.title}: the command goes against setpoint minus position: the command, or"
                " each of the other two, has the wrong sign, give it scale = -1.0 in the map"
            )
        if kp and abs(found.kp / kp / math.radians(1.0) - 1.0) < _SAME:
            raise UserError(
                f"{log.title}: the command follows from a kp {kp / found.kp:.3g} times smaller than"
                f" the map's {kp:g}, as where positions are in degrees; give setpoint and position"
                " scale = 0.01745329 in the map"
            )
        if kp == 0.0 or not 0.8 < found.kp / kp < 1.25:
            raise UserError(
                f"{log.title}: kp = {kp:g} contradicts the command, which follows from"
                f" kp = {found.kp:.4g} and kd = {found.kd:.4g}; correct the map, or say"
                ' kp = "unknown"'
            )
        kd = log.gains[1]
        if kd is not None and inspection.explained_by(log, kp, kd) < _CONTRADICTS:
            raise UserError(
                f"{log.title}: kd = {kd:g} contradicts the command, which follows from"
                f" kp = {found.kp:.4g} and kd = {found.kd:.4g}; correct the map, or say"
                ' kd = "unknown"'
            )
