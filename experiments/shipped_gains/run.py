"""How much delay do the gains that robots ship with bear?

    python experiments/shipped_gains/run.py [--quick] [--out FOLDER]

Every robot of robots.toml on a stand and held where it stands, with an ideal actuator and with
those that were measured on HyQ and StarlETH: how much delay in the loop its published gains bear at
a control rate of 1 kHz, which joint shakes then, and what Ms and the growth rate are over the
delay. Writes results/shipped_gains/.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import models
import numpy as np
import pictures
import report
from models import Robot

from jaxact.errors import UserError
from jaxact.robot_margins import whole_robot
from jaxact.robot_margins.whole_robot import WholeRobot

OUT = models.HERE.parent.parent / "results" / "shipped_gains"
RATE = 1000.0  # of control [Hz]
ACTUATORS = ("ideal", "hyq", "starleth")
DELAYS = [0.0, 1e-3, 2e-3, 5e-3, 0.01, 0.02]  # [s]


def main() -> int:
    """Compute and write; 0, or 2 after saying what is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two robots, to see that it runs")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the results")
    options = parser.parse_args()
    rows = models.robots()
    if options.quick:
        rows = [row for row in rows if row.name in ("Unitree Go1", "Unitree Go2")][1:3]
    try:
        with tempfile.TemporaryDirectory() as folder:
            found = [looked_at(row, models.prepared(row, Path(folder))) for row in rows]
    except UserError as error:
        print(f"run.py: {error}", file=sys.stderr)
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "shipped_gains.json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    pictures.write(found, options.out)
    (options.out / "README.md").write_text(report.page(found), encoding="utf-8")
    print(f"wrote {options.out}")
    return 0


def looked_at(robot: Robot, model: Path) -> dict[str, Any]:
    """All that is asked of one robot."""
    begun = time.monotonic()
    stand = {name: over_delay(robot, model, name) for name in ACTUATORS}
    found = {
        "robot": robot.name, "publisher": robot.publisher, "source": robot.source,
        "published_delay": robot.delay, "closes": robot.closes, "control_rate": RATE,
        "stand": stand,
        "held": borne(one(robot, model, base="held", actuator="ideal")),
        "stuck": borne(one(robot, model, base="fixed", friction="stuck", actuator="ideal")),
    }  # fmt: skip
    seconds = time.monotonic() - begun
    print(f"{robot.label}: {stand['ideal']['delay']} s, {seconds:.0f} s", flush=True)
    return found


def one(robot: Robot, model: Path, **asked: Any) -> WholeRobot:
    """Its loop without delay."""
    (found,) = whole_robot.evaluate(models.specification(robot, model, control_rate=RATE, **asked))
    return found


def borne(found: WholeRobot) -> dict[str, Any]:
    """The delay that it bears [s], the frequency [rad/s] and the joint of the shaking."""
    known = found.delay_borne
    return {
        "delay": plain(known.delay), "frequency": plain(known.frequency),
        "joint": found.robot.names[int(np.argmax(known.participation))],
        "friction_left_out": found.left_out,
    }  # fmt: skip


def over_delay(robot: Robot, model: Path, actuator: str) -> dict[str, Any]:
    """The same on a stand, with Ms [-] and the growth rate [1/s] over the loop's delay."""
    asked = {"base": "fixed", "actuator": actuator, "control_rate": RATE}
    loops = whole_robot.evaluate(models.specification(robot, model, delay=DELAYS, **asked))
    row = borne(loops[0])
    row["delays"] = DELAYS
    row["growth_rate"] = [plain(each.delay_borne.growth_rate) for each in loops]
    row["peak"] = [peak(each) for each in loops]
    return row


def peak(found: WholeRobot) -> float | None:
    """Ms, the largest singular value of S over frequency; None of a loop that is not stable."""
    if not found.delay_borne.stable:
        return None
    return float(np.max(found.curves.sensitivity))


def plain(value: float) -> float | None:
    """A number as JSON has it."""
    return value if math.isfinite(value) else None


if __name__ == "__main__":
    raise SystemExit(main())
