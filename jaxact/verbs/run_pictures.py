"""A simulated loop as what its pictures draw."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from jaxact.plotting import step as _step
from jaxact.plotting import trajectory as _trajectory
from jaxact.plotting.wording import quantity
from jaxact.status import Verdict
from jaxact.verbs.run_tables import SIGNALS

if TYPE_CHECKING:
    from jaxact.simulation.single import Single


def signals(run: Single, joint: int = 0) -> _trajectory.Joint:
    """The signals of one joint of a simulated loop."""
    rows = {name: getattr(run.trajectory, name)[:, joint] for name in SIGNALS}
    return _trajectory.Joint(time=run.trajectory.time, **rows)


def step_response(run: Single, label: str) -> _step.StepResponse:
    """A simulated loop as a step response, its legend with overshoot, rise and settling time.

    Of a loop that diverges the legend has the verdict only.

    Args:
        run: of one loop.
        label: what it is called.
    """
    verdict, results = Verdict(int(run.results["verdict"])), run.results
    words = [] if verdict is Verdict.STABLE else [verdict.label]
    if verdict.bounded and math.isfinite(results["overshoot"]):
        words.append(f"overshoot {100.0 * results['overshoot']:.3g} %")
    for name in ("rise_time", "settling_time"):
        if verdict.bounded and math.isfinite(results[name]):
            words.append(f"{name.replace('_', ' ')} {quantity(results[name], 's')}")
    label = f"{label}: {', '.join(words)}" if words else label
    return _step.StepResponse(label, signals(run), verdict.bounded)
