"""Metrics from simulated time: settling and tracking, smooth for the descent and exact for the end.

The loop that is simulated is that of every sweep, drive and all, under the exact mass. Without a
control rate it is sampled at a tenth of the shortest lag, so that the hold hardly counts; a filter
of the velocity then sees positions differenced at that rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

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
from jaxact.loops.loop import Loop
from jaxact.plants.mass import Mass
from jaxact.simulation import rollout
from jaxact.tuning.goal import Goal
from jaxact.tuning.joint.ensemble import PLANT, Ensemble, Sampling

# Half-width of the band that counts as settled, relative to the step.
BAND = 0.02
# Simulated time in lags of the slowest member, and the most control periods it may take.
_LAGS, _MOST_TICKS = 120.0, 4000
# A smooth last time needs several samples within its width.
_SHARPEST = 100.0


@dataclass(frozen=True)
class Timed:
    """What is simulated for a metric; static and hashable.

    Attributes:
        metric: "settling_time" [s] or "tracking_error", rms [m].
        ticks: control periods.
        period: control period [s].
        reference: setpoints at the ticks [m], shape (ticks,); a step to 1 where empty.
        options: of the drive.
        sampling: of the controller, for the velocity it sees.
        sprung: whether joints have damping or stiffness of their own.
    """

    metric: str
    ticks: int
    period: float
    reference: tuple[float, ...]
    options: DriveOptions
    sampling: Sampling
    sprung: bool = False

    def of_loops(self, kp: jax.Array, kd: jax.Array, plant: jax.Array) -> jax.Array:
        """The metric of a flat batch of loops, shape (n,); plant: shape (4 or 6, n)."""
        errors = jax.vmap(self.errors, (0, 0, 1))(kp, kd, plant)
        return jax.vmap(self._metric)(errors)

    def smooth(
        self, kp: jax.Array, kd: jax.Array, plant: jax.Array, sharpness: jax.Array
    ) -> jax.Array:
        """ln of the metric of one loop, smooth; plant: shape (4,) or (6,)."""
        error = self.errors(kp, kd, plant)
        if self.metric == "tracking_error":
            return jnp.log(self._metric(error))
        level = jnp.minimum(sharpness, _SHARPEST)
        time = self.period * jnp.arange(1, self.ticks + 1, dtype=error.dtype)
        outside = jax.nn.log_sigmoid(level * jnp.log(jnp.abs(error) / BAND + 1e-9))
        return jax.scipy.special.logsumexp(level * (jnp.log(time) + outside)) / level

    def errors(self, kp: jax.Array, kd: jax.Array, plant: jax.Array) -> jax.Array:
        """Position less setpoint at the ticks [m], shape (ticks,)."""
        mass, wn, zeta, delay, *joint = plant
        own = Mass(mass, *joint) if self.sprung else Mass(mass)
        actuator = Actuator(natural_frequency=wn, damping_ratio=zeta, delay=delay)
        sensor = Sensor(velocity_filter=self.sampling.velocity_filter)
        drive = Drive(Controller(kp=kp, kd=kd), actuator, sensor, control_period=self.period)
        step = (1.0,) * self.ticks
        given = jnp.asarray(self.reference or step, kp.dtype)
        still = jnp.zeros_like(given)
        path = rollout.trajectory(
            Loop(plant=own, drive=drive), self.options, self.ticks, Setpoint(given[0]),
            setpoints=Setpoint(given, still, still),
            position=given[0] if self.reference else 0.0,
        )  # fmt: skip
        return path.position - given

    def _metric(self, error: jax.Array) -> jax.Array:
        if self.metric == "tracking_error":
            return jnp.sqrt(jnp.mean(error * error))
        size = jnp.abs(error)
        outside = size > BAND
        last = self.ticks - 1 - jnp.argmax(outside[::-1])
        after = jnp.minimum(last + 1, self.ticks - 1)
        fall = jnp.maximum(size[last] - size[after], jnp.finfo(size.dtype).tiny)
        # Never settled: the end of what was simulated.
        part = jnp.where(after > last, (size[last] - BAND) / fall, 1.0)
        return self.period * (last + jnp.clip(part, 0.0, 1.0))


def timed(goal: Goal, ensembles: Sequence[Ensemble]) -> Timed | None:
    """What a goal needs to be simulated, None for one that needs nothing.

    Args:
        ensembles: of all cases.
    """
    if goal.metric not in ("settling_time", "tracking_error"):
        return None
    sampling = ensembles[0].sampling
    lags = np.concatenate([members.lag for members in ensembles])
    period = sampling.control_period or min(1e-3, 0.1 * max(lags.min(), 1e-4))
    if goal.metric == "tracking_error":
        end = (len(goal.reference) - 1) * goal.reference_period
        ticks = max(2, min(math.floor(end / period), _MOST_TICKS))
        given = np.arange(len(goal.reference)) * goal.reference_period
        reference = np.interp(np.arange(ticks) * period, given, goal.reference)
    else:
        ticks = int(min(max(_LAGS * lags.max() / period, 200), _MOST_TICKS))
        reference = np.empty(0)
    longest = max(float(members.delay.max()) for members in ensembles)
    drive = Drive(Controller(1.0, 1.0), Actuator(delay=longest), control_period=period)
    differenced = sampling.velocity == "differenced"
    options = _drive.options(drive, differenced=differenced)
    sprung = any(own.joint_damping.any() or own.joint_stiffness.any() for own in ensembles)
    setpoints = tuple(map(float, reference))
    return Timed(goal.metric, ticks, period, setpoints, options, sampling, sprung)


def step_responses(
    members: Ensemble, kp: float, kd: float, duration: float
) -> tuple[np.ndarray, np.ndarray]:
    """Step responses of all members to a setpoint of 1, with the same gains.

    Args:
        kp, kd: [N/m], [N s/m].
        duration: [s].

    Returns:
        Time [s], shape (ticks,), and positions relative to the step, shape (members, ticks).
    """
    goal = Goal(objective="settling")
    how = timed(goal, [members])
    assert how is not None
    how = replace(how, ticks=int(np.clip(duration / how.period, 50, _MOST_TICKS)))
    plant = np.stack([getattr(members, name) for name in PLANT])
    with jax.enable_x64(True):
        gains = (jnp.full(len(members), gain) for gain in (kp, kd))
        errors = _errors(*gains, jnp.asarray(plant), how=how)
    return how.period * np.arange(how.ticks), 1.0 + np.asarray(errors)


@Program
def _errors(kp: jax.Array, kd: jax.Array, plant: jax.Array, *, how: Timed) -> jax.Array:
    """Errors of a flat batch of loops, shape (n, ticks), from gains (n,) and plants (6, n)."""
    return jax.vmap(how.errors, (0, 0, 1))(kp, kd, plant)
