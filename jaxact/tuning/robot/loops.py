"""A robot's loops, opened at the controllers: every situation with every member of its box.

A situation is a robot at rest in a posture, linearised there, with its drives; a member is a point
of what is uncertain of both. Of each loop the matrices over one control period are kept,

    x' = A x + B u,     seen = Y x,     G(z) = Y (z I - A)^-1 B,

which do not know of any gains. Where a member with a body of its own, a payload say, rests does
depend on them (`jaxact.simulation.changed_models`): the search takes what stiff joints would hold,
and `jaxact.tuning.robot.resting` goes on from there with where the members rest.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jaxact import parameters
from jaxact.compilation.programs import building
from jaxact.drive.step import Drive
from jaxact.errors import UserError
from jaxact.loops import robots
from jaxact.loops.conversion import drive_of
from jaxact.loops.samples import explicit
from jaxact.loops.specification import Push, Setting, Specification
from jaxact.loops.template import Template
from jaxact.parameters import base
from jaxact.simulation import changed_models, kernel, mujoco_batch, plans, robot_loop
from jaxact.simulation.kernel import Case
from jaxact.tuning.box import KNOWN, Box
from jaxact.tuning.robot.amid import values_of

OF_BODY = (
    parameters.PAYLOAD, parameters.INERTIA_SCALE, parameters.JOINT_DAMPING,
    parameters.JOINT_ARMATURE, parameters.CONTACT_FRICTION,
)  # fmt: skip
"""What may be uncertain of a robot itself. Its controllers use the nominal model: setpoint and
feedforward are those of the robot without. Damping and armature are added to the model's own, as
in a sweep (`jaxact.plants.variation`)."""

VARIED = (*parameters.OF_DRIVES, *OF_BODY)
"""What may be uncertain of a robot and its drives, of all joints alike."""

_GAINS = (parameters.KP, parameters.KD, parameters.GAIN_SCALE)

Opened = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""A, B and Y of one loop, and the effective inertias of the joints, shape (joints,)."""


@dataclass(frozen=True)
class Situation:
    """A robot in a posture, ready to be opened with any member of a box.

    Attributes:
        name: of the posture.
        names: of each driven joint and of its actuator.
        kp, kd: gains that are given, or that the model brings, shape (joints,); None where some
            joint has none.
        inertias: effective ones of the joints [kg or kg m^2], at the end of the box where they
            are smaller, shape (joints,).
        rotary: whether a joint is a hinge, shape (joints,).
        lag: of the slowest drive of the box [s], delays + 2 zeta / wn + T / 2.
        period: control period T [s].
        residual: largest acceleration left at the posture [rad/s^2 or m/s^2].
        lead: time by which the integrator has positions ahead of velocities [s], 0 where it is
            corrected for.
        specification: that it was made of.
        payload_body: name of the body that carries a payload.
        box: what is uncertain; every range has a width.
        known: values by key that ranges of no width gave, of which the specification was made.
        opener: from the stiffness that members rest with [N/m or N m/rad], shape (joints,), to
            `opened`; infinite for joints that hold their positions.
        leaves: from values of `keys` and such a stiffness to why the member does not rest with it,
            in words; "" where it does.
        opened: from values of `keys`, shape (keys,), to a loop
            (`jaxact.simulation.robot_loop.OpenMap`) and its inertias, compiled.
        keys: parameters that vary.
        places: number of the range that each of them follows, shape (keys,).
        low, high: their values at the ends of the box, shape (keys,).
    """

    name: str
    names: tuple[tuple[str, str], ...]
    kp: np.ndarray | None
    kd: np.ndarray | None
    inertias: np.ndarray
    rotary: np.ndarray
    lag: float
    period: float
    residual: float
    lead: float
    specification: Specification
    payload_body: str
    box: Box
    known: Mapping[str, float]
    opener: Callable[[np.ndarray], Callable[[np.ndarray], Opened]]
    leaves: Callable[[np.ndarray, np.ndarray], str]
    opened: Callable[[np.ndarray], Opened]
    keys: tuple[str, ...]
    places: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def gives_way(self) -> bool:
        """Whether a member rests elsewhere than the nominal robot."""
        nominal = self.specification.nominal
        static = [name for name in nominal if base(name) in changed_models.STATIC]
        changed = any(nominal[name] != parameters.PARAMETERS[base(name)].default for name in static)
        return changed or any(base(key) in changed_models.STATIC for key in self.keys)

    def resting(self, kp: np.ndarray) -> Situation:
        """The same with every member linearised where it rests with this stiffness (joints,)."""
        return replace(self, opened=self.opener(kp))

    def pushed(self, push: Push | None) -> Situation:
        """The same with a push in what is simulated of it, None for none."""
        return replace(self, specification=replace(self.specification, push=push))

    def values(self, fraction: np.ndarray) -> np.ndarray:
        """Values of `keys` at fractions of the ranges, shape (n, ranges) -> (n, keys)."""
        return self.low + (self.high - self.low) * fraction[:, self.places]

    def columns(self, fraction: np.ndarray) -> dict[str, np.ndarray]:
        """The same by key, shape (n,) each."""
        return dict(zip(self.keys, self.values(fraction).T, strict=True))


def situation(specification: Specification, name: str, box: Box = KNOWN) -> Situation:
    """Prepare a robot in a posture.

    Args:
        specification: with a plant; nothing in it varies.
        name: to call it by.
        box: what is uncertain.

    Raises:
        UserError: a robot that cannot be used, and for a range that does not fit.
    """
    specification, owned = _with_gains(specification)
    given, _, single, _ = _ends(specification, box.known)
    known, box = dict(zip(given, single.tolist(), strict=True)), box.uncertain
    keys, places, low, high = _ends(specification, box)
    columns = dict(zip(keys, np.stack([low, high], axis=1), strict=True))
    # What differs between models or joints must be part of what is compiled.
    own = {k: float(rows[0]) for k, rows in columns.items() if base(k) in OF_BODY or "@" in k}
    every = {**specification.parameters, **known, **own}
    specification = replace(specification, parameters=every)
    samples = explicit(specification, columns or {parameters.FEEDFORWARD: np.zeros(2)})
    (plan,) = plans.groups(specification, samples)
    values = samples.take(np.arange(2))
    template = mujoco_batch.template(plan.case, specification.setting)
    with jax.enable_x64(True):
        drives = [_drive(template, {key: row[i] for key, row in values.items()}) for i in (0, 1)]
    scene, nominal = template.scene, {key: float(row[0]) for key, row in values.items()}
    assert scene is not None
    shape = (len(scene.labels),)

    def opener(kp: np.ndarray) -> Callable[[np.ndarray], Opened]:
        return _opener(plan.case, specification.setting, nominal, keys, kp)

    def leaves(row: np.ndarray, kp: np.ndarray) -> str:
        own = nominal | dict(zip(keys, row.tolist(), strict=True))
        one = {key: np.full(1, value) for key, value in own.items()}
        return changed_models.rests(plan.case, specification.setting, one, kp)[0].leaves

    opened = opener(np.full(shape, np.inf))
    period = 1.0 / nominal[parameters.CONTROL_RATE]
    gains = drives[0].controller
    hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
    model = scene.robot.model
    exact = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    return Situation(
        name=name,
        names=scene.names,
        kp=np.broadcast_to(np.asarray(gains.kp, float), shape) if owned else None,
        kd=np.broadcast_to(np.asarray(gains.kd, float), shape) if owned else None,
        inertias=np.minimum(opened(low)[3], opened(high)[3]),
        rotary=np.array([model.jnt_type[joint.joint] == hinge for joint in scene.robot.joints]),
        lag=max(_lag(drive) for drive in drives) + 0.5 * period,
        period=period,
        residual=scene.posture.residual,
        lead=0.0 if exact or specification.integrator_correction else 0.5 * plan.case.step,
        specification=specification,
        payload_body=scene.carrier,
        box=box,
        known=known,
        opener=opener,
        leaves=leaves,
        opened=opened,
        keys=keys,
        places=places,
        low=low,
        high=high,
    )


def integrated(situations: Sequence[Situation]) -> tuple[str, ...]:
    """What is to be said of the integrator that robots are linearised with."""
    lead = max(one.lead for one in situations)
    if not lead:
        return ()
    return (
        f"This is of robots as MuJoCo integrates them, positions {1e3 * lead:.3g} ms ahead of "
        "velocities, as no robot has them: its own peaks differ a little. With "
        "`integrator_correction` they are the robot's.",
    )


def _with_gains(specification: Specification) -> tuple[Specification, bool]:
    """The specification, and whether it has gains for all joints; others stand in if it has not."""
    specification = replace(specification, axes=(), sampling=None)
    assert specification.plant is not None
    scene = robots.scene(specification.plant)
    nominal = specification.nominal
    given = {key for key, value in nominal.items() if not np.isnan(value)}
    keys = [key for key in specification.setting.keys if base(key) in _GAINS]
    for key in keys:
        robots.matched(scene, key)
    try:
        robots.check(scene, keys, given)
    except UserError:
        kept = {k: v for k, v in specification.parameters.items() if base(k) not in _GAINS}
        stand_in = replace(specification, parameters=kept | dict.fromkeys(_GAINS[:2], 1.0))
        return stand_in, False
    return specification, True


def _drive(template: Template, values: Mapping[str, float]) -> Drive:
    return drive_of(
        kernel.resolved(template, {key: jnp.asarray(value) for key, value in values.items()})
    )


def _lag(drive: Drive) -> float:
    """Largest delay + 2 zeta / wn of any joint [s]."""
    actuator = drive.actuator
    slow = 2.0 * np.asarray(actuator.damping_ratio) / np.asarray(actuator.natural_frequency)
    late = np.asarray(actuator.delay) + np.asarray(drive.sensor.delay)
    return float(np.max(slow + late + np.asarray(drive.output_delay)))


def _ends(
    specification: Specification, box: Box
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]:
    """Parameters that vary, the range of each, and their values at the ends of the box."""
    assert specification.plant is not None
    scene, nominal = robots.scene(specification.plant), specification.nominal
    brought = robots.brought(scene)
    rows: list[tuple[str, int, float, float]] = []
    for place, one in enumerate(box.ranges):
        own = {k: v for k, v in nominal.items() if base(k) == one.name}
        if "@" in one.name:
            values = values_of(specification, one)
            if one.factor and (values != values[0]).any():
                raise UserError(f"`uncertainty` {one.name}: these joints differ in it; name fewer")
            own = {one.name: float(values[0])}
        elif np.isnan(own[one.name]):
            of_model = np.unique(brought[one.name])
            if one.factor and of_model.size > 1:
                raise UserError(
                    f"`uncertainty` {one.name}: the model's joints differ in it; give `{one.name}`"
                )
            own[one.name] = float(of_model[0])
        rows += [(key, place, *ends) for key, ends in one.ends(own).items()]
    columns = np.array([row[1:] for row in rows], float).reshape(-1, 3).T
    return tuple(row[0] for row in rows), columns[0].astype(int), columns[1], columns[2]


def _opener(
    case: Case,
    setting: Setting,
    nominal: Mapping[str, float],
    keys: tuple[str, ...],
    kp: np.ndarray,
) -> Callable[[np.ndarray], Opened]:
    """See `Situation.opener`; compiled once for all members."""
    linearised = _linearised(case, setting, nominal, keys, kp)
    # One NaN, which is found again as a key, for all that the model brings.
    known = {key: math.nan if np.isnan(value) else value for key, value in nominal.items()}
    case, setting = kernel.linear_part(case, setting)
    constant = tuple(sorted(known.items()))

    def opened(row: np.ndarray) -> Opened:
        with jax.enable_x64(True):
            moved = jax.tree.map(jnp.asarray, linearised(row))
            member = jnp.asarray(row, float), moved
            loop = _open_loop(*member, case=case, setting=setting, nominal=constant, keys=keys)
            return jax.tree.map(np.asarray, loop)

    return opened


@building
def _open_loop(
    *, case: Case, setting: Setting, nominal: tuple[tuple[str, float], ...], keys: tuple[str, ...]
) -> Callable:
    """From values of the keys and a plant of their own to a loop, see `Situation.opened`.

    What is nominal is a constant there, so that little is left to be compiled.
    """
    template = kernel.template_of(case, setting, "growth_rate")

    def matrices(row: jax.Array, moved: tuple[jax.Array, jax.Array] | None):
        """A, B, what controllers measure, and inertias of one member."""
        values = {name: jnp.asarray(value) for name, value in nominal}
        values |= {key: row[place] for place, key in enumerate(keys)}
        loop = kernel.linear_loop(case, template, values, moved)
        found = robot_loop.open_map(loop, case.drive)
        seen = jnp.stack([found.positions, found.velocities], axis=1)
        return found.A, found.B, seen, robot_loop.effective_inertias(loop.plant)

    return matrices


def _linearised(
    case: Case,
    setting: Setting,
    nominal: Mapping[str, float],
    keys: tuple[str, ...],
    kp: np.ndarray,
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray] | None]:
    """From values of the keys to A and B of the plant, where its members differ in the model.

    Each where it rests with the stiffness kp, shape (joints,).
    """
    bodies = [place for place, key in enumerate(keys) if base(key) in OF_BODY]

    # Neighbours in the box often differ in their drives only.
    @functools.lru_cache(maxsize=64)
    def of(body: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        own = dict(zip((keys[place] for place in bodies), body, strict=True))
        values = {key: np.full(1, value) for key, value in {**nominal, **own}.items()}
        A, B = changed_models.moved(case, setting, values, kp)
        return A[0], B[0]

    return lambda row: of(tuple(row[bodies].tolist())) if case.varied else None
