"""What came out of an identification: a loop, an ensemble, a report, a file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxact.errors import UserError
from jaxact.identification import inspection
from jaxact.identification.inspection import Inspection
from jaxact.identification.ladder import Candidate, Ladder
from jaxact.identification.model import effective_lag
from jaxact.identification.verdict import Verdict
from jaxact.loops.building import joint
from jaxact.loops.control_loop import ControlLoop
from jaxact.parameters import (
    CONTROL_RATE,
    DELAY,
    FORCE_LIMIT,
    JOINT_DAMPING,
    KD,
    KP,
    MASS,
    POSITION_RESOLUTION,
    WN,
    ZETA,
    of,
)

_MOST_TRIES = 50


@dataclass(frozen=True)
class Identified:
    """An identified drive; printed, it is its report.

    Attributes:
        plant: "none" for the force loop alone, "mass" or "pendulum".
        ladder: every model that was tried.
        inspections: of the logs, the fitted ones first.
        verdict: whether it can be used.
    """

    plant: str
    ladder: Ladder
    inspections: tuple[Inspection, ...]
    verdict: Verdict

    @property
    def chosen(self) -> Candidate:
        """The chosen model."""
        return self.ladder.chosen

    @property
    def loop(self) -> ControlLoop:
        """The loop with the identified numbers; gains of the log where they are known.

        Of the force loop alone the plant is the default one.
        """
        values: dict[str, Any] = dict(self._loop_values(self.chosen.numbers))
        return joint(**values)

    def samples(self, number: int = 32, *, seed: int = 0) -> ControlLoop:
        """Loops drawn from what is known of the numbers, an ensemble for `jaxact.tune`.

        Args:
            number: of loops.
            seed: of the draws.

        Returns:
            Loops of shape (number,).
        """
        fit, covariance = self.chosen.fit, self.chosen.knowledge.covariance
        low, high = self._limits()
        generator = np.random.default_rng(seed)
        values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
        spread = vectors * np.sqrt(np.maximum(values, 0.0))
        drawn: list[np.ndarray] = []
        for _ in range(_MOST_TRIES):
            points = fit.point + generator.standard_normal((number, len(fit.point))) @ spread.T
            drawn += [point for point in points if np.all((point >= low) & (point <= high))]
            if len(drawn) >= number:
                break
        else:
            # So wide that most draws leave the range: kept within it instead.
            points = fit.point + generator.standard_normal((number, len(fit.point))) @ spread.T
            drawn += list(np.clip(points, low, high))
        rows = [self._loop_values(fit.problem.model_values(point)) for point in drawn[:number]]
        each: dict[str, Any] = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return joint(**each)

    def _limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends of the delay's interval and of the ranges, in the coordinates of the search."""
        unknowns = self.chosen.fit.problem.unknowns
        both = np.array([sorted((u.inner(u.low), u.inner(u.high))) for u in unknowns])
        return both[:, 0], both[:, 1]

    def _loop_values(self, numbers: dict[str, float]) -> dict[str, float]:
        log = self.ladder.fitted[0]
        values = {
            WN: min(numbers[WN], of(WN).maximum) if math.isfinite(numbers[WN]) else math.inf,
            ZETA: numbers[ZETA],
            DELAY: numbers[DELAY],
        }
        limit = numbers.get(FORCE_LIMIT, math.inf)
        values[FORCE_LIMIT] = math.inf if limit >= 1e12 else limit
        gain = abs(numbers.get("gain", 1.0))
        if self.plant != "none":
            values[MASS] = numbers["inertia"]
            values[JOINT_DAMPING] = numbers["viscous"]
            kp, kd = log.gains
            if kp is None and KP in self.chosen.rung.free:
                kp, kd = numbers[KP], numbers[KD]
            if kp is not None:
                values[KP] = gain * kp
                values[KD] = gain * (kd or 0.0)
        quanta = self.inspections[0].quanta
        if "position" in quanta:
            values[POSITION_RESOLUTION] = quanta["position"]
        values[CONTROL_RATE] = 1.0 / log.period
        return values

    def document(self) -> dict[str, Any]:
        """Everything as plain numbers and words, for TOML and JSON."""
        chosen, known = self.chosen, self.chosen.knowledge
        drive = {
            name: value
            for name, value in self._loop_values(chosen.numbers).items()
            if math.isfinite(value)
        }
        estimates = {
            e.name: {
                "value": e.value, "unit": e.unit, "low": e.low, "high": e.high,
                "identified": e.identified, "reason": e.reason, "wider_than_naive": e.wider,
            }
            for e in known.estimates
        }  # fmt: skip
        return {
            # A list of one, as files of loops have it: `jaxact margins --loops` reads it.
            "loop": [{"name": "identified", **drive}],
            "model": chosen.rung.name,
            "plant": self.plant,
            "unit": self.ladder.fitted[0].unit,
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
            "covariance": {
                "names": list(known.names),
                "logarithms": [u.positive for u in chosen.fit.problem.unknowns],
                "rows": known.covariance.tolist(),
            },
            "logs": {
                "fitted": [log.title for log in self.ladder.fitted],
                "validation": [log.title for log in self.ladder.validation],
            },
        }

    @property
    def report(self) -> str:
        """What was found, as text."""
        from jaxact.identification.report import text

        return text(self)

    def __str__(self) -> str:
        """The report."""
        return self.report


def inspected(ladder: Ladder) -> tuple[Inspection, ...]:
    """The inspections of a ladder's logs, the fitted ones first."""
    return tuple(inspection.inspect(log) for log in (*ladder.fitted, *ladder.validation))


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
        if kp == 0.0 or not 0.8 < found.kp / kp < 1.25:
            raise UserError(
                f"{log.title}: kp = {kp:g} contradicts the command, which follows from"
                f" kp = {found.kp:.4g} and kd = {found.kd:.4g}; correct the map, or say"
                ' kp = "unknown"'
            )
