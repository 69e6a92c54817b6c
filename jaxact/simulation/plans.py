"""How a sweep is computed: groups of samples, each with one compiled kernel, tiles and devices.

A tile is a fixed number of loops simulated side by side, small on a CPU so that their state stays
in the first-level cache. Samples are sent to the devices in batches of a fixed number of tiles, so
that each kernel is compiled once; a batch that is not full is filled up with copies of its last
sample.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import jax
import numpy as np

from jaxact.compilation.filling import filled
from jaxact.drive import step as _drive
from jaxact.errors import UserError
from jaxact.loops import torque_speed
from jaxact.loops.conversion import drive_of, own_motion
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Motion, Specification
from jaxact.parameters import (
    CONTROL_RATE,
    INITIAL_POSITION,
    INITIAL_VELOCITY,
    OF_PLANT,
    SETPOINT,
    base,
)
from jaxact.simulation import engines, kernel, limited_steps
from jaxact.simulation import rollout as _rollout
from jaxact.simulation import starts as _starts
from jaxact.simulation.growth.rate import GrowthOptions
from jaxact.simulation.kernel import Case
from jaxact.simulation.rollout import RolloutOptions

# Control periods of the mass plant in one iteration of the compiled loop: on a GPU, where each
# iteration starts its kernels anew and carries all state through the memory, more.
_UNROLL, _UNROLL_ON_GPU = 4, 10

# A robot has many slow modes (contacts that creep), which only blocks of many periods tell apart; a
# start that has settled for long holds too few of them.
_ROBOT_GROWTH = GrowthOptions(block=64, settle=4, dimension=32, squarings=18)
# The control rate that the blocks of `GrowthOptions` are meant for [Hz].
_USUAL_RATE = 1000.0

_STEP = Motion(kind="step")

# A control period may miss a whole number of physics steps by rounding only.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Plan:
    """How a group of samples is computed.

    Attributes:
        case: static options.
        rates: control rates of the group's samples [Hz], shape (n,); None: all samples are in it.
        tile: loops in a tile.
        tiles: tiles that each device gets at once.
        devices: number of devices.
    """

    case: Case
    rates: np.ndarray | None
    tile: int
    tiles: int
    devices: int

    @property
    def batch(self) -> int:
        """Loops in one call."""
        return self.tile * self.tiles * self.devices

    @property
    def steps(self) -> int:
        """Physics steps of one loop, from all starts that it is judged by."""
        return _starts.steps(self.case)


def substeps(
    specification: Specification,
    control_rate: np.ndarray,
    along: Mapping[str, np.ndarray] | None = None,
) -> np.ndarray:
    """Physics steps in a control period for these control rates [Hz].

    Args:
        specification: checked.
        control_rate: shape (n,).
        along: parameters of all samples, whose limits a single joint's own steps are made finer
            for, see `jaxact.simulation.limited_steps`; None: of a robot.

    Raises:
        UserError: a control period is not a multiple of the physics step.
    """
    engine = engines.of(specification)
    step = specification.physics_step or engine.step
    if step is None:
        # The largest step that divides the control period and is no longer than the model's own.
        longest = kernel.longest_step(specification.setting)
        whole = fewest(control_rate, longest)
        return whole if engine.robot or along is None else _finer(whole, control_rate, along)
    ratio = 1.0 / (control_rate * step)
    whole = np.maximum(np.round(ratio), 1.0)
    wrong = np.abs(ratio - whole) > _ROUNDING * whole
    if np.any(wrong):
        rate = float(np.extract(wrong, control_rate)[0])
        raise UserError(
            f"control_rate = {rate:g} Hz: its period of {1.0 / rate:g} s is not a multiple of "
            f"physics_step = {step:g} s"
        )
    whole = whole.astype(int)
    own = specification.physics_step is None and not engine.robot and along is not None
    return _finer(whole, control_rate, along) if own else whole


def _finer(
    whole: np.ndarray, control_rate: np.ndarray, along: Mapping[str, np.ndarray]
) -> np.ndarray:
    return whole * limited_steps.finer(along, 1.0 / (control_rate * whole))


def fewest(control_rate: np.ndarray | float, longest: float) -> np.ndarray:
    """Fewest steps of equal length in a control period, none longer than `longest` [s].

    Args:
        control_rate: [Hz], any shape.
        longest: physics step that is not to be exceeded [s].
    """
    steps = np.ceil(1.0 / (np.asarray(control_rate) * longest) - _ROUNDING)
    return np.maximum(steps, 1.0).astype(int)


def _devices(specification: Specification) -> int:
    """Number of devices to use.

    Raises:
        UserError: more are asked for than there are.
    """
    there = len(jax.local_devices())
    engine = engines.of(specification)
    gaining = engine.cpu_devices if jax.default_backend() == "cpu" else None
    asked = specification.devices or gaining or there
    if gaining is not None and asked > gaining:
        raise UserError(
            f"devices = {asked}: on CPUs, the engine {engine.name} uses one; leave it out"
        )
    if asked > there:
        raise UserError(f"devices = {asked}: this machine has {there}; `jaxact info` lists them")
    return asked


def _refuse_deadlock(specification: Specification) -> None:
    """JAX 0.10 on few cores can wait for ever for its own threads on a large model.

    Raises:
        UserError: it could happen here, and how to prevent it.
    """
    old = engines.old_jax() and jax.default_backend() == "cpu"
    asked = os.environ.get("NPROC", "")
    threads = int(asked) if asked.isdigit() else os.cpu_count() or 1
    if old and engines.of(specification).large and threads < 8:
        raise UserError(
            "JAX 0.10 can hang on this machine with a model of one's own: set the environment "
            "variable NPROC=8 before Python starts, or use Python 3.12 or newer, which gets a "
            "newer JAX"
        )


def groups(
    specification: Specification,
    samples: Samples,
    *,
    together: int | None = None,
    refined: bool = False,
    alone: bool = False,
) -> list[Plan]:
    """How the groups of samples that one compiled kernel serves each are computed.

    Usually there is one. Samples of a built-in plant share it if their control periods hold as many
    physics steps, each with its own number of ticks, see `jaxact.simulation.own_ticks`; a robot is
    linearised, and compiled, for its own physics step, so that every control rate is a group.

    Args:
        specification: checked.
        samples: expanded from it.
        together: loops that are computed together; None: about a second of work.
        refined: values between those of the samples will be computed as well.
        alone: every control rate has a group of its own, whatever the plant.

    Raises:
        UserError: a control period is not a multiple of the physics step, there are too few
            devices, this version of JAX could hang, or no group has the control rates that are
            refined.
    """
    specification = engines.resolved(specification)
    _refuse_deadlock(specification)
    rates = samples.along[CONTROL_RATE].ravel()
    steps = substeps(specification, rates, samples.along)
    engine = engines.of(specification)
    kinds = rates if alone or engine.robot else steps
    if refined and _refines_rates(specification) and np.unique(kinds).size > 1:
        raise UserError(
            "adaptive: loops of different control rates have other physics steps here, so that "
            "the rates between them cannot be refined; give `control_rate` as a list"
        )
    devices = _devices(specification)
    tile = max(min(engines.tile_size(specification), len(samples)), engines.fewest(engine))
    found = []
    for kind in np.unique(kinds):
        own, count = rates[kinds == kind], steps[kinds == kind][0]
        along = samples.along | {CONTROL_RATE: own.reshape(-1, *(1,) * len(samples.dims))}
        case = _case(specification, along, int(count))
        size = together
        if size is None:
            # Batches of equal size, so that the last one is not mostly filling.
            size = -(-len(samples) // -(-len(samples) // engines.batch_size(case, tile, devices)))
        tiles = max(1, -(-size * own.size // (rates.size * tile * devices)))
        found.append(Plan(case, None if own.size == rates.size else own, tile, tiles, devices))
    return found


def _refines_rates(specification: Specification) -> bool:
    return any(axis.name == CONTROL_RATE and axis.listed is None for axis in specification.axes)


def steps_only(specification: Specification) -> bool:
    """Whether the setpoints stay where they step to."""
    return (specification.motion or _STEP).kind == "step"


def _case(specification: Specification, values: dict[str, np.ndarray], count: int) -> Case:
    """The static options that serve all samples with these values, which broadcast."""
    rates = values[CONTROL_RATE]
    fastest = float(np.max(rates))
    engine = engines.of(specification)
    torque_speed.check_samples(specification.setting, values)
    options = _drive.options(
        drive_of(kernel.occurring(specification.setting, values)),
        substeps=count,
        differenced=specification.velocity == "differenced",
    )
    on_cpu = jax.default_backend() == "cpu"
    if engine.exact and on_cpu:
        options = replace(options, staged=True)
    each = _rollout.whole_ticks(specification.duration, 1.0 / np.asarray(rates))
    ticks = int(each.max())
    varied = {base(axis.name) for axis in specification.axes}
    varied |= {base(name) for name in specification.parameters}
    changed = varied if engine.robot else set(own_motion(values))
    starts = _starts.needed(
        options,
        linear_plant=not engine.robot,
        rubs=kernel.rubs(specification.setting, values),
        disturbed=_disturbed(specification, values),
    )
    return Case(
        engine=engine,
        drive=options,
        rollout=RolloutOptions(
            ticks=ticks,
            several=bool(each.min() < ticks),
            unroll=(_UNROLL if on_cpu else _UNROLL_ON_GPU) if engine.exact else 1,
            linear_plant=not engine.robot,
            stops=engine.in_jax,
        ),
        masked=bool(np.any(np.ceil(specification.duration * rates - 1e-4) < ticks)),
        duration=specification.duration,
        model=kernel.model_digest(specification.setting),
        varied=tuple(name for name in OF_PLANT if name in changed),
        step=1.0 / (fastest * count) if engine.robot else 0.0,
        growth=_growth(
            _ROBOT_GROWTH if engine.robot else GrowthOptions(dense=not engine.exact), fastest
        ),
        starts=starts,
    )


def _disturbed(specification: Specification, values: dict[str, np.ndarray]) -> bool:
    """Whether every loop is judged by a motion of its own: a step, its initial state, or a push."""
    if not steps_only(specification):
        return False
    if specification.push is not None:
        return True
    moving = (SETPOINT, INITIAL_POSITION, INITIAL_VELOCITY)
    return any(base(key) in moving and bool(np.all(given != 0.0)) for key, given in values.items())


def _growth(usual: GrowthOptions, rate: float) -> GrowthOptions:
    """The options with blocks that last as long at another control rate [Hz].

    In a shorter block the slow modes hardly differ from each other; in a longer one the fast ones
    drown.
    """
    return replace(usual, block=max(4, round(usual.block * rate / _USUAL_RATE)))


def batches(
    plan: Plan, samples: Samples, numbers: np.ndarray | None = None
) -> Iterator[tuple[np.ndarray, int]]:
    """Numbers of the samples of each batch of the plan's group, filled up, and how many count.

    Args:
        plan: of the group.
        samples: of the sweep.
        numbers: of the samples to compute; None for all.
    """
    if numbers is None:
        numbers = np.arange(len(samples))
    if plan.rates is not None:
        numbers = numbers[np.isin(samples.take(numbers)[CONTROL_RATE], plan.rates)]
    for first in range(0, numbers.size, plan.batch):
        part = numbers[first : first + plan.batch]
        yield filled(part, plan.batch), part.size
