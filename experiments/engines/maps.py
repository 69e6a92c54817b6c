"""Verdicts of maps of gains in MJX and C MuJoCo, and whether they differ at the boundary only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cases
import numpy as np

from jaxact.loops.samples import Samples, expand
from jaxact.loops.specification import Specification
from jaxact.simulation import execute
from jaxact.status import Verdict

NEAR = 1.05  # factor on a gain that is near the boundary
STEPS = 5  # of each gain, from one end of what is near to the other
SHARE = 0.95  # of the verdicts that must agree


@dataclass(frozen=True)
class Comparison:
    """How two engines see a map of gains.

    description: of the robot
    drive: actuator, and delay of its command [s]
    loops: number of gains
    stable: share of them that C MuJoCo calls stable
    agree: share of verdicts (stable or not) that agree
    same: share of verdicts that are the same in every word
    far: loops that disagree and are not near the boundary
    """

    description: str
    drive: tuple[str, float]
    loops: int
    stable: float
    agree: float
    same: float
    far: int

    @property
    def fine(self) -> bool:
        """Whether they agree as they should."""
        return self.agree >= SHARE and self.far == 0


def compare(name: str, number: int | None = None) -> list[Comparison]:
    """Both engines on the map of a specification with every drive, MJX in float32.

    name: of a specification
    number: of gains along each axis, if not the specification's
    """
    fewer = () if number is None else (f"axes.kp.num={number}", f"axes.kd.num={number}")
    asked = cases.load(name, *fewer)
    gains = expand(asked).values
    loops = cases.loops(asked, kp=gains["kp"], kd=gains["kd"])
    every = [_verdicts(asked, loops, engine) for engine in ("mujoco", "mjx")]
    one, other = (found.reshape(len(cases.DRIVES), -1) for found in every)
    differ = (one == Verdict.STABLE) != (other == Verdict.STABLE)
    far = _far(asked, gains["kp"], gains["kd"], differ)
    return [
        Comparison(
            description=str(asked.description),
            drive=drive,
            loops=one.shape[1],
            stable=float((one[row] == Verdict.STABLE).mean()),
            agree=float(1.0 - differ[row].mean()),
            same=float((one[row] == other[row]).mean()),
            far=int(far[row].sum()),
        )
        for row, drive in enumerate(cases.DRIVES)
    ]


def _verdicts(specification: Specification, loops: Samples, engine: str) -> np.ndarray:
    return execute.run(replace(specification, engine=engine, axes=()), loops)["verdict"]


def _far(
    specification: Specification, kp: np.ndarray, kd: np.ndarray, differ: np.ndarray
) -> np.ndarray:
    """Of which loops C MuJoCo gives one verdict to all neighbours, a little up and down in gain.

    kp, kd: shape (gains,)
    differ: loops that are looked at, shape (drives, gains), as the result
    """
    looked = np.flatnonzero(differ.any(axis=0))
    if not looked.size:
        return differ
    factors = np.geomspace(1 / NEAR, NEAR, STEPS)
    steps = [(a, b) for a in factors for b in factors]
    around = cases.loops(
        specification,
        kp=np.concatenate([kp[looked] * a for a, _ in steps]),
        kd=np.concatenate([kd[looked] * b for _, b in steps]),
    )
    calm = _verdicts(specification, around, "mujoco") == Verdict.STABLE
    calm = calm.reshape(len(cases.DRIVES), len(steps), -1)
    far = np.zeros_like(differ)
    far[:, looked] = calm.all(axis=1) | ~calm.any(axis=1)
    return far & differ
