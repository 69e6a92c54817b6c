"""Stability boundaries in the plane of the gains (D-partition).

On the curves of `marginal` some root is marginal. Only parts with no unstable root on one of their
sides are the boundary of the stable region; the rest is where a further pair becomes unstable.
Which is which is decided by counting the roots on both sides.
"""

import math

import numpy as np

from jaxact.analysis.boundary.curves import (
    BoundaryCurve,
    Line,
    Range,
    classify,
    curves_inside,
    spread,
)
from jaxact.analysis.boundary.marginal_gains import (
    Marginal,
    continuous_marginal,
    kd_on_line,
    kp_on_line,
    sampled_marginal,
    window_grid,
)

__all__ = ["BoundaryCurve", "continuous_boundary", "sampled_boundary"]


def continuous_boundary(
    mass: float,
    natural_frequency: float,
    damping_ratio: float,
    delay: float,
    *,
    velocity_filter: float = math.inf,
    joint_damping: float = 0.0,
    joint_stiffness: float = 0.0,
    kp_range: Range,
    kd_range: Range,
) -> list[BoundaryCurve]:
    """All marginal gains of the continuous loop inside a window of the (kp, kd) plane.

    Args:
        mass: m [kg], > 0.
        natural_frequency: wn of the force servo [rad/s], > 0, inf = ideal.
        damping_ratio: zeta [-], > 0, ignored if ideal.
        delay: total delay td [s], >= 0.
        velocity_filter: cutoff of the first-order filter of the velocity [rad/s], > 0, inf = none.
        joint_damping, joint_stiffness: of the joint itself, c [N s/m] and k [N/m].
        kp_range, kd_range: (low, high) of the window [N/m], [N s/m]; an axis with low > 0 is
            sampled evenly in its logarithm, otherwise evenly.

    Raises:
        ValueError: an empty window or values out of their domain.
    """
    _check_window(kp_range, kd_range)
    plant = (mass, natural_frequency, damping_ratio, delay, velocity_filter)
    marginal = continuous_marginal(*plant, (joint_damping, joint_stiffness))
    return _curves(marginal, mass, kp_range, kd_range)


def sampled_boundary(
    mass: float,
    natural_frequency: float,
    damping_ratio: float,
    delay: float,
    control_period: float,
    *,
    velocity: str = "sampled",
    velocity_filter: float = math.inf,
    measurement_delay: float = 0.0,
    output_delay: float = 0.0,
    joint_damping: float = 0.0,
    joint_stiffness: float = 0.0,
    kp_range: Range,
    kd_range: Range,
    integrator: str = "exact",
    substeps: int = 1,
) -> list[BoundaryCurve]:
    """All marginal gains of the sampled loop inside a window of the (kp, kd) plane.

    Args:
        mass, natural_frequency, damping_ratio, joint_damping, joint_stiffness, kp_range, kd_range:
            as in `continuous_boundary`.
        delay, measurement_delay, output_delay: [s], >= 0; only their sum matters.
        control_period: T [s], > 0.
        velocity: "sampled", or "differenced" for positions differenced through a first-order
            filter.
        velocity_filter: its cutoff [rad/s], > 0, inf = none.
        integrator: "exact", or "euler" for MuJoCo's semi-implicit Euler with `substeps` a period.

    Raises:
        ValueError: an empty window or values out of their domain.
    """
    _check_window(kp_range, kd_range)
    total = delay + measurement_delay + output_delay
    kinds = {"velocity": velocity, "integrator": integrator, "substeps": substeps}
    plant = (mass, natural_frequency, damping_ratio, total, control_period, velocity_filter)
    marginal = sampled_marginal(*plant, kinds, (joint_damping, joint_stiffness))
    return _curves(marginal, mass, kp_range, kd_range)


def _check_window(kp_range: Range, kd_range: Range) -> None:
    for name, (low, high) in (("kp_range", kp_range), ("kd_range", kd_range)):
        if not -math.inf < low < high < math.inf:
            raise ValueError(f"{name} must be (low, high) with low < high, both finite")


def _curves(
    marginal: Marginal, mass: float, kp_range: Range, kd_range: Range
) -> list[BoundaryCurve]:
    grid = window_grid(marginal, mass, kp_range, kd_range)
    curves = curves_inside(marginal.gains, grid, kp_range, kd_range) if len(grid) else []
    lines = _line_at_rest(marginal.at_rest, kp_range, kd_range)
    if math.isfinite(marginal.nyquist):
        lines += _alternating_line(marginal, kp_range, kd_range)
    return classify(curves, marginal.gains, lines, marginal.count, kp_range, kd_range)


def _line_at_rest(at_rest: float, kp_range: Range, kd_range: Range) -> list[Line]:
    """The line kp = -k (a root at the origin), if the window contains it."""
    if not kp_range[0] <= at_rest <= kp_range[1]:
        return []
    kd = spread(kd_range)
    return [(np.full_like(kd, at_rest), kd, 0.0)]


def _alternating_line(marginal: Marginal, kp_range: Range, kd_range: Range) -> list[Line]:
    """The line 1 + kp Gp(-1) + kd Gv(-1) = 0 of a root at z = -1, inside the window."""
    kp, kd = spread(kp_range), spread(kd_range)
    kp_there = np.array([kp_on_line(marginal, value) for value in kd])
    kd_there = np.array([kd_on_line(marginal, value) for value in kp])
    kp, kd = np.concatenate([kp, kp_there]), np.concatenate([kd_there, kd])
    keep = (kp >= kp_range[0]) & (kp <= kp_range[1]) & (kd >= kd_range[0]) & (kd <= kd_range[1])
    kp, kd = kp[keep], kd[keep]
    if len(kp) < 2:
        return []
    # Along the line, whichever way it leans.
    rising = kd_on_line(marginal, kp_range[1]) > kd_on_line(marginal, kp_range[0])
    order = np.lexsort((kd if rising else -kd, kp))
    return [(kp[order], kd[order], marginal.nyquist)]
