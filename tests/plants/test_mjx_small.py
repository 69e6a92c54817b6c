"""Small matrices written out: the same numbers, and no library called any more."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from robots import PENDULUM

from jaxact.plants import mjx
from jaxact.plants.mjx_small import written_out

_RANDOM = np.random.default_rng(5)


def _everything(tree, b):
    """Products over none, one and two axes, factors, solves from both sides; trees of all kinds."""
    a, size = tree["a"], tree["size"]
    positive = a @ a.T + 2.0 * jnp.eye(size)
    factor = jnp.linalg.cholesky(positive)
    solved = jax.scipy.linalg.cho_solve((factor, True), b)
    right = jax.lax.linalg.triangular_solve(factor, b.T, left_side=False, lower=True)
    upper = jax.scipy.linalg.solve_triangular(factor.T, b, lower=False)
    outer = jnp.einsum("ij,kl->ijkl", a, b)
    batch = jnp.einsum("bij,bjk->bik", jnp.stack([a, 2 * a]), jnp.stack([b, b]))
    both = jnp.tensordot(a, a, axes=2)
    return {"all": (solved, right, upper, outer, batch, both), "size": size, "none": None}


@pytest.mark.parametrize("size", [1, 2, 3])
def test_values_and_derivatives_are_the_functions(size):
    with jax.enable_x64(True):
        a, b = (jnp.asarray(_RANDOM.normal(size=(4, size, size))) for _ in range(2))

        def whole(function):
            def one(a, b):
                found = function({"a": a, "size": size}, b)
                assert found["size"] == size and found["none"] is None
                return found["all"]

            return jax.jit(jax.vmap(lambda a, b: (one(a, b), jax.jacfwd(one)(a, b))))

        want, found = whole(_everything)(a, b), whole(written_out(_everything))(a, b)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-9), want, found)


@pytest.mark.parametrize("robot", ["slide", "pendulum"])
def test_a_small_robots_step_calls_no_library(robot, tmp_path):
    """So that XLA can compile its rollouts as one kernel."""
    path = tmp_path / "pendulum.xml"
    path.write_text(PENDULUM)
    plant = mjx.load() if robot == "slide" else mjx.load(path, keyframe="home")
    plant = plant.prepare(jnp.asarray(1e-3, jnp.float32))
    zero = jnp.zeros(len(plant.dofs))
    force = mjx.Force(mean=zero, moment=zero, partial=None)
    states = jax.vmap(lambda q: plant.init(q, q))(jnp.zeros((8, len(plant.dofs))))
    step = jax.jit(jax.vmap(lambda state: plant.advance(state, force)))
    text = step.lower(states).compile().as_text()
    assert "custom-call" not in text and " dot(" not in text
