"""How simple may the model of an actuator be, for predicting its motion, force, and margins?

    python experiments/identification/run.py [--emps FOLDER] [--quick]

Fits the ladder of models to the logs in `logs/`, with others held out, and writes a table, the
numbers and a picture for each system to results/identification/. For every rung: the error on
logs it has not seen, and the gain and delay margin that it predicts for one and the same loop.
The EMPS logs state no licence and are not kept here; `--emps` names a folder that has them, and
only a page of its own, emps.md, is written then. `--quick` leaves out the servo, the slowest.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

import jaxact as jx
from jaxact.identification.choice import Candidate
from jaxact.identification.identify import identify
from jaxact.identification.model import predicted
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


def emps(folder: Path) -> System:
    """The benchmark whose logs are elsewhere."""
    return System(
        "emps", "EMPS, pulses held out", (folder / "data_emps.csv",),
        (folder / "data_emps_pulses.csv",), HERE / "emps.toml", "mass",
    )  # fmt: skip


def systems(quick: bool) -> list[System]:
    """All that is asked of the logs that are kept here."""
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
    return [*lines, "", "```text", str(found), "```", ""]


PAGE = f"""# How simple may the model of an actuator be?

Made by `make identification`. Each ladder of models was fitted to some logs and tried on others.
Beside the error on those stand the gain and delay margin that each model predicts for one and the
same loop ({INERTIA:g} kg m^2, kp {KP:g} N m/rad, kd {KD:g} N m s/rad, continuous): how far a model
that predicts the motion well can still be wrong about stability. Logs, sources and licences:
[experiments/identification](../../experiments/identification/README.md). EMPS, whose logs are not
kept here: [emps.md](emps.md). How often intervals contain the truth: [coverage.md](coverage.md).

"""


EMPS_PAGE = """# EMPS, from logs that are not kept here

Made by `python experiments/identification/run.py --emps FOLDER`. The electro-mechanical positioning
system of Janot, Gautier and Brunot (2019): fitted on one log, tried on the one with added pulses of
force. Published there for the pulses: position 0.0080 %, force 8.94 %, mass 95.11 kg.

"""


def main() -> None:
    """Write results/identification/."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--emps", type=Path, default=None)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    RESULTS.mkdir(parents=True, exist_ok=True)
    if given.emps is not None:
        write([emps(given.emps)], EMPS_PAGE, "emps.md", "emps.json")
    else:
        write(systems(given.quick), PAGE, "README.md", "identification.json")


def write(asked: list[System], page: str, name: str, data: str) -> None:
    """Solve, and write a page, its numbers and its pictures."""
    numbers = {}
    for system in asked:
        found = solve(system)
        rungs = [rung(system, found, one) for one in found.ladder.candidates]
        numbers[system.name] = {"document": found.document(), "rungs": rungs}
        for of_file in ("covariance", "ladder", "signal", "signal_unit"):  # rungs say more
            numbers[system.name]["document"].pop(of_file)
        if system.name == "emps":
            numbers[system.name]["errors"] = relative = relative_errors(found)
            page += "".join(
                f"Error of the {n}: {share:.4g} %.  \n" for n, share in relative.items()
            )
            page += "\n"
        page += "\n".join(table(system, found, rungs))
        if not system.name.endswith("_swapped"):
            figure = identification_sheet(found)
            theme.write(figure, RESULTS / f"{system.name}.png", title=system.title)
            page += f"\n![{system.title}]({system.name}.png)\n\n"
        print(f"{system.title}: {found.verdict.sentence}", flush=True)
    (RESULTS / name).write_text(page, encoding="utf-8")
    (RESULTS / data).write_text(json.dumps(numbers, indent=1) + "\n", "utf-8")
    print(f"wrote {RESULTS / name}")


def relative_errors(found: Identified) -> dict[str, float]:
    """100 |y - yh| / |y| of position and command [%], as the benchmark's publications count it."""
    family, log = found.ladder.family, found.ladder.validation[0]
    numbers = found.chosen.numbers
    position = predicted(family, log, numbers)
    with jax.enable_x64(True):
        command = np.asarray(family.simulate.both(numbers, family.inputs(log))[1])[: len(log)]
    return {
        signal: 100.0 * float(np.linalg.norm(made - log[signal]) / np.linalg.norm(log[signal]))
        for signal, made in (("position", position), ("command", command))
    }


if __name__ == "__main__":
    main()
