"""MJX against C MuJoCo: the verdicts of a map of gains of the standing quadruped, pushed.

    python experiments/quadruped/engines.py

The same 32 x 32 gains of all joints, the same drives; the two simulators differ in code, in
precision (float32 in MJX), and in how they end a contact's iterations. Where the verdicts differ,
the boundary must be near: with one or both gains 5 % up or down, C MuJoCo itself must come to the
other verdict. Takes some minutes.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace

import cases
import numpy as np

from jaxact.status import Verdict
from jaxact.sweep import execute
from jaxact.sweep.samples import Samples, explicit

KP, KD = (150.0, 3000.0), (5.0, 100.0)  # [N m/rad], [N m s/rad]
DRIVES = (("hyq", 0.005), ("ideal", 0.005), ("hyq", 0.001))
NEAR = 1.05  # factor on a gain that is near the boundary
SHARE = 0.95  # of the verdicts that must agree


@dataclass(frozen=True)
class Comparison:
    """How two simulators see a map of gains.

    loops: number of gains
    stable: share of them that C MuJoCo calls stable
    agree: share of verdicts (stable or not) that agree
    same: share of verdicts that are the same in every word
    far: loops that disagree and are not near the boundary
    """

    loops: int
    stable: float
    agree: float
    same: float
    far: int

    @property
    def fine(self) -> bool:
        """Whether they agree as they should."""
        return self.agree >= SHARE and self.far == 0


def columns(actuator: str, delay: float, kp: np.ndarray, kd: np.ndarray) -> dict[str, np.ndarray]:
    """Parameters of loops with one drive and these gains, shape (n,) each."""
    drive = cases.Drives(np.repeat(actuator, kp.size), np.full(kp.size, delay), np.zeros(kp.size))
    return drive.columns() | {"kp": kp, "kd": kd}


def verdicts(samples_of: dict[str, np.ndarray], engine: str, duration: float) -> np.ndarray:
    """Codes of the verdicts of loops of the standing quadruped, shape (n,)."""
    asked = cases.load("stand", duration)
    assert asked.push is not None
    kept = {k: v for k, v in asked.parameters.items() if "@" not in k}
    push = replace(asked.push, time=0.1 * duration, duration=0.05 * duration)
    asked = replace(asked, engine=engine, parameters=kept, push=push, axes=())
    loops: Samples = explicit(asked, samples_of)
    return execute.run(asked, loops)["verdict"]


def compare(actuator: str, delay: float, number: int, duration: float) -> Comparison:
    """Both simulators on a map of number x number gains."""
    grid = np.meshgrid(np.geomspace(*KP, number), np.geomspace(*KD, number), indexing="ij")
    kp, kd = (axis.ravel() for axis in grid)
    asked = columns(actuator, delay, kp, kd)
    one, other = (verdicts(asked, engine, duration) for engine in ("mujoco", "mjx"))
    calm = one == Verdict.STABLE
    apart = np.flatnonzero(calm != (other == Verdict.STABLE))
    far = 0
    if apart.size:
        steps = [(a, b) for a in (1 / NEAR, 1.0, NEAR) for b in (1 / NEAR, 1.0, NEAR)]
        around = columns(
            actuator,
            delay,
            np.concatenate([kp[apart] * a for a, _ in steps]),
            np.concatenate([kd[apart] * b for _, b in steps]),
        )
        near = verdicts(around, "mujoco", duration).reshape(len(steps), -1) == Verdict.STABLE
        far = int(np.sum(near.all(axis=0) | ~near.any(axis=0)))
    return Comparison(
        kp.size, float(calm.mean()), 1.0 - apart.size / kp.size, float((one == other).mean()), far
    )


def main() -> int:
    """Print a table; 1 if the simulators do not agree as they should."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--number", type=int, default=32, help="gains along each axis")
    parser.add_argument("--duration", type=float, default=1.0, help="of the rollouts [s]")
    options = parser.parse_args()
    print("| actuator | delay | gains | stable | agree | same verdict | differ far from boundary |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    fine = True
    for actuator, delay in DRIVES:
        found = compare(actuator, delay, options.number, options.duration)
        print(
            f"| {actuator} | {1e3 * delay:g} ms | {found.loops} | {found.stable:.1%} "
            f"| {found.agree:.2%} | {found.same:.2%} | {found.far} |",
            flush=True,
        )
        fine &= found.fine
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
