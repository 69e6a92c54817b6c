"""`jaxact.simulate`: loops over time, with every physics step kept, and their metrics."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.engines import ROBOT_IN_MJX, best_precision, check_name
from jaxact.errors import UserError
from jaxact.loops import conversion
from jaxact.loops.control_loop import ControlLoop, demand
from jaxact.loops.samples import Samples
from jaxact.loops.weak_joints import tell_weak
from jaxact.simulation import engines, single
from jaxact.simulation.clamping import tell_clamped
from jaxact.simulation.keyframe_velocity import tell_keyframe_velocity
from jaxact.status import Verdict
from jaxact.sweeping.variables import VARIABLES
from jaxact.units import joint_units
from jaxact.verbs import run_tables
from jaxact.verbs.run_tables import SIGNALS

if TYPE_CHECKING:
    import xarray as xr

    from jaxact.simulation.single import Joint, Single


def simulate(
    loop: ControlLoop,
    setpoint: Any = None,
    duration: float = 1.0,
    *,
    engine: str | None = None,
    precision: str | None = None,
    seed: int = 0,
) -> xr.Dataset:
    """Simulate a loop, or the loops of a small batch, and keep their trajectories.

        run = jaxact.simulate(jaxact.joint(actuator="starleth", delay=5e-3), setpoint=0.1)
        run.position.plot()

    Args:
        loop: from `jaxact.joint` or `jaxact.robot`; loops of a batch need the same physics step.
        setpoint: height of the step at time 0 [m or rad], or amplitude of a robot's motion, a
            number or an array that broadcasts; None for the loop's own. What a position servo of a
            robot's model does not accept is clamped, with an `InexactWarning`.
        duration: simulated time [s].
        engine: of a joint "mass" (exact, the default) or "mjx"; of a robot "mujoco", "mjx", "warp"
            or "auto" (the default), the one expected to be the fastest.
        precision: "float64" (the default; of "warp" "float32") or "float32".
        seed: of noise.

    Returns:
        A dataset over the batch's dimensions: `position`, `velocity`, `setpoint`, `command`,
        `delayed_command` and `force` over `time` [s], of a robot also over `joint`; and the metrics
        of a sweep, `verdict` among them (see its `flag_meanings`). Units are attributes; of a
        single loop `report` is the command line's table, with what came of each start.

    Raises:
        UserError: parameters that do not fit each other, or a robot that cannot be simulated.
        TypeError: the loop is traced.
    """
    demand(loop)
    if setpoint is not None:
        loop = loop.replace(setpoint=setpoint)
    found = runs(loop, duration=duration, engine=engine, precision=precision, seed=seed)
    return _dataset(loop, found)


def runs(
    loop: ControlLoop,
    *,
    duration: float = 1.0,
    engine: str | None = None,
    precision: str | None = None,
    seed: int = 0,
) -> list[Single]:
    """As `simulate`, one result for each loop of the batch, with what came of each start.

    Args:
        loop, duration, engine, precision, seed: as for `simulate`.
    """
    check_name(engine, robot=loop.kind.plant is not None)
    options: dict[str, Any] = {"duration": duration, "seed": seed}
    if engine is not None:
        options["engine"] = engine
    options["precision"] = precision or best_precision(engine)
    asked = engines.resolved(conversion.specification(loop, **options))
    if asked.engine == ROBOT_IN_MJX.name:
        engines.tell_inexact(asked.plant)
    samples = conversion.samples(loop)
    tell_clamped(asked, samples.along)
    tell_keyframe_velocity(asked)
    tell_weak(asked.plant, samples.along)
    return single.simulate_all(asked, samples)


def _dataset(loop: ControlLoop, runs: list[Single]) -> xr.Dataset:
    from jaxact.verbs import results  # with xarray, which is slow to import

    samples = _renamed(conversion.samples(loop))
    shape = loop.shape
    dims = samples.dims if shape else ()
    time = np.asarray(runs[0].trajectory.time)
    if any(not np.array_equal(time, run.trajectory.time) for run in runs):
        raise UserError(
            "control_rate: loops with different steps have trajectories of different lengths;"
            " simulate them one by one"
        )
    joints = runs[0].joints
    many = loop.kind.plant is not None
    own = (*dims, "time", "joint") if many else (*dims, "time")
    variables: dict[str, Any] = {}
    for name, (slide, hinge, words) in SIGNALS.items():
        rows = np.stack([np.asarray(getattr(run.trajectory, name)) for run in runs])
        rows = rows if many else rows[..., 0]
        about = {"units": _unit(slide, hinge, joints), "long_name": words}
        variables[name] = (own, rows.reshape((*shape, *rows.shape[1:])), about)
    variables |= _metrics(runs, dims, shape)
    coords: dict[str, Any] = {"time": ("time", time, {"units": "s"})}
    if many:
        coords["joint"] = [joint.name for joint in joints]
    if shape:
        coords |= {
            name: (place.dims, place.values, place.attributes)
            for name, place in samples.coords.items()
        }
    attributes = {} if shape else {"report": run_tables.text(runs[0])}
    return results.dataset(variables, coords, attributes)


def _renamed(samples: Samples) -> Samples:
    """The same without a dimension that has the name of a signal."""

    def name(dim: str) -> str:
        return f"{dim}_height" if dim in SIGNALS else dim

    coords = {
        name(key): dataclasses.replace(place, dims=tuple(name(dim) for dim in place.dims))
        for key, place in samples.coords.items()
    }
    return dataclasses.replace(samples, dims=tuple(map(name, samples.dims)), coords=coords)


def _metrics(runs: list[Single], dims: tuple[str, ...], shape: tuple[int, ...]) -> dict[str, Any]:
    rotary = runs[0].rotary
    found = {}
    for name in (name for name in VARIABLES if name in runs[0].results):
        about = VARIABLES[name]
        values = np.array([run.results[name] for run in runs])
        attributes: dict[str, Any] = {
            "units": joint_units(about.units, rotary), "long_name": about.long_name,
            "description": about.description,
        }  # fmt: skip
        if name == "verdict":
            values = values.astype(np.int8)
            attributes["flag_values"] = [int(verdict) for verdict in Verdict]
            attributes["flag_meanings"] = " ".join(
                verdict.label.replace(" ", "_") for verdict in Verdict
            )
        found[name] = (dims, values.reshape(shape), attributes)
    return found


def _unit(slide: str, hinge: str, joints: tuple[Joint, ...]) -> str:
    kinds = {joint.rotary for joint in joints}
    return f"{hinge} or {slide}" if len(kinds) > 1 else hinge if True in kinds else slide
