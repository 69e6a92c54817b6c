"""Computing loops: growth rates, then rollouts, batch by batch.

What a sample computes depends on its own values and number, and on the tile's size, only. The
growth rate is measured in float64 whatever the precision of the rollout: the verdict near the
boundary hangs on it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.parameters import CONTROL_RATE
from jaxact.simulation import kernel, plans, spectra, tiles
from jaxact.simulation.growth.rate import TOLERANCE
from jaxact.simulation.metrics import Metrics
from jaxact.simulation.rollout import whole_ticks
from jaxact.simulation.spectra import Rates
from jaxact.status import Verdict

# A perturbation that grows this often by a factor of e has overflowed in single precision.
_OVERFLOW = 44.0
# Metrics that only a step has.
_OF_STEP = ("overshoot", "rise_time", "settling_time")
# Lives that are told apart.
_STEPS = 256


@dataclass(frozen=True)
class _Batch:
    """A batch that devices are simulating.

    Attributes:
        order: in which its samples are computed.
        rates: of its samples.
        metrics: in that order; not waited for.
        stepped: whether their setpoints stay where they step to.
    """

    order: slice | np.ndarray
    rates: Rates
    metrics: Metrics
    stepped: bool = True


@dataclass(frozen=True)
class RunningBatches:
    """Samples that devices are simulating.

    Attributes:
        size: number of samples.
        batches: each with where its rows belong, and how many of them count.
    """

    size: int
    batches: list[tuple[slice | np.ndarray, int, _Batch]]


def simulate_batch(
    plan: plans.Plan,
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
    rates: Rates,
) -> dict[str, np.ndarray]:
    """Metrics of one batch of samples whose growth rates are known; each (batch,)."""
    return _rows(_simulated(plan, specification, samples, numbers, rates))


def _simulated(
    plan: plans.Plan,
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
    rates: Rates,
) -> _Batch:
    """A batch that is being simulated; arguments as for `simulate_batch`."""
    stepped = plans.steps_only(specification)
    with _precision(specification):
        if not plan.case.engine.in_jax:
            found = _outside(plan, specification, samples, numbers, rates.growth)
            return _Batch(slice(None), rates, found, stepped=stepped)
        order = _by_life(plan, rates.growth, _own_ticks(plan, samples, numbers))
        growth = rates.growth[order]
        inputs, static = _inputs(plan, specification, samples, numbers[order], growth)
        return _Batch(order, rates, tiles.run(*inputs, **static), stepped=stepped)


def _own_ticks(plan: plans.Plan, samples: Samples, numbers: np.ndarray) -> np.ndarray | None:
    """Ticks of each of some samples, shape (n,); None where all have those of the plan."""
    if not plan.case.rollout.several:
        return None
    rates = samples.take(numbers, {CONTROL_RATE})[CONTROL_RATE]
    return whole_ticks(plan.case.duration, 1.0 / rates)


def prepare(
    groups: Sequence[plans.Plan],
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
) -> None:
    """Compile what simulates some samples; arguments as for `compute`."""
    for plan in groups:
        batch = next((batch for batch, _ in plans.batches(plan, samples, numbers)), None)
        if batch is None or not plan.case.engine.in_jax:
            continue
        with _precision(specification):
            rates = np.zeros(batch.size)
            inputs, static = _inputs(plan, specification, samples, batch, rates)
            tiles.run.compiled(*inputs, **static)


def _precision(specification: Specification) -> AbstractContextManager[Any]:
    return jax.enable_x64(True) if specification.precision == "float64" else nullcontext()


def _inputs(
    plan: plans.Plan,
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
    growth: np.ndarray,
) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """What `jaxact.simulation.tiles.run` simulates a batch from: arrays and static arguments."""
    dtype = np.float64 if specification.precision == "float64" else np.float32
    shared, values = tiles.tiled(plan, samples, numbers, dtype)
    setting, push = kernel.split_push(specification.setting, dtype)
    shape = values[tiles.NEVER_SHARED].shape
    own = _own_ticks(plan, samples, numbers)
    if own is not None:
        values |= {kernel.OWN_TICKS: own.reshape(shape).astype(np.int32)}
    inputs = (
        {**shared, **push},
        values,
        growth.reshape(shape).astype(dtype),
        np.full(shape, specification.seed, np.uint32),
        (samples.first + numbers).reshape(shape).astype(np.uint32),
    )
    return inputs, tiles.static(plan, "metrics", plan.case, setting)


def _by_life(
    plan: plans.Plan, growth: np.ndarray, own_ticks: np.ndarray | None
) -> slice | np.ndarray:
    """An order in which loops that are over early share tiles, which then end early.

    Which loops share a tile changes no result.
    """
    with np.errstate(divide="ignore"):
        life = _OVERFLOW / np.maximum(np.nan_to_num(growth), 0.0)
    share = np.minimum(life / plan.case.duration, 1.0)
    if own_ticks is not None:
        share *= own_ticks / plan.case.rollout.ticks
    if not plan.case.rollout.stops or share.min() == 1.0:
        return slice(None)
    # Of small whole numbers NumPy sorts millions in no time.
    return np.argsort((share * _STEPS).astype(np.int16), kind="stable")


def _outside(
    plan: plans.Plan,
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
    growth: np.ndarray,
) -> Metrics:
    """Metrics of a batch whose physics is C MuJoCo's."""
    from jaxact.simulation import mujoco_batch  # imports MuJoCo

    values = samples.take(numbers)
    setting, seed = specification.setting, specification.seed
    return mujoco_batch.metrics(plan.case, setting, values, growth, seed, samples.first + numbers)


def _rows(batch: _Batch) -> dict[str, np.ndarray]:
    """Metrics as flat arrays by name, the growth rates as they were before any rounding."""
    names = Metrics.__dataclass_fields__
    rows = {name: np.asarray(getattr(batch.metrics, name)).reshape(-1) for name in names}
    rows = {name: _reordered(row, batch.order) for name, row in rows.items()}
    return with_rates(rows if batch.stepped else without_step(rows), batch.rates)


def without_step(rows: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Metrics of loops whose setpoints move on: there is no step that they could be those of."""
    return rows | {name: np.full_like(rows[name], np.nan) for name in _OF_STEP}


def with_rates(rows: dict[str, np.ndarray], rates: Rates) -> dict[str, np.ndarray]:
    """Metrics with the growth rates; a robot that falls, but would not shake, topples."""
    rows = rows | {"growth_rate": rates.growth}
    if rates.shaking is None:
        return rows
    falls = (rates.growth > TOLERANCE) & (rates.shaking <= TOLERANCE)
    # What is bounded, as it lies on the ground or hangs, but has not swung is not a limit cycle.
    still = (rows["verdict"] == Verdict.LIMIT_CYCLE) & np.isnan(rows["limit_cycle_frequency"])
    falls &= (rows["verdict"] == Verdict.UNSTABLE) | still
    amplitude = np.where(falls, np.nan, rows["limit_cycle_amplitude"])
    rows |= {"limit_cycle_amplitude": amplitude.astype(rows["limit_cycle_amplitude"].dtype)}
    verdict = np.where(falls, Verdict.TOPPLES, rows["verdict"]).astype(rows["verdict"].dtype)
    return rows | {"verdict": verdict, "shaking_rate": rates.shaking}


def _reordered(row: np.ndarray, order: slice | np.ndarray) -> np.ndarray:
    """Values at the places that they were taken from."""
    if isinstance(order, slice):
        return row
    back = np.empty_like(row)
    back[order] = row
    return back


def growth_rates(
    groups: Sequence[plans.Plan],
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
) -> list[Rates]:
    """Growth rates of some samples of a sweep, batch by batch; arguments as for `compute`."""
    return [
        spectra.rates_batch(plan, specification, samples, batch)
        for plan in groups
        for batch, _ in plans.batches(plan, samples, numbers)
    ]


def begin(
    groups: Sequence[plans.Plan],
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
    growth: Sequence[Rates],
) -> RunningBatches:
    """Set devices to simulate some samples, without waiting for them.

    Args:
        groups, specification, samples, numbers: as for `compute`.
        growth: from `growth_rates`.
    """
    begun = []
    done = 0
    batches = [(plan, *each) for plan in groups for each in plans.batches(plan, samples, numbers)]
    for (plan, batch, count), rates in zip(batches, growth, strict=True):
        places: slice | np.ndarray = slice(done, done + count)
        if len(groups) > 1:
            places = np.searchsorted(numbers, batch[:count])
        found = _simulated(plan, specification, samples, batch, rates)
        begun.append((places, count, found))
        done += count
    return RunningBatches(numbers.size, begun)


def finish(begun: RunningBatches) -> dict[str, np.ndarray]:
    """What `compute` returns, once it is there."""
    results: dict[str, np.ndarray] = {}
    for places, count, batch in begun.batches:
        for name, row in _rows(batch).items():
            if name not in results:
                results[name] = np.zeros(begun.size, row.dtype)
            results[name][places] = row[:count]
    return results


def compute(
    groups: Sequence[plans.Plan],
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
) -> dict[str, np.ndarray]:
    """Simulate some samples of a sweep.

    Args:
        groups: from `jaxact.simulation.plans.groups`.
        specification: checked.
        samples: expanded from it.
        numbers: of the samples, rising, shape (n,).

    Returns:
        One array for each field of `jaxact.simulation.metrics.Metrics`, shape (n,); of robots the
        shaking rate as well.
    """
    growth = growth_rates(groups, specification, samples, numbers)
    return finish(begin(groups, specification, samples, numbers, growth))


def run(
    specification: Specification,
    samples: Samples,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, np.ndarray]:
    """Simulate every sample of a sweep, and keep all results in memory.

    Args:
        specification: checked.
        samples: expanded from it.
        progress: called with the number of samples done and in all.

    Returns:
        One array for each field of `jaxact.simulation.metrics.Metrics`, shape (samples,).

    Raises:
        UserError: a control period is not a multiple of the physics step, the model cannot be used,
            or there are fewer devices than asked for.
    """
    groups = plans.groups(specification, samples)
    size = sum(plan.batch for plan in groups)
    parts = []
    for first in range(0, len(samples), size):
        numbers = np.arange(first, min(first + size, len(samples)))
        parts.append(compute(groups, specification, samples, numbers))
        if progress is not None:
            progress(int(numbers[-1]) + 1, len(samples))
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
