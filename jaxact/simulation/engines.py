"""Which engine simulates a specification, and how many loops it computes side by side."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import jax

from jaxact.engines import (
    AUTO,
    MUJOCO,
    ROBOT_IN_MJX,
    WARP,
    Engine,
    Name,
    names,
)
from jaxact.errors import InexactWarning, UserError
from jaxact.loops.specification import Plant, Setting, Specification
from jaxact.simulation import starts as _starts
from jaxact.simulation.kernel import Case

# Most degrees of freedom of a robot without constraints that MJX on a CPU simulates faster than C
# MuJoCo: as many as `jaxact.plants.mjx.step` writes out.
_LIGHT = 7
# Most degrees of freedom of a robot that is held and in MJX the faster one: those of a quadruped. A
# step takes MJX 12 to 17 us and C MuJoCo 19; with an arm on it (24) 25 against 20.
_HELD = 18
# Physics steps of a sweep from which on MJX is the faster one on a CPU: of a light robot for each
# degree of freedom squared, of another one whose step is written out for each one and row of
# constraints, and of one that is held. On two cores, compiling anew, both engines are within a
# tenth of each other between these numbers of steps, in millions: one hinge up to 0.2; two 0.4 to
# 1.1, with limits 1.0 to 1.9; six 2.9 to 4.9, with limits 13 to 25, with dry friction too 17 to 40;
# a quadruped 5 to 9. See `benchmarks.choice`.
_MANY_LIGHT, _MANY_WRITTEN_OUT, _MANY_HELD = 1.1e5, 4.5e5, 8e6
# Those for each core, of any robot, from which on MJX is the faster one on a GPU: it compiles for
# 40 s, and then a quadruped's step takes an H200 0.27 us, and one core in C MuJoCo 19.
_MANY_ON_GPU = 3e6
# Most iterations of a held robot's solver with which MJX is the faster one: a tile waits for the
# slowest of its robots. With up to four a quadruped's step takes MJX .6 of C MuJoCo's time, with up
# to a hundred the Go1's 1.7, and on a stand 1.2.
_ITERATIONS = 10
# Loops of light robots in a tile on a CPU: little enough for the first-level cache, and vector
# units like it better than the usual one, by a third (six hinges) to two thirds (two).
_TILE_OF_LIGHT = 128


def resolved(specification: Specification) -> Specification:
    """The specification with an engine in place of "auto": the one expected to be faster here.

    That is C MuJoCo, which compiles the drive only. So it is for a single loop; for a sweep, which
    may be long enough for MJX to make up for its compiling, see
    `jaxact.sweeping.throughput.fastest`.

    Raises:
        UserError: the engine cannot simulate the robot.
    """
    asked, chosen = specification.engine, specification.simulator
    if chosen is None and asked != AUTO:
        if specification.robot:
            others = "', '".join((AUTO, *names(robot=True)))
            raise UserError(f"engine = '{asked}': simulates no robot; use '{others}'")
        allowed = "', '".join(names(robot=False))
        raise UserError(
            f"engine = '{asked}': is for robots, of jaxact.robot or [plant] model; a joint has "
            f"'{allowed}'"
        )
    if chosen is not None and not chosen.simulates:
        others = "', '".join((AUTO, *names(robot=True)))
        raise UserError(
            f"engine = '{asked}': computes the margins of a sweep and simulates nothing; "
            f"use '{others}'"
        )
    if chosen is None:
        chosen = MUJOCO
    elif chosen.robot:
        if specification.precision == "float64" and not chosen.double:
            doubles = "', '".join(name for name in names(robot=True) if name != asked)
            raise UserError(
                f"precision = 'float64': {chosen.title} computes in float32; use it, or engine "
                f"'{doubles}'"
            )
        _demand(specification.setting, chosen)
    return replace(specification, engine=chosen.name)


def of(specification: Specification) -> Engine:
    """The engine of a specification from `resolved`."""
    engine = specification.simulator
    assert engine is not None
    return engine


def _demand(setting: Setting, engine: Engine) -> None:
    """Raise UserError unless the engine is there and can simulate the robot."""
    if engine.packages:
        from jaxact.plants import warp  # starts MJX

        warp.demand()
    robot, model = _robot(setting)
    model.demand(robot, engine.name)


def _robot(setting: Setting) -> tuple[Any, Any]:
    """The robot, and the module that knows which engines suit it."""
    from jaxact.robots import model  # imports MuJoCo, which the mass plant does not need

    return _scene(setting).robot, model


def _scene(setting: Setting) -> Any:
    from jaxact.loops import robots

    return robots.scene(setting.plant)


def tell_inexact(plant: Plant | None) -> None:
    """Warn of what MJX simulates otherwise than MuJoCo in a robot; nothing without one."""
    if plant is None:
        return
    from jaxact.loops import robots
    from jaxact.robots import model

    for found in model.inexact(robots.scene(plant).robot):
        said = f"the engine `mjx` {found.mjx} ({found.where}): {found.advice}"
        warnings.warn(said, InexactWarning, stacklevel=3)


def able(specification: Specification) -> tuple[Name, ...]:
    """The engines that simulate the robot as MuJoCo does and are worth measuring here.

    MJX-Warp is on an NVIDIA GPU only; on a CPU it is there to be asked for by name.
    """
    robot, model = _robot(specification.setting)
    refused = _place() != 0 and _in_mjx(_scene(specification.setting)) is None
    engines = [MUJOCO] if refused else [ROBOT_IN_MJX, MUJOCO]
    if jax.default_backend() == "gpu" and specification.precision == "float32":
        from jaxact.plants import warp  # starts MJX

        if not warp.lacking() and not warp.refusal(robot.model):
            engines.append(WARP)
    return tuple(engine.name for engine in engines if model.exact(robot, engine.name))


def _in_mjx(scene: Any) -> Any:
    """The robot in MJX; None where MJX itself refuses it, for contacts that it does not have."""
    from jaxact.plants.mjx import plant  # starts MJX

    try:
        return plant.place(scene.robot, scene.posture)
    except UserError:
        return None


def compiling_pays(specification: Specification, steps: float, devices: int) -> bool:
    """Whether a sweep is long enough for MJX, which compiles longer, to be the faster one.

    On a GPU that can be so of any robot, on a CPU of those whose step is written out, and of others
    that constraints hold, if MJX computes these of many robots at once. Of a quadruped that hangs,
    and is at none of its limits, C MuJoCo computes no constraints, and MJX all that may act: a step
    takes both the same time.

    Args:
        specification: of a robot that MJX can simulate, as far as that is known.
        steps: physics steps of all loops.
        devices: that MJX would use; C MuJoCo uses every core.
    """
    from jaxact.plants import mujoco

    if _place() != 0:
        return steps > _MANY_ON_GPU * mujoco.cores()
    scene = _scene(specification.setting)
    model = scene.robot.model
    if light(specification.setting):
        return steps > _MANY_LIGHT * model.nv**2
    if model.nv > _HELD or specification.precision != "float32" or old_jax():
        return False
    if steps <= min(_MANY_WRITTEN_OUT * model.nv, _MANY_HELD):
        return False
    if devices < mujoco.cores():
        return False
    placed = _in_mjx(scene)
    if placed is None:
        return False
    from jaxact.plants.mjx import step

    if step.is_small(placed.model, placed.data):
        return steps > _MANY_WRITTEN_OUT * model.nv * step.rows(placed.data)
    at_once = step.is_side_by_side(placed.model, placed.data)
    at_once = at_once and model.opt.iterations <= _ITERATIONS
    return steps > _MANY_HELD and at_once and mujoco.is_held(scene.robot, scene.posture)


def light(setting: Setting) -> bool:
    """Whether a robot has few degrees of freedom and no constraints, so that MJX is the faster one.

    On two cores, with 2 hinges: MJX 0.1 us a step, C MuJoCo 3.8; with 6 hinges: 0.75 against 2.75.
    With limits or contacts it depends on the robot.
    """
    model = _robot(setting)[0].model
    touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    held = model.jnt_limited.any() or model.tendon_limited.any() or model.neq
    rubbing = model.dof_frictionloss.any() or model.tendon_frictionloss.any()
    return model.nv <= _LIGHT and int(touching.sum()) <= 1 and not held and not rubbing


def fewest(engine: Engine) -> int:
    """Smallest tile of a sweep that has but one loop.

    XLA's simplifier goes round in circles, and complains, over products of a matrix with a vector
    in batches of one.
    """
    return 2 if engine.robot else 1


def tile_size(specification: Specification) -> int:
    """Loops in a tile: the specification's own, else the engine's usual."""
    if specification.tile:
        return specification.tile
    engine = of(resolved(specification))
    if engine is ROBOT_IN_MJX and _place() == 0 and not old_jax() and light(specification.setting):
        return _TILE_OF_LIGHT
    return engine.tiles[_place()]


def usual_rate(case: Case) -> float:
    """Physics steps per second on one device, before anything was measured on a machine."""
    rates = case.engine.rates
    return case.engine.work if rates is None else rates[_place()]


def _place() -> int:
    """Of a CPU's number among those of a CPU and a GPU."""
    return 0 if jax.default_backend() == "cpu" else 1


def batch_size(case: Case, tile: int, devices: int) -> int:
    """Loops that make about a second of work, in whole tiles for every device."""
    per_tile = tile * _starts.steps(case)
    return max(1, int(case.engine.work / per_tile)) * tile * devices


def old_jax() -> bool:
    """Whether this is JAX 0.10, which on a CPU can wait for ever for threads of its own."""
    return jax.__version__.startswith("0.10.")
