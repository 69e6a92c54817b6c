"""Where along the gain scale a robot stops being stable: by its growth rate, and by rollouts alone.

The two are independent. The growth rate belongs to the linearised loop; the rollouts are nonlinear,
start with a small velocity of all driven joints, and are judged by whether their motion dies out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import jax
import numpy as np

from jaxact.loops.samples import Samples, explicit
from jaxact.loops.specification import Specification
from jaxact.simulation import engines, execute, plans, spectra

Columns = Mapping[str, np.ndarray]
Judge = Callable[[Columns], np.ndarray]

KICK = 0.02
"""Velocity of every driven joint at the start of a rollout that is judged [m/s or rad/s]."""

FAST = 0.5
"""A joint that becomes faster is not in a small motion any more [m/s or rad/s]."""

_REST = 1e-6  # share of the first accelerations that is not a motion


def growth_rates(specification: Specification, columns: Columns) -> np.ndarray:
    """Growth rates of loops of a robot [1/s], shape (n,).

    Args:
        specification: checked; what is not in a column.
        columns: values of each varied parameter (names of presets of `actuator`), shape (n,) each.
    """
    samples = explicit(specification, dict(columns))
    found = np.zeros(len(samples))
    for plan, batch, count in _batches(specification, samples):
        rates = spectra.rates_batch(plan, specification, samples, batch).growth
        found[batch[:count]] = rates[:count]
    return found


def simulated(
    specification: Specification, columns: Columns, growth_rate: np.ndarray
) -> dict[str, np.ndarray]:
    """Metrics of loops whose growth rates are known already, by name, shape (n,) each.

    Args:
        specification, columns: as for `growth_rates`, whose result does not depend on push and
            errors.
        growth_rate: [1/s], shape (n,).
    """
    samples = explicit(specification, dict(columns))
    found: dict[str, np.ndarray] = {}
    for plan, batch, count in _batches(specification, samples):
        rows = execute.simulate_batch(
            plan, specification, samples, batch, spectra.Rates(growth_rate[batch])
        )
        for name, row in rows.items():
            found.setdefault(name, np.zeros(len(samples), row.dtype))[batch[:count]] = row[:count]
    return found


def die_out(specification: Specification, columns: Columns) -> np.ndarray:
    """Whether a small motion dies out in the nonlinear rollouts of a robot, shape (n,).

    It does if no joint ever becomes fast, and the joint accelerations (root mean square over all
    joints) of the last quarter are smaller than those of the quarter before and of the first one,
    or have come to rest. Accelerations and not positions: in those, fast modes that grow are hidden
    behind slow ones that decay.

    Args:
        specification: checked, of the engine "mujoco"; without noise and quantisation.
        columns: as for `growth_rates`.
    """
    own = dict(specification.parameters) | {"initial_velocity": KICK}
    kicked = replace(specification, parameters=own, precision="float64")
    samples = explicit(kicked, dict(columns))
    found = np.zeros(len(samples), bool)
    for plan, batch, count in _batches(kicked, samples):
        (first, *_, before, last), fastest = _motion(kicked, plan, samples, batch)
        decays = (last < before) & (last < first) | (last < _REST * first)
        found[batch[:count]] = (decays & (fastest < FAST))[:count]
    return found


def _batches(specification: Specification, samples: Samples):
    """Plan, numbers and their count of every batch; of one size, so that calls share kernels."""
    tile = engines.tile_size(specification)
    one = replace(specification, tile=tile, devices=1)
    for plan in plans.groups(one, samples, together=tile):
        plan = replace(plan, tile=tile, tiles=1)
        for batch, count in plans.batches(plan, samples):
            yield plan, batch, count


def _motion(specification: Specification, plan, samples: Samples, batch):
    """How the joints of a batch moved.

    Returns:
        The root mean square of the accelerations of each quarter, shape (4, batch), and the largest
        speed of any joint, shape (batch,).
    """
    from jaxact.simulation import mujoco_batch  # imports MuJoCo

    kept: list[np.ndarray] = []

    def watch(simulations, _coefficients):
        return lambda *_: kept.append(simulations.measure()[:, 1])

    with jax.enable_x64(True):
        mujoco_batch.metrics(
            plan.case, specification.setting, samples.take(batch), np.zeros(len(batch)),
            specification.seed, batch, watch=watch,
        )  # fmt: skip
    velocities = np.stack(kept)
    with np.errstate(all="ignore"):  # of simulations that diverged
        changes = np.diff(velocities, axis=0) / plan.case.step
        quarters = np.array_split(np.mean(changes**2, axis=2), 4)
        sizes = np.sqrt(np.stack([quarter.mean(axis=0) for quarter in quarters]))
        return sizes, np.max(np.abs(velocities), axis=(0, 2))


def edge(
    stable: Judge,
    columns: Columns,
    start: float | np.ndarray,
    end: float | np.ndarray,
    *,
    points: int = 16,
    rounds: int = 3,
) -> np.ndarray:
    """The gain scale at which loops become stable on the way from one gain scale to another.

    From the larger to the smaller one that is the largest stable gain scale, from the smaller to
    the larger one the smallest.

    Args:
        stable: tells of columns, `gain_scale` among them, which loops are stable; shape (n,).
        columns: the loops, shape (n,) each.
        start, end: of the way, gain scales, one for all loops or one for each.
        points: that are looked at in each round, evenly on a logarithmic scale.
        rounds: each looks between the last unstable and the first stable point of the one before.

    Returns:
        The geometric mean of these two points, shape (n,); infinity (or 0, where start is the
        smaller one) for a loop that is stable from the start on, NaN for one that never is.
    """
    number = len(next(iter(columns.values())))
    before, after = np.full(number, start, float), np.full(number, end, float)
    at_once = np.where(before > after, np.inf, 0.0)
    found = np.full(number, np.nan)
    open_ = np.ones(number, bool)
    for turn in range(rounds):
        # The ends of the way are looked at once; those of a later round are known already.
        share = np.linspace(0.0, 1.0, points + 2 * (turn > 0))[turn > 0 :][:points]
        scales = before[:, None] ** (1.0 - share) * after[:, None] ** share
        spread = {name: np.repeat(values, points) for name, values in columns.items()}
        verdict = stable({**spread, "gain_scale": scales.ravel()}).reshape(scales.shape)
        for row in np.flatnonzero(open_):
            hits = np.flatnonzero(verdict[row])
            if turn == 0 and (hits.size == 0 or hits[0] == 0):
                open_[row] = False
                found[row] = np.nan if hits.size == 0 else at_once[row]
                continue
            rim = np.concatenate([[before[row]], scales[row], [after[row]]])
            place = hits[0] + 1 if hits.size else points + 1
            before[row], after[row] = rim[place - 1], rim[place]
    return np.where(open_, np.sqrt(before * after), found)
