"""Whole robots: what the drive costs beside MJX's physics, and one robot against real time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from benchmarks import lone
from benchmarks.timing import Row, alternate
from jaxact.drive import Force
from jaxact.plants import mjx, posture
from jaxact.plants import model as models
from jaxact.sweep import engines, execute, plans, reading
from jaxact.sweep.samples import Samples, expand
from jaxact.sweep.specification import Specification

MODELS = Path("experiments/quadruped")

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
    asked = specification("quadruped.xml", "mjx", duration, loops)
    samples = expand(asked)
    ours, plan = rollouts(asked, samples)
    yield Row(
        "MJX quadruped, 12 joints, full drive and metrics (noise, quantisation, three delays)",
        "the same MJX rollout with a bare PD command",
        *alternate(ours, bare(samples, plan), 9),  # some per cent are to be told from noise
        "physics step",
        "at least 0.91 (10 % more)",
        1 / 1.1,
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


def specification(model: str, engine: str, duration: float, loops: int) -> Specification:
    """A sweep over the gains of one of the quadruped's models under the full drive."""
    text = f"""
    engine = "{engine}"
    duration = {duration}
    tile = {min(32, loops)}
    physics_step = 0.001
    [plant]
    model = "{model}"
    keyframe = "stand"
    [parameters]
    kp = 800
    kd = 12
    {_FULL}
    [axes]
    gain_scale = {np.linspace(1.0, 0.8, loops).tolist()}
    """
    return reading.parse(text, MODELS)


def rollouts(asked: Specification, samples: Samples) -> tuple[Callable[[], float], plans.Plan]:
    """The rollouts with their metrics, growth rates given; units: control periods of one loop."""
    asked = engines.resolved(asked)
    (plan,) = plans.groups(asked, samples)
    growth = np.full(plan.batch, -1.0)
    numbers = [batch for batch, _ in plans.batches(plan, samples)]

    def run() -> float:
        for batch in numbers:
            execute.simulate_batch(plan, asked, samples, batch, growth)
        return len(samples) * plan.case.rollout.ticks

    return run, plan


def bare(samples: Samples, plan: plans.Plan) -> Callable[[], float]:
    """MJX with a PD command and nothing else, in the same tiles; units as `rollouts`."""
    robot = models.read(MODELS / "quadruped.xml", keyframe="stand")
    start = posture.settled(robot)
    plant = mjx.place(robot, start).prepare(jnp.asarray(1e-3, jnp.float32))
    rest, carried = (jnp.asarray(row, jnp.float32) for row in (start.joints(robot), start.force))

    def rollout(scale: jax.Array) -> jax.Array:
        def period(state: Any, _: None) -> tuple[Any, None]:
            q, v = plant.measure(state)
            command = scale * (800.0 * (rest - q) - 12.0 * v) + carried
            return plant.advance(state, Force(command, command, None)), None

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
