"""How far positions in MJX are from those in C MuJoCo, over the whole of a short motion."""

from __future__ import annotations

from dataclasses import dataclass

import cases
import numpy as np

from jaxact.simulation import single
from jaxact.simulation.single import Single

ALLOWED = 1e-4  # [rad or m]


@dataclass(frozen=True)
class Parity:
    """Two engines on one motion.

    description: of the motion
    joints: number of driven ones
    precision: of MJX
    moved: how far the joint that moves most goes [rad or m]
    apart: largest difference of any joint's position at any time [rad or m]
    """

    description: str
    joints: int
    precision: str
    moved: float
    apart: float

    @property
    def fine(self) -> bool:
        """Whether the engines agree as they should, on a motion that says something."""
        return self.apart <= ALLOWED < self.moved


def compare(name: str, precision: str) -> Parity:
    """The worst of the drives.

    name: of a specification
    precision: of MJX; C MuJoCo computes in float64 always
    """
    one, other = (_motions(name, engine, precision) for engine in ("mujoco", "mjx"))
    pairs = [
        (a.trajectory.position, b.trajectory.position) for a, b in zip(one, other, strict=True)
    ]
    return Parity(
        description=str(cases.load(name).description),
        joints=len(one[0].joints),
        precision=precision,
        moved=float(min(np.ptp(a, axis=0).max() for a, _ in pairs)),
        apart=float(max(np.abs(a - b).max() for a, b in pairs)),
    )


def _motions(name: str, engine: str, precision: str) -> list[Single]:
    asked = cases.load(name, f"engine={engine}", f"precision={precision}")
    return single.simulate_all(asked, cases.loops(asked))
