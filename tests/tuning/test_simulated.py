"""Simulated tracking by the gains of groups: its gradient against central differences."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from robots import MONOPED, QUADRUPED

from jaxact.errors import UserError
from jaxact.loops import reading, robots
from jaxact.loops.specification import Push
from jaxact.tuning.rollouts.tracking import chosen, term, value_and_gradient, work

SIZE = 1e-4


def _differences(value, x):
    """Central differences of a function of arrays, shape of x."""
    ends = [[value(x + sign * SIZE * unit) for sign in (1.0, -1.0)] for unit in np.eye(x.size)]
    return np.array([(high - low) / (2.0 * SIZE) for high, low in ends])


@pytest.mark.exhaustive
def test_the_gradient_of_a_standing_quadruped_is_that_of_central_differences():
    """Forwards; contacts, delays, noise, limits and a push; hips, thighs and knees."""
    asked = reading.load(QUADRUPED / "stand.toml")
    push = replace(asked.push, time=0.002, duration=0.01)
    asked = replace(asked, push=push, duration=0.04)
    labels = robots.scene(asked.plant).labels
    groups = [("HAA", "HFE", "KFE").index(label.partition("_")[2]) for label in labels]
    x = np.log([709.0, 709.0, 709.0, 39.9, 41.4, 5.57])
    members = {"output_delay": np.array([0.0012])}
    made = term(asked, groups, members)
    value, gradient = value_and_gradient(made, x, "forward")
    assert value > 0.0
    differences = _differences(lambda x: value_and_gradient(made, x, "forward")[0], x)
    np.testing.assert_allclose(gradient, differences, rtol=1e-5)


@pytest.fixture(scope="module")
def monoped(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "monoped.xml"
    path.write_text(MONOPED)
    asked = reading.parse('[plant]\nmodel = "monoped.xml"\n[axes]\nkp = [1.0]\n', path.parent)
    return replace(asked, axes=(), push=Push("trunk", (0.0, 0.0, -1.0), 0.002, 0.01), duration=0.04)


@pytest.mark.exhaustive
def test_backwards_is_central_differences_too(monoped):
    x = np.log([300.0, 8.0])
    members = {
        "delay": np.array([0.001, 0.0034]),
        "wn": np.array([300.0, 200.0]),
        "velocity_noise": np.array([0.0, 0.01]),
        "position_resolution": np.full(2, 1e-3),
    }
    made = term(monoped, [0], members)
    assert made.ticks >= 40 and made.ticks % made.chunk == 0
    value, gradient = value_and_gradient(made, x, "reverse")
    # MJX's own steps, which nobody has made differentiable.
    plain = term(monoped, [0], members, differentiable=False)
    with jax.enable_x64(True):
        own = jax.jit(plain.error)
        assert value == pytest.approx(float(own(jnp.asarray(x))), rel=1e-9)
        differences = _differences(lambda x: float(own(jnp.asarray(x))), x)
    np.testing.assert_allclose(gradient, differences, rtol=1e-5)


def test_the_mode_is_chosen_by_counting():
    assert chosen("auto", 2) == "forward" and chosen("auto", 36) == "reverse"
    assert chosen("reverse", 2) == "reverse" and chosen("forward", 36) == "forward"
    costs = work(8)
    assert chosen("auto", 8) == min(costs, key=costs.get)
    with pytest.raises(UserError, match="mode 'backward'"):
        chosen("backward", 2)


def test_the_tracking_of_a_single_joint_is_refused():
    asked = reading.parse("[axes]\nkp = [400.0]\n")
    with pytest.raises(UserError, match="only of a robot"):
        term(asked, [0], {})
