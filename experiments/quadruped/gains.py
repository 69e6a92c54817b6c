"""The nominal gains, from the bare robot alone: well damped, and no actuator was looked at.

    kp     1.5 times the stiffness of all joints below which the robot topples, in its worst posture
    kd_j = J_j b,   b = 2 zeta sqrt(kp / J_min)

A robot on its feet is an inverted pendulum; kp leaves it a third of the stiffness in reserve. J_j
is the least inertia that a joint of its kind (HAA, HFE, KFE) moves in any posture, all else free to
give way. All joints get the same ratio b = kd/J, the bandwidth of their velocity loop, so that none
is nearer to shaking than the others; it is as large as the lightest joint, the knee of a leg in the
air, is damped with zeta = 0.7. More than that it needs no damping, and the loaded joints, which
could do with more, get what the sampling of a light one allows.

    python experiments/quadruped/gains.py      prints them as the specifications give them
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import cases
import critical
import numpy as np

from jaxact.loops import robots
from jaxact.loops.specification import Specification
from jaxact.robots import inertia

RESERVE = 1.5
DAMPING = 0.7
KINDS = ("HAA", "HFE", "KFE")
# Gains that are scaled to find where the robot topples; only the stiffness matters for that.
_TRIAL_KP, _TRIAL_KD = 1000.0, 12.0  # [N m/rad], [N m s/rad]


@dataclass(frozen=True)
class Nominal:
    """Gains, and what they follow from.

    kp: of all joints [N m/rad]
    kd: of each kind of joint [N m s/rad]
    toppling: stiffness below which the robot topples in each situation [N m/rad], 0 for none
    inertia: least that each kind of joint moves [kg m^2]
    """

    kp: float
    kd: dict[str, float]
    toppling: dict[str, float]
    inertia: dict[str, float]

    @property
    def bandwidth(self) -> float:
        """kd / J, the same for all joints [rad/s]."""
        return self.kd["KFE"] / self.inertia["KFE"]


def nominal(
    situations: Mapping[str, Specification], *, points: int = 16, rounds: int = 3
) -> Nominal:
    """The gains by the rule.

    situations: specifications of the robot's situations by name
    points, rounds: of the search for where it topples, `critical.edge`
    """
    toppling = {
        name: toppling_stiffness(one, points=points, rounds=rounds)
        for name, one in situations.items()
    }
    least = dict(zip(KINDS, _inertias(situations), strict=True))
    kp = RESERVE * max(toppling.values())
    bandwidth = 2.0 * DAMPING * math.sqrt(kp / min(least.values()))
    return Nominal(kp, {kind: bandwidth * own for kind, own in least.items()}, toppling, least)


def toppling_stiffness(specification: Specification, *, points: int = 16, rounds: int = 3) -> float:
    """Stiffness of all joints below which the bare robot topples [N m/rad]; 0 if it never does."""
    trial = {
        name: _TRIAL_KP if name == "kp" else _TRIAL_KD if name.startswith("kd@") else value
        for name, value in specification.parameters.items()
    }
    bare = cases.smooth(replace(specification, parameters=trial))

    def stable(columns):
        return critical.growth_rates(bare, columns) < 0.0

    # All drives are asked, so that the kernel is the one that everything else uses.
    drives = cases.drives(bare=False).columns()
    edges = critical.edge(stable, drives, 0.05, 1.0, points=points, rounds=rounds)
    return _TRIAL_KP * float(edges[0])


def _inertias(situations: Mapping[str, Specification]) -> np.ndarray:
    """Least inertia of each kind of joint [kg m^2], shape (kinds,)."""
    rows = []
    for one in situations.values():
        robot = robots.scene(one.plant).robot
        free, _ = inertia.inertias(robot)
        kinds = [joint.name.partition("_")[2] for joint in robot.joints]
        rows.append([min(j for j, own in zip(free, kinds, strict=True) if own == k) for k in KINDS])
    return np.min(rows, axis=0)


def differs(specification: Specification, rule: Nominal, share: float = 0.01) -> bool:
    """Whether a specification gives other gains than the rule."""
    given = specification.parameters
    pairs = [(given["kp"], rule.kp)]
    pairs += [(given[f"kd@.*_{kind}"], value) for kind, value in rule.kd.items()]
    return any(abs(float(own) - value) > share * value for own, value in pairs)


def main() -> None:
    """Print the gains as the specifications give them."""
    found = nominal({name: cases.load(name) for name in cases.SITUATIONS})
    print(f"kp = {found.kp:.3g}")
    for kind, value in found.kd.items():
        print(f'"kd@.*_{kind}" = {value:.3g}')


if __name__ == "__main__":
    main()
