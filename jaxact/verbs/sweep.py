"""`jaxact.sweep`: thousands to millions of loops over a grid or a sample of their parameters."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from jaxact import engines
from jaxact.errors import UserError
from jaxact.loops import anew, reading
from jaxact.loops.axes import SPACINGS, Axis, check_range, read_axis
from jaxact.loops.control_loop import ControlLoop, demand, is_traced
from jaxact.loops.conversion import described, fixed_in, preset_axis
from jaxact.loops.samples import expand
from jaxact.loops.specification import Sampling, Specification
from jaxact.loops.weak_joints import tell_weak
from jaxact.parameters import ALIASES, PARAMETERS, WN, ZETA, canonical, known
from jaxact.simulation.clamping import tell_clamped
from jaxact.simulation.engines import tell_inexact
from jaxact.simulation.keyframe_velocity import tell_keyframe_velocity
from jaxact.sweeping import execution, location
from jaxact.verbs import showing
from jaxact.verbs.sweep_options import Say, computed_by, options, settled

if TYPE_CHECKING:
    import xarray as xr

Moved = Callable[[int, int], None]
"""Called with the number of loops done and in all."""


def log(low: float, high: float, num: int | None = None) -> dict[str, Any]:
    """A range of `num` values, evenly spaced in their logarithm; to be drawn from without `num`.

    Args:
        low, high: ends, included; above 0.
        num: number of values.

    Raises:
        UserError: ends or a number that make no range.
    """
    return _range(low, high, num, "log")


def linear(low: float, high: float, num: int | None = None) -> dict[str, Any]:
    """A range of `num` evenly spaced values; to be drawn from without `num`.

    Args:
        low, high: ends, included.
        num: number of values.

    Raises:
        UserError: ends or a number that make no range.
    """
    return _range(low, high, num, "linear")


def _range(low: float, high: float, num: int | None, spacing: str) -> dict[str, Any]:
    check_range(f"jaxact.{spacing}", low, high, num)
    number = {} if num is None else {"num": int(num)}
    return {"min": float(low), "max": float(high), **number, "spacing": spacing}


def sweep(
    loop: ControlLoop | Specification | str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    engine: str | None = None,
    duration: float | None = None,
    precision: str | None = None,
    seed: int | None = None,
    tile: int | None = None,
    devices: int | None = None,
    sampling: str | None = None,
    number: int | None = None,
    resume: bool = False,
    overwrite: bool = False,
    adaptive: bool = False,
    width: float | None = None,
    memory: str | None = None,
    workers: str = "local",
    address: str | None = None,
    say: Say | None = None,
    progress: bool | Moved = True,
    **axes: Any,
) -> xr.Dataset:
    """Simulate every loop of a grid or a sample of parameters.

        maps = jaxact.sweep(loop, kp=jaxact.log(10, 1e5, 64), kd=jaxact.log(0.1, 2e3, 64))

    Args:
        loop: from `jaxact.joint` or `jaxact.robot`; parameters of it that have several values, each
            along one dimension, are axes too. Or a specification, read, or a path to one.
        out: folder or URL to keep the results in, chunk by chunk; None to keep them in memory only.
        engine: "mass" or "mjx" of a joint, "mjx", "mujoco", "warp" or "auto" of a robot; "linear"
            computes the margins of a robot, linearised at its posture, and simulates nothing.
        duration: simulated time [s], 2 where nothing is given.
        precision: "float32" (the default) or "float64", of the rollouts.
        seed: of noise and of sampling.
        tile, devices: loops simulated at once, and local devices used; None: chosen.
        sampling: "sobol" or "latin-hypercube" draws `number` points from ranges without `num`.
        number: of points drawn.
        resume: continue what is in `out`.
        overwrite: replace it.
        adaptive: refine around the stability boundary only, from the grid given.
        width: relative width to which it does, 0.001 where none is given.
        memory: most to take, e.g. "4G"; None: a quarter of what is free.
        workers: "local", all devices of this machine, or "ray", a Ray cluster (jaxact[ray]).
        address: of that cluster, "auto" for the one this machine belongs to; None: a new one.
        say: told what is measured before a long sweep, to plan it and to choose its engine; what
            comes of it is kept for the next. None: nothing is measured.
        progress: show a bar on a terminal and in a notebook; or a function that is called with the
            numbers of loops done and in all.
        axes: parameter, by either name, or `actuator` -> what it is varied over: a list, a tuple or
            an array of its values, each of them a loop, or a range from `jaxact.log` or
            `jaxact.linear`: `kp=(100, 400)` are two values, not what lies between them. They count
            before what the loop has of the same parameters, that of some joints as well.

    Returns:
        The results as the command line keeps them: growth rate, verdict and metrics over the axes
        (of the engine "linear" margins by the names of `jaxact.margins`, NaN where a robot is
        unstable), with units, the specification and versions; in memory, or read lazily from `out`.

    Raises:
        UserError: parameters that do not fit each other, and as `jaxact.sweeping.execution.sweep`.
        TypeError: the loop is traced.
    """
    showing.check(progress)
    own = {"engine": engine, "duration": duration, "precision": precision, "seed": seed,
               "tile": tile, "devices": devices}  # fmt: skip
    given = {name: value for name, value in own.items() if value is not None}
    drawn = None if sampling is None and number is None else _sampling(sampling, number)
    asked = _asked(loop, axes, given, drawn)
    how = options(resume=resume, overwrite=overwrite, adaptive=adaptive, width=width)
    if out is not None and not os.fspath(out):
        raise UserError("`out` is empty; name a folder, or give None to keep the results in memory")
    if out is None and (resume or overwrite):
        raise UserError("resume and overwrite are for results that are kept; give out")
    where = None if out is None else location.at(os.fspath(out))
    asked = settled(asked, where, how, say if workers == "local" else None)
    if asked.engine == engines.ROBOT_IN_MJX.name:
        tell_inexact(asked.plant)
    if asked.plant is not None:
        along = expand(asked).along
        tell_clamped(asked, along)
        tell_keyframe_velocity(asked)
        tell_weak(asked.plant, along)
    from jaxact.verbs import results  # with xarray, which is slow to import

    by = computed_by(how, workers=workers, address=address, budget=memory, say=say)
    with by as how, _shown(progress) as moved:
        how = dataclasses.replace(how, moved=moved)
        if where is not None:
            return results.opened(execution.sweep(asked, where, how).location)
        with tempfile.TemporaryDirectory(prefix="jaxact-") as folder:
            filled = execution.sweep(asked, location.at(Path(folder) / "results"), how)
            return results.loaded(results.opened(filled.location))


def _sampling(method: str | None, number: int | None) -> Sampling:
    try:
        count = 1024 if number is None else number
        return Sampling(method=method or "sobol", samples=count)  # type: ignore[arg-type]
    except ValidationError as error:
        raise UserError(reading.explained(error, "sampling.")) from None


def _asked(
    loop: ControlLoop | Specification | str | os.PathLike[str],
    axes: Mapping[str, Any],
    options: dict[str, Any],
    sampling: Sampling | None,
) -> Specification:
    """The checked specification of a sweep."""
    if isinstance(loop, ControlLoop):
        return _of_loop(loop, axes, options, sampling)
    if not isinstance(loop, Specification | str | os.PathLike):
        demand(loop)
    own = loop if isinstance(loop, Specification) else reading.load(Path(loop))
    drawn = own.sampling if sampling is None else sampling
    named = _read(axes, drawn)
    varied = anew.over({axis.name: axis for axis in own.axes}, named)
    fixed = {name: v for name, v in own.parameters.items() if not anew.replaced(name, named)}
    changed = {"parameters": fixed, "axes": tuple(varied.values()), "sampling": drawn, **options}
    fields = {f.name: getattr(own, f.name) for f in dataclasses.fields(own)}
    return described(**(fields | changed))


def _of_loop(
    loop: ControlLoop, axes: Mapping[str, Any], options: dict[str, Any], sampling: Sampling | None
) -> Specification:
    demand(loop)
    if is_traced(loop):
        raise TypeError("a sweep cannot be traced; call it outside jit and grad")
    engines.check_name(options.get("engine"), robot=loop.kind.plant is not None, margins=True)
    named = _read(axes, sampling)
    preset = {WN, ZETA} if "actuator" in named else set()
    values = {
        name: value
        for name, value in loop.values.items()
        if name not in preset and not anew.replaced(name, named)
    }
    fixed = fixed_in(values)
    varied = _own_axes({n: np.asarray(v, float) for n, v in values.items() if np.ndim(v)}, named)
    if not varied and not named:
        raise UserError("nothing varies; give an axis, e.g. kp = jaxact.log(10, 1e5, 64)")
    options.setdefault("engine", engines.MASS.name if loop.kind.plant is None else "auto")
    return described(
        **loop.kind.specified, **options, parameters=fixed, axes=tuple((varied | named).values()),
        sampling=sampling,
    )  # fmt: skip


def _own_axes(arrays: Mapping[str, np.ndarray], named: Mapping[str, Axis]) -> dict[str, Axis]:
    """Axes of the parameters of which the loop has several values."""
    free = {name: array for name, array in arrays.items() if name not in named}
    preset = preset_axis(free)
    if preset is not None:
        free = {name: array for name, array in free.items() if name not in (WN, ZETA)}
    shapes = [array.shape for array in free.values()] + ([] if preset is None else [preset.shape])
    together = len(np.broadcast_shapes(*shapes)) if shapes else 0
    places = [int(np.argmax(np.array(shape))) - len(shape) for shape in shapes]
    if any(sum(size > 1 for size in shape) > 1 for shape in shapes) or (
        together and len(set(places)) < len(places)
    ):
        raise UserError(
            "several parameters of the loop vary along the same dimension; give each as an axis of"
            " its own, e.g. kp = jaxact.log(10, 1e5, 64)"
        )
    found = {} if preset is None else {"actuator": read_axis("actuator", preset.ravel().tolist(),
                                                             sampled=False)}  # fmt: skip
    return found | {
        name: read_axis(name, array.ravel().tolist(), sampled=False) for name, array in free.items()
    }


def _read(axes: Mapping[str, Any], sampling: Sampling | None) -> dict[str, Axis]:
    """Axes as they are given, by short name."""
    found = {}
    for given, value in axes.items():
        name = canonical(given)
        if not known(name) and name != "actuator":
            from jaxact.errors import nearest

            also = (*ALIASES, *(sweep.__kwdefaults__ or ()))
            known_names = nearest(given, (*PARAMETERS, "actuator"), also)
            raise UserError(f"{given}: unknown parameter; {known_names}")
        if name in found:
            raise UserError(f"{given}: the same parameter is given twice; remove one")
        listed = value if isinstance(value, dict) else _listed(given, value)
        ranged = isinstance(value, dict) and "num" not in value
        if ranged and sampling is None and value.get("spacing") in SPACINGS:
            low, high, spacing = value.get("min"), value.get("max"), value["spacing"]
            raise UserError(
                f"{given}: how many values? Write jaxact.{spacing}({low:g}, {high:g}, 5), or have"
                ' points drawn from the range: `sampling="sobol"`'
            )
        found[name] = read_axis(name, listed, sampled=sampling is not None and ranged)
    return found


def _listed(name: str, value: Any) -> list[Any]:
    nested = isinstance(value, list | tuple) and any(np.ndim(one) for one in value)
    if nested or np.ndim(value) > 1:
        raise UserError(f"{name}: an axis is a list of values, not of lists")
    return value if isinstance(value, list) else np.ravel(np.asarray(value)).tolist()


@contextlib.contextmanager
def _shown(progress: bool | Moved) -> Iterator[Moved]:
    """A function that shows how many loops are done, where somebody can see it."""
    if callable(progress):
        yield progress
        return
    if not progress or not showing.seen():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    console = Console(stderr="ipykernel" not in sys.modules)
    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as shown:
        task = shown.add_task("simulating", total=None)
        yield lambda done, total: shown.update(task, completed=done, total=total)
