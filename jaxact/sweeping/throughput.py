"""How fast this machine computes loops, by the tile's size: measured, kept, and used to choose it.

Every finished sweep leaves its own rate, from which the time of the next of its kind (plant, model,
drive, precision, device) is foretold. Where a sweep is long enough for it to pay, the tiles around
the engine's usual one are measured first, and the fastest is taken. A sweep's tile is part of its
store, so that this never changes one that is resumed.
"""

from __future__ import annotations

import hashlib
import os
import platform
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxact.engines import AUTO, ROBOT_IN_MJX
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.simulation import engines, execute, plans
from jaxact.simulation.plans import Plan
from jaxact.simulation.spectra import Rates
from jaxact.sweeping import cache

# Tiles that are measured, as factors on the usual one.
_FACTORS = (0.5, 1.0, 2.0, 4.0)
# Physics steps of a rollout that is measured.
_STEPS = 400

# What a rate is of: whole sweeps, growth rates and files included, or rollouts only.
SWEEPS, ROLLOUTS = "sweeps", "rollouts"


def curve(plan: Plan, specification: Specification, what: str = SWEEPS) -> dict[int, float]:
    """Physics steps per second on one device, by the loops in a tile, as far as measured here."""
    found = cache.read_rates().get(_kind(plan, specification, what), {})
    try:
        return {int(tile): float(rate) for tile, rate in found.items()}
    except (AttributeError, TypeError, ValueError):
        return {}


def keep(plan: Plan, specification: Specification, rate: float, what: str = SWEEPS) -> None:
    """Keep a measured rate [physics steps per second on one device] of the plan's tile."""
    rates = cache.read_rates()
    kind = _kind(plan, specification, what)
    known = rates[kind] if isinstance(rates.get(kind), dict) else {}
    rates[kind] = known | {str(plan.tile): float(f"{rate:.4g}")}
    cache.write_rates(rates)


def seconds(groups: list[Plan], specification: Specification, loops: int) -> tuple[float, bool]:
    """Estimated time of a sweep [s], and whether it rests on what was measured on this machine."""
    plan = groups[0]
    known = curve(plan, specification)
    rate = known.get(plan.tile) or max(known.values(), default=0.0)
    measured = rate > 0.0
    if not measured:
        rate = engines.usual_rate(plan.case)
    return loops * plan.steps / (rate * plan.devices), measured


def startup(groups: list[Plan]) -> float:
    """Least time of a sweep beside its loops [s]: start, posture, programs that are kept.

    Where programs must be compiled anew it takes several times as long, a robot's in MJX minutes.
    """
    return groups[0].case.engine.startup


def best_tile(
    specification: Specification, samples: Samples, *, say: Callable[[str], None] | None
) -> int | None:
    """The fastest tile of a kind of sweep on this machine; None: the engine's usual one.

    Measures only where the sweep is long and nothing is known yet.

    Args:
        specification, samples: of the sweep.
        say: told when measuring begins; None: nothing is measured.
    """
    if specification.tile is not None:
        return None
    plan = plans.groups(specification, samples)[0]
    known = curve(plan, specification, ROLLOUTS)
    if len(known) < len(_FACTORS):
        if say is None:
            return None
        estimate, _ = seconds([plan], specification, len(samples))
        if estimate < plan.case.engine.worth:
            return None
        say("measuring the best tile")
        known |= _measured(plan, specification, samples)
    return max(known, key=lambda tile: known[tile])


def fastest(
    specification: Specification, samples: Samples, *, say: Callable[[str], None] | None
) -> str:
    """The engine that `engine = "auto"` comes to on this machine.

    The one that is expected to be it: MJX where `jaxact.simulation.engines.compiling_pays` says so,
    else C MuJoCo. On a GPU, if the sweep is so long that compiling pays, each engine that can
    simulate the robot is measured on short rollouts, once on a machine.

    Args:
        specification, samples: of the sweep.
        say: told when measuring begins; None: nothing is measured.

    Raises:
        UserError: as `jaxact.simulation.engines.resolved`.
    """
    usual = engines.resolved(specification)
    if specification.engine != AUTO or not specification.robot:
        return usual.engine
    first = plans.groups(usual, samples)[0]
    steps = len(samples) * first.steps
    if _unsure() and not engines.compiling_pays(usual, steps, first.devices):
        return usual.engine
    able = engines.able(specification)
    if ROBOT_IN_MJX.name in able and engines.compiling_pays(usual, steps, first.devices):
        usual = replace(usual, engine=ROBOT_IN_MJX.name)
        first = plans.groups(usual, samples)[0]
    if not _unsure():
        return usual.engine
    rates: dict[str, float] = {}
    for engine in able:
        one = replace(specification, engine=engine)
        plan = plans.groups(one, samples)[0]
        known = curve(plan, one, ROLLOUTS)
        if not known:
            if say is None or seconds([plan], usual, len(samples))[0] < first.case.engine.worth:
                return usual.engine
            say(f"measuring engine {engine}")
            known = _measured(plan, one, samples, factors=(1.0,))
        rates[engine] = max(known.values())
    return max(rates, key=lambda engine: rates[engine], default=usual.engine)


def _unsure() -> bool:
    """Whether measuring may find a faster engine than the one expected.

    On a CPU it would not have for any of ten robots, from a mass to a humanoid, and compiles for up
    to a minute.
    """
    import jax

    return jax.default_backend() != "cpu"


def _measured(
    plan: Plan,
    specification: Specification,
    samples: Samples,
    factors: tuple[float, ...] | None = None,
) -> dict[int, float]:
    """Rates of the tiles around the usual one, measured on short rollouts."""
    found = {}
    for factor in factors or _FACTORS:
        tile = max(1, int(plan.tile * factor))
        ticks = max(4, min(plan.case.rollout.ticks, _STEPS // plan.case.drive.substeps) // 4 * 4)
        case = replace(plan.case, rollout=replace(plan.case.rollout, ticks=ticks))
        tiles = max(1, 4 * max(1, int(plan.tile * max(_FACTORS))) // tile)
        short = Plan(case, plan.rates, tile, tiles, plan.devices)
        numbers = np.arange(short.batch) % len(samples)
        rates = Rates(np.zeros(short.batch))
        spent = []
        for _ in range(3):
            begun = time.perf_counter()
            execute.simulate_batch(short, specification, samples, numbers, rates)
            spent.append(time.perf_counter() - begun)
        found[tile] = short.batch * short.steps / min(spent) / plan.devices
        keep(short, specification, found[tile], ROLLOUTS)
    return found


def _kind(plan: Plan, specification: Specification, what: str) -> str:
    """What rates can be compared: plant, model, parts of the drive, precision, device."""
    import jax

    device = jax.local_devices()[0]
    parts = repr((plan.case.drive, plan.case.model, plan.case.masked)).encode()
    words = (
        what, plan.case.engine.name, specification.precision, device.device_kind,
        platform.machine(), str(os.cpu_count()), jax.__version__,
        hashlib.sha256(parts).hexdigest()[:12],
    )  # fmt: skip
    return " ".join(words)
