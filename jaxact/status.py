"""What a rollout can end as: the verdict, with a name and a sentence of advice for each."""

from __future__ import annotations

from enum import IntEnum


class Verdict(IntEnum):
    """Outcome of one closed loop; the value is the code stored in result files."""

    STABLE = 0
    LIMIT_CYCLE = 1
    UNSTABLE = 2
    INVALID = 3
    TOPPLES = 4

    @property
    def label(self) -> str:
        """The name people read in tables, plots and files."""
        return self.name.lower().replace("_", " ")

    @property
    def bounded(self) -> bool:
        """Whether the motion stays about its setpoint: only then a step's metrics describe it."""
        return self in (Verdict.STABLE, Verdict.LIMIT_CYCLE)

    @property
    def advice(self) -> str:
        """One sentence: what the verdict means and what to do about it."""
        return _ADVICE[self]


_ADVICE = {
    Verdict.STABLE: "Perturbations decay; see the margins for how much room is left.",
    Verdict.LIMIT_CYCLE: (
        "The motion stays bounded but goes on, in a loop with counts, limits or dry friction, or "
        "of a robot far from its posture; lower the gains or shorten the delay."
    ),
    Verdict.UNSTABLE: "Perturbations grow; lower the gains or shorten the delay.",
    Verdict.TOPPLES: (
        "The robot falls, or leaves its posture, without swinging: its gains do not balance it, as "
        'no gains may. Nothing shakes; hang it up, base = "fixed", to judge its gains alone.'
    ),
    Verdict.INVALID: (
        "The simulation produced values that are not numbers, or the growth rate was not found; "
        "check the model and its time step, and compute in float64."
    ),
}
