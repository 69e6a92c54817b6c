"""From flat parameter values to the metrics of loops: what one tile of a sweep computes.

A robot's parameters become those of its joints here, and with `jaxact.loops.conversion` a loop.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.drive.controller import Setpoint
from jaxact.drive.step import Drive, DriveOptions
from jaxact.engines import Engine
from jaxact.loops import joint_ranges
from jaxact.loops import loop as _loop
from jaxact.loops import template as _template
from jaxact.loops.conversion import drive_of
from jaxact.loops.loop import Loop, LoopState, Prepared
from jaxact.loops.specification import Setting
from jaxact.loops.template import Template
from jaxact.parameters import (
    CONTROL_RATE,
    GAIN_SCALE,
    INITIAL_POSITION,
    INITIAL_VELOCITY,
    JOINT_FRICTION,
    KD,
    KP,
    MASS,
    OF_JOINT,
    PAYLOAD,
    SETPOINT,
)
from jaxact.plants.mass import Mass
from jaxact.simulation import metrics as _metrics
from jaxact.simulation import rollout as _rollout
from jaxact.simulation import starts as _starts
from jaxact.simulation.growth import characteristic as _characteristic
from jaxact.simulation.growth import rate as _growth
from jaxact.simulation.growth.rate import GrowthOptions, SlowModes
from jaxact.simulation.metrics import Metrics
from jaxact.simulation.rollout import RolloutOptions
from jaxact.simulation.verdicts import Judgement

Values = Mapping[str, Any]

PUSH = "push"  # the parameter that `split_push` makes of one
OWN_TICKS = "own_ticks"  # that of a loop whose number of ticks is its own


@dataclass(frozen=True)
class Case:
    """The static side of a tile: everything that a compiled kernel depends on.

    Attributes:
        engine: what simulates it.
        drive: static options of the drive.
        rollout: static options of the rollout.
        masked: some samples run longer than the duration, because ticks are rounded up to whole
            segments, and their integrals stop before the end.
        duration: simulated time [s].
        model: digest of the compiled model, empty for the built-in one: a file edited since then
            is another model.
        varied: changes of a robot's model that differ between samples.
        step: physics step of a robot [s]; 0 for the built-in plants.
        growth: how the growth rate is measured.
        starts: from which every loop is judged beside its own, see `jaxact.simulation.starts`.
    """

    engine: Engine
    drive: DriveOptions
    rollout: RolloutOptions
    masked: bool
    duration: float
    model: str = ""
    varied: tuple[str, ...] = ()
    step: float = 0.0
    growth: GrowthOptions = field(default_factory=GrowthOptions)
    starts: tuple[str, ...] = ()


def template_of(case: Case, setting: Setting, stage: str) -> Template:
    """What the samples of a kernel share, in the precision that JAX has at this moment.

    `stage` is the kernel's name: rates of a robot need its linearised plant.
    """
    if setting.plant is None:
        return _template.built_in(case.engine, corrected=setting.corrected)
    return _template.of_robot(
        setting,
        case.engine,
        varied=case.varied,
        step=case.step,
        period=case.step * case.drive.substeps,
        ticks=case.rollout.ticks,
        growth=stage in ("growth_rate", "slow_modes"),
    )


def model_digest(setting: Setting) -> str:
    """Fingerprint of a user's files for `Case`; empty where there are none."""
    if setting.plant is None:
        return ""
    from jaxact.loops import robots  # imports MuJoCo, which the mass plant does not need

    found = robots.scene(setting.plant).robot.digest
    if setting.motion is not None and setting.motion.file is not None:
        found += hashlib.sha256(setting.motion.file.read_bytes()).hexdigest()
    return found


def longest_step(setting: Setting) -> float:
    """Physics step that is not to be exceeded: a robot's model's own [s]."""
    if setting.plant is None:
        return math.inf
    from jaxact.loops import robots  # as above

    return float(robots.scene(setting.plant).robot.model.opt.timestep)


def rubs(setting: Setting, along: Mapping[str, np.ndarray]) -> bool:
    """Whether a joint or a tendon of a robot has dry friction in some sample."""
    if setting.plant is None:
        return False
    from jaxact.loops import robots  # as above

    model = robots.scene(setting.plant).robot.model
    own = [model.dof_frictionloss, model.tendon_frictionloss]
    own += [value for key, value in along.items() if key.partition("@")[0] == JOINT_FRICTION]
    return any(bool(np.any(np.nan_to_num(part) > 0.0)) for part in own)


def occurring(setting: Setting, along: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """All values that occur of each parameter, over samples and joints, for the static options.

    Raises:
        UserError: a key matches no joint, or a joint has no gains.
    """
    if setting.plant is None:
        return along
    from jaxact.loops import bodies, robots  # as above

    scene = robots.scene(setting.plant)
    robots.check_values(scene, setting.keys, along)
    if setting.corrected:
        robots.check_integrator(scene)
    if np.any(np.nan_to_num(along[PAYLOAD]) > 0.0):
        bodies.check_payload(scene.robot, scene.payload_body)
    return robots.spread(along, robots.brought(scene))


def split_push(setting: Setting, dtype: type) -> tuple[Setting, Values]:
    """What a kernel is compiled for, and the numbers of the push, which belong to its parameters.

    Another push on the same body needs no other kernel.
    """
    push = setting.push
    if push is None:
        return setting, {}
    numbers: Values = {
        "force": np.asarray(push.force, dtype),
        "start": np.asarray(push.time, dtype),
        "duration": np.asarray(push.duration, dtype),
    }
    any_push = replace(push, impulse=(0.0, 0.0, 0.0), time=0.0, duration=1.0)
    return replace(setting, push=any_push), {PUSH: numbers}


def resolved(template: Template, values: Values) -> Values:
    """The parameters of a sample, for each joint where joints differ, gains scaled."""
    if template.scene is not None:
        from jaxact.loops import robots

        values = robots.each_joint(values, template.defaults, template.masks)
    scale = values[GAIN_SCALE]
    return {**values, KP: scale * values[KP], KD: scale * values[KD]}


def _plant_of(case: Case, template: Template, values: Values) -> Any:
    """The plant with the sample's own parameters filled in."""
    if case.engine.exact:
        own = (values[name] if name in case.varied else None for name in OF_JOINT)
        return Mass(values[MASS], *own)
    plant = template.plant if case.engine.robot else template.plant.with_mass(values[MASS])
    if PUSH in values:
        plant = replace(plant, push=replace(plant.push, **values[PUSH]))
    if not case.varied:
        return plant
    from jaxact.plants.variation import Variation

    return replace(plant, variation=Variation(**{name: values[name] for name in case.varied}))


def loop_of(case: Case, values: Values, template: Template) -> Loop:
    """The closed loop with these parameters; values by key, `template` from `template_of`."""
    values = resolved(template, values)
    return Loop(plant=_plant_of(case, template, values), drive=drive_of(values))


def start(case: Case, template: Template, values: Values) -> tuple[Prepared, LoopState, Setpoint]:
    """The prepared loop of a sample, its initial state, and its setpoint at the first tick."""
    values = resolved(template, values)
    return begun(case, template, values, drive_of(values))


def begun(
    case: Case, template: Template, values: Values, drive: Drive
) -> tuple[Prepared, LoopState, Setpoint]:
    """As `start`, of parameters from `resolved` and the drive with them."""
    loop = Loop(plant=_plant_of(case, template, values), drive=drive)
    prepared = _loop.prepare(loop, case.drive)
    dtype = prepared.drive.step.dtype
    rest, force = jnp.asarray(template.position, dtype), jnp.asarray(template.force, dtype)
    state = _loop.init(
        prepared,
        case.drive,
        rest + values[INITIAL_POSITION],
        values[INITIAL_VELOCITY],
        command=force,
    )
    asked = joint_ranges.within(values, rest + values[SETPOINT])
    return prepared, state, Setpoint(asked, force=force)


def setpoints(template: Template, values: Values, ticks: int) -> Setpoint | None:
    """The setpoint at every tick, leaves of shape (ticks, joints); None where it is constant."""
    if template.profile is None and template.track is None:
        return None
    values = resolved(template, values)
    rest = jnp.asarray(template.position, values[SETPOINT].dtype)
    shape = (ticks, *rest.shape)
    if template.track is not None:
        moved = jnp.asarray(template.track, rest.dtype).reshape(shape)
    else:
        over_time = jnp.asarray(template.profile, rest.dtype).reshape((ticks, *(1,) * rest.ndim))
        moved = over_time * jnp.broadcast_to(values[SETPOINT], rest.shape)[None]
    zero, force = jnp.zeros(shape, rest.dtype), jnp.asarray(template.force, rest.dtype)
    asked = joint_ranges.within(values, rest[None] + moved)
    return Setpoint(asked, zero, force[None] + zero)


def linear_part(case: Case, setting: Setting) -> tuple[Case, Setting]:
    """What the linearised loop depends on: sweeps that differ in nothing else share its kernels.

    Noise (the bias that walks included, whose state is not one of the linear loop), quantisation
    and limits do not change it, nor how long the loop is simulated or what moves it.
    """
    return (
        replace(
            case,
            drive=case.drive.linearised(),
            rollout=RolloutOptions(ticks=0),
            masked=False,
            duration=0.0,
            starts=(),
        ),
        replace(setting, motion=None, push=None),
    )


def growth_rate(case: Case, template: Template, values: Values) -> jax.Array:
    """Growth rate of one sample [1/s], shape (); `case` from `linear_part`, of no robot."""
    prepared, state, setpoint = start(case, template, values)
    return _growth.growth_rate(prepared, case.drive, state, setpoint, case.growth)


def slow_modes(
    case: Case, template: Template, values: Values, moved: tuple[jax.Array, jax.Array] | None = None
) -> SlowModes:
    """The slow modes of a robot's loop, the growth rate among them; `case` from `linear_part`.

    `moved` is A and B of the robot's linear plant where its model differs from sample to sample.
    """
    return _growth.slow_modes(*_at_rest(case, template, values, moved), case.growth)


def _at_rest(
    case: Case, template: Template, values: Values, moved: tuple[jax.Array, jax.Array] | None
) -> tuple[Prepared, DriveOptions, LoopState, Setpoint]:
    """A robot's linearised loop at rest."""
    prepared = _loop.prepare(linear_loop(case, template, values, moved), case.drive)
    rest = jnp.zeros(prepared.plant.shape)
    return prepared, case.drive, _loop.init(prepared, case.drive, rest, rest), Setpoint(rest)


def transition(case: Case, template: Template, values: Values) -> jax.Array:
    """What a block of periods does to one sample's perturbation, as
    `jaxact.simulation.growth.rate.transition`; `case` from `linear_part`.
    """
    prepared, state, setpoint = start(case, template, values)
    return _growth.transition(prepared, case.drive, state, setpoint, case.growth)


def log_radius(case: Case, template: Template, values: Values) -> jax.Array:
    """Logarithm of the spectral radius of one sample, from polynomials that span those of its set.

    `bases` holds those of all sets, shape (sets, 3, n), and `place` the number of the sample's, or
    `bases` those of the only one, shape (3, n); `kp` and `kd` are the second's and third's shares.
    """
    bases = values["bases"]
    if bases.ndim > 2:
        bases = bases[values["place"]]
    mixed = bases[0] + values[KP] * bases[1] + values[KD] * bases[2]
    return _characteristic.log_largest_root([*mixed], case.growth.squarings)


def linear_loop(
    case: Case, template: Template, values: Values, moved: tuple[jax.Array, jax.Array] | None = None
) -> Loop:
    """The loop of a robot's linearised plant with the parameters of one sample.

    `moved` as for `slow_modes`.
    """
    linear = template.linear
    assert linear is not None
    if moved is not None:
        linear = replace(linear, A=moved[0], B=moved[1])
    return Loop(plant=linear, drive=drive_of(resolved(template, values)))


def metrics(
    case: Case,
    template: Template,
    values: Values,
    growth_rate: jax.Array,
    seed: jax.Array,
    number: jax.Array,
) -> Metrics:
    """Metrics of one sample, each of shape (); metrics of several joints are their worst.

    Its random numbers follow from the sweep's seed and its own number alone.
    """
    key = jax.random.fold_in(jax.random.key(seed), number)
    prepared, state, setpoint = start(case, template, values)
    growth_rate = growth_rate.astype(prepared.drive.step.dtype)
    others, rest, rubs = other_starts(case, template, values, growth_rate, key)
    result = _rollout.evaluate(
        prepared,
        case.drive,
        case.rollout,
        state,
        setpoint,
        key,
        growth_rate=growth_rate,
        active_ticks=active_ticks(case, values),
        own_ticks=values.get(OWN_TICKS),
        setpoints=setpoints(template, values, case.rollout.ticks),
        rest_amplitude=rest,
        rubs=rubs,
        others=others,
        bases=template.bases,
    )
    return _metrics.worst(result)


def other_starts(
    case: Case, template: Template, values: Values, growth_rate: jax.Array, key: jax.Array
) -> tuple[Judgement | None, jax.Array, jax.Array]:
    """What comes of a sample's other starts, and what it and its own are judged with.

    Returns:
        Leaves of shape (starts, joints), None where there are none; half ranges that count as rest
        [m or rad], (joints,); and whether dry friction acts, shape ().
    """
    values = resolved(template, values)
    drive = drive_of(values)
    rest = _starts.rest_amplitude(case.drive, values, drive, robot=template.scene is not None)

    def judged(given: Values, drive: Drive, rest: jax.Array) -> Judgement:
        prepared, state, setpoint = begun(case, template, {**values, **given}, drive)
        loop = prepared, case.drive, case.rollout, state, setpoint, key
        told = {"growth_rate": growth_rate, "rest_amplitude": rest, "rubs": rubs}
        return _rollout.judged(*loop, **told, own_ticks=values.get(OWN_TICKS), bases=template.bases)

    friction, rubs = _starts.friction(template), _starts.rubs(template, values)
    if _starts.LINEAR in case.starts:
        given = _starts.given(("between",), values, drive, friction)
        first = jax.tree.map(lambda leaf: leaf[0], given)
        sustained = judged(first, _starts.without_errors(drive), rest).amplitude
        rest = _starts.above_noise(rest, sustained, growth_rate)
    names = tuple(name for name in case.starts if name != _starts.LINEAR)
    if not names:
        return None, rest, rubs
    given = _starts.given(names, values, drive, friction)
    return jax.vmap(lambda given: judged(given, drive, rest))(given), rest, rubs


def active_ticks(case: Case, values: Values) -> jax.Array | None:
    """Ticks of the sample's duration, where samples differ in it."""
    if not case.masked:
        return None
    return jnp.ceil(case.duration * values[CONTROL_RATE] - 1e-4)
