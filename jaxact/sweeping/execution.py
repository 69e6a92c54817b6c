"""A sweep from its specification to a finished store: lock, resume, compute, complete."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from jaxact.errors import UserError
from jaxact.loops.samples import Samples, expand
from jaxact.loops.specification import Specification
from jaxact.sweeping import adaptive, fill, integrity, lock, opening, planning, progress
from jaxact.sweeping import store as _store
from jaxact.sweeping.fill import Workers
from jaxact.sweeping.location import Folder, Location
from jaxact.sweeping.planning import Planned
from jaxact.sweeping.progress import Store
from jaxact.sweeping.summary import summary

Planner = Callable[[Specification, Samples], Planned]


@dataclass(frozen=True)
class SweepOptions:
    """How a sweep is run; nothing of it changes the results of a grid.

    Attributes:
        resume: continue what is in the folder.
        overwrite: replace it.
        width: relative width to which the stability boundary is refined; None: the whole grid.
        planner: plans on the machine that computes.
        workers: compute.
        moved: called with the number of loops done and in all.
    """

    resume: bool = False
    overwrite: bool = False
    width: float | None = None
    planner: Planner = planning.plan
    workers: Workers = fill.here
    moved: Callable[[int, int], None] = lambda done, total: None


def sweep(specification: Specification, folder: Location, how: SweepOptions) -> Store:
    """Run a sweep to its end.

    Whatever ends it early, the chunks that are done stay; before the first one is, nothing is
    touched, and an old store that is to be replaced stays.

    Args:
        specification: checked.
        folder: of the results, made if it is not there; the store is `sweep.zarr` in it.
        how: to run it.

    Raises:
        UserError: the folder holds another sweep, another process fills it, or it cannot be
            written; and as `jaxact.sweeping.planning.plan`.
    """
    target = folder.inside(_store.STORE)
    try:
        _refuse_existing(folder, how)
    except OSError as error:
        raise UserError(_store.unwritable(target.name, error)) from error
    with _locked(folder):
        _refuse_existing(folder, how)
        samples = expand(specification)
        try:
            if how.width is None:
                store = _grid(folder, specification, samples, how)
            else:
                store = adaptive.refine(folder, specification, samples, how.width, how)
            complete(store)
            _tidy(folder)
        except OSError as error:
            raise UserError(_full(target, error)) from error
    return store


def _grid(
    folder: Location, specification: Specification, samples: Samples, how: SweepOptions
) -> Store:
    target, rounds = folder.inside(_store.STORE), folder.inside(adaptive.ROUNDS)

    def clear() -> None:
        if adaptive.are_rounds(rounds):
            rounds.remove()
        target.remove()

    return fill.fill(
        target, specification, samples, how.planner(specification, samples),
        workers=how.workers, resume=how.resume, clear=clear, moved=how.moved,
    )  # fmt: skip


def complete(store: Store) -> None:
    """Put the mark of completion and the summary on a store whose chunks are all done.

    Raises:
        UserError: one is not: somebody has removed it meanwhile.
    """
    root = _store.attributes_of(store.location) or {}
    if root.get("complete"):
        return
    entries = store.location.entries()
    numbers = range(len(store.layout))
    integrity.refuse(
        store.location, integrity.lost(numbers, (store.glance(n, entries) for n in numbers))
    )
    store.finish({"complete": True, "summary": summary(opening.opened(store.location))})


def _tidy(folder: Location) -> None:
    """Remove what killed processes have left beside a complete store."""
    folder.inside(_store.STORE).clean()
    rounds = folder.inside(adaptive.ROUNDS)
    if adaptive.are_rounds(rounds):
        rounds.remove()
        rounds.clean()


def _refuse_existing(folder: Location, how: SweepOptions) -> None:
    """Raise UserError unless a store may be begun, continued or replaced there."""
    target, rounds = folder.inside(_store.STORE), folder.inside(adaptive.ROUNDS)
    there, begun = _is_there(target), bool(rounds.entries())
    if begun and not adaptive.are_rounds(rounds):
        if how.width is not None:
            raise UserError(
                f"{rounds.name}: exists and is nothing of a sweep, so it stays; give another `out`"
            )
        begun = False
    if not there and not begun:
        return
    name = target.name if there else rounds.name
    if not how.resume and not how.overwrite:
        raise UserError(
            f"{name}: exists; continue it with `resume`, replace it with `overwrite`, or give"
            " another `out`"
        )
    if how.resume and not there and how.width is None:
        raise UserError(
            f"{name}: is of a sweep that was begun with `adaptive`; continue it with that, give"
            " another `out`, or `overwrite` to begin anew"
        )


def _is_there(target: Location) -> bool:
    """Whether there is a store of ours; raises UserError if there is anything else."""
    if isinstance(target, Folder):
        path = target.path
        foreign = path.is_symlink() or (path.exists() and not path.is_dir())
    else:
        foreign = False
    if not foreign and _store.is_ours(target):
        return True
    if foreign or target.entries():
        raise UserError(
            f"{target.name}: exists and is no result of a sweep, so it stays; give another `out`"
        )
    return False


@contextlib.contextmanager
def _locked(folder: Location) -> Iterator[None]:
    """Hold the folder; one that was made for it and stays empty is removed again."""
    made = [] if not isinstance(folder, Folder) else _missing(folder)
    try:
        try:
            if isinstance(folder, Folder):
                folder.path.mkdir(parents=True, exist_ok=True)
            held = contextlib.ExitStack()
            held.enter_context(lock.held(folder))
        except OSError as error:
            raise UserError(_full(folder.inside(_store.STORE), error)) from error
        with held:
            yield
    finally:
        for path in made:
            with contextlib.suppress(OSError):
                path.rmdir()


def _missing(folder: Folder) -> list[Path]:
    """The folder and its parents that are not there, innermost first."""
    return [path for path in (folder.path, *folder.path.parents) if not _there(path)]


def _there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:
        return False


def _full(target: Location, error: OSError) -> str:
    """What to say when the store could not be written any more."""
    reason = error.strerror or error
    store = progress.existing(target)
    if store is None:
        return _store.unwritable(target.name, error)
    done = len(progress.times(target.entries()))
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    mend = "make room" if full else "put that right"
    return (
        f"{target.name}: cannot be written ({reason}); {done} of {len(store.layout)} chunks are"
        f" kept: {mend}, then continue with `resume`"
    )
