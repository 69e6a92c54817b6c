"""What jaxact is held against: a C loop, MuJoCo's own batch, and MJX with a bare PD controller."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from jaxact.drive import step as drive
from jaxact.drive.step import Coefficients
from jaxact.loops import loop
from jaxact.loops.conversion import drive_of
from jaxact.loops.loop import Loop
from jaxact.loops.samples import Samples
from jaxact.plants.mass import Mass
from jaxact.plants.mjx import plant as mjx

_OUTPUTS = 31


def c_loop(samples: Samples, ticks: int) -> Callable[[], float] | None:
    """The hand-vectorised C loop on these samples; None without a C compiler.

    Units: loop steps. The same arithmetic and the same coefficients as the sweep's rollouts.
    """
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return None
    drives = drive_of(samples.values)
    options = drive.options(drives)
    source = Path(__file__).with_name("mass_loop.c")
    folder = Path(tempfile.mkdtemp(prefix="jaxact-benchmark-"))
    library = folder / "mass_loop.so"
    flags = ["-O3", "-march=native", "-mprefer-vector-width=512", "-ffp-contract=fast"]
    subprocess.run(
        [compiler, *flags, f"-DSLOTS={options.command_slots}", "-shared", "-fPIC", "-o"]
        + [str(library), str(source), "-lpthread"],
        check=True,
    )
    simulate = ctypes.CDLL(str(library)).simulate
    shutil.rmtree(folder)
    inputs = _aligned(_inputs(samples, options))
    count = inputs.shape[1]
    outputs = _aligned(np.zeros((_OUTPUTS, count), np.float32))
    threads = os.cpu_count() or 1

    def run() -> float:
        simulate(
            inputs.ctypes.data_as(ctypes.c_void_p),
            outputs.ctypes.data_as(ctypes.c_void_p),
            ctypes.c_size_t(count),
            ctypes.c_int(ticks),
            ctypes.c_int(threads),
        )
        return count * ticks

    run.outputs = outputs  # type: ignore[attr-defined]
    return run


def _aligned(array: np.ndarray) -> np.ndarray:
    """A copy whose rows start at multiples of 64 bytes."""
    room = np.zeros(array.size + 16, np.float32)
    start = (-room.ctypes.data // 4) % 16
    copy = room[start : start + array.size].reshape(array.shape)
    copy[:] = array
    return copy


def _inputs(samples: Samples, options: drive.DriveOptions) -> np.ndarray:
    """Rows of the C loop's inputs, in its order."""

    def coefficients(values: dict[str, jax.Array]) -> tuple[Any, Coefficients]:
        closed = Loop(Mass(values["mass"]), drive_of(values))
        prepared = loop.prepare(closed, options)
        return prepared.plant, prepared.drive

    values = {name: jnp.asarray(value, jnp.float32) for name, value in samples.values.items()}
    plant, prepared = jax.jit(jax.vmap(coefficients))(values)
    controller, response = prepared.drive.controller, prepared.responses
    start, setpoint = values["initial_position"], values["setpoint"]
    rows = [controller.kp, controller.kd, controller.feedforward, setpoint, start]
    rows += [1.0 / (setpoint - start), plant.step, plant.mean_gain, plant.moment_gain]
    for triple in (response.force, response.rate, response.mean, response.moment):
        rows += [coefficient[:, 0] for coefficient in triple]
    rows += list(prepared.command_at)
    return np.stack([np.asarray(row, np.float32) for row in rows])


def mujoco_batch(samples: Samples, ticks: int, *, delayed: bool) -> Callable[[], float]:
    """`mujoco.batch` on the slide joint, all cores, the PD command written at every step.

    With `delayed`, MuJoCo's own actuator delay, one for each simulation. It has no second-order
    actuator, so its loop is the lighter one. Units: loop steps.
    """
    from mujoco.batch import Batch

    count = len(samples)
    gains = {name: samples.values[name][:, None].copy() for name in ("kp", "kd", "setpoint")}
    delay = samples.values["delay"]
    native = f'delay="{delay.max()}" nsample="{round(delay.max() * 1e3) + 2}"' if delayed else ""
    text = mjx.SLIDE.read_text().replace('timestep="0.00025"', 'timestep="0.001"')
    text = text.replace('name="slide" joint="slide"/>', f'name="slide" joint="slide" {native}/>')
    batch = Batch(mujoco.MjModel.from_xml_string(text), count)
    if delayed:
        batch.expand("actuator_delay")[:] = delay[:, None]
    qpos, qvel, ctrl = (batch.bind(name) for name in ("qpos", "qvel", "ctrl"))

    def run() -> float:
        batch.reset()
        for _ in range(ticks):
            ctrl[:] = gains["kp"] * (gains["setpoint"] - qpos) - gains["kd"] * qvel
            batch.step()
        return count * ticks

    return run


def bare_mjx(
    samples: Samples, ticks: int, tile: int, devices: int, *, own_step: bool
) -> Callable[[], float]:
    """MJX on the slide joint with a PD command and nothing else, in the same tiles, at 1 kHz.

    The step is MJX's (`mjx.step`), of a state without what follows from it, or jaxact's of the same
    model (`own_step`). Units: control periods of one loop.
    """
    plant = mjx.load().prepare(jnp.asarray(1e-3, jnp.float32))

    def step(state: Any, command: jax.Array) -> Any:
        force = drive.Force(mean=command, moment=command, partial=None)
        if own_step:
            return plant.advance(state, force)
        with jax.numpy_rank_promotion("allow"):
            return plant.state(mjx.mjx.step(plant.model, plant.loaded(state, force)))

    def rollout(kp: jax.Array, kd: jax.Array, setpoint: jax.Array) -> jax.Array:
        def period(state: Any, _: None) -> tuple[Any, None]:
            q, v = plant.measure(state)
            return step(state, kp * (setpoint - q) - kd * v), None

        start = plant.init(jnp.zeros(1), jnp.zeros(1))
        return plant.measure(jax.lax.scan(period, start, None, length=ticks)[0])[0]

    mesh = Mesh(np.array(jax.local_devices()[:devices]), ("device",))
    spec = PartitionSpec("device")
    tiles = jax.jit(
        jax.shard_map(
            lambda *inputs: jax.lax.map(lambda tile: jax.vmap(rollout)(*tile), inputs),
            mesh=mesh,
            in_specs=spec,
            out_specs=spec,
            check_vma=False,
        )
    )
    inputs = [
        jnp.asarray(samples.values[name].reshape(-1, tile), jnp.float32)
        for name in ("kp", "kd", "setpoint")
    ]

    def run() -> float:
        jax.block_until_ready(tiles(*inputs))
        return len(samples) * ticks

    return run
