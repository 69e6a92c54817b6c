"""How simple may the model of an actuator be, for predicting its motion, force, and margins?

    python experiments/identification/run.py [--emps FOLDER] [--quick]

Fits the ladder of models to the logs in `logs/`, with others held out, and writes a table, the
numbers and a picture for each system to results/identification/. For every rung: the error on
logs it has not seen, and the gain and delay margin that it predicts for one and the same loop.
The EMPS logs state no licence and are not kept here; `--emps` names a folder that has them.
`--quick` leaves out the servo, whose fits take minutes.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import jaxact as jx
from jaxact.identification.identify import identify
from jaxact.identification.ladder import Candidate
from jaxact.identification.problem import effective_lag
from jaxact.identification.result import Identified
from jaxact.plotting import theme
from jaxact.verbs.identify import identification_sheet

HERE = Path(__file__).resolve().parent
LOGS = HERE / "logs"
RESULTS = HERE.parent.parent / "results" / "identification"

# The loop whose margins every rung predicts: what a leg's knee is to such a drive.
INERTIA, KP, KD, RATE = 0.05, 20.0, 0.6, 500.0


@dataclass(frozen=True)
class System:
    """One question: logs to fit, logs to predict, and what moves."""

    name: str
    title: str
    fit: tuple[Path, ...]
    validate: tuple[Path, ...]
    columns: Path
    plant: str
    joint: str = ""
    control_rate: float | None = None


def systems(quick: bool, emps: Path | None) -> list[System]:
    """All that is asked."""
    one, two = LOGS / "ak80_fit.npz", LOGS / "ak80_validate.npz"
    found = [
        System(f"ak80_{joint}{name}", f"AK80-6, {joint}{said}", (a,), (b,), HERE / "ak80.toml",
               "none", joint)
        for joint in ("shoulder", "elbow")
        for name, said, a, b in (("", "", one, two), ("_swapped", ", logs swapped", two, one))
    ]  # fmt: skip
    if not quick:
        for held in (100, 200, 400):
            every = sorted(LOGS.glob("xl330_*.npz"))
            out = tuple(path for path in every if f"_kp{held}_" in path.name)
            found.append(
                System(f"xl330_{held}", f"XL330, kp {held} held out",
                       tuple(path for path in every if path not in out), out, HERE / "xl330.toml",
                       "pendulum", control_rate=1000.0)
            )  # fmt: skip
    if emps is not None:
        found.append(
            System("emps", "EMPS, pulses held out", (emps / "data_emps.csv",),
                   (emps / "data_emps_pulses.csv",), HERE / "emps.toml", "mass")
        )  # fmt: skip
    return found


def solve(system: System) -> Identified:
    """The ladder of one system."""
    return identify(
        system.fit, system.plant, validate=system.validate, columns=system.columns,
        joint=system.joint, control_rate=system.control_rate,
    )  # fmt: skip


def rung(system: System, found: Identified, one: Candidate) -> dict[str, object]:
    """A rung's errors, and the margins it predicts."""
    loop = jx.joint(
        mass=INERTIA, kp=KP, kd=KD, control_rate=RATE, delay=one.numbers["delay"],
        wn=one.numbers["wn"], zeta=one.numbers["zeta"],
    )  # fmt: skip
    margins = jx.margins(loop)
    degrees = [
        math.degrees(float(np.mean(np.abs(_rest(found, one, number)))))
        for number in range(len(found.ladder.validation))
    ]
    return {
        "model": one.rung.name,
        "unknowns": one.size,
        "error": one.error,
        "score": min(one.scores),
        "degrees": float(np.mean(degrees)) if system.plant == "pendulum" else None,
        "identified": one.knowledge.identified,
        "effective_lag": effective_lag(one.numbers),
        "gain_margin": float(margins.gain_margin),
        "delay_margin": float(margins.delay_margin),
        "values": one.fit.values,
    }


def _rest(found: Identified, one: Candidate, number: int) -> np.ndarray:
    from jaxact.identification.model import predicted

    log = found.ladder.validation[number]
    return predicted(found.ladder.family, log, one.numbers) - found.ladder.family.measured(log)


def table(system: System, found: Identified, rungs: list[dict[str, object]]) -> list[str]:
    """A system's section of the page."""
    unit = found.ladder.family.unit
    mean = system.plant == "pendulum"
    head = f"| model | unknowns | error [{unit}] |" + (" mean error [deg] |" if mean else "")
    rule = "|---|---|---|" + ("---|" if mean else "")
    lines = [
        f"## {system.title}", "", f"**{found.verdict.sentence}.** Chosen: "
        f"{found.chosen.rung.name}.", "",
        f"{head} all known | lag [ms] | gain margin | delay margin [ms] |",
        f"{rule}---|---|---|---|",
    ]  # fmt: skip
    for row in rungs:
        mark = "**" if row["model"] == found.chosen.rung.name else ""
        middle = f" {row['degrees']:.2f} |" if mean else ""
        lines.append(
            f"| {mark}{row['model']}{mark} | {row['unknowns']} | {row['error']:.3g} |{middle}"
            f" {'yes' if row['identified'] else 'no'} | {1e3 * row['effective_lag']:.3g} |"
            f" {row['gain_margin']:.3g} | {1e3 * row['delay_margin']:.3g} |"
        )
    return [*lines, "", "```text", found.report, "```", ""]


PAGE = f"""# How simple may the model of an actuator be?

Made by `make identification`. Each ladder of models was fitted to some logs and tried on others.
Beside the error on those stand the gain and delay margin that each model predicts for one and the
same loop ({INERTIA:g} kg m^2, kp {KP:g} N m/rad, kd {KD:g} N m s/rad, continuous): how far a model
that predicts the motion well can still be wrong about stability. Logs, sources and licences:
[experiments/identification](../../experiments/identification/README.md).

"""


def main() -> None:
    """Write results/identification/."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--emps", type=Path, default=None)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    RESULTS.mkdir(parents=True, exist_ok=True)
    page, numbers = PAGE, {}
    for system in systems(given.quick, given.emps):
        found = solve(system)
        rungs = [rung(system, found, one) for one in found.ladder.candidates]
        numbers[system.name] = {"document": found.document(), "rungs": rungs}
        numbers[system.name]["document"].pop("covariance")
        page += "\n".join(table(system, found, rungs))
        if not system.name.endswith("_swapped"):
            figure = identification_sheet(found)
            theme.write(figure, RESULTS / f"{system.name}.png", title=system.title)
            page += f"\n![{system.title}]({system.name}.png)\n\n"
        print(f"{system.title}: {found.verdict.sentence}", flush=True)
    (RESULTS / "README.md").write_text(page, encoding="utf-8")
    (RESULTS / "identification.json").write_text(json.dumps(numbers, indent=1) + "\n", "utf-8")
    print(f"wrote {RESULTS}")


if __name__ == "__main__":
    main()
