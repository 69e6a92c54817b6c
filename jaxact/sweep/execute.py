"""Computing loops: growth rates, then rollouts, batch by batch.

What a sample computes depends on its own values and number, and on the tile's size, only. The
growth rate is measured in float64 whatever the precision of the rollout: the verdict near the
boundary hangs on it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.metrics import Metrics
from jaxact.sweep import plans, spectra, tiles
from jaxact.sweep.samples import Samples
from jaxact.sweep.specification import Specification


def simulate_batch(
    plan: plans.Plan,
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
    growth: np.ndarray,
) -> dict[str, np.ndarray]:
    """Metrics of one batch of samples whose growth rates [1/s] are known; each (batch,)."""
    double = specification.precision == "float64"
    with jax.enable_x64(True) if double else nullcontext():
        if plan.case.engine == "mujoco":
            return _outside(plan, specification, samples, numbers, growth)
        dtype = np.float64 if double else np.float32
        shared, values = tiles.tiled(plan, samples, numbers, dtype)
        shape = values[tiles.NEVER_SHARED].shape
        simulate = tiles.compiled("metrics", plan.case, plan.devices, specification.setting, double)
        result: Metrics = simulate(
            shared,
            values,
            jnp.asarray(growth.reshape(shape).astype(dtype)),
            jnp.full(shape, specification.seed, jnp.uint32),
            jnp.asarray((samples.first + numbers).reshape(shape).astype(np.uint32)),
        )
        return _rows(result, growth)


def _outside(
    plan: plans.Plan,
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
    growth: np.ndarray,
) -> dict[str, np.ndarray]:
    """`simulate_batch` for physics in C MuJoCo."""
    from jaxact.sweep import outside  # imports MuJoCo

    values = samples.take(numbers)
    setting, seed = specification.setting, specification.seed
    return _rows(
        outside.metrics(plan.case, setting, values, growth, seed, samples.first + numbers), growth
    )


def _rows(result: Metrics, growth: np.ndarray) -> dict[str, np.ndarray]:
    """Metrics as flat arrays by name, the growth rates as they were before any rounding."""
    names = Metrics.__dataclass_fields__
    rows = {name: np.asarray(getattr(result, name)).reshape(-1) for name in names}
    return rows | {"growth_rate": growth}


def compute(
    groups: Sequence[plans.Plan],
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
) -> dict[str, np.ndarray]:
    """Simulate some samples of a sweep.

    Args:
        groups: from `jaxact.sweep.plans.groups`.
        specification: checked.
        samples: expanded from it.
        numbers: of the samples, rising, shape (n,).

    Returns:
        One array for each field of `jaxact.metrics.Metrics`, shape (n,).
    """
    results: dict[str, np.ndarray] = {}
    for plan in groups:
        for batch, count in plans.batches(plan, samples, numbers):
            growth = spectra.growth_batch(plan, specification, samples, batch)
            rows = simulate_batch(plan, specification, samples, batch, growth)
            places = np.searchsorted(numbers, batch[:count])
            for name, row in rows.items():
                if name not in results:
                    results[name] = np.zeros(numbers.size, row.dtype)
                results[name][places] = row[:count]
    return results


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
        One array for each field of `jaxact.metrics.Metrics`, shape (samples,).

    Raises:
        UserError: a control period is no multiple of the physics step, the model cannot be used,
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
