"""Engines, and how many loops each likes to compute side by side.

`mass` is the exact mass plant; `mjx`, `warp` and `mujoco` simulate models.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, cast

import jax

from jaxact.errors import UserError
from jaxact.sweep import starts as _starts
from jaxact.sweep.kernel import Case
from jaxact.sweep.specification import Setting, Specification

Engine = Literal["mjx", "mujoco", "warp"]
"""Of a robot."""

# Loops in a tile, where none is given: measured on CPUs, where the state should stay in the
# first-level cache, and GPUs, which want many. On a CPU each step of MJX-Warp costs 10 ms whatever
# the tile: its kernels are started from Python, one by one.
_TILES = {
    ("mass", "cpu"): 128, ("mjx", "cpu"): 128, ("mujoco", "cpu"): 32, ("warp", "cpu"): 256,
    ("mass", "gpu"): 65536, ("mjx", "gpu"): 4096, ("mujoco", "gpu"): 32, ("warp", "gpu"): 4096,
}  # fmt: skip
# The same for robots in MJX on a CPU: their states are far larger.
_ROBOT_TILE = 32
# Most degrees of freedom of a robot without constraints that MJX on a CPU simulates faster than C
# MuJoCo: as many as `jaxact.plants.mjx_step` writes out.
_LIGHT = 7
# Physics steps that one call to a device simulates: about a second of work; of MJX-Warp on a CPU.
_WORK = {"mass": 6e8, "mjx": 5e6, "mujoco": 2e5, "warp": 1e4}
# Of robots in C MuJoCo on a core, growth rates included: a quadruped's, measured.
_ROBOT_RATE = 8e4
# The same work for the single joint in MJX.
_JOINT_WORK = 2e8


def resolved(specification: Specification) -> Specification:
    """The specification with an engine in place of "auto": the one expected to be faster here.

    On a GPU that is MJX where MJX can simulate the robot, on a CPU C MuJoCo: it needs no
    compilation, and for robots with contacts it is the faster one. A long sweep from the command
    line measures instead, see `jaxact.sweep.throughput.fastest`.

    Raises:
        UserError: the engine cannot simulate the robot.
    """
    if specification.plant is None:
        if specification.engine in ("mujoco", "warp"):
            raise UserError(
                f"engine = '{specification.engine}': simulates robots; give one with [plant] model"
            )
        if specification.engine == "auto":
            return replace(specification, engine="mjx")
        return specification
    if specification.engine == "mass":
        raise UserError("engine = 'mass': simulates no robot; use 'auto', 'mjx', 'mujoco', 'warp'")
    if specification.engine == "warp" and specification.precision == "float64":
        raise UserError(
            "precision = 'float64': MJX-Warp computes in float32; use it, or engine 'mjx', 'mujoco'"
        )
    return replace(specification, engine=_for_robot(specification.setting, specification.engine))


def _for_robot(setting: Setting, asked: str) -> Engine:
    """The engine that simulates a robot: the one asked for, or the one expected to be faster.

    Raises:
        UserError: the engine asked for cannot simulate the robot.
    """
    from jaxact.plants import model  # imports MuJoCo, which the mass plant does not need
    from jaxact.sweep import robots

    assert setting.plant is not None
    robot = robots.scene(setting.plant).robot
    if asked == "warp":
        from jaxact.plants import warp  # starts MJX

        warp.demand()
    if asked != "auto":
        model.demand(robot, asked)
        return cast(Engine, asked)
    if jax.default_backend() == "cpu":
        return "mujoco"
    return "mjx" if model.suits(robot, "mjx") else "mujoco"


def able(specification: Specification) -> tuple[Engine, ...]:
    """The engines that can simulate the robot and are worth measuring here.

    MJX-Warp is on an NVIDIA GPU only; on a CPU it is there to be asked for by name.
    """
    from jaxact.plants import model  # as above
    from jaxact.sweep import robots

    assert specification.plant is not None
    robot = robots.scene(specification.plant).robot
    engines: tuple[Engine, ...] = ("mjx", "mujoco")
    if jax.default_backend() == "gpu" and specification.precision == "float32":
        from jaxact.plants import warp  # starts MJX

        if not warp.lacking() and not warp.refusal(robot.model):
            engines = ("mjx", "mujoco", "warp")
    return tuple(engine for engine in engines if model.suits(robot, engine))


def light(setting: Setting) -> bool:
    """Whether a robot has few degrees of freedom and no constraints, so that MJX is the faster one.

    On two cores, with 2 hinges: MJX 0.1 us a step, C MuJoCo 3.8; with 6 hinges: 0.75 against 2.75.
    With limits or contacts it depends on the robot.
    """
    from jaxact.sweep import robots  # as above

    assert setting.plant is not None
    model = robots.scene(setting.plant).robot.model
    touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    held = model.jnt_limited.any() or model.tendon_limited.any() or model.neq
    rubbing = model.dof_frictionloss.any() or model.tendon_frictionloss.any()
    return model.nv <= _LIGHT and int(touching.sum()) <= 1 and not held and not rubbing


def fewest(specification: Specification) -> int:
    """Smallest tile of a sweep that has but one loop.

    XLA's simplifier goes round in circles, and complains, over products of a matrix with a vector
    in batches of one.
    """
    return 1 if specification.plant is None else 2


def tile_size(specification: Specification) -> int:
    """Loops in a tile: the specification's own, else the engine's usual."""
    specification = resolved(specification)
    platform = "cpu" if jax.default_backend() == "cpu" else "gpu"
    if specification.tile is not None:
        return specification.tile
    if specification.plant is not None and (specification.engine, platform) == ("mjx", "cpu"):
        return _ROBOT_TILE
    return _TILES[specification.engine, platform]


def usual_rate(case: Case) -> float:
    """Physics steps per second on one device, before anything was measured on a machine."""
    if case.engine == "warp" and jax.default_backend() != "cpu":
        return _WORK["mjx"]
    if case.engine == "mujoco":
        return _ROBOT_RATE
    return _work(case)


def batch_size(case: Case, tile: int, devices: int) -> int:
    """Loops that make about a second of work, in whole tiles for every device."""
    per_tile = tile * _starts.steps(case)
    return max(1, int(_work(case) / per_tile)) * tile * devices


def _work(case: Case) -> float:
    """Physics steps that one call to a device simulates."""
    return _JOINT_WORK if case.engine == "mjx" and not case.model else _WORK[case.engine]


def old_jax() -> bool:
    """Whether this is JAX 0.10, which on a CPU can wait for ever for threads of its own."""
    return jax.__version__.startswith("0.10.")
