"""Sweeps and rollouts of a single joint: the mass plant against a C loop, MJX against MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator


def mass(quick: bool) -> Iterator:
    """Lines of the table: sweeps of the mass plant, and the whole command."""
    import jax

    from benchmarks import rivals, sweeps
    from benchmarks.timing import Row, alternate
    from jaxact.loops.samples import expand

    asked = sweeps.specification("mass", 64 if quick else 512, 0.2 if quick else 2.0)
    samples = expand(asked)
    ticks = sweeps.steps(asked, samples) // len(samples)
    small = sweeps.specification("mass", 32 if quick else 64, 0.2)
    small_ticks = sweeps.steps(small, expand(small)) // len(expand(small))
    batch = rivals.mujoco_batch(expand(small), small_ticks, delayed=True)
    yield Row(
        "mass sweep, growth rates and metrics included",
        "mujoco.batch with its own delay, no metrics",
        *alternate(sweeps.whole(asked), batch, 3),
        "loop step",
        "at least 500",
        500.0,
    )
    loop = rivals.c_loop(samples, ticks)
    if loop is None:
        print("no C compiler: the C loop is left out")
        return
    old = tuple(int(part) for part in jax.__version__.split(".")[:2]) < (0, 11)
    factor = 4.0 if old else 2.0
    target = f"at least {1 / factor:g} (jax {jax.__version__})"
    yield Row(
        "mass rollouts with metrics",
        "C loop of the same arithmetic, AVX, all threads",
        *alternate(sweeps.rollouts(asked), loop),
        "loop step",
        target,
        1 / factor,
    )
    yield Row(
        "mass sweep, growth rates included",
        "C loop without growth rates",
        *alternate(sweeps.whole(asked), loop, 3),
        "loop step",
        "at least 0.77 (1.3 times as long)",
        1 / 1.3,
    )
    gains = 64 if quick else 3200
    yield Row(
        f"the whole command `jaxact sweep` over {gains**2:,} loops, programs kept from before",
        "C loop without growth rates, store or start",
        *alternate(sweeps.command("mass", gains, 2.0), loop, 3),
        "loop step",
        "at least 0.77 (1.3 times as long)",
        1 / 1.3,
    )


def mjx(quick: bool) -> Iterator:
    """Lines of the table: sweeps of a joint in MJX, and what the full drive costs."""
    from benchmarks import rivals, sweeps
    from benchmarks.timing import Row, alternate
    from jaxact.loops.samples import expand
    from jaxact.simulation import plans

    gains, duration = (16, 0.04) if quick else (32, 0.5)
    coarse = sweeps.specification("mjx", gains, duration, physics_step=0.001)
    samples = expand(coarse)
    ticks = sweeps.steps(coarse, samples) // len(samples)
    yield Row(
        "MJX sweep, growth rates and metrics included",
        "mujoco.batch with its own delay, no metrics",
        *alternate(
            sweeps.whole(coarse), rivals.mujoco_batch(samples, min(ticks, 200), delayed=True), 3
        ),
        "physics step",
        "at least 2",
        2.0,
    )
    full = sweeps.with_everything(coarse)
    (plan,) = plans.groups(full, samples)
    for own_step, rival, target, wanted in (
        (False, "MJX's own step with a bare PD command", "at least 0.8 (25 % more)", 0.8),
        (True, "jaxact's step of MJX's model with a bare PD command", "none: what it costs", 0.0),
    ):
        bare = rivals.bare_mjx(samples, ticks, plan.tile, plan.devices, own_step=own_step)
        yield Row(
            "MJX rollout with the full drive and metrics (noise, quantisation, three delays)",
            rival,
            *alternate(sweeps.rollouts(full), bare, 3),
            "physics step",
            target,
            wanted,
        )
