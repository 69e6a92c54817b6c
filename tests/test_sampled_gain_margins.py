"""Gain margins by bisection on simulated verdicts, against independent sampled-data figures."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.drive import step as drives
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.step import Drive
from jaxact.loops import loop
from jaxact.loops.loop import Loop
from jaxact.parameters import PRESETS
from jaxact.plants.mass import Mass
from jaxact.simulation.growth import rate as growth

ORACLE = json.loads((Path(__file__).parent / "data" / "paper_loop.json").read_text())


@pytest.mark.exhaustive
@pytest.mark.parametrize("velocity", ["velocity_sampled", "velocity_backward_difference"])
def test_bisected_gain_margins_equal_the_oracle(velocity):
    names = [case["name"] for case in ORACLE["sampled_1khz"]]
    cases = [(*PRESETS[name.split()[0]], float(name.split()[1]) * 1e-3) for name in names]
    wn, zeta, delay = np.array(cases).T
    drive = Drive(Controller(400.0, 20.0), Actuator(wn, zeta, delay))
    options = drives.options(drive, differenced=velocity == "velocity_backward_difference")

    def stable(factor, wn, zeta, delay):
        drive = Drive(Controller(400.0 * factor, 20.0 * factor), Actuator(wn, zeta, delay))
        prepared = loop.prepare(Loop(Mass(0.7), drive), options)
        state = loop.init(prepared, options, 0.0, 0.0)
        return growth.growth_rate(prepared, options, state, Setpoint(0.0)) < 0.0

    verdicts = jax.jit(jax.vmap(jax.vmap(stable, (0, None, None, None)), (0, 0, 0, 0)))
    with jax.enable_x64(True):
        ladder = np.broadcast_to(np.geomspace(1.0, 200.0, 64), (len(names), 64))
        first = np.argmin(np.asarray(verdicts(ladder, wn, zeta, delay)), axis=1)
        low, high = (np.take_along_axis(ladder, (first + k)[:, None], 1)[:, 0] for k in (-1, 0))
        for _ in range(3):
            inside = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, 64)
            first = np.argmin(np.asarray(verdicts(jnp.asarray(inside), wn, zeta, delay)), axis=1)
            low, high = (np.take_along_axis(inside, (first + k)[:, None], 1)[:, 0] for k in (-1, 0))
    want = [case[velocity]["gm"] for case in ORACLE["sampled_1khz"]]
    np.testing.assert_allclose(0.5 * (low + high), want, rtol=1e-3)
