"""Metrics from simulated time: settling and tracking, smooth for the descent and exact for the end.

With a control rate the loop that is simulated is that of every sweep, drive and all, under the
exact mass. Without one it is that in continuous time (`jaxact.tuning.joint.march`), which also
stands in for a loop of so many control periods that a search could not afford them: the hold delays
what is fed back by half a period.

How long is simulated follows from the loop. What has not come to rest by then has no settling time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.compilation.programs import Program
from jaxact.drive import step as _drive
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.options import DriveOptions
from jaxact.drive.sensor import Sensor
from jaxact.drive.step import Drive
from jaxact.errors import UserError
from jaxact.loops.loop import Loop
from jaxact.plants.linear import hermite
from jaxact.plants.mass import Mass
from jaxact.simulation import trajectory
from jaxact.tuning.goal import Goal
from jaxact.tuning.joint import march
from jaxact.tuning.joint.ensemble import PLANT, Ensemble, Sampling
from jaxact.tuning.objective import softmax

TIMED = ("settling_time", "tracking_error")
"""Metrics that are simulated."""

# Half-width of the band that counts as settled, relative to the step.
BAND = 0.02
# While gains are searched for it is narrower by this: an overshoot that just stays within it does
# so in finer steps, too.
_CAREFUL = 0.998
# A sampled step response is looked at so many times in a control period: between its ticks it may
# leave the band.
_BETWEEN = 4
_ENDS = slice(None, -1), slice(1, None)
# Simulated time in lags of the slowest member; the best gains settle in about a tenth of it.
_LAGS = 120.0
# A lag of a loop that is slow because it must be soft [sqrt(m / kp)].
_SOFT = 0.35
# Steps in a lag, and the most of them, while descending, and for all that is computed exactly.
_ROUGH, _FINE = (12.0, 4000), (40.0, 40_000)
# The fewest steps in a lag with which a whole file is tracked.
_FEWEST = 3.0
# Control periods that are simulated one by one: at least, in a search, and with gains found.
_LEAST_TICKS, _MOST_TICKS, _MOST_PERIODS = 200, 4000, 200_000
# The last part of a simulation, in which a loop must be at rest.
_LAST = 0.1
# A smooth last time needs several samples within its width.
_SHARPEST = 100.0


@dataclass(frozen=True)
class Timed:
    """What is simulated for a metric; static and hashable.

    Attributes:
        metric: "settling_time" [s] or "tracking_error", rms [m].
        ticks: control periods, or steps in continuous time.
        period: of either [s].
        reference: setpoints at the ticks [m], shape (ticks,); a step to 1 where empty.
        options: of the drive; None in continuous time.
        sampling: of the controller, for the velocity it sees.
        longest: delay of all members [s].
        measured_late: what of the delays is before the controller [s]: a setpoint does without it.
        sprung: whether joints have damping or stiffness of their own.
        band: half-width of the band that counts as settled, relative to the step.
    """

    metric: str
    ticks: int
    period: float
    reference: tuple[float, ...]
    options: DriveOptions | None
    sampling: Sampling
    longest: float
    measured_late: float = 0.0
    sprung: bool = False
    band: float = BAND

    def of_loops(self, kp: jax.Array, kd: jax.Array, plant: jax.Array) -> jax.Array:
        """The metric of a flat batch of loops, shape (n,); plant: shape (4 or 6, n)."""
        errors = jax.vmap(self.errors, (0, 0, 1))(kp, kd, plant)
        return jax.vmap(self._metric)(errors, plant[3])

    def smooth(
        self, kp: jax.Array, kd: jax.Array, plant: jax.Array, sharpness: jax.Array
    ) -> jax.Array:
        """ln of the metric of one loop, smooth; plant: shape (4,) or (6,).

        Of a loop that does not settle it grows with what is left at the end, so that gains with
        which it does are found.
        """
        error = self.errors(kp, kd, plant)
        if self.metric == "tracking_error":
            return jnp.log(self._metric(error, plant[3]))
        level = jnp.minimum(sharpness, _SHARPEST)
        time = self.times(plant[3]) + self.spacing
        beyond = jnp.log(jnp.abs(error) / self.band + 1e-9)
        outside = jax.nn.log_sigmoid(level * beyond)
        settled = jax.scipy.special.logsumexp(level * (jnp.log(time) + outside)) / level
        left = softmax(beyond[-max(1, int(_LAST * len(error))) :], level)
        return settled + jax.nn.softplus(level * left) / level

    @property
    def _closely(self) -> int:
        """How many errors there are in a period."""
        return 1 if self.options is None or self.reference else _BETWEEN

    @property
    def spacing(self) -> float:
        """Time between errors [s]."""
        return self.period / self._closely

    def times(self, delay: jax.Array) -> jax.Array:
        """When the errors of a loop are [s], shape (points,): a step is met after the delay."""
        met = delay - self.measured_late
        begun = met if self.options is None and not self.reference else 0.0 * delay
        points = self._closely * (self.ticks - 1) + 1
        return begun + self.spacing * jnp.arange(points, dtype=delay.dtype)

    def errors(self, kp: jax.Array, kd: jax.Array, plant: jax.Array) -> jax.Array:
        """Position less setpoint at `times` [m], shape (points,)."""
        given = jnp.asarray(self.reference or (1.0,) * self.ticks, kp.dtype)
        if self.options is None:
            return self._continuous(kp, kd, plant, given)
        mass, wn, zeta, delay, *joint = plant
        own = Mass(mass, *joint) if self.sprung else Mass(mass)
        late = jnp.maximum(delay - self.measured_late, 0.0)
        actuator = Actuator(natural_frequency=wn, damping_ratio=zeta, delay=late)
        sensor = Sensor(delay=self.measured_late, velocity_filter=self.sampling.velocity_filter)
        drive = Drive(Controller(kp=kp, kd=kd), actuator, sensor, control_period=self.period)
        still = jnp.zeros_like(given)
        path = trajectory.of_loop(
            Loop(plant=own, drive=drive), self.options, self.ticks, Setpoint(given[0]),
            setpoints=Setpoint(given, still, still),
            position=given[0] if self.reference else 0.0,
        )  # fmt: skip
        if self.reference:
            return path.position - given
        ticks = path.position, path.velocity
        before, after = (tuple(leaf[part] for leaf in ticks) for part in _ENDS)
        shares = [place / self._closely for place in range(self._closely)]
        between = [hermite(before, after, share * self.period, self.period)[0] for share in shares]
        return jnp.append(jnp.stack(between, axis=1).ravel(), path.position[-1]) - 1.0

    def _continuous(
        self, kp: jax.Array, kd: jax.Array, plant: jax.Array, given: jax.Array
    ) -> jax.Array:
        hold = 0.5 * (self.sampling.control_period or 0.0)
        cutoff = self.sampling.velocity_filter
        if hold and self.sampling.velocity == "differenced":
            # A difference is the velocity of half a period ago.
            cutoff = 1.0 / (1.0 / cutoff + hold)
        elif hold:
            cutoff = math.inf
        plant = plant if self.sprung else plant[:4]
        common = {"step": self.period, "longest": self.longest + hold, "cutoff": cutoff}
        if not self.reference:
            return march.step_positions(kp, kd, plant, self.ticks, plant[3] + hold, **common) - 1.0
        time = self.times(plant[3])
        late = plant[3] - self.measured_late + hold
        arriving = jnp.interp(time - late, time, given)
        return march.positions(kp, kd, plant, arriving, plant[3] + hold, **common) - given

    def _metric(self, error: jax.Array, delay: jax.Array) -> jax.Array:
        if self.metric == "tracking_error":
            return jnp.sqrt(jnp.mean(error * error))
        size, time = jnp.abs(error), self.times(delay)
        outside = size > self.band
        last = len(size) - 1 - jnp.argmax(outside[::-1])
        after = jnp.minimum(last + 1, len(size) - 1)
        fall = jnp.maximum(size[last] - size[after], jnp.finfo(size.dtype).tiny)
        part = jnp.clip((size[last] - self.band) / fall, 0.0, 1.0)
        # Not at rest well before the end: no time is known.
        rests = last < (1.0 - _LAST) * len(size)
        return jnp.where(rests, time[last] + self.spacing * part, jnp.nan)


def timed(goal: Goal, ensembles: Sequence[Ensemble], *, use: str = "report") -> Timed | None:
    """What a goal needs to be simulated, None for one that needs nothing.

    Args:
        ensembles: of all cases.
        use: "descent", "polish", or "report", from the roughest to the most exact.

    Raises:
        UserError: more than can be simulated.
    """
    if goal.metric not in TIMED:
        return None
    if len({own.measurement_delay for own in ensembles}) > 1:
        raise ValueError("cases that are simulated together have one measurement delay")
    sampling, settling = ensembles[0].sampling, goal.metric == "settling_time"
    lag = max(float(_lags(goal, members).max()) for members in ensembles)
    period = sampling.control_period
    if settling:
        # The lightest member limits the damping of the heaviest.
        end = _LAGS * lag * max(float(own.mass.max() / own.mass.min()) for own in ensembles)
        end = max(end, _LEAST_TICKS * (period or 0.0))
    else:
        end = (len(goal.reference) - 1) * goal.reference_period
    longest = max(float(members.delay.max()) for members in ensembles)
    most = _MOST_PERIODS if use == "report" else _MOST_TICKS
    options = None
    if period is not None and end / period > _MOST_PERIODS:
        raise UserError(
            f"{goal.objective}: {end:.4g} s have to be simulated, {end / period:.3g} control "
            f"periods, and {_MOST_PERIODS:,} can be; give a lower control rate, or none"
        )
    if period is not None and end / period <= most:
        options = _options(ensembles[0], longest)
    else:
        period = _step(goal, end, lag, *(_ROUGH if use == "descent" else _FINE))
    ticks = max(2, math.floor(end / period + 1e-9))
    setpoints: tuple[float, ...] = ()
    if not settling:
        given = np.arange(len(goal.reference)) * goal.reference_period
        setpoints = tuple(map(float, np.interp(np.arange(ticks) * period, given, goal.reference)))
    sprung = any(own.joint_damping.any() or own.joint_stiffness.any() for own in ensembles)
    band = BAND if use == "report" else _CAREFUL * BAND
    late = ensembles[0].measurement_delay
    return Timed(
        goal.metric, ticks, period, setpoints, options, sampling, longest, late, sprung, band
    )


def _options(members: Ensemble, longest: float) -> DriveOptions:
    """The static side of drives that are sampled like these, with delays of up to so much [s]."""
    period, late = members.sampling.control_period, members.measurement_delay
    actuator, sensor = Actuator(delay=max(longest - late, 0.0)), Sensor(delay=late)
    drive = Drive(Controller(1.0, 1.0), actuator, sensor, control_period=period or 0.0)
    return _drive.options(drive, differenced=members.sampling.velocity == "differenced")


def _lags(goal: Goal, members: Ensemble) -> np.ndarray:
    """The lags that say how long a joint takes [s], shape (n,): the drive's, or of a softer one."""
    # A servo with little damping lags little, and rings for long.
    rings = np.maximum(1.0 - 2.0 * members.damping_ratio, 0.0) / members.natural_frequency
    soft = _SOFT * np.sqrt(members.mass / goal.max_kp)
    return np.maximum(members.lag + rings + goal.min_delay_margin, soft)


def _step(goal: Goal, end: float, lag: float, in_lag: float, most: int) -> float:
    """How long a step in continuous time is [s]."""
    if goal.metric == "settling_time":
        return max(lag / in_lag, end / most)
    coarse = max(lag, goal.reference_period) / _FEWEST
    if end / coarse > _FINE[1]:
        raise UserError(
            f"{goal.objective}: {end:.4g} s of setpoints are {end / lag:,.0f} lags of the loop, "
            f"and {_FINE[1] / _FEWEST:,.0f} can be simulated; give a shorter file"
        )
    return min(max(lag / in_lag, end / most), coarse)


def step_responses(
    members: Ensemble, kp: float, kd: float, duration: float
) -> tuple[np.ndarray, np.ndarray]:
    """Step responses of all members to a setpoint of 1, with the same gains.

    Args:
        kp, kd: [N/m], [N s/m].
        duration: [s].

    Returns:
        Time [s], shape (points,), and positions relative to the step, shape (members, points).
    """
    period = members.sampling.control_period
    longest = float(members.delay.max())
    options = None
    if period is not None and duration / period <= _MOST_TICKS:
        options = _options(members, longest)
    else:
        period = duration / _MOST_TICKS
    ticks = max(math.ceil(duration / period), 50)
    sprung = bool(members.joint_damping.any() or members.joint_stiffness.any())
    how = Timed(
        "settling_time", ticks, period, (), options, members.sampling, longest,
        members.measurement_delay, sprung,
    )  # fmt: skip
    plant = np.stack([getattr(members, name) for name in PLANT])
    with jax.enable_x64(True):
        gains = (jnp.full(len(members), gain) for gain in (kp, kd))
        errors = np.asarray(_errors(*gains, jnp.asarray(plant), how=how))
    time = how.spacing * np.arange(errors.shape[1])
    if options is None:
        rows = zip(members.delay - members.measurement_delay, errors, strict=True)
        errors = np.stack([np.interp(time, late + time, row, left=-1.0) for late, row in rows])
    return time, 1.0 + errors


@Program
def _errors(kp: jax.Array, kd: jax.Array, plant: jax.Array, *, how: Timed) -> jax.Array:
    """Errors of a flat batch of loops, shape (n, points), from gains (n,) and plants (6, n)."""
    return jax.vmap(how.errors, (0, 0, 1))(kp, kd, plant)
