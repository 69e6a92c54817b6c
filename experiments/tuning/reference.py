"""Gains as textbooks and rules of thumb give them: what tuned gains are held against.

All see the actuator as its lag at low frequency, theta = delay + 2 zeta / wn.
"""

from __future__ import annotations

import numpy as np

from jaxact.tuning.joint import problem as joint
from jaxact.tuning.joint.ensemble import Ensemble
from jaxact.tuning.joint.problem import Case
from jaxact.tuning.polish import MET

Gains = tuple[float, float, int]
"""kp [N/m], kd [N s/m], and the loops that had to be evaluated."""


def simc(members: Ensemble, closed_loop: float = 1.0) -> Gains:
    """PD with critical damping by the SIMC rule for a double integrator.

    closed_loop: tc / theta [-]; 1 is the rule's own choice

    kp = m / (4 (tc + theta)^2), kd = m / (tc + theta) (Skogestad, Journal of Process Control 13,
    2003). For an ensemble the slowest and the lightest member.
    """
    time = (1.0 + closed_loop) * float(members.lag.max())
    mass = float(members.mass.min())
    return mass / (4.0 * time**2), mass / time, 0


def damping_rule(case: Case, damping_ratio: float = 0.7) -> Gains:
    """kd = 2 zeta sqrt(kp m), and the stiffest kp with which the constraints hold.

    damping_ratio: of the rigid joint [-]
    """
    mass = float(case.members.mass.min())
    lag = float(joint.time_scale(case).max())

    def damping(kp: float) -> float:
        return 2.0 * damping_ratio * float(np.sqrt(kp * mass))

    low, high = 1e-5 * mass / lag**2, mass / lag**2
    problem, number = joint.problem([case]), 0
    for _ in range(40):
        middle = float(np.sqrt(low * high))
        rows = problem(np.log([[middle, damping(middle)]]))
        met = rows.usable[0] and rows.violation[0] <= MET
        low, high = (middle, high) if met else (low, middle)
        number += len(case.members)
    return low, damping(low), number


def phase_margin(members: Ensemble, degrees: float = 60.0) -> Gains:
    """The stiffest PD whose phase margin is as asked; one plant, in continuous time.

    degrees: phase margin [deg]

    At the crossover w the controller must lead by phi = margin + arg D(jw) + w delay, so that
    kp = m w^2 |D| cos(phi) and kd w = kp tan(phi); kp is largest somewhere along w.
    """
    m, wn, zeta, td = (float(getattr(members, name)[0]) for name in
                       ("mass", "natural_frequency", "damping_ratio", "delay"))  # fmt: skip
    w = np.geomspace(1e-4, 3.0, 20_001) / float(members.lag[0])
    servo = 1.0 - (w / wn) ** 2 + 2j * zeta * w / wn
    lead = np.radians(degrees) + np.angle(servo) + w * td
    size = m * w**2 * np.abs(servo)
    kp = np.where(lead < 0.5 * np.pi, size * np.cos(lead), -np.inf)
    best = int(np.argmax(kp))
    return float(kp[best]), float(size[best] * np.sin(lead[best]) / w[best]), len(w)
