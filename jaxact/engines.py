"""The engines: what each can simulate, and what the rest of the package needs to know of it.

An engine is chosen by name in a specification. Of MJX there are two, as a robot's loop takes some
forty times the time and memory of the built-in joint's. Nobody else compares names: code asks the
engine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from jaxact.errors import UserError, nearest, shown

Name = Literal["mass", "mjx", "mujoco", "warp", "linear"]
Asked = Literal[Name, "auto"]
"""What a specification may ask for."""
_MIB = 2**20


@dataclass(frozen=True)
class Engine:
    """What simulates a plant.

    Attributes:
        name: in specifications.
        title: in captions.
        robot: whether it simulates robots, or the built-in joint.
        simulates: whether it simulates, or computes margins of the linearised robot.
        exact: whether it solves the joint's equation in closed form: by steps of any length, and
            whatever the mass.
        in_jax: whether it runs in JAX, compiled with the drive in tiles, or outside of it.
        impl: of MJX, "jax" or "warp"; "" where nothing of MJX is loaded.
        differentiable: whether its steps have derivatives.
        double: whether it can compute in float64.
        reproducible: whether it comes to the same bits each time, on a GPU too.
        step: physics step where none is given [s]; None: the control period, or, of a robot, what
            its model has.
        tiles: loops in a tile, on a CPU, where the state should stay in the first-level cache, and
            on a GPU, which wants many; measured.
        work: physics steps that one call to a device simulates: about a second of work on a CPU.
        rates: physics steps per second on a CPU and a GPU, before any is measured, growth rates
            included.
        cpu_devices: how many CPU devices gain by it; None: all.
        large: whether one loop is so much work that XLA cuts up a single operation on a CPU.
        memory: what Python, JAX and a kernel that is being compiled take, measured and rounded up
            [bytes].
        startup: least time before the first loop is simulated, programs being compiled [s].
        worth: shortest sweep for which measuring tiles pays, as it takes some compilations [s].
        packages: on whose version the results depend, beside those of all engines.
    """

    name: Name
    title: str
    robot: bool
    tiles: tuple[int, int]
    work: float
    memory: int
    startup: float
    worth: float
    simulates: bool = True
    exact: bool = False
    in_jax: bool = True
    impl: str = ""
    differentiable: bool = True
    double: bool = True
    reproducible: bool = True
    step: float | None = None
    rates: tuple[float, float] | None = None
    cpu_devices: int | None = None
    large: bool = False
    packages: tuple[str, ...] = ()


MASS = Engine(
    "mass", "exact mass plant", robot=False, exact=True,
    tiles=(128, 262144), work=6e8, memory=600 * _MIB, startup=3.0, worth=300.0,
)  # fmt: skip
JOINT_IN_MJX = Engine(
    "mjx", "MuJoCo MJX", robot=False, impl="jax", step=0.25e-3,
    tiles=(128, 65536), work=2e8, memory=900 * _MIB, startup=10.0, worth=1800.0,
)  # fmt: skip
ROBOT_IN_MJX = Engine(
    "mjx", "MuJoCo MJX", robot=True, impl="jax", large=True,
    tiles=(32, 8192), work=5e6, memory=1500 * _MIB, startup=10.0, worth=1800.0,
)  # fmt: skip
MUJOCO = Engine(
    "mujoco", "MuJoCo (C)", robot=True, in_jax=False, rates=(8e4, 8e4),
    tiles=(32, 32), work=2e5, memory=700 * _MIB, startup=5.0, worth=600.0,
)  # fmt: skip
# On a CPU each of its steps costs 10 ms whatever the tile: kernels are started from Python, one by
# one, for one device after the other.
WARP = Engine(
    "warp", "MJX-Warp", robot=True, impl="warp", differentiable=False, double=False,
    reproducible=False, cpu_devices=1, packages=("warp-lang",), rates=(1e4, 5e6),
    tiles=(256, 4096), work=1e4, memory=1100 * _MIB, startup=10.0, worth=1800.0,
)  # fmt: skip
# No rollouts: its loops are linearised in C MuJoCo, and their margins are computed; its work is
# loops of a chunk.
LINEAR = Engine(
    "linear", "margins of the linearised robot", robot=True, in_jax=False, simulates=False,
    tiles=(24, 24), work=200, memory=700 * _MIB, startup=4.0, worth=math.inf,
    reproducible=False, rates=(20.0, 20.0),
)  # fmt: skip

ENGINES = (MASS, JOINT_IN_MJX, ROBOT_IN_MJX, MUJOCO, WARP, LINEAR)
LINEARISING = ("mujoco", "mjx")
"""In which a robot can be linearised for its margins; the first one where none is named."""
AUTO: Literal["auto"] = "auto"
"""The name that stands for the engine of a robot that is expected to be the fastest."""


def known(name: str, *, robot: bool) -> Engine | None:
    """The engine of this name for a robot or the built-in joint.

    Returns:
        None where there is none, or the robot decides.
    """
    if name == AUTO and not robot:
        return JOINT_IN_MJX
    return next((one for one in ENGINES if (one.name, one.robot) == (name, robot)), None)


def names(*, robot: bool) -> tuple[Name, ...]:
    """Of the engines that simulate robots, or the built-in joint."""
    return tuple(one.name for one in ENGINES if one.robot == robot and one.simulates)


def named(name: str) -> Engine | None:
    """An engine of this name, whatever it simulates; None where there is none."""
    return next((one for one in ENGINES if one.name == name), None)


def check_name(name: Any, *, robot: bool, margins: bool = False) -> None:
    """Raise UserError, with the names that there are, for an engine that nobody knows.

    Args:
        name: of it; None for none.
        robot: whether a robot is simulated, or a joint.
        margins: whether the margins of a robot will do.
    """
    if name is None or name == AUTO or named(name) is not None:
        return
    own = (*names(robot=True), AUTO, *([LINEAR.name] if margins else [])) if robot else ()
    raise UserError(f"engine = {shown(name)}; {nearest(name, own or names(robot=False))}")


def best_precision(name: str | None) -> Literal["float32", "float64"]:
    """The best one that an engine of this name has; float64 where none is named."""
    own = named(name or "")
    return "float64" if own is None or own.double else "float32"
