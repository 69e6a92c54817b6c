"""The actuators that gains are tuned for: one, or many that all must get along with the same gains.

A member is a mass behind a force servo with a delay. Where a control rate is given its loop is the
sampled one, margins and all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from jaxact.errors import UserError
from jaxact.parameters import DELAY, MASS, OF_JOINT, canonical
from jaxact.tuning.box import Box, Points, Range

PARAMETERS = (MASS, "natural_frequency", "damping_ratio", DELAY)
PLANT = (*PARAMETERS, *OF_JOINT)
"""Every field of a plant; the last two are 0 of a bare mass."""
FIELDS = {canonical(name): name for name in PLANT}
"""Fields of an ensemble by the short names of the parameters; each may be uncertain."""

# The noise of an encoder that is read at this rate where no control rate is given [s].
DEFAULT_PERIOD = 1e-3


@dataclass(frozen=True)
class Sampling:
    """How the controller samples; static, the same for all members.

    Attributes:
        control_period: T [s]; None for the loop in continuous time.
        velocity: "sampled" or "differenced"; the same in continuous time.
        velocity_filter: cutoff of the first-order filter of the differenced velocity, in continuous
            time of the velocity [rad/s], inf = none.
    """

    control_period: float | None = None
    velocity: str = "sampled"
    velocity_filter: float = math.inf


@dataclass(frozen=True)
class Ensemble:
    """Plants and actuators, n of them; float64 NumPy arrays of shape (n,).

    Attributes:
        mass: m [kg], > 0.
        natural_frequency: wn of the force servo [rad/s], > 0, inf = ideal.
        damping_ratio: zeta [-], > 0.
        delay: sum of command, measurement and output delay [s], >= 0.
        joint_damping: c of the joint itself [N s/m], >= 0.
        joint_stiffness: k of the joint itself [N/m].
        sampling: of the controller, or that there is none.
        names: what each is called in reports, numbered by default.
        measurement_delay, output_delay: what of the delay is before the controller, and behind the
            actuator [s], the same for all members. Margins do without; what a range of `delay`
            holds, and when a setpoint is met, do not.
    """

    mass: np.ndarray
    natural_frequency: np.ndarray
    damping_ratio: np.ndarray
    delay: np.ndarray
    joint_damping: np.ndarray
    joint_stiffness: np.ndarray
    sampling: Sampling = Sampling()
    names: tuple[str, ...] = field(default=())
    measurement_delay: float = 0.0
    output_delay: float = 0.0

    def __len__(self) -> int:
        """Number of members."""
        return len(self.mass)

    def base(self, name: str) -> float:
        """What a value of a field has beside the parameter of that short name."""
        return self.measurement_delay + self.output_delay if name == DELAY else 0.0

    @property
    def lag(self) -> np.ndarray:
        """What delays the damping [s], shape (n,): delay + 2 zeta / wn + T / 2 + 1 / cutoff."""
        own = 0.5 * (self.sampling.control_period or 0.0) + 1.0 / self.sampling.velocity_filter
        return self.delay + 2.0 * self.damping_ratio / self.natural_frequency + own

    def name(self, index: int) -> str:
        """What a member is called."""
        return self.names[index] if self.names else f"member {index}"


def ensemble(
    mass: object,
    natural_frequency: object,
    damping_ratio: object,
    delay: object,
    joint_damping: object = 0.0,
    joint_stiffness: object = 0.0,
    *,
    sampling: Sampling = Sampling(),
    names: tuple[str, ...] = (),
    measurement_delay: float = 0.0,
    output_delay: float = 0.0,
) -> Ensemble:
    """A checked ensemble from numbers or arrays that broadcast to one dimension.

    Arguments as the fields of `Ensemble`.

    Raises:
        UserError: values out of their domain.
    """
    given = (mass, natural_frequency, damping_ratio, delay, joint_damping, joint_stiffness)
    arrays = np.broadcast_arrays(*(np.atleast_1d(np.asarray(a, dtype=float)) for a in given))
    if arrays[0].ndim != 1:
        raise UserError("the members of an ensemble lie along one dimension")
    m, wn, zeta, td, c, k = (np.ascontiguousarray(a) for a in arrays)
    fine = (m > 0) & np.isfinite(m) & (wn > 0) & (zeta > 0) & np.isfinite(zeta)
    fine &= (td >= 0) & np.isfinite(td) & (c >= 0) & np.isfinite(c) & np.isfinite(k)
    if not fine.all():
        index = int(np.flatnonzero(~fine)[0])
        raise UserError(
            f"member {index}: mass {m[index]:g} kg, wn {wn[index]:g} rad/s, zeta {zeta[index]:g}, "
            f"delay {td[index]:g} s, damping {c[index]:g} N s/m; mass, wn and zeta must be "
            "positive, delay and damping not negative"
        )
    if names and len(names) != len(m):
        raise UserError(f"{len(names)} names for {len(m)} members; give one for each")
    return Ensemble(m, wn, zeta, td, c, k, sampling, names, measurement_delay, output_delay)


def joined(first: Ensemble, second: Ensemble) -> Ensemble:
    """The members of both; all that is one for all is that of the first."""
    names = tuple(e.name(i) for e in (first, second) for i in range(len(e)))
    rows = {p: np.concatenate([getattr(first, p), getattr(second, p)]) for p in PLANT}
    return replace(first, **rows, names=names)


def chosen(members: Ensemble, index: np.ndarray) -> Ensemble:
    """Some of the members, by their numbers."""
    names = tuple(members.name(int(i)) for i in index)
    rows = {p: getattr(members, p)[index] for p in PLANT}
    return replace(members, **rows, names=names)


@dataclass(frozen=True)
class Uncertain:
    """Plants at points of a box around a nominal one.

    Attributes:
        nominal: an ensemble of one.
        box: what is uncertain; every range has a width.
        low, high: values of the parameters at its ends, shape (ranges,).
    """

    nominal: Ensemble
    box: Box
    low: np.ndarray
    high: np.ndarray

    @property
    def columns(self) -> list[int]:
        """Which field of PLANT each range is of."""
        return [PLANT.index(FIELDS[one.name]) for one in self.box.ranges]

    def at(self, points: Points) -> Ensemble:
        """The plants at some points."""
        values = {p: np.full(len(points), getattr(self.nominal, p)[0]) for p in PLANT}
        spans = self.low + (self.high - self.low) * points.fraction
        for one, column in zip(self.box.ranges, spans.T, strict=True):
            values[FIELDS[one.name]] = column + self.nominal.base(one.name)
        return replace(self.nominal, **values, names=points.names)


def uncertain(nominal: Ensemble, box: Box) -> Uncertain:
    """A plant of which not everything is known.

    Args:
        nominal: an ensemble of one; it takes the values of ranges that have no width.
        box: of names of FIELDS.

    Raises:
        UserError: ranges that do not fit the plant.
    """

    def ends(one: Range) -> tuple[float, float]:
        own = float(getattr(nominal, FIELDS[one.name])[0]) - nominal.base(one.name)
        return one.ends({one.name: own})[one.name]

    values = {
        FIELDS[one.name]: np.array([ends(one)[0] + nominal.base(one.name)])
        for one in box.known.ranges
    }
    low, high = np.array([ends(one) for one in box.uncertain.ranges]).reshape(-1, 2).T
    return Uncertain(replace(nominal, **values), box.uncertain, low, high)
