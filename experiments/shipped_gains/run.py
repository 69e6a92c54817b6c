"""How much delay do the gains that robots ship with bear?

    python experiments/shipped_gains/run.py [--quick] [--resume] [--redraw] [--out FOLDER]

Every robot of robots.toml on a stand and held where it stands, with an ideal actuator and with
those that were measured on HyQ and StarlETH: how much delay in the loop its published gains bear at
a control rate of 1 kHz, which joint shakes then, and what Ms and the growth rate are over the
delay; and the same of gains that are tuned for 5 ms. Writes results/shipped_gains/.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

# The matrices are small: threads of the linear algebra would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import models
import numpy as np
import pictures
import report
import tuned
from models import Robot, plain

from jaxact.analysis.robot.modes import ranked
from jaxact.analysis.robot.multiloop import curves, multiloop
from jaxact.errors import UserError
from jaxact.robot_margins import whole_robot
from jaxact.robot_margins.whole_robot import WholeRobot

FILE = "shipped_gains.json"
OUT = models.HERE.parent.parent / "results" / "shipped_gains"
RATE = 1000.0  # of control [Hz]
ACTUATORS = ("ideal", "hyq", "starleth")
DELAYS = [0.0, 1e-3, 2e-3, 5e-3, 0.01, 0.02]  # [s]


def main() -> int:
    """Compute and write; 0, or 2 after saying what is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two robots, to see that it runs")
    parser.add_argument("--resume", action="store_true", help="keep robots that are there")
    parser.add_argument("--redraw", action="store_true", help="draw what is in the folder anew")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the results")
    options = parser.parse_args()
    if options.redraw:
        written(known(options.out), options.out)
        return 0
    rows = models.robots()
    if options.quick:
        rows = [row for row in rows if row.name in ("Unitree Go1", "Unitree Go2")][1:3]
    options.out.mkdir(parents=True, exist_ok=True)
    before = {place(row): row for row in known(options.out)} if options.resume else {}
    found = []
    try:
        with tempfile.TemporaryDirectory() as folder:
            for row in rows:
                one = before.get((row.name, row.publisher))
                found.append(one or looked_at(row, models.prepared(row, Path(folder))))
                kept(found, options.out)
    except UserError as error:
        print(f"run.py: {error}", file=sys.stderr)
        return 2
    written(found, options.out)
    return 0


def known(folder: Path) -> list[dict[str, Any]]:
    """What is in the folder."""
    path = folder / FILE
    return json.loads(path.read_text("utf-8")) if path.is_file() else []


def place(row: dict[str, Any]) -> tuple[str, str]:
    """What tells a row from the others."""
    return row["robot"], row["publisher"]


def kept(found: list[dict[str, Any]], folder: Path) -> None:
    """Write the numbers."""
    (folder / FILE).write_text(json.dumps(found, indent=1) + "\n", "utf-8")


def written(found: list[dict[str, Any]], folder: Path) -> None:
    """Write the picture and the page."""
    pictures.write(found, folder)
    (folder / "README.md").write_text(report.page(found), encoding="utf-8")
    print(f"wrote {folder}")


def looked_at(robot: Robot, model: Path) -> dict[str, Any]:
    """All that is asked of one robot."""
    begun = time.monotonic()
    stand = {name: over_delay(robot, model, name) for name in ACTUATORS}
    found = {
        "robot": robot.name, "publisher": robot.publisher, "source": robot.source,
        "published_delay": robot.delay, "closes": robot.closes, "control_rate": RATE,
        "stand": stand,
        "held": held(robot, model),
        "stuck": borne(one(robot, model, base="fixed", friction="stuck", actuator="ideal")),
        "tuned": tuned.tuned(robot, model, RATE),
    }  # fmt: skip
    seconds = time.monotonic() - begun
    print(f"{robot.label}: {stand['ideal']['delay']} s, {seconds:.0f} s", flush=True)
    return found


def held(robot: Robot, model: Path) -> dict[str, Any] | None:
    """The same where it stands in contact, its trunk held; None if it cannot stand there."""
    try:
        return borne(one(robot, model, base="held", actuator="ideal"))
    except UserError as error:
        print(f"{robot.label}, held: {error}", file=sys.stderr)
        return None


def one(robot: Robot, model: Path, **asked: Any) -> WholeRobot:
    """Its loop without delay."""
    (found,) = whole_robot.evaluate(models.specification(robot, model, control_rate=RATE, **asked))
    return found


def borne(found: WholeRobot) -> dict[str, Any]:
    """The delay that it bears [s], the frequency [rad/s] and the joint of the shaking."""
    known = found.delay_borne
    return {
        "delay": plain(known.delay), "frequency": plain(known.frequency),
        "joint": found.robot.names[ranked(known.participation)[0]],
        "friction_left_out": found.left_out,
    }  # fmt: skip


def over_delay(robot: Robot, model: Path, actuator: str) -> dict[str, Any]:
    """The same on a stand, with Ms [-] and the growth rate [1/s] over the loop's delay."""
    asked: dict[str, Any] = {"base": "fixed", "actuator": actuator, "control_rate": RATE}
    loops = whole_robot.evaluate(models.specification(robot, model, delay=DELAYS, **asked))
    row = borne(loops[0])
    levels = [level(each) for each in loops]
    row["delays"] = DELAYS
    row["growth_rate"] = [growth for growth, _ in levels]
    row["peak"] = [peak for _, peak in levels]
    return row


def level(found: WholeRobot) -> tuple[float | None, float | None]:
    """The growth rate [1/s], and Ms, the largest singular value of S; None if not stable."""
    loop = multiloop(*found.robot.matrices, found.robot.period)
    growth = math.log(float(np.max(np.abs(loop.roots)))) / found.robot.period
    if growth >= 0.0:
        return growth, None
    return growth, float(np.max(curves(loop, found.robot.names).sensitivity))


if __name__ == "__main__":
    raise SystemExit(main())
