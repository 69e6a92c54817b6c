"""What becomes of a loop: the loop of exact theory, and the specification and samples of a rollout.

The one place where delays are added up and parameters become the fields of another description.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import ValidationError

from jaxact import engines
from jaxact.analysis.joint.frequency import JointLoop
from jaxact.analysis.sampled.period_map import SampledLoop
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller
from jaxact.drive.options import Drive
from jaxact.drive.sensor import Sensor
from jaxact.errors import UserError
from jaxact.loops import checks
from jaxact.loops.axes import NO_AXIS, Axis
from jaxact.loops.control_loop import ControlLoop, is_traced
from jaxact.loops.given import ACTUATOR
from jaxact.loops.joint_ranges import RANGES
from jaxact.loops.joint_units import with_units
from jaxact.loops.reading import explained
from jaxact.loops.samples import Coordinate, Samples
from jaxact.loops.specification import Specification
from jaxact.parameters import (
    BIASES,
    COMMAND_RESOLUTION,
    CONTROL_RATE,
    DELAY,
    FEEDFORWARD,
    GAIN_SCALE,
    KD,
    KP,
    LIMITS,
    LOOP_DELAYS,
    MASS,
    MEASUREMENT_DELAY,
    NOISES,
    OF_JOINT,
    OUTPUT_DELAY,
    PARAMETERS,
    POLICY_RATE,
    POSITION_RESOLUTION,
    PRESETS,
    SETPOINT_DELAY,
    VELOCITY_FILTER,
    VELOCITY_RESOLUTION,
    WALKS,
    WN,
    ZETA,
    base,
    of,
)

# Fields of a sensor that are called as in the table.
_OF_SENSOR = (
    POSITION_RESOLUTION, VELOCITY_RESOLUTION, *NOISES, *BIASES, *WALKS, VELOCITY_FILTER,
)  # fmt: skip
# Rates must each fit the physics step; of what else varies the ends say enough.
_EACH_COUNTS = (CONTROL_RATE, POLICY_RATE)
_LOOP = {"long_name": "loop", "units": "1", "description": "Number of the loop."}


def within_bounds(values: Mapping[str, Any], names: Iterable[str]) -> jax.Array:
    """Where parameters are what they may be; traced ones cannot be refused. Of their shape.

    Args:
        values: parameters by key, numbers or arrays.
        names: the keys that are asked about.
    """
    known = jnp.asarray(True)
    for name in names:
        bounds, value = PARAMETERS[base(name)], values[name]
        inside = (value >= bounds.minimum) & (value <= bounds.maximum)
        known = known & (inside | (bounds.infinite & (value == jnp.inf)))
    return known


def total_delay(values: Mapping[str, Any]) -> Any:
    """The delay within the loop [s]: of command, measurement and output together.

    Args:
        values: parameters by short name, numbers or arrays.
    """
    return sum(values[name] for name in LOOP_DELAYS)


def drive_of(values: Mapping[str, Any]) -> Drive:
    """The drive with these parameters, by their short names; scalars or arrays alike.

    Ranges of a robot's joints (`RANGES`) are among them where its model has any.
    """
    return Drive(
        controller=Controller(
            kp=values[KP],
            kd=values[KD],
            feedforward=values[FEEDFORWARD],
            command_resolution=values[COMMAND_RESOLUTION],
            setpoint_delay=values[SETPOINT_DELAY],
            **{name: values[name] for name in RANGES[2:] if name in values},
        ),
        actuator=Actuator(
            natural_frequency=values[WN],
            damping_ratio=values[ZETA],
            delay=values[DELAY],
            **{name: values[name] for name in LIMITS},
            **{name: values[name] for name in RANGES[:2] if name in values},
        ),
        sensor=Sensor(
            delay=values[MEASUREMENT_DELAY], **{name: values[name] for name in _OF_SENSOR}
        ),
        output_delay=values[OUTPUT_DELAY],
        control_period=1.0 / values[CONTROL_RATE],
        policy_period=1.0 / values[POLICY_RATE],
    )


def continuous(values: Mapping[str, Any]) -> JointLoop:
    """The linear loop in continuous time, in the precision that JAX has at this moment.

    Args:
        values: parameters by short name, numbers or arrays that broadcast; may be traced.
    """
    cutoff = values[VELOCITY_FILTER]
    unfiltered = not isinstance(cutoff, jax.core.Tracer) and bool(np.isinf(cutoff).all())
    return JointLoop(
        kp=jnp.asarray(values[GAIN_SCALE] * values[KP], float),
        kd=jnp.asarray(values[GAIN_SCALE] * values[KD], float),
        mass=jnp.asarray(values[MASS], float),
        natural_frequency=jnp.asarray(values[WN], float),
        damping_ratio=jnp.asarray(values[ZETA], float),
        delay=jnp.asarray(total_delay(values), float),
        velocity_filter=None if unfiltered else jnp.asarray(cutoff, float),
        **{name: jnp.asarray(values[name], float) for name in own_motion(values)},
    )


def own_motion(values: Mapping[str, Any]) -> tuple[str, ...]:
    """The parameters of a joint that is not a bare mass; none where all are 0 and not traced.

    Nothing is computed for a bare mass of what it does not have.

    Args:
        values: parameters by short name; one that is missing is 0.
    """
    own = [values.get(name, 0.0) for name in OF_JOINT]
    bare = all(not isinstance(value, jax.core.Tracer) and not np.any(value) for value in own)
    return () if bare else tuple(name for name in OF_JOINT if name in values)


def sampled(values: Mapping[str, Any], velocity: str) -> SampledLoop:
    """The linear loop as its controller samples it, in the precision of this moment.

    Args:
        values: as for `continuous`.
        velocity: that the controller sees, "sampled" or "differenced".
    """
    own = {
        "control_period": jnp.asarray(1.0 / values[CONTROL_RATE], float),
        "velocity_filter": jnp.asarray(values[VELOCITY_FILTER], float),
    }
    return SampledLoop(**vars(continuous(values)) | own, velocity=velocity)


def specification(loop: ControlLoop, **options: Any) -> Specification:
    """The checked specification of a loop; of a batch, its varied parameters are axes of their
    ends.

    Args:
        loop: not traced.
        options: of the specification: engine, duration, precision, seed, tile, devices, ...

    Raises:
        UserError: values or options that do not fit each other.
        TypeError: the loop is traced.
    """
    if is_traced(loop):
        raise TypeError(
            "a robot, a simulation or a tuning cannot be traced: call it outside jit, vmap and "
            "grad; a batch (kp=[500, 600]) is computed at once"
        )
    fixed = fixed_in(loop.values)
    axes = tuple(_axis(name, np.asarray(v)) for name, v in loop.values.items() if np.ndim(v))
    options.setdefault("engine", engines.MASS.name if loop.kind.plant is None else "auto")
    return described(**loop.kind.specified, **options, parameters=fixed, axes=axes or (NO_AXIS,))


def fixed_in(values: Mapping[str, Any]) -> dict[str, float]:
    """The fixed parameters of a specification of a loop with these values.

    Of what varies for some joints the first value is among them, with its key in its place: which
    of several keys counts follows from their order.

    Args:
        values: by key, numbers or arrays.
    """
    return {
        name: float(np.ravel(v)[0]) for name, v in values.items() if not np.ndim(v) or "@" in name
    }


def linear_specification(loop: ControlLoop, **options: Any) -> Specification:
    """As `specification`, of a loop that is not going to be simulated: for any control rate.

    What moves the loop, a push or a motion of its setpoint, is left out: its margins are the same.
    """
    still = dataclasses.replace(loop.kind, motion=None, push=None)
    loop = dataclasses.replace(loop, kind=still)
    rates = loop.parameters[CONTROL_RATE]
    slowest = 1.0 if is_traced(loop) else float(np.min(rates))
    return specification(loop, duration=checks.shortest_duration(slowest), **options)


def described(**fields: Any) -> Specification:
    """The checked specification with these fields.

    Raises:
        UserError: values that do not fit their fields or each other.
    """
    try:
        made = Specification(**fields)
    except ValidationError as error:
        raise UserError(explained(error)) from None
    checks.check(made)
    return made


def _axis(name: str, values: np.ndarray) -> Axis:
    each = np.unique(values)
    if name not in _EACH_COUNTS:
        each = np.unique(each[[0, -1]])
    return Axis(name, listed=tuple(each.tolist()))


def samples(loop: ControlLoop) -> Samples:
    """The loops of a batch as the samples of a sweep, a single loop as one sample.

    A dimension along which a single parameter varies has its name, as that of presets is
    `actuator`; any other is `loop`, numbered where there are several.

    Args:
        loop: not traced.
    """
    shape = loop.shape or (1,)
    rank = len(shape)
    arrays = {
        name: np.asarray(value, float).reshape((1,) * (rank - np.ndim(value)) + np.shape(value))
        for name, value in loop.values.items()
    }
    dims, coords = _dimensions(arrays, shape, loop.kind.unit)
    nominal = Specification(plant=loop.kind.plant).nominal
    along = {name: np.full((1,) * rank, value, float) for name, value in nominal.items()} | arrays
    return Samples(along, dims, shape, with_units(coords, loop.kind.plant))


def _dimensions(
    arrays: Mapping[str, np.ndarray], shape: tuple[int, ...], unit: str | None
) -> tuple[tuple[str, ...], dict[str, Coordinate]]:
    """Names of the dimensions, and coordinates of what varies along each."""
    varied = {name: [a for a, size in enumerate(array.shape) if size > 1] for name, array in
              arrays.items() if array.size > 1}  # fmt: skip
    preset = preset_axis(arrays)
    preset = None if preset is None else preset.ravel()
    dims: list[str] = []
    for axis in range(len(shape)):
        along = [name for name, axes in varied.items() if axes == [axis]]
        if preset is not None and sorted(along) == [WN, ZETA]:
            along = [ACTUATOR]
        alone = len(along) == 1 and not any(axis in axes for name, axes in varied.items()
                                            if len(axes) > 1)  # fmt: skip
        dims.append(along[0] if alone else "loop" if len(shape) == 1 else f"loop_{axis}")
    coords = {}
    for name, axes in varied.items():
        own = tuple(dims[axis] for axis in axes)
        values = arrays[name].reshape([shape[axis] for axis in axes])
        coords[name] = Coordinate(own, values, of(name, unit).attributes)
    for axis, dim in enumerate(dims):
        if dim == ACTUATOR and preset is not None:
            coords[dim] = Coordinate((dim,), preset, {"long_name": "actuator"})
        elif dim not in coords:
            coords[dim] = Coordinate((dim,), np.arange(shape[axis]), _LOOP)
    return tuple(dims), coords


def preset_axis(arrays: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Names of the presets that several wn and zeta are all of, in their shape; else None.

    Args:
        arrays: parameters by short name.
    """
    if not {WN, ZETA} <= set(arrays) or arrays[WN].size < 2:
        return None
    if arrays[WN].shape != arrays[ZETA].shape:
        return None
    pairs = list(zip(arrays[WN].ravel().tolist(), arrays[ZETA].ravel().tolist(), strict=True))
    names = {pair: name for name, pair in PRESETS.items()}
    if any(pair not in names for pair in pairs):
        return None
    found = np.array([names[pair] for pair in pairs], dtype=object)
    return found.reshape(arrays[WN].shape)


def one(loop: ControlLoop) -> dict[str, float]:
    """The parameters of a single loop as numbers.

    Raises:
        UserError: it is a batch.
    """
    if loop.shape:
        raise UserError(f"this is for a single loop, not for a batch of {loop.shape}; index it")
    return {name: float(value) for name, value in loop.parameters.items()}
