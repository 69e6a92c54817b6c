"""A log as the simulation of its joint needs it: ticks of the controller, cut from its rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np


@dataclass(frozen=True)
class Links:
    """What the links of a robot do to a joint in the middle of each tick, shape (ticks,) each.

    Attributes:
        inertia: that the joint moves with all others held [kg or kg m^2].
        force: of gravity and of the other joints' motion, to be overcome [N or N m].
        stiffness: its change with the joint's own position [N/m or N m/rad].
        position: at which it was computed [m or rad].
    """

    inertia: jax.Array
    force: jax.Array
    stiffness: jax.Array
    position: jax.Array


jax.tree_util.register_dataclass(Links)


@dataclass(frozen=True)
class Recording:
    """What the simulation needs of a log; arrays over its ticks.

    Attributes:
        time: of the ticks [s], shape (ticks,).
        setpoint, feedforward: held at each tick, [m or rad] and [N or N m].
        command: given at each tick [N or N m]; used where the loop is not closed.
        strength: supply voltage over the usual one, 0 where the drive is off [-], shape (ticks,).
        controls: whether the controller runs at a tick, shape (ticks,).
        row: tick of each row of the log, shape (rows,).
        kp, kd: of the controller [N/m, N s/m or per rad]; NaN where they are sought.
        command_limit: of the controller's output [N or N m].
        position, velocity: at the first row [m or rad] and per second.
        links: of a robot, None of a single joint.
        stated: numbers of the joint that are of this log alone, by the model's name for them.
    """

    time: jax.Array
    setpoint: jax.Array
    feedforward: jax.Array
    command: jax.Array
    strength: jax.Array
    controls: jax.Array
    row: jax.Array
    kp: jax.Array
    kd: jax.Array
    command_limit: jax.Array
    position: jax.Array
    velocity: jax.Array
    links: Links | None = None
    stated: Mapping[str, jax.Array] = field(default_factory=dict)

    @property
    def control_period(self) -> jax.Array:
        """Mean time between two ticks at which the controller runs [s]; it does so at the ends."""
        return (self.time[-1] - self.time[0]) / (jnp.sum(self.controls) - 1)


jax.tree_util.register_dataclass(Recording)


def of_rows(
    time: np.ndarray,
    *,
    setpoint: np.ndarray,
    command: np.ndarray,
    feedforward: np.ndarray,
    strength: np.ndarray,
    position: np.ndarray,
    velocity: float,
    gains: tuple[float, float],
    command_limit: float,
    ticks_per_row: int,
    controlled: int,
    lines: bool = False,
    links: tuple[np.ndarray, ...] | None = None,
    stated: Mapping[str, float] | None = None,
) -> Recording:
    """A log cut into ticks.

    Args:
        time: of the rows [s], shape (rows,).
        setpoint, command, feedforward, strength: at each row.
        position: at each row; the first is where the joint begins.
        velocity: at the first row.
        gains: (kp, kd), NaN where sought.
        command_limit: of the controller's output.
        ticks_per_row: into which each time between rows is cut.
        controlled: the controller runs at every so many ticks.
        lines: setpoint, command and feedforward lie on lines between the rows.
        links: of a robot: inertia, force and stiffness as in `Links`, at each row.
        stated: numbers of the joint in this log alone; None for none.
    """
    share = np.arange(ticks_per_row) / ticks_per_row
    fine = (time[:-1, None] + np.diff(time)[:, None] * share).ravel()
    fine = np.append(fine, time[-1])

    def each(values: np.ndarray) -> jax.Array:
        return jnp.asarray(np.append(np.repeat(values[:-1], ticks_per_row), values[-1]))

    def asked(values: np.ndarray) -> jax.Array:
        return jnp.asarray(np.interp(fine, time, values)) if lines else each(values)

    def between(values: np.ndarray) -> jax.Array:
        middle = fine + 0.5 * np.diff(fine, append=fine[-1])
        return jnp.asarray(np.interp(middle, time, values))

    return Recording(
        time=jnp.asarray(fine),
        setpoint=asked(setpoint),
        feedforward=asked(feedforward),
        command=asked(command),
        strength=each(strength),
        controls=jnp.asarray(np.arange(len(fine)) % controlled == 0),
        row=jnp.asarray(np.arange(len(time)) * ticks_per_row),
        kp=jnp.asarray(gains[0]),
        kd=jnp.asarray(gains[1]),
        command_limit=jnp.asarray(command_limit),
        position=jnp.asarray(float(position[0])),
        velocity=jnp.asarray(velocity),
        links=None if links is None else Links(*(between(rows) for rows in (*links, position))),
        stated={name: jnp.asarray(value) for name, value in (stated or {}).items()},
    )
