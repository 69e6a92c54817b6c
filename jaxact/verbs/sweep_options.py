"""How a sweep is run: who plans and computes it, in which engine, and what it would take."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterator

from jaxact.engines import AUTO, names
from jaxact.errors import UserError
from jaxact.loops.samples import Samples, expand
from jaxact.loops.specification import Specification
from jaxact.sweeping import adaptive as _adaptive
from jaxact.sweeping import fill, memory, planning, store, throughput
from jaxact.sweeping.execution import SweepOptions
from jaxact.sweeping.location import Location
from jaxact.sweeping.planning import Planned
from jaxact.sweeping.progress import duration
from jaxact.sweeping.variables import variables_of

Say = Callable[[str], None]
"""Told what is measured before a long sweep."""
WORKERS = ("local", "ray")
# Relative width to which the boundary is refined where none is given.
_WIDTH = 1e-3
# Loops that take so many times as long as the start at least make a time that can be told.
_MOSTLY_LOOPS = 20.0


def options(
    *, resume: bool, overwrite: bool, adaptive: bool = False, width: float | None = None
) -> SweepOptions:
    """The options of a sweep that do not depend on who computes it.

    Args:
        resume, overwrite, adaptive, width: as for `jaxact.sweep`.

    Raises:
        UserError: what cannot be had together.
    """
    if resume and overwrite:
        raise UserError("`resume` continues what is there, `overwrite` replaces it: give one")
    if width is not None and not adaptive:
        raise UserError(f"`width` {width:g}: is for `adaptive`")
    if width is not None and not 1e-9 <= width < 1.0:
        raise UserError(f"`width` {width:g}: allowed: from 1e-9 to below 1")
    found = SweepOptions(resume=resume, overwrite=overwrite)
    if not adaptive:
        return found
    return dataclasses.replace(found, width=_WIDTH if width is None else width)


@contextlib.contextmanager
def computed_by(
    how: SweepOptions,
    *,
    workers: str = "local",
    address: str | None = None,
    budget: str | None = None,
    say: Say | None = None,
) -> Iterator[SweepOptions]:
    """The options with who plans and computes; a Ray cluster stays attached meanwhile.

    Args:
        how: from `options`.
        workers, address: as for `jaxact.sweep`.
        budget: of memory.
        say: as for `jaxact.sweep`.
    """
    if workers not in WORKERS:
        raise UserError(f"`workers` {workers}: allowed: {', '.join(WORKERS)}")
    if address is not None and workers != "ray":
        raise UserError(f"`address` {address}: is for `workers` ray")
    most = None if budget is None else memory.read_size(budget)
    if workers == "local":
        own = functools.partial(planning.plan, budget=most, say=say)
        here = fill.here if say is None else functools.partial(fill.here, keep=throughput.keep)
        yield dataclasses.replace(how, planner=own, workers=here)
        return
    from jaxact.sweeping import cluster

    with cluster.attached(address) as attached:
        there = functools.partial(attached.plan, budget=most)
        yield dataclasses.replace(how, planner=there, workers=attached.work)


def settled(
    asked: Specification, location: Location | None, how: SweepOptions, say: Say | None = None
) -> Specification:
    """The specification with an engine in place of "auto": a sweep that goes on keeps its own.

    Args:
        asked: checked.
        location: of the results, None where they are not kept.
        how: to run it.
        say: as for `jaxact.sweep`.
    """
    if asked.engine != AUTO:
        return asked
    engine = None
    with contextlib.suppress(OSError):  # said when the sweep begins
        if how.resume and location is not None:
            engine = (store.identity_of(location.inside(store.STORE)) or {}).get("engine")
    if engine not in names(robot=True):
        engine = throughput.fastest(asked, expand(asked), say=say)
    return dataclasses.replace(asked, engine=engine)


def forecast(asked: Specification, how: SweepOptions) -> str:
    """What a sweep would take, in a few lines: loops, chunks, memory, disk and time.

    Args:
        asked: checked, with an engine.
        how: from `computed_by`.
    """
    samples = expand(asked)
    planned: Planned = how.planner(asked, samples)
    layout = planned.layout(samples)
    count = len(layout)
    first = f"{len(samples):,} loops" + _shape(samples)
    if how.width is not None:
        grid = _adaptive.lattice(asked, how.width)
        fine = " x ".join(f"{n:,}" for n in grid.shape)
        first += f", refined to a grid of {fine} at the boundary"
    size = sum(layout.loops * (1 if name == "verdict" else 4) for name in variables_of(asked))
    if asked.precision == "float64":
        size *= 2
    basis = "measured on this machine" if planned.measured else "roughly; nothing measured here yet"
    return "\n".join(
        [
            first,
            f"{count:,} chunk{'' if count == 1 else 's'} of up to {layout.loops:,} loops,"
            f" in tiles of {planned.tile:,} on {planned.device}",
            f"memory: about {memory.text(planned.peak)} of {memory.text(planned.memory)} allowed;"
            f" on disk: {memory.text(size * len(layout))}",
            _time(planned, basis),
        ]
    )


def _time(planned: Planned, basis: str) -> str:
    """How long it takes; where starting may take longer than the loops, at least how long."""
    whole = duration(planned.startup + planned.seconds)
    if planned.seconds > _MOSTLY_LOOPS * planned.startup:
        return f"time: about {whole} ({basis})"
    return (
        f"time: at least {whole}: {duration(planned.seconds)} for the loops ({basis}), the rest to "
        "start; compiling what has not been compiled before takes longer"
    )


def _shape(samples: Samples) -> str:
    sizes = (f"{name} {n:,}" for name, n in zip(samples.dims, samples.shape, strict=True))
    return f" ({' x '.join(sizes)})"
