"""Building loops from the parameters that everybody knows, or from a specification."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, cast

from pydantic import ValidationError

from jaxact.errors import UserError, nearest, shown
from jaxact.loops import drives, listed
from jaxact.loops.axes import MOST_SAMPLES, NO_AXIS
from jaxact.loops.control_loop import ControlLoop, Kind, made, rotary
from jaxact.loops.given import ACTUATOR, patterns_of, read
from jaxact.loops.reading import explained, load
from jaxact.loops.samples import expand
from jaxact.loops.specification import Motion, Plant, Push, Specification
from jaxact.parameters import INERTIA, WN, ZETA
from jaxact.units import UNITS

Velocity = Literal["sampled", "differenced"]
_VELOCITIES = ("sampled", "differenced")


def joint(
    *, actuator: str | Sequence[str] | None = None, velocity: Velocity | None = None,
    physics_step: float | None = None, unit: Literal["m", "rad"] | None = None,
    names: Sequence[str] = (), drive: Any = None, samples: int | None = None, seed: int = 0,
    **parameters: Any,
) -> ControlLoop:  # fmt: skip
    """The loop of one joint: a mass under PD control through an actuator with delays.

        loop = jaxact.joint(mass=0.7, kp=400, kd=20, actuator="starleth", delay=1e-3)

    Args:
        actuator: preset that sets wn and zeta, "ideal", "hyq" or "starleth"; or several.
        velocity: that the controller sees, "sampled" or the "differenced" position; None for what
            the drive says of the controller of its log, else "sampled".
        physics_step: of the plant [s]; None for the control period, or as small a part of it as
            limits of the force need.
        unit: of its position: "rad" of a rotary joint, whose numbers are in N m, N m/rad, kg m^2,
            as everything that is said of it; None for m, or for rad where `inertia` is given
            instead of `mass`.
        names: what tables and pictures call the loops of a batch; () for what tells them apart.
        drive: an identified drive, a file of `jaxact identify` or what `jaxact.identify` gave: it
            says what is not given here.
        samples: loops drawn from what is known of the drive's numbers together, a batch; None for
            the one loop of its estimates.
        seed: of these draws.
        parameters: any parameter of `jaxact parameters` by its short or long name, scalars or
            arrays that broadcast: kp [N/m], kd [N s/m], mass [kg], joint_damping [N s/m],
            joint_stiffness [N/m], wn [rad/s], zeta, delay, measurement_delay, output_delay [s],
            control_rate [Hz], velocity_filter [rad/s], force_limit [N], position_resolution [m],
            ...
            What is not given has the default of the table (`jaxact parameters` on the command
            line): the joint of the reference study, controlled at 1000 Hz.

    Returns:
        The loop, or a batch of loops.

    Raises:
        UserError: an unknown name, a value out of bounds, shapes that do not broadcast.
    """
    known = None if drive is None else drives.taken(drive)
    if known is None and samples is not None:
        raise UserError("`samples`: are those of a `drive`; give one")
    kind = Kind(
        velocity=_velocity(velocity, known), physics_step=physics_step,
        unit=_unit(unit, parameters) or (None if known is None else known.unit),
        names=names,  # type: ignore[arg-type]
    )  # fmt: skip
    given = read({"actuator": actuator, **parameters}, robot=False, unit=kind.unit)
    own: Mapping[str, Any] = {}
    if known is not None:
        known = known.moving(given)
        own = known.draws(samples, seed) if samples else known.parameters()
    return made(drives.filled(own, given), kind)


def robot(
    model: str | os.PathLike[str],
    *,
    keyframe: str | None = None,
    joints: str | Sequence[str] = (".*",),
    base: Literal["free", "fixed", "held"] = "free",
    damping: Literal["joint", "drive"] = "joint",
    friction: Literal["moving", "stuck"] = "moving",
    posture: Literal["settled", "keyframe"] = "settled",
    gains: str | os.PathLike[str] | None = None,
    payload_body: str | None = None,
    actuator: str | Sequence[str] | None = None,
    velocity: Velocity | None = None,
    physics_step: float | None = None,
    integrator_correction: bool = False,
    motion: Motion | Mapping[str, Any] | None = None,
    push: Push | Mapping[str, Any] | None = None,
    drive: Any = None,
    **parameters: Any,
) -> ControlLoop:
    """The loop of a MuJoCo robot: its model under the drives of its joints.

        stand = jaxact.robot("go1.xml", keyframe="home", base="fixed", delay=2e-3)

    Args:
        model: MJCF or URDF file.
        keyframe: posture, None for the model's default.
        joints: regular expressions; joints or actuators that match in full are driven.
        base: "free" as the model has it, "fixed" on a stand without contact, "held" where it
            stands.
        damping: the joints' own, left in the "joint", or moved into the "drive" as part of kd.
        friction: dry friction of the linearised robot, see `jaxact.loops.specification.Plant`.
        posture: "settled", where stiff joints that hold the keyframe come to rest on its contacts;
            or as the "keyframe" has it. The torques that hold the robot there are fed forward, so
            that it rests there with any gains and does not sag under soft ones.
        gains: file of gains instead of the model's: jaxact's own TOML, MJCF, a deployment's YAML, a
            configuration of legged_gym, Isaac Lab or mjlab, see docs/gains.md. Joints are matched
            by name; names that match none are a `GainsWarning`, and `jaxact.check` says all.
        payload_body: that carries the payload, None for the heaviest.
        actuator: preset of all joints that sets wn and zeta; None for what those say or the model
            has, ideal where neither does.
        velocity: that the controllers see; None for that of the drive, as for `jaxact.joint`.
        physics_step: [s], None for the longest that divides the control period and is no longer
            than the model's own.
        integrator_correction: take back MuJoCo's half step of lead.
        motion, push: of the setpoint, and on a body, in simulations; tables as in a specification,
            `push={"body": "trunk", "impulse": [0, 20, 0]}`.
        drive: an identified drive of every joint, as for `jaxact.joint`; its dynamics, delay,
            friction, limit, resolution and rate say what is not given here.
        parameters: as for `jaxact.joint`; gains, limits and delays that are not given are those of
            the model's own actuators. For some joints, a table of patterns:
            `kp={".*_knee": 300, ".*_hip": 200}` [N m/rad of hinges]. The control rate is 1000 Hz
            where none is given, whatever the model's time step is.

    Returns:
        The loop, or a batch of loops. The model is read when something is asked of it.

    Raises:
        UserError: there is no such file, and as `jaxact.joint`.
    """
    if not isinstance(model, str | os.PathLike):
        raise UserError(
            f"model: a value of type {type(model).__name__} is not the path of a file; give "
            "that of an MJCF or URDF file"
        )
    path = Path(model)
    if not path.is_file():
        raise UserError(f"{path}: no such model file; give an MJCF or URDF file")
    patterns = patterns_of(joints)
    try:
        plant = Plant(
            model=path, keyframe=keyframe, posture=posture, joints=patterns,
            payload_body=payload_body, base=base, damping=damping, friction=friction,
            gains=None if gains is None else os.fspath(gains),
        )  # fmt: skip
    except ValidationError as error:
        raise UserError(explained(error)) from None
    known = None if drive is None else drives.taken(drive)
    seen, moved = _velocity(velocity, known), (motion, push)
    kind = Kind(plant, seen, physics_step, integrator_correction, *cast(Any, moved))
    given = read({"actuator": actuator, **parameters}, robot=True)
    own = {} if known is None else known.parameters(robot=True)
    return made(drives.filled(own, given), kind)


def loop_of(
    specification: Specification | str | os.PathLike[str], *, velocity: Velocity | None = None,
    **parameters: Any,
) -> ControlLoop:  # fmt: skip
    """The loops that a specification describes, or that a file lists.

        loop = jaxact.loop_of("experiments/paper_gain_map.toml")

    Args:
        specification: read, or a TOML file: of a sweep, what it varies is a batch over its axes; or
            of `[[loop]]` tables, each with its parameters and perhaps a `name` and a `drive`.
        velocity: as for `jaxact.joint`; None leaves a file its own.
        parameters: of listed loops, what they do not say themselves, as for `jaxact.joint`; a
            `drive` among them.

    Returns:
        The loop, or a batch of loops.

    Raises:
        UserError: the file cannot be read, or what it says does not fit.
    """
    if not isinstance(specification, Specification):
        path = Path(specification)
        rows = listed.rows(path)
        if rows is not None:
            unit = _unit(parameters.pop("unit", None), {*parameters, *itertools.chain(*rows)})
            names, own, of_drives = listed.values(path, rows, parameters)
            unit = unit or of_drives
            seen = _velocity(velocity or listed.velocity(path, rows, parameters))
            kind = Kind(velocity=seen, unit=unit, names=tuple(names))
            return made(own, kind)
        if parameters:
            name = next(iter(parameters))
            raise UserError(f"`{name}`: {path} has axes of its own; change them there")
        specification = load(path)
    samples = expand(specification)
    if len(samples) > MOST_SAMPLES:
        raise UserError(f"axes: make {len(samples):,} loops; allowed here: up to {MOST_SAMPLES:,}")
    varied = {axis.name for axis in specification.axes if axis != NO_AXIS}
    given = {*specification.parameters, *varied}
    if ACTUATOR in given:
        given |= {WN, ZETA}
    values: dict[str, Any] = {
        name: array if array.size > 1 else float(array.item())
        for name, array in samples.along.items()
        if name in given
    }
    parts = {f.name: getattr(specification, f.name) for f in fields(Kind) if f.name != "names"}
    if velocity is not None:
        parts["velocity"] = _velocity(velocity)
    return made(values, Kind(**parts))


def _unit(unit: str | None, given: Iterable[str]) -> str | None:
    """The unit of a joint's position, "rad" where an inertia is among the names given."""
    if unit not in (None, *UNITS):
        raise UserError(f"`unit` = {shown(unit)}; {nearest(unit, UNITS)}")
    return rotary(given, unit) if INERTIA in given else unit


def _velocity(name: str | None, drive: drives.IdentifiedDrive | None = None) -> str:
    if name is None:
        return (None if drive is None else drive.velocity) or _VELOCITIES[0]
    if name not in _VELOCITIES:
        raise UserError(f"`velocity` = {shown(name)}; {nearest(name, _VELOCITIES)}")
    return name
