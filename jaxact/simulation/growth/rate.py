"""The growth rate of a small perturbation, measured by propagating it through the simulated loop.

"Did it diverge within two seconds" is wrong near the stability boundary. Instead the step of the
loop itself is linearised (`jax.linearize` of the same code that simulates), a perturbation is sent
through it, renormalised, until the fast modes are gone, and a few more blocks of periods span a
Krylov space of what is left; a small state is spanned as a whole. The largest eigenvalue of the
propagation in that space gives

    growth rate = log(|largest eigenvalue|) / (periods in a block * T)

The space is that of `jaxact.simulation.growth.krylov`, the spectral radius of the small matrix as
in `jaxact.simulation.growth.characteristic`.

The delay line of a single joint may have hundreds of states, which no small space holds. Such a
loop's rate comes from its characteristic equation instead
(`jaxact.simulation.growth.delayed_roots`), the short part of which is the derivative of the same
step (`jaxact.simulation.growth.joint_polynomials`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from jaxact.drive import delay as _delay
from jaxact.drive import history as _history
from jaxact.drive.controller import Setpoint
from jaxact.drive.step import DriveOptions
from jaxact.loops import loop as _loop
from jaxact.loops.loop import LoopState, Prepared
from jaxact.simulation.growth import characteristic as _characteristic
from jaxact.simulation.growth import delayed_roots as _delayed_roots
from jaxact.simulation.growth import joint_polynomials as _joint
from jaxact.simulation.growth import krylov as _krylov

# Dimensions of a robot's Krylov space beyond those of the plant's states.
_SPARE = 8

TOLERANCE = 0.005
"""Error of a growth rate that nobody minds [1/s]."""


@dataclass(frozen=True)
class GrowthOptions:
    """How the growth rate is measured: static.

    Attributes:
        block: control periods in one application of the propagation; some milliseconds, so that
            the slow modes differ.
        settle: blocks before the Krylov space is built, until the fast modes are gone.
        dimension: of the Krylov space.
        whole: a state of no more than this many numbers is its own Krylov space, in which the fast
            modes need not be gone; a quarter of `block` tells its modes apart, and a sixteenth of
            `settle` is enough to find its scale.
        squarings: of the small matrix; the last one looks 2^squarings blocks ahead.
        dense: write the propagation of one period out as a matrix first. Cheaper where one period
            of the plant costs more than the product of a matrix and a vector.
    """

    block: int = 4
    settle: int = 64
    dimension: int = 8
    whole: int = 10
    squarings: int = 20
    dense: bool = False


class TooManyStatesError(ValueError):
    """A loop has too many states for what is asked."""


def aligned(state: LoopState) -> LoopState:
    """The same state with every ring buffer turned so that its newest value comes first."""

    def turn(node: Any) -> Any:
        if not isinstance(node, _delay.Ring):
            return node
        values = jnp.roll(node.values, -node.newest, axis=0)
        return _delay.Ring(values=values, newest=jnp.zeros_like(node.newest))

    return jax.tree.map(turn, state, is_leaf=lambda node: isinstance(node, _delay.Ring))


def split(state: LoopState) -> tuple[list[jax.Array], Callable[[list[jax.Array]], LoopState]]:
    """The real leaves of a state, in order, and a function that puts others in their place."""
    leaves, structure = jax.tree.flatten(state)
    real = [jnp.issubdtype(jnp.result_type(leaf), jnp.floating) for leaf in leaves]

    def merge(vector: list[jax.Array]) -> LoopState:
        filled = iter(vector)
        merged = [next(filled) if keep else leaf for leaf, keep in zip(leaves, real, strict=True)]
        return jax.tree.unflatten(structure, merged)

    return [leaf for leaf, keep in zip(leaves, real, strict=True) if keep], merge


def _essential(state: LoopState) -> tuple[list[jax.Array], Callable[[list[jax.Array]], LoopState]]:
    """As `split`, without the numbers that are always zero between two periods."""
    smaller, restored = _history.essential(state.drive)
    vector, merge = split(LoopState(state.plant, smaller))

    def whole(vector: list[jax.Array]) -> LoopState:
        merged = merge(vector)
        return LoopState(merged.plant, restored(merged.drive))

    return vector, whole


def propagation(
    prepared: Prepared, options: DriveOptions, state: LoopState, setpoint: Setpoint, periods: int
) -> tuple[list[jax.Array], Callable[[list[jax.Array]], list[jax.Array]]]:
    """The linearised map of a state perturbation over a number of control periods.

    Noise, quantisation and limits are left out: they have no derivative.

    Args:
        prepared: from `jaxact.loops.loop.prepare`.
        options: static.
        state: to linearise at; an equilibrium, or any state of a linear loop.
        setpoint: constant.
        periods: static.

    Returns:
        The real leaves of the state in order, without those that are always zero, and the linear
        map on lists of that form.
    """
    smooth = options.linearised()
    vector, merge = _essential(aligned(state))

    def body(state: LoopState, _: None) -> tuple[LoopState, None]:
        return _loop.step(prepared, smooth, state, setpoint)[0], None

    def advance(vector: list[jax.Array]) -> list[jax.Array]:
        after, _ = jax.lax.scan(body, merge(vector), None, length=periods)
        after = aligned(after)
        kept = _history.forget(prepared.drive, after.drive)
        return _essential(LoopState(after.plant, kept))[0]

    return vector, jax.linearize(advance, vector)[1]


Propagation = tuple[list[jax.Array], Callable[[list[jax.Array]], list[jax.Array]]]


def _dense(vector: list[jax.Array], apply: Callable, block: int) -> Propagation:
    """The same map over `block` periods, with the one over a single period as a matrix."""
    flat, unravel = ravel_pytree(vector)
    columns = jax.vmap(lambda unit: ravel_pytree(apply(unravel(unit)))[0])(jnp.eye(flat.size))

    def repeated(vector: list[jax.Array]) -> list[jax.Array]:
        def once(image: jax.Array, _: None) -> tuple[jax.Array, None]:
            return jnp.sum(columns * image[:, None], axis=0), None

        return [jax.lax.scan(once, vector[0], None, length=block, unroll=min(block, 4))[0]]

    return [flat], repeated


def _perturbation(state: LoopState, prepared: Prepared) -> list[jax.Array]:
    """A perturbation that moves every joint's position and velocity and nothing else.

    The delay lines fill by themselves; perturbing the clock of a plant would add a mode of growth
    rate 0 that is none of the loop's.
    """
    velocity_scale = 30.0

    def displaced(amount: jax.Array) -> list[jax.Array]:
        q, v = prepared.plant.measure(state.plant)
        joints = jnp.arange(jnp.size(q), dtype=q.dtype).reshape(jnp.shape(q))
        # Unequal amounts, so that no symmetric mode of a robot is missed.
        weight = 1.0 + 0.37 * jnp.cos(1.7 * joints)
        plant = prepared.plant.init(q + amount * weight, v - amount * velocity_scale * weight)
        return _essential(LoopState(plant, state.drive))[0]

    dtype = prepared.drive.step.dtype
    return jax.jvp(displaced, (jnp.zeros((), dtype),), (jnp.ones((), dtype),))[1]


@dataclass(frozen=True)
class _Space:
    """What a Krylov space is made of.

    Attributes:
        apply: the propagation over a block, of states in their own scale.
        start: first vector.
        dimension: of the space.
        whole: it is the whole state.
        block: control periods.
    """

    apply: Callable[[list[jax.Array]], list[jax.Array]]
    start: list[jax.Array]
    dimension: int
    whole: bool
    block: int


def _short(measure: GrowthOptions) -> int:
    """Control periods of a block where the whole state is looked at."""
    return max(1, measure.block // 4)


def _space(
    prepared: Prepared,
    options: DriveOptions,
    state: LoopState,
    setpoint: Setpoint,
    measure: GrowthOptions,
) -> _Space:
    """Send a perturbation through the loop until it has found its scale."""
    tangent = _perturbation(aligned(state), prepared)
    rank = sum(leaf.size for leaf in tangent)
    whole = rank <= measure.whole
    block = _short(measure) if whole else measure.block
    blocks = measure.settle // 16 if whole else measure.settle
    periods = 1 if measure.dense else block
    start, apply = propagation(prepared, options, state, setpoint, periods)
    if measure.dense:
        tangent = [ravel_pytree(tangent)[0]]
        start, apply = _dense(start, apply, block)

    def settle(carry, _: None):
        vector, squares = carry
        image = apply(vector)
        vector = _krylov.scaled(image, _krylov.inverse(jnp.sqrt(_krylov.dot(image, image))))
        return (vector, [x * x + y for x, y in zip(vector, squares, strict=True)]), None

    # Positions, velocities and forces have different units; their size along the way is the scale.
    carry = tangent, [jnp.zeros_like(leaf) for leaf in tangent]
    (settled, squares), _ = jax.lax.scan(settle, carry, None, length=blocks)
    scale = [jnp.where(x > 0.0, jnp.sqrt(x / blocks), 1.0) for x in squares]

    def scaled_apply(vector: list[jax.Array]) -> list[jax.Array]:
        image = apply([x * y for x, y in zip(vector, scale, strict=True)])
        return [x / y for x, y in zip(image, scale, strict=True)]

    # What has settled lacks the fast modes, and the whole space has them.
    first = tangent if whole else settled
    unit = [x / y for x, y in zip(first, scale, strict=True)]
    return _Space(scaled_apply, unit, rank if whole else min(measure.dimension, rank), whole, block)


def transition(
    prepared: Prepared,
    options: DriveOptions,
    state: LoopState,
    setpoint: Setpoint,
    measure: GrowthOptions = GrowthOptions(),
) -> jax.Array:
    """What a block of periods does to a perturbation of a loop with few states, as a matrix.

    Args:
        prepared, options, state, setpoint, measure: as for `growth_rate`.

    Returns:
        shape (n, n); it maps the real leaves of the state, without those that are always zero.

    Raises:
        TooManyStatesError: the loop has more than `measure.whole`.
    """
    rank = sum(leaf.size for leaf in _essential(aligned(state))[0])
    if rank > measure.whole:
        raise TooManyStatesError(f"{rank} states; at most {measure.whole} can be written out")
    vector, apply = propagation(prepared, options, state, setpoint, _short(measure))
    flat, unravel = ravel_pytree(vector)
    units = jnp.eye(flat.size, dtype=flat.dtype)
    return jax.vmap(lambda unit: ravel_pytree(apply(unravel(unit)))[0], out_axes=1)(units)


def growth_rate(
    prepared: Prepared,
    options: DriveOptions,
    state: LoopState,
    setpoint: Setpoint,
    measure: GrowthOptions = GrowthOptions(),
) -> jax.Array:
    """Exponential rate of a small perturbation of the loop; negative is stable.

    Args:
        prepared: from `jaxact.loops.loop.prepare`; in float64 for verdicts near the boundary.
        options: static.
        state: to linearise at; an equilibrium, or any state of a linear loop.
        setpoint: constant.
        measure: static.

    Returns:
        [1/s], shape (). Of a single joint, 0 where rounding hides its sign, and NaN where it was
        not found; it has no derivative there.
    """
    control_period = prepared.drive.drive.control_period
    if _joint.applies(prepared, state):
        longest = options.command_slots + options.measurement_slots
        delayed = _joint.delayed_loop(prepared, options)
        enough = TOLERANCE * control_period
        return _delayed_roots.log_radius(delayed, longest, enough) / control_period
    space = _space(prepared, options, state, setpoint, measure)
    kept = functools.partial(_loop.stage, options)
    small = _krylov.hessenberg(space.apply, space.start, space.dimension, space.whole, kept)
    log_radius = _characteristic.log_spectral_radius(small, measure.squarings, kept)
    return log_radius / (space.block * control_period)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SlowModes:
    """What a loop of many slow modes does over one control period.

    Attributes:
        growth: logarithm of the largest eigenvalue's size over a period; as `growth_rate`.
        matrix: of the period in a space of all slow modes, without the usual growth, shape (n, n).
        products: scalar products of what the period makes of the space's basis, likewise.
        usual: logarithm of the growth that was left out of both.
    """

    growth: jax.Array
    matrix: jax.Array
    products: jax.Array
    usual: jax.Array


def slow_modes(
    prepared: Prepared,
    options: DriveOptions,
    state: LoopState,
    setpoint: Setpoint,
    measure: GrowthOptions = GrowthOptions(),
) -> SlowModes:
    """The slow modes of a robot's loop; arguments as for `growth_rate`.

    Blocks of periods tell slow modes apart; what they span is then mapped over a single period, in
    which no oscillation of a sampled loop passes for another one.
    """
    tangent, _ = ravel_pytree(_perturbation(aligned(state), prepared))
    parts, apply = propagation(prepared, options, state, setpoint, 1)
    _, unravel = ravel_pytree(parts)
    settling = measure.settle * measure.block

    def once(vector: jax.Array) -> jax.Array:
        return ravel_pytree(apply(unravel(vector)))[0]

    def settle(carry, _: None):
        vector, squares, log_size = carry
        image = once(vector)
        size = jnp.linalg.norm(image)
        vector = image * _krylov.inverse(size)
        log_size = log_size + jnp.log(jnp.maximum(size, jnp.finfo(size.dtype).tiny))
        return (vector, squares + vector * vector, log_size), None

    start = tangent * _krylov.inverse(jnp.linalg.norm(tangent))
    carry = start, jnp.zeros_like(start), jnp.zeros((), start.dtype)
    (settled, squares, log_size), _ = jax.lax.scan(settle, carry, None, length=settling)
    # Positions, velocities and forces have different units; their size along the way is the scale.
    scale = jnp.where(squares > 0.0, jnp.sqrt(squares / settling), 1.0)
    # Without its usual growth, a long block of a violent loop would overflow.
    usual = log_size / settling
    relief = jnp.exp(-usual)

    def relieved(image: jax.Array) -> jax.Array:
        return once(image) * relief

    def block(vector: jax.Array) -> jax.Array:
        image, _ = jax.lax.scan(
            lambda image, _: (relieved(image), None), vector * scale, None, length=measure.block
        )
        return image / scale

    slow = sum(leaf.size for leaf in jax.tree.leaves(state.plant))
    dimension = min(max(measure.dimension, slow + _SPARE), start.size)
    matrix, basis = _krylov.arnoldi(block, settled / scale, dimension)
    growth = usual + _krylov.log_radius(matrix, measure.squarings) / measure.block
    if _joint.applies(prepared, state):
        growth = (
            growth_rate(prepared, options, state, setpoint) * prepared.drive.drive.control_period
        )
    images = jax.lax.map(lambda vector: relieved(vector * scale) / scale, basis)
    return SlowModes(growth, basis @ images.T, images @ images.T, usual)
