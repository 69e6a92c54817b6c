"""Programs written out number by number: the same numbers, and no library called any more."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from robots import PENDULUM

from jaxact.plants.mjx import plant as mjx
from jaxact.plants.mjx import step as mjx_step
from jaxact.plants.mjx.scalars.step import written_out

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
    both = jnp.tensordot(a, a, axes=2), jnp.arange(size) @ a, a @ (a > 0.0)
    return {"all": (solved, right, upper, outer, batch, both), "size": size, "none": None}


def _moves(tree, b):
    """Look-ups, writes, cuts and sums of all kinds, at places that are known and that are not."""
    a, size = tree["a"], tree["size"]
    known = jnp.asarray(np.arange(size)[::-1].copy())
    far = jnp.array([0, size + 3, -1])
    looked = (
        a[known],
        jnp.take(a, far, axis=0, mode="clip"),
        jnp.take(b, far, axis=1, mode="fill", fill_value=2.5),
        jnp.take_along_axis(a, jnp.broadcast_to(known[:, None], a.shape), axis=0),
        a[jnp.argmax(a[:, 0])],
        jax.vmap(lambda row, i: jnp.roll(row, 1)[i])(a, known),
        jnp.sort(a, axis=1),
    )
    written = (
        a.at[known].set(b),
        a.at[far].add(1.5, mode="drop"),
        a.at[0, 0].multiply(b[0, 0]),
        jax.lax.dynamic_update_slice(a, b[:1], (size - 1, 0)),
        jax.lax.dynamic_slice(a, (size, 0), (1, size)),
    )
    cut = (
        jnp.pad(a, ((1, 0), (0, 2)), constant_values=3.0),
        jnp.flip(a, 1),
        jnp.tile(a, (2, 1)),
        jnp.concatenate([a, b], axis=1)[:, ::2],
        jnp.stack([a, b], axis=1).reshape(-1),
        jnp.where(a > b, a, jnp.where(True, b, a)),
        [*jnp.split(a.T, size, axis=1)],
    )
    summed = (
        a.sum(), a.max(axis=0), b.min(), jnp.prod(a, axis=1), 1.0 * jnp.any(a > b),
        1.0 * jnp.all(a > -9.0), jnp.cumsum(a, axis=0), jnp.linalg.norm(a) ** 3,
        jnp.sign(a) * jnp.minimum(a, 0.3),
        a - 0.0 + 0.0 * b + 1.0 * b / 1.0, jnp.zeros((0, 2)).sum(axis=0), 0.0 - a,
    )  # fmt: skip
    return {"all": (looked, written, cut, summed), "size": size, "none": None}


def _until(carry, limit):
    """MJX's loop of a largest number of turns, which it writes so for derivatives in reverse."""

    def turn(at, _):
        value, on = at

        def one(value):
            after = value * 1.5 + 0.1
            return after, after < limit

        return jax.lax.cond(on, one, lambda value: (value, False), value), None

    return jax.lax.scan(turn, (carry, carry < limit), None, length=30)[0][0]


def _loops(tree, b):
    """Loops of all kinds; some carry arrays, some keep rows, one ends by a flag."""
    a, size = tree["a"], tree["size"]

    def kept(carry, row):
        after = jnp.tanh(carry + row[0]) @ a
        return after, (after.sum(), row[1])

    rows = jax.lax.scan(kept, b[0], (a, jnp.arange(size)), reverse=True)
    halved = jax.lax.while_loop(lambda x: jnp.abs(x).max() > 0.2, lambda x: 0.5 * x, a)
    known = jax.lax.cond(jnp.asarray(size) > 1, lambda x: 2.0 * x, lambda x: x, a)
    chosen = jax.lax.switch((a[0, 0] > 0.0).astype(int) + 1, [jnp.cos, jnp.sin, jnp.exp], b)
    powers = jax.lax.fori_loop(0, 3, lambda i, x: x * a + i, b)
    ended = jax.vmap(lambda x: _until(x, 4.0))(jnp.abs(a[0]))
    return {
        "all": (rows, halved, known, chosen, powers, ended), "size": size, "none": None,
    }  # fmt: skip


@pytest.mark.exhaustive
@pytest.mark.parametrize("function", [_everything, _moves, _loops])
@pytest.mark.parametrize("size", [1, 3])
def test_values_and_derivatives_are_the_functions(function, size):
    with jax.enable_x64(True):
        a, b = (jnp.asarray(_RANDOM.normal(size=(4, size, size))) for _ in range(2))

        def whole(function):
            def one(a, b):
                found = function({"a": a, "size": size}, b)
                assert found["size"] == size and found["none"] is None
                return found["all"]

            return jax.jit(jax.vmap(lambda a, b: (one(a, b), jax.jacfwd(one)(a, b))))

        want, found = whole(function)(a, b), whole(written_out(function))(a, b)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-9), want, found)


@pytest.mark.exhaustive
def test_large_arrays_stay_arrays():
    a, b = (jnp.asarray(_RANDOM.normal(size=(3, 3)), jnp.float32) for _ in range(2))
    for function in (_everything, _moves, _loops):
        want = jax.jit(lambda a, b, f=function: f({"a": a, "size": 3}, b)["all"])(a, b)
        written = written_out(function, largest=4)
        found = jax.jit(lambda a, b, f=written: f({"a": a, "size": 3}, b)["all"])(a, b)
        jax.tree.map(
            lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-5, atol=1e-5), want, found
        )


def test_a_loop_that_does_nothing_more_ends():
    def ends(function):
        return "while[" in str(jax.make_jaxpr(jax.jit(function))(1.0))

    assert not ends(lambda x: _until(x, 4.0))
    assert ends(written_out(lambda x: _until(x, 4.0)))


def _written_too(scan_body):
    """A scan whose flag does not stop everything must go on to its end."""
    return jax.lax.scan(scan_body, (jnp.float32(1.0), jnp.bool_(True)), None, length=5)[0]


def test_a_loop_that_goes_on_beside_its_flag_does_not_end():
    def counted(scale):
        def turn(at, _):
            value, on = at
            return jax.lax.cond(
                on, lambda v: (v * scale, v < 2.0), lambda v: (v + 1.0, False), value
            ), None

        return _written_too(turn)

    want, found = jax.jit(counted)(1.7), jax.jit(written_out(counted))(1.7)
    np.testing.assert_allclose(found[0], want[0], rtol=1e-6)


_LINK = """
  <body pos="0.1 0 0.2"><joint name="j{i}" {joint}/>
  <geom type="capsule" fromto="0 0 0 0.2 0.05 0.1" size="0.03" mass="0.7" {touch}/>"""
_APART = 'contype="0" conaffinity="0"'


def _robot(option, joints, *, touch=_APART, more=""):
    links = "".join(_LINK.format(i=i, joint=j, touch=touch) for i, j in enumerate(joints))
    motors = "".join(f'<motor joint="j{i}"/>' for i in range(len(joints)))
    return (
        f'<mujoco><option timestep="0.002" {option}/><worldbody>'
        f'<geom type="plane" size="3 3 0.1" pos="0 0 -0.05"/>{links}{"</body>" * len(joints)}'
        f"</worldbody>{more}<actuator>{motors}</actuator></mujoco>"
    )


_HINGE, _SLIDE = 'axis="0.3 1 0.2" damping="0.2"', 'type="slide" axis="0 0.6 0.8" armature="0.1"'
_LIMITED = 'axis="0 1 0" limited="true" range="-0.1 0.1" damping="0.1"'
_TENDON = (
    '<tendon><fixed limited="true" range="-1 0.05"><joint joint="j0" coef="1"/>'
    '<joint joint="j1" coef="-0.5"/></fixed></tendon>'
)
_BALL = (
    '<body name="b" pos="1 0 1"><joint type="ball"/>'
    f'<geom size="0.1" pos="0.2 0 0" {_APART}/></body><body name="c" pos="1 0 1"/></worldbody>'
    '<equality><weld body1="b" body2="c"/></equality>'
)
ROBOTS = {
    "Runge-Kutta": _robot('integrator="RK4"', [_HINGE, _SLIDE]),
    "limits, a tendon": _robot(
        'solver="CG" integrator="implicitfast"', [_LIMITED, _LIMITED], more=_TENDON
    ),
    "dry friction, a contact": _robot("", [_LIMITED + ' frictionloss="0.3"'], touch=""),
    "a ball, held": _robot("", [_SLIDE + ' stiffness="9"']).replace("</worldbody>", _BALL),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ROBOTS)
def test_a_small_robots_steps_are_those_of_mjx(name, tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(ROBOTS[name])
    with jax.enable_x64(True):
        plant = mjx.load(path).prepare(jnp.asarray(2e-3))
        data = plant.data
        assert mjx_step.is_small(plant.model, data)
        zero, moved = jnp.zeros(len(plant.dofs)), 0.05 * _RANDOM.normal(size=(6, data.qvel.size))
        force = mjx.Force(mean=zero, moment=zero, partial=None)

        def after(step, velocity):
            def one(state, _):
                return plant.state(step(plant.loaded(state, force))), None

            start = plant.state(data.replace(qvel=data.qvel + velocity))
            end = jax.lax.scan(one, start, None, length=25)[0]
            return end.qpos, end.qvel

        def theirs(data):
            with jax.numpy_rank_promotion("allow"):
                return mjx.mjx.step(plant.model, data)

        def ours(data):
            return mjx_step.step(plant.model, data)

        want, found = (
            jax.jit(jax.vmap(lambda v, s=step: after(s, v)))(moved) for step in (theirs, ours)
        )
    assert all(np.isfinite(array).all() for array in found)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(y, x, rtol=1e-7, atol=1e-9), want, found)


def test_of_a_slide_next_to_nothing_remains():
    plant = mjx.load().prepare(jnp.asarray(1e-3, jnp.float32))
    one = jnp.zeros(1)
    force = mjx.Force(mean=one, moment=one, partial=None)
    traced = jax.make_jaxpr(lambda s: plant.advance(s, force))(plant.init(one, one))
    # M = m; a = f / m; v + h a; q + h v: and the numbers are taken out of arrays and put back.
    assert len(traced.eqns) < 60


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
