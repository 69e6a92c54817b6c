"""Running a sweep: samples in tiles, tiles over all local devices, memory bounded by the tile.

A tile is a fixed number of loops simulated side by side, small on a CPU so that their state stays
in the first-level cache. Samples are sent to the devices in batches of a fixed number of tiles, so
that each kernel is compiled once; the last batch is filled up with copies of its last sample. What
a sample computes depends on its own values and number only.

The growth rate is measured in float64 whatever the precision of the rollout: the verdict near the
boundary hangs on it.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from jaxact import drive as _drive
from jaxact import rollout as _rollout
from jaxact.errors import UserError
from jaxact.growth import GrowthOptions
from jaxact.metrics import Metrics
from jaxact.rollout import RolloutOptions
from jaxact.sweep import kernel
from jaxact.sweep.kernel import Case
from jaxact.sweep.samples import Samples
from jaxact.sweep.specification import Specification

# Physics step of the MJX plant where none is given [s].
MJX_STEP = 0.25e-3

# Loops in a tile, where none is given: measured on CPUs, where the state should stay in the
# first-level cache, and GPUs, which want many.
_TILES = {("mass", "cpu"): 64, ("mjx", "cpu"): 32, ("mass", "gpu"): 65536, ("mjx", "gpu"): 4096}
# Control periods that one call to a device simulates: about a second of work.
_WORK = {"mass": 2e8, "mjx": 5e6}

# A control period may miss a whole number of physics steps by rounding only.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Plan:
    """How a group of samples is cut up.

    Attributes:
        case: static options.
        members: numbers of the samples of the group; None for all.
        tile: loops in a tile.
        tiles: tiles that each device gets at once.
        devices: number of devices.
    """

    case: Case
    members: np.ndarray | None
    tile: int
    tiles: int
    devices: int

    @property
    def batch(self) -> int:
        """Loops in one call."""
        return self.tile * self.tiles * self.devices


def substeps(specification: Specification, control_rate: np.ndarray) -> np.ndarray:
    """Physics steps in a control period for these control rates [Hz].

    Raises:
        UserError: a control period is no multiple of the physics step.
    """
    step = specification.physics_step
    if step is None and specification.engine == "mass":
        return np.ones(control_rate.shape, int)
    step = MJX_STEP if step is None else step
    ratio = 1.0 / (control_rate * step)
    whole = np.maximum(np.round(ratio), 1.0)
    wrong = np.abs(ratio - whole) > _ROUNDING * whole
    if np.any(wrong):
        rate = float(np.extract(wrong, control_rate)[0])
        raise UserError(
            f"control_rate = {rate:g} Hz: its period of {1.0 / rate:g} s is no multiple of "
            f"physics_step = {step:g} s"
        )
    return whole.astype(int)


def _distinct(values: np.ndarray) -> np.ndarray:
    """The values without the repetitions of a parameter that does not vary."""
    return values[:1] if values.strides == (0,) else values


def _devices(specification: Specification) -> int:
    """Number of devices to use.

    Raises:
        UserError: more are asked for than there are.
    """
    there = len(jax.local_devices())
    asked = there if specification.devices is None else specification.devices
    if asked > there:
        raise UserError(f"devices = {asked}: this machine has {there}; `jaxact info` lists them")
    return asked


def _refuse_deadlock(specification: Specification) -> None:
    """JAX 0.10 on few cores can wait for ever for its own threads on a large model.

    Raises:
        UserError: it could happen here, and how to prevent it.
    """
    old = jax.__version__.startswith("0.10.") and jax.default_backend() == "cpu"
    asked = os.environ.get("NPROC", "")
    threads = int(asked) if asked.isdigit() else os.cpu_count() or 1
    if old and specification.model is not None and threads < 8:
        raise UserError(
            "JAX 0.10 can hang on this machine with a model of one's own: set the environment "
            "variable NPROC=8 before Python starts, or use Python 3.12 or newer, which gets a "
            "newer JAX"
        )


def plans(specification: Specification, samples: Samples) -> list[Plan]:
    """Cut a sweep into groups of samples that one compiled kernel serves.

    Samples whose control periods hold different numbers of physics steps are different groups;
    usually there is one.

    Raises:
        UserError: a control period is no multiple of the physics step, there are too few devices,
            or this version of JAX could hang.
    """
    _refuse_deadlock(specification)
    rates = _distinct(samples.values["control_rate"])
    steps = substeps(specification, rates)
    kinds = np.unique(steps)
    devices = _devices(specification)
    groups = []
    for count in kinds:
        members = None if kinds.size == 1 else np.flatnonzero(steps == count)
        values = {
            name: _distinct(value) if members is None else value[members]
            for name, value in samples.values.items()
        }
        case = _case(specification, values, int(count))
        size = len(samples) if members is None else members.size
        groups.append(_plan(specification, case, members, size, devices))
    return groups


def _case(specification: Specification, values: dict[str, np.ndarray], count: int) -> Case:
    """The static options that serve all of these samples."""
    rates = values["control_rate"]
    fastest = float(np.max(rates))
    options = _drive.options(
        kernel.drive_of(values),
        substeps=count,
        differenced=specification.velocity == "differenced",
    )
    if specification.engine == "mass" and jax.default_backend() == "cpu":
        options = replace(options, staged=True)
    ticks = _rollout.whole_ticks(specification.duration, 1.0 / fastest)
    varied = {axis.name for axis in specification.axes} | set(specification.parameters)
    mass = specification.engine == "mass"
    return Case(
        engine=specification.engine,
        drive=options,
        rollout=RolloutOptions(
            ticks=ticks,
            unroll=int(__import__("os").environ.get("UN", "4")) if mass else 1,
            linear_plant=mass or specification.model is None,
        ),
        masked=bool(np.any(np.ceil(specification.duration * rates - 1e-4) < ticks)),
        duration=specification.duration,
        model=kernel.model_digest(specification.engine, specification.model),
        own_mass=specification.model is None or "mass" in varied,
        growth=GrowthOptions(dense=not mass),
    )


def _plan(
    specification: Specification, case: Case, members: np.ndarray | None, size: int, devices: int
) -> Plan:
    platform = "cpu" if jax.default_backend() == "cpu" else "gpu"
    usual = _TILES[case.engine, platform]
    tile = min(specification.tile or usual, max(1, size))
    per_tile = tile * case.rollout.ticks * case.drive.substeps
    most = max(1, int(_WORK[case.engine] / per_tile)) * tile * devices
    # Batches of equal size, so that the last one is not mostly filling.
    batches = -(-size // most)
    tiles = -(-size // (batches * tile * devices))
    return Plan(case=case, members=members, tile=tile, tiles=tiles, devices=devices)


@functools.cache
def _compiled(stage: str, case: Case, devices: int, model: Path | None, double: bool) -> Callable:
    """The function that runs one batch: arrays of shape (devices * tiles, tile) in and out.

    Args:
        stage: name of the function of `jaxact.sweep.kernel` to run on every sample.
        case, devices, model: static.
        double: whether JAX computes in float64 at this moment; the model is loaded in it.
    """
    template = kernel.plant_template(case.engine, model)
    one = functools.partial(getattr(kernel, stage), case, template)
    mesh = Mesh(np.array(jax.local_devices()[:devices]), ("device",))
    spec = PartitionSpec("device")

    def tiles(*inputs):
        return jax.lax.map(lambda tile: jax.vmap(one)(*tile), inputs)

    if devices == 1:
        return jax.jit(tiles)
    return jax.jit(jax.shard_map(tiles, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False))


def batches(plan: Plan, samples: Samples) -> Iterator[tuple[np.ndarray, int]]:
    """Numbers of the samples of each batch, filled up, and how many of them count."""
    size = len(samples) if plan.members is None else plan.members.size
    for first in range(0, size, plan.batch):
        count = min(plan.batch, size - first)
        places = np.minimum(np.arange(first, first + plan.batch), size - 1)
        yield (places if plan.members is None else plan.members[places]), count


def _tiled(plan: Plan, samples: Samples, numbers: np.ndarray, dtype: type) -> dict[str, jax.Array]:
    """The parameters of a batch of samples, each of shape (devices * tiles, tile)."""
    shape = (plan.devices * plan.tiles, plan.tile)
    return {
        name: jnp.asarray(value[numbers].reshape(shape).astype(dtype))
        for name, value in samples.values.items()
    }


def growth_batch(
    plan: Plan, specification: Specification, samples: Samples, numbers: np.ndarray
) -> np.ndarray:
    """Growth rates of one batch of samples [1/s], shape (batch,), in float64."""
    with jax.enable_x64(True):
        grow = _compiled("growth_rate", plan.case, plan.devices, specification.model, True)
        return np.asarray(grow(_tiled(plan, samples, numbers, np.float64))).reshape(-1)


def simulate_batch(
    plan: Plan,
    specification: Specification,
    samples: Samples,
    numbers: np.ndarray,
    growth: np.ndarray,
) -> dict[str, np.ndarray]:
    """Metrics of one batch of samples whose growth rates [1/s] are known; each (batch,)."""
    double = specification.precision == "float64"
    with jax.enable_x64(True) if double else nullcontext():
        dtype = np.float64 if double else np.float32
        values = _tiled(plan, samples, numbers, dtype)
        shape = values["kp"].shape
        simulate = _compiled("metrics", plan.case, plan.devices, specification.model, double)
        result: Metrics = simulate(
            values,
            jnp.asarray(growth.reshape(shape).astype(dtype)),
            jnp.full(shape, specification.seed, jnp.uint32),
            jnp.asarray(numbers.reshape(shape).astype(np.uint32)),
        )
        rows = {
            name: np.asarray(getattr(result, name)).reshape(-1)
            for name in Metrics.__dataclass_fields__
        }
    return rows | {"growth_rate": growth}


def run(
    specification: Specification,
    samples: Samples,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, np.ndarray]:
    """Simulate every sample of a sweep.

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
    results: dict[str, np.ndarray] = {}
    done = 0
    for plan in plans(specification, samples):
        for numbers, count in batches(plan, samples):
            growth = growth_batch(plan, specification, samples, numbers)
            rows = simulate_batch(plan, specification, samples, numbers, growth)
            for name, row in rows.items():
                if name not in results:
                    results[name] = np.zeros(len(samples), row.dtype)
                results[name][numbers[:count]] = row[:count]
            done += count
            if progress is not None:
                progress(done, len(samples))
    return results
