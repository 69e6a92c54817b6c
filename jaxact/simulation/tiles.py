"""One stage of a kernel, compiled to run on tiles of samples on several devices."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from jaxact.compilation.programs import building
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Setting
from jaxact.parameters import KP
from jaxact.simulation import kernel
from jaxact.simulation.kernel import Case
from jaxact.simulation.plans import Plan

# So that there is always a parameter with an axis for the samples.
NEVER_SHARED = KP


@building
def run(*, stage: str, case: Case, devices: int, setting: Setting) -> Callable:
    """The function that runs one batch: arrays of shape (devices * tiles, tile) in and out.

    Its first argument are the parameters that all samples share, numbers of shape ().

    Args:
        stage: name of the function of `jaxact.simulation.kernel` to run on every sample.
        case, devices, setting: static.
    """
    template = kernel.template_of(case, setting, stage)
    one = functools.partial(getattr(kernel, stage), case, template)
    mesh = Mesh(np.array(jax.local_devices()[:devices]), ("device",))
    spec = PartitionSpec("device")

    def tiles(shared, *inputs):
        def sample(values, *others):
            return one({**shared, **values}, *others)

        return jax.lax.map(lambda tile: jax.vmap(sample)(*tile), inputs)

    # In the same way on a single device, so that the same bits come out.
    def sharded(shared, *inputs):
        parted = jax.shard_map(
            tiles,
            mesh=mesh,
            in_specs=(PartitionSpec(), *(spec for _ in inputs)),
            out_specs=spec,
            check_vma=False,
        )
        return parted(shared, *inputs)

    return sharded


def static(plan: Plan, stage: str, case: Case, setting: Setting) -> dict[str, Any]:
    """The static arguments of `run` for a plan's batches."""
    return {"stage": stage, "case": case, "devices": plan.devices, "setting": setting}


def tiled(
    plan: Plan, samples: Samples, numbers: np.ndarray, dtype: type
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The parameters of a batch of samples.

    Returns:
        Those that all samples of the sweep share, of shape (), so that what follows from them is
        computed once and need not be read for every loop; and the others, each of shape
        (devices * tiles, tile).
    """
    shape = (plan.devices * plan.tiles, plan.tile)
    shared: dict[str, np.ndarray] = {
        name: array.reshape(()).astype(dtype)
        for name, array in samples.along.items()
        if array.size == 1 and name != NEVER_SHARED
    }
    own: dict[str, np.ndarray] = {
        name: value.reshape(shape).astype(dtype)
        for name, value in samples.take(numbers, samples.along.keys() - shared.keys()).items()
    }
    return shared, own
