"""What a sweep will take, before it starts: tiles, chunks, memory, time."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass

from jaxact.errors import UserError
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.sweeping import layout, memory
from jaxact.sweeping.layout import Layout
from jaxact.sweeping.store import as_json, numeric_versions
from jaxact.sweeping.variables import KIND, of_margins, variables_of

# Chunks of a sweep that are enough, where they would otherwise be a second of work each.
_CHUNKS = 32
# What the margins of some loops of a robot take in a process [bytes].
_OF_ROBOT = 300 * 2**20
# Longest chunk, in seconds of work: what is lost at most when a process is killed.
_LONGEST = 8


@dataclass(frozen=True)
class Planned:
    """How a sweep is computed on the machine that plans it.

    Attributes:
        tile: loops in a tile.
        loops: most samples of a chunk.
        devices: number of devices.
        engine: that simulates.
        digest: of the model, empty for a built-in plant.
        platform: "cpu" or "gpu".
        device: what the devices are, in words.
        memory: bound for the process [bytes].
        peak: expected [bytes].
        seconds: expected, of the loops.
        startup: least time before the first of them [s]; compiling takes longer.
        measured: whether that rests on what was measured on this machine.
    """

    tile: int
    loops: int
    devices: int
    engine: str
    digest: str
    platform: str
    device: str
    memory: int
    peak: int
    seconds: float
    startup: float
    measured: bool

    def layout(self, samples: Samples) -> Layout:
        """How the samples are cut into chunks."""
        return layout.cut(samples.shape, self.loops)


def plan(
    specification: Specification,
    samples: Samples,
    *,
    budget: int | None = None,
    say: Callable[[str], None] | None = None,
) -> Planned:
    """Plan a sweep on the devices of this process.

    Args:
        specification: checked.
        samples: expanded from it.
        budget: memory that the process may take [bytes]; None: a quarter of what is free.
        say: told when tiles are measured; None: none are.

    Raises:
        UserError: as `jaxact.simulation.plans.groups`, and if the memory does not suffice.
    """
    import jax

    from jaxact.simulation import engines, plans
    from jaxact.sweeping import throughput

    if of_margins(specification):
        return _of_margins(specification, samples, budget)
    coordinates = sum(array.nbytes for array in samples.along.values() if array.size > 1)
    each = memory.per_loop(
        len(samples.along),
        len(variables_of(specification)),
        8 if specification.precision == "float64" else 4,
    )
    case = plans.groups(specification, samples)[0].case
    base = case.engine.memory
    if budget is None:
        budget = max(int(memory.SHARE * memory.free()), memory.least(base, coordinates, each))
    most = memory.most_loops(budget, base, coordinates, each)
    best = throughput.best_tile(specification, samples, say=say)
    specification = dataclasses.replace(specification, tile=best or specification.tile)
    # a tile is not cut by the end of a batch
    tile = min(engines.tile_size(specification), most, max(1, len(samples)))
    specification = dataclasses.replace(specification, tile=tile)
    groups = plans.groups(specification, samples)
    devices = groups[0].devices
    second = engines.batch_size(groups[0].case, tile, devices)
    # long sweeps in longer chunks, so that writing files does not count
    longer = min(max(len(samples) // (_CHUNKS * second), 1), _LONGEST)
    loops = min(second * longer, most)
    seconds, measured = throughput.seconds(groups, specification, len(samples))
    device = jax.local_devices()[0]
    return Planned(
        tile=tile,
        loops=loops,
        devices=devices,
        engine=case.engine.name,
        digest=groups[0].case.model,
        platform="cpu" if jax.default_backend() == "cpu" else "gpu",
        device=f"{jax.local_device_count()} x {device.platform} ({device.device_kind})",
        memory=budget,
        peak=base + 4 * coordinates + min(loops, len(samples)) * each,
        seconds=seconds,
        startup=throughput.startup(groups),
        measured=measured,
    )


def _of_margins(specification: Specification, samples: Samples, budget: int | None) -> Planned:
    """Plan a sweep of margins, as `plan`."""
    from jaxact.simulation import plans
    from jaxact.sweeping import margins_computer

    engine = specification.simulator
    assert engine is not None and engine.rates is not None
    asked = margins_computer.linearised(specification)
    case = plans.groups(asked, samples)[0].case
    processes = margins_computer.processes(specification)
    coordinates = sum(array.nbytes for array in samples.along.values() if array.size > 1)
    results = len(variables_of(specification)) * 8
    beside = margins_computer.helping_processes(specification, len(samples))
    least = (1 + beside) * (engine.memory + 4 * coordinates + _OF_ROBOT)
    if budget is None:
        budget = max(int(memory.SHARE * memory.free()), least)
    loops = int(engine.work) * processes
    if budget < least + loops * results:
        raise UserError(
            f"memory: {memory.text(budget)} are too little; this sweep needs at least"
            f" {memory.text(least + loops * results)}"
        )
    return Planned(
        tile=min(specification.tile or engine.tiles[0], max(1, len(samples))),
        loops=loops,
        devices=processes,
        engine=engine.name,
        digest=case.model,
        platform="cpu",
        device=f"{processes} x cpu",
        memory=budget,
        peak=least + min(loops, len(samples)) * results,
        seconds=len(samples) / (engine.rates[0] * processes),
        startup=engine.startup,
        measured=False,
    )


def identity(
    specification: Specification, planned: Planned, layout: Layout, **more: object
) -> dict[str, object]:
    """What a sweep that continues another must share with it, and how that one is cut up.

    The number of devices and the place of a model change nothing in the results.
    """
    document = {
        name: value
        for name, value in specification.document.items()
        if name not in ("devices", "tile", "model", "engine")
    }
    if "plant" in document:
        places = ("model", "gains")  # what is in them is in the digest
        document["plant"] = {k: v for k, v in document["plant"].items() if k not in places}
    found = {
        "specification": document,
        "engine": planned.engine,
        "model": planned.digest,
        "platform": planned.platform,
        "versions": numeric_versions(planned.engine),
        **more,
        **({"shaking_rate": True} if specification.robot else {}),
        **({KIND: True} if of_margins(specification) else {}),
        "tile": planned.tile,
        "precision": specification.precision,
        "shape": list(layout.shape),
        "chunk": list(layout.chunk),
    }
    return dict(json.loads(as_json(found)))


# Keys of an identity that a sweep takes over from the one it continues.
TAKEN_OVER = ("tile", "loops", "precision", "shape", "chunk")
