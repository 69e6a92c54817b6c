"""The parameters of the drive, and what they may be."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

Number = float | tuple[float, float]
"""A number, or a range (low, high), from which every environment draws uniformly at its reset."""


@dataclass(kw_only=True)
class DriveParameters:
    """A drive behind the PD gains of an actuator; what is not given is not there.

    Attributes:
        wn, zeta: natural frequency [rad/s] and damping ratio of the force loop; inf: ideal.
        delay, output_delay: of the command, and of the force [s].
        measurement_delay, setpoint_delay: of the sensed state, and of the setpoint [s].
        force_limit: [N or N m]; the actuator's own limit counts as well.
        lowest_force, highest_force: range that holds too, of a limit that differs by direction.
        force_rate_limit: [N/s or N m/s].
        stall_force, no_load_speed: of the force-speed line [N or N m, m/s or rad/s].
        lowest_setpoint, highest_setpoint: positions that are accepted as setpoints, which are
            clamped to them [rad or m].
        gain_scale: factor on both gains.
        feedforward: constant force [N or N m].
        position_resolution, velocity_resolution, command_resolution: one count; 0: none.
        position_noise, velocity_noise: standard deviation of each sample.
        position_bias, velocity_bias: constant errors.
        position_bias_walk, velocity_bias_walk: standard deviation of the bias after 1 s.
        velocity_filter: cutoff of the differenced velocity [rad/s]; inf: none.
        control_rate: [Hz].
        velocity: that the controller sees, "sampled" or "differenced" positions.
        each_joint: every joint draws from ranges for itself; else all joints share a number, those
            of other groups with the same `seed`, too.
        seed: of what is drawn from ranges.
    """

    wn: Number = math.inf
    zeta: Number = 1.0
    delay: Number = 0.0
    output_delay: Number = 0.0
    measurement_delay: Number = 0.0
    setpoint_delay: Number = 0.0
    force_limit: Number = math.inf
    lowest_force: Number = -math.inf
    highest_force: Number = math.inf
    force_rate_limit: Number = math.inf
    stall_force: Number = math.inf
    no_load_speed: Number = math.inf
    lowest_setpoint: Number = -math.inf
    highest_setpoint: Number = math.inf
    gain_scale: Number = 1.0
    feedforward: Number = 0.0
    position_resolution: Number = 0.0
    velocity_resolution: Number = 0.0
    command_resolution: Number = 0.0
    position_noise: Number = 0.0
    velocity_noise: Number = 0.0
    position_bias: Number = 0.0
    velocity_bias: Number = 0.0
    position_bias_walk: Number = 0.0
    velocity_bias_walk: Number = 0.0
    velocity_filter: Number = math.inf
    control_rate: float = 1000.0
    velocity: str = "sampled"
    each_joint: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        self.check()

    def ends(self) -> dict[str, tuple[float, float]]:
        """Both ends of the range of every number, by name."""
        kept = {one.name: getattr(self, one.name) for one in fields(self)[:-4]}
        return {n: (v, v) if isinstance(v, int | float) else tuple(v) for n, v in kept.items()}

    def check(self) -> None:
        """Raise ValueError for the first parameter that is not what it may be."""
        numbers = {one.name: getattr(self, one.name) for one in fields(self)[:-3]}
        for name, value in numbers.items():
            _check_number(name, value)
        for side in ("setpoint", "force"):
            names = f"lowest_{side}", f"highest_{side}"
            low, high = (self.ends()[name] for name in names)
            if low[1] > high[0]:
                raise ValueError(f"{names[0]} = {low[1]:g} is above {names[1]} = {high[0]:g}")
        names = "stall_force", "no_load_speed"
        if len({math.isinf(self.ends()[name][1]) for name in names}) > 1:
            raise ValueError(f"a force-speed line needs both {' and '.join(names)}")
        if self.velocity not in VELOCITIES:
            raise ValueError(f"velocity = {self.velocity!r}; allowed: {', '.join(VELOCITIES)}")
        if not isinstance(self.each_joint, bool):
            raise ValueError(f"each_joint = {self.each_joint!r}; allowed: True, False")


VELOCITIES = ("sampled", "differenced")
LONGEST_DELAY = 10.0  # [s]
# What may be of either sign; everything else is at least 0, and above it if it is among the next.
SIGNED = (
    "feedforward", "position_bias", "velocity_bias", "lowest_force", "highest_force",
    "lowest_setpoint", "highest_setpoint",
)  # fmt: skip
POSITIVE = (
    "wn", "zeta", "force_limit", "force_rate_limit", "stall_force", "no_load_speed",
    "velocity_filter", "control_rate",
)  # fmt: skip


def _check_number(name: str, value: Any) -> None:
    """Raise ValueError for what is neither a number that a parameter may be nor a range of such."""
    ranged = isinstance(value, tuple | list)
    ends = tuple(value) if ranged else (value,)
    plain = all(isinstance(end, int | float) and not isinstance(end, bool) for end in ends)
    if not plain or any(math.isnan(end) for end in ends) or len(ends) != 1 + ranged:
        raise ValueError(f"{name} = {value!r}; give a number, or a range (low, high)")
    if ranged and name == "control_rate":
        raise ValueError(f"{name} = {value!r} cannot have a range; give a number")
    if ends[0] > ends[-1]:
        raise ValueError(f"{name} = {value!r} ends below where it begins; give (low, high)")
    least = -math.inf if name in SIGNED else 0.0
    if ends[0] < least or (name in POSITIVE and ends[0] == 0.0):
        above = "above 0" if name in POSITIVE else "at least 0"
        raise ValueError(f"{name} = {value!r} is out of range; give {above}")
    default = {one.name: one.default for one in fields(DriveParameters)}[name]
    if any(map(math.isinf, ends)) and (ends[0] != ends[-1] or ends[0] != default):
        raise ValueError(f"{name} = {value!r} is infinite; give a finite number or range")
    if name.endswith("delay") and ends[-1] > LONGEST_DELAY:
        raise ValueError(f"{name} = {value!r} is out of range; give at most {LONGEST_DELAY:g} [s]")
