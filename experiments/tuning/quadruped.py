"""Gains for the study's quadruped: on four feet, on three and hanging, with a box of actuators.

    python experiments/tuning/quadruped.py [--quick] [--out FOLDER]

The stiffest gains of hips (HAA), thighs (HFE) and knees (KFE) whose multi-loop Ms and Mt stay at or
below MAX_PEAK with every actuator, against the nominal gains of experiments/quadruped and three
times those. All are then held against nonlinear rollouts with noise, quantisation, limits, contacts
and a push. Writes results/tuning/quadruped/.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "quadruped"))

import cases  # noqa: E402
import numpy as np  # noqa: E402

from jaxact.tuning import report  # noqa: E402
from jaxact.tuning.box import read_box  # noqa: E402
from jaxact.tuning.goal import Goal  # noqa: E402
from jaxact.tuning.groups import group  # noqa: E402
from jaxact.tuning.robot import search as robot  # noqa: E402
from jaxact.tuning.robot.exact import exact  # noqa: E402
from jaxact.tuning.robot.loops import VARIED, situation  # noqa: E402
from jaxact.tuning.rollouts.exposure import exposed  # noqa: E402
from jaxact.tuning.rollouts.validation import Rollouts, Validation, validate  # noqa: E402
from jaxact.verbs import tuning_folder, tuning_tables  # noqa: E402

RESULTS = HERE.parent.parent / "results" / "tuning" / "quadruped"
GROUPS = ("HAA", "HFE", "KFE")
# HyQ's actuators, not known to 10 %, and 0.75 to 1.25 ms around the loop.
BOX = "wn=0.9..1.1,zeta=0.9..1.1,output_delay=0.25e-3..0.75e-3"
MAX_PEAK = 6.0
TRIPLED = 3.0


def main() -> None:
    """Tune, validate, and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two situations, few actuators")
    parser.add_argument("--out", type=Path, default=RESULTS)
    asked = parser.parse_args()
    names = cases.SITUATIONS[1:] if asked.quick else cases.SITUATIONS
    number, steps, duration = (1, 40, 1.0) if asked.quick else (8, 150, 4.0)
    begun = time.perf_counter()
    box = read_box(BOX, VARIED)
    situations = [situation(cases.load(name), name, box) for name in names]
    first = situations[0]
    groups = group(GROUPS, first.names)
    tuned = robot.tune(
        situations, Goal(max_peak=MAX_PEAK), groups, number=number, start=(first.kp, first.kd),
        steps=steps,
    )  # fmt: skip
    seconds = time.perf_counter() - begun
    candidates = {
        "nominal": (first.kp, first.kd),
        "tripled": (TRIPLED * first.kp, TRIPLED * first.kd),
        "tuned": (tuned.kp, tuned.kd),
    }
    rollouts = {name: simulated(tuned, *gains, duration) for name, gains in candidates.items()}
    asked.out.mkdir(parents=True, exist_ok=True)
    held = Rollouts(duration, rollouts["tuned"], rollouts["nominal"])
    shown = tuning_tables.Robot(tuned, held)
    document = shown.report()
    tuning_folder.write(shown, asked.out, document, "make tuning")
    print(shown.text(document))
    document |= {"seconds": seconds}
    document["rollouts"] = {name: report.verdicts(rows) for name, rows in rollouts.items()}
    (asked.out / "quadruped.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    text = markdown(tuned, candidates, rollouts, duration)
    (asked.out / "README.md").write_text(text, encoding="utf-8")
    print(f"wrote {asked.out}")


def simulated(tuned, kp, kd, duration: float) -> dict[str, Validation]:
    """Rollouts of gains in every situation with every actuator that was looked at."""
    found = {}
    for place, one in enumerate(tuned.robot.situations):
        fraction = tuned.members.fraction[tuned.members.situation == place]
        specification = exposed(replace(one.specification, seed=1), duration=duration)
        found[one.name] = validate({one.name: specification}, kp, kd, one.columns(fraction))
    return found


HEAD = """# Gains tuned for the quadruped

Written by `make tuning`; not edited by hand. What is asked: [experiments/tuning](../../../experiments/tuning/README.md).

The stiffest gains (geometric mean of kp over the 12 joints) whose Ms and Mt, peaks of the largest
singular values, stay at or below {peak:g} in {situations} with every actuator of a box: HyQ's
natural frequency and damping ratio to 10 %, 0.75 to 1.25 ms around the loop. {loops} loops: samples,
corners, and the worst points of the box that were found.

{verdict}. {agreeing:.0f} % of the starts agree within 1 % before the polish.

| gains | kp HAA | kp HFE | kp KFE | kd HAA | kd HFE | kd KFE | mean kp |
|---|---|---|---|---|---|---|---|
"""  # noqa: E501
MIDDLE = """
kp in N m/rad, kd in N m s/rad. The worst loop of each situation, linearised, sampled, exact; and
how many of the nonlinear rollouts of {duration:g} s came to rest, with noise, quantisation, limits,
contacts and a push:

| gains | situation | unstable | growth rate [1/s] | Ms | Mt | rollouts stable | excursion [rad] |
|---|---|---|---|---|---|---|---|
"""
TAIL = """
![Largest singular values of S and T, before and after](sensitivity.png)

![Gains of the groups, and where every start ended](gains.png)

![The descent from all starts](convergence.png)
"""


def markdown(tuned, candidates, rollouts, duration: float) -> str:
    """The report: gains, linear metrics and rollouts, side by side."""
    sure = "Certified" if tuned.certified else "Not certified"
    text = HEAD.format(
        peak=MAX_PEAK, situations=", ".join(one.name for one in tuned.robot.situations),
        loops=len(tuned.members), verdict=f"{sure}: {tuned.verdict}",
        agreeing=100.0 * tuned.certificate.agreeing,
    )  # fmt: skip
    first = tuned.robot.case.groups.first
    for name, (kp, kd) in candidates.items():
        cells = [f"{k[i]:.4g}" for k in (kp, kd) for i in first]
        text += row(name, *cells, f"{np.exp(np.mean(np.log(kp))):.4g}")
    text += MIDDLE.format(duration=duration)
    for name, gains in candidates.items():
        known = exact(tuned.members, *gains, ("sensitivity_peak", "complementary_peak"))
        for place, one in enumerate(tuned.robot.situations):
            own = tuned.members.situation == place
            text += row(name, one.name, *linear(known, own), *rolled(rollouts[name][one.name]))
    return text + TAIL


def linear(known, own) -> list[str]:
    """Cells of the loops of one situation."""
    lost = int((~known.stable[own]).sum())
    peaks = ["" if lost else f"{np.exp(log[own].max()):.3g}" for log in known.log.values()]
    return [f"{lost} of {own.sum()}", f"{known.growth_rate[own].max():.3g}", *peaks]


def rolled(one: Validation) -> list[str]:
    """Cells of the rollouts of one situation."""
    counted = f"{int(one.stable.sum())} of {one.stable.size}"
    return [counted, f"{np.nanmax(one.excursion):.2g}"]


def row(*cells: str) -> str:
    """A line of a table."""
    return f"| {' | '.join(cells)} |\n"


if __name__ == "__main__":
    main()
