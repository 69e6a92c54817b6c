"""From flat parameter values to the metrics of loops: what one tile of a sweep computes.

The flat names of `jaxact.sweep.parameters` become a closed loop here and nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from jaxact import growth as _growth
from jaxact import loop as _loop
from jaxact import rollout as _rollout
from jaxact.actuator import Actuator
from jaxact.controller import Controller, Setpoint
from jaxact.drive import Drive, DriveOptions
from jaxact.growth import GrowthOptions
from jaxact.loop import Loop
from jaxact.metrics import Metrics
from jaxact.plants import Mass
from jaxact.rollout import RolloutOptions
from jaxact.sensor import Sensor

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Case:
    """The static side of a tile: everything that a compiled kernel depends on.

    Attributes:
        engine: "mass" or "mjx".
        drive: static options of the drive.
        rollout: static options of the rollout.
        masked: some samples run longer than the duration, because control rates differ or because
            ticks are rounded up to whole segments, and their integrals stop before the end.
        duration: simulated time [s].
        model: digest of the compiled model, empty for the built-in one: a file edited since then
            is another model.
        own_mass: the samples' mass is given to the model.
        growth: how the growth rate is measured.
    """

    engine: str
    drive: DriveOptions
    rollout: RolloutOptions
    masked: bool
    duration: float
    model: str = ""
    own_mass: bool = True
    growth: GrowthOptions = field(default_factory=GrowthOptions)


def drive_of(values: Values) -> Drive:
    """The drive with these parameters, by their short names; scalars or arrays alike."""
    return Drive(
        controller=Controller(
            kp=values["kp"],
            kd=values["kd"],
            feedforward=values["feedforward"],
            command_resolution=values["command_resolution"],
            setpoint_delay=values["setpoint_delay"],
        ),
        actuator=Actuator(
            natural_frequency=values["wn"],
            damping_ratio=values["zeta"],
            delay=values["delay"],
            force_limit=values["force_limit"],
            force_rate_limit=values["force_rate_limit"],
            stall_force=values["stall_force"],
            no_load_speed=values["no_load_speed"],
        ),
        sensor=Sensor(
            delay=values["measurement_delay"],
            position_resolution=values["position_resolution"],
            velocity_resolution=values["velocity_resolution"],
            position_noise=values["position_noise"],
            velocity_noise=values["velocity_noise"],
            position_bias=values["position_bias"],
            velocity_bias=values["velocity_bias"],
            position_bias_walk=values["position_bias_walk"],
            velocity_bias_walk=values["velocity_bias_walk"],
            velocity_filter=values["velocity_filter"],
        ),
        output_delay=values["output_delay"],
        control_period=1.0 / values["control_rate"],
    )


def plant_template(engine: str, model: Path | None) -> Any:
    """The plant before its parameters are known: None for the mass, a loaded model for MJX.

    In the precision that JAX has at this moment.
    """
    if engine == "mass":
        return None
    from jaxact.plants import mjx  # imports MuJoCo, which the mass plant does not need

    return mjx.load() if model is None else mjx.load(model)


def model_digest(engine: str, model: Path | None) -> str:
    """Fingerprint of a user's model for `Case`; empty where there is none."""
    if engine == "mass" or model is None:
        return ""
    from jaxact.plants import mjx  # as above

    return mjx.digest(model)


def loop_of(values: Values, template: Any, *, own_mass: bool = True) -> Loop:
    """The closed loop with these parameters; `template` from `plant_template`."""
    if template is None:
        return Loop(plant=Mass(values["mass"]), drive=drive_of(values))
    plant = template.with_mass(values["mass"]) if own_mass else template
    return Loop(plant=plant, drive=drive_of(values))


def _start(case: Case, template: Any, values: Values):
    """The prepared loop, its initial state and its setpoint."""
    loop = loop_of(values, template, own_mass=case.own_mass)
    prepared = _loop.prepare(loop, case.drive)
    state = _loop.init(prepared, case.drive, values["initial_position"], values["initial_velocity"])
    return prepared, state, Setpoint(values["setpoint"])


def growth_rate(case: Case, template: Any, values: Values) -> jax.Array:
    """Growth rate of one sample [1/s], shape ()."""
    prepared, state, setpoint = _start(case, template, values)
    return _growth.growth_rate(prepared, case.drive, state, setpoint, case.growth)


def metrics(
    case: Case,
    template: Any,
    values: Values,
    growth_rate: jax.Array,
    seed: jax.Array,
    number: jax.Array,
) -> Metrics:
    """Metrics of one sample, each of shape (); figures of several joints are their worst.

    Its random numbers follow from the sweep's seed and its own number alone.
    """
    key = jax.random.fold_in(jax.random.key(seed), number)
    prepared, state, setpoint = _start(case, template, values)
    active = None
    if case.masked:
        active = jnp.ceil(case.duration * values["control_rate"] - 1e-4)
    result = _rollout.evaluate(
        prepared,
        case.drive,
        case.rollout,
        state,
        setpoint,
        key,
        growth_rate=growth_rate.astype(prepared.drive.step.dtype),
        active_ticks=active,
    )
    # A loop with several joints is as good as its worst one; joints that have no such figure
    # (NaN) do not hide the others'.
    return jax.tree.map(lambda leaf: jnp.nanmax(leaf) if leaf.ndim else leaf, result)
