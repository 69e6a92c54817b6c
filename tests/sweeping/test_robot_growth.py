"""Growth rates of robots on their feet, against the eigenvalues of their loops."""

from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.loops import reading
from jaxact.loops.samples import explicit
from jaxact.simulation import execute, kernel, plans, robot_loop

ROBOTS = Path(mujoco.__file__).parent / "mjx" / "test_data"
DRIVES = (("ideal", 0.005), ("hyq", 0.001), ("starleth", 0.0123))


@dataclass(frozen=True)
class Case:
    """A robot at a keyframe, its control rate [Hz], and the ranges of its gains."""

    model: str
    keyframe: str
    rate: float
    kp: tuple[float, float]
    kd: tuple[float, float]


CASES = {
    # Some 50 slow modes: weight that creeps on two feet, and limbs of very different size.
    "humanoid": Case("humanoid/humanoid.xml", "squat", 1000.0, (40.0, 400.0), (0.5, 10.0)),
    "shaking": Case("humanoid/humanoid.xml", "squat", 1000.0, (40.0, 4e5), (0.5, 1000.0)),
    "quadruped": Case(
        "barkour_v0/assets/barkour_v0_mjx.xml", "standing", 250.0, (2.0, 100.0), (0.05, 2.0)
    ),
}


def _loops(case):
    """A specification, and its loops: a map of gains with each drive."""
    path = ROBOTS / case.model
    text = (
        f'engine = "mujoco"\n[plant]\nmodel = "{path.name}"\nkeyframe = "{case.keyframe}"\n'
        f"[parameters]\ncontrol_rate = {case.rate}\n[axes]\nkp = [1]\nkd = [1]\n"
    )
    specification = replace(reading.parse(text, path.parent), axes=())
    kp, kd = (a.ravel() for a in np.meshgrid(np.geomspace(*case.kp, 4), np.geomspace(*case.kd, 4)))
    names, delays = zip(*DRIVES, strict=True)
    columns = {
        "kp": np.tile(kp, len(DRIVES)),
        "kd": np.tile(kd, len(DRIVES)),
        "actuator": np.repeat(names, kp.size),
        "delay": np.repeat(delays, kp.size),
    }
    return specification, explicit(specification, columns)


def _exact(plan, specification, loops, rate):
    """Roots of each loop by LAPACK, ln(z) / T of its map over a control period."""
    with jax.enable_x64(True):
        template = kernel.template_of(plan.case, specification.setting, "growth_rate")

        def matrix(values):
            loop = kernel.linear_loop(plan.case, template, values)
            return robot_loop.period_map(loop, plan.case.drive).M

        values = {
            name: jnp.asarray(row, float)
            for name, row in loops.take(np.arange(len(loops))).items()
            if row.dtype.kind == "f"
        }
        matrices = np.asarray(jax.jit(jax.vmap(matrix))(values))
    roots = np.linalg.eigvals(matrices)
    return rate * np.log(np.where(roots == 0.0, 1e-300, roots).astype(complex))


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", CASES)
def test_growth_rates_are_those_of_the_slowest_or_wildest_mode(name):
    specification, loops = _loops(CASES[name])
    (plan,) = plans.groups(specification, loops)
    numbers = np.arange(len(loops))
    rates = execute.growth_rates([plan], specification, loops, numbers)
    found = np.concatenate([each.growth for each in rates])[: len(loops)]
    roots = _exact(plan, specification, loops, CASES[name].rate)
    exact = roots.real.max(axis=1)
    np.testing.assert_allclose(found, exact, rtol=1e-4, atol=1e-3)
    swings = (np.abs(roots.imag) > np.abs(roots.real)) & (np.abs(roots.imag) > 0.1)
    shaking = np.where(swings, roots.real, -CASES[name].rate).max(axis=1)
    shaking = np.where(exact > 30.0, exact, shaking)  # nothing falls as fast
    found = np.concatenate([each.shaking for each in rates])[: len(loops)]
    np.testing.assert_allclose(found, shaking, rtol=1e-2, atol=0.02)
    # Stable, unstable and, where gains are violent, far beyond what a block of periods can hold.
    assert exact.min() < 0.1
    assert exact.max() > (1000.0 if name == "shaking" else 5.0)
