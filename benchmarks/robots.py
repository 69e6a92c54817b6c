"""Whole robots: what the drive costs beside MJX's physics, and one robot against real time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from benchmarks import lone
from benchmarks.timing import Row, alternate
from jaxact.drive.step import Force
from jaxact.loops import reading
from jaxact.loops.samples import Samples, expand
from jaxact.loops.specification import Specification
from jaxact.plants.mjx import plant as mjx
from jaxact.robots import model as models
from jaxact.robots import posture
from jaxact.simulation import engines, execute, plans, starts
from jaxact.simulation.spectra import Rates


@dataclass(frozen=True)
class Robot:
    """A robot and its usual gains [N m/rad and N m s/rad]; loops in a tile on a CPU."""

    file: Path
    keyframe: str
    kp: float
    kd: float
    tile: int = 32


QUADRUPED = Robot(Path("experiments/quadruped/quadruped.xml"), "stand", 800.0, 12.0)
WITH_ARM = replace(QUADRUPED, file=QUADRUPED.file.with_name("quadruped_arm.xml"))
ARM = Robot(Path("benchmarks/arm.xml"), "reach", 400.0, 20.0, tile=64)

_FULL = """
actuator = "hyq"
delay = 0.002
measurement_delay = 0.0012
setpoint_delay = 0.002
position_resolution = 1e-5
velocity_resolution = 1e-3
command_resolution = 0.01
position_noise = 1e-5
velocity_noise = 1e-3
"""


def rows(quick: bool) -> Iterator[Row]:
    """The lines of the table."""
    loops, duration = (64, 0.02) if quick else (512, 0.2)
    asked = specification(ARM, "mjx", duration, loops)
    samples = expand(asked)
    ours, plan = rollouts(asked, samples)
    yield Row(
        "MJX arm, 6 joints, full drive and metrics (noise, quantisation, three delays)",
        "MJX's own step with a bare PD command",
        *alternate(ours, bare(ARM, samples, plan, own_step=False), 3),
        "physics step",
        "at least 1",
        1.0,
    )
    asked = specification(QUADRUPED, "mjx", duration, loops)
    samples = expand(asked)
    ours, plan = rollouts(asked, samples)
    yield Row(
        "MJX quadruped, 12 joints, full drive and metrics (noise, quantisation, three delays)",
        "the same MJX rollout with a bare PD command",
        # Some per cent are to be told from noise.
        *alternate(ours, bare(QUADRUPED, samples, plan, own_step=True), 9),
        "physics step",
        "at least 0.91 (10 % more)",
        1 / 1.1,
    )
    yield Row(
        "MJX quadruped, 12 joints, the same",
        "MJX's own step with a bare PD command",
        *alternate(ours, bare(QUADRUPED, samples, plan, own_step=False), 3),
        "physics step",
        "at least 1.5",
        1.5,
    )
    yield Row(
        "a robot of 18 joints in C MuJoCo on one core, full drive, control at 1 kHz",
        "real time",
        lone.on_one_core(0.2 if quick else 2.0),
        1e-3,
        "control period",
        "at least 5",
        5.0,
    )


def specification(robot: Robot, engine: str, duration: float, loops: int) -> Specification:
    """A sweep over the gains of a robot under the full drive."""
    text = f"""
    engine = "{engine}"
    duration = {duration}
    tile = {min(robot.tile, loops)}
    physics_step = 0.001
    [plant]
    model = "{robot.file.name}"
    keyframe = "{robot.keyframe}"
    [parameters]
    kp = {robot.kp}
    kd = {robot.kd}
    {_FULL}
    [axes]
    gain_scale = {np.linspace(1.0, 0.8, loops).tolist()}
    """
    return reading.parse(text, robot.file.parent)


def rollouts(asked: Specification, samples: Samples) -> tuple[Callable[[], float], plans.Plan]:
    """The rollouts with their metrics, growth rates given; units: physics steps of all starts."""
    asked = engines.resolved(asked)
    (plan,) = plans.groups(asked, samples)
    rates = Rates(np.full(plan.batch, -1.0))
    numbers = [batch for batch, _ in plans.batches(plan, samples)]

    def run() -> float:
        for batch in numbers:
            execute.simulate_batch(plan, asked, samples, batch, rates)
        return len(samples) * starts.steps(plan.case)

    return run, plan


def bare(
    robot: Robot, samples: Samples, plan: plans.Plan, *, own_step: bool
) -> Callable[[], float]:
    """MJX with a PD command and nothing else, in the same tiles; units as `rollouts`.

    The step is MJX's (`mjx.step`), or jaxact's of the same model (`own_step`); in MJX-Warp, if the
    plan's engine is that.
    """
    read = models.read(robot.file, keyframe=robot.keyframe)
    start = posture.settled(read)
    plant = mjx.place(read, start, impl=plan.case.engine.impl)
    plant = plant.prepare(jnp.asarray(1e-3, jnp.float32))
    rest, carried = (jnp.asarray(row, jnp.float32) for row in (start.joints(read), start.force))

    def step(state: Any, command: jax.Array) -> Any:
        force = Force(command, command, None)
        if own_step:
            return plant.advance(state, force)
        with jax.numpy_rank_promotion("allow"):
            return plant.state(mjx.mjx.step(plant.model, plant.loaded(state, force)))

    def rollout(scale: jax.Array) -> jax.Array:
        def period(state: Any, _: None) -> tuple[Any, None]:
            q, v = plant.measure(state)
            return step(state, scale * (robot.kp * (rest - q) - robot.kd * v) + carried), None

        state = plant.init(rest, jnp.zeros_like(rest))
        return plant.measure(jax.lax.scan(period, state, None, length=ticks)[0])[0]

    ticks = plan.case.rollout.ticks
    mesh = Mesh(np.array(jax.local_devices()[: plan.devices]), ("device",))
    spec = PartitionSpec("device")
    tiles = jax.jit(
        jax.shard_map(
            lambda scales: jax.lax.map(jax.vmap(rollout), scales),
            mesh=mesh,
            in_specs=spec,
            out_specs=spec,
            check_vma=False,
        )
    )
    scales = samples.take(np.arange(len(samples)))["gain_scale"]
    given = jnp.asarray(np.resize(scales, plan.batch).reshape(-1, plan.tile), jnp.float32)

    def run() -> float:
        jax.block_until_ready(tiles(given))
        return plan.batch * ticks

    return run
