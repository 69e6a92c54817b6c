"""Gradient descent on a smooth objective from many starts, for many cases, in one compiled call.

The optimiser is an optax chain: Adam with cosine decay and clipped gradients by default, then
L-BFGS to settle. Sharpness is annealed on the way. A step that loses stability is not taken, and
the next ones are shorter; of a surrogate that does not know of it (`gated` is False), every step is
taken that is a number, and evaluated once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxact.compilation.programs import Program
from jaxact.compilation.waiting import waited
from jaxact.tuning.objective import Smooth, Surrogate, forward_gradient, loss

# Up to this many gains are differentiated forwards: as many passes, no memory.
FORWARD_GAINS = 8
_DULL, _SHARP = 20.0, 4000.0
_SLOWDOWNS = 16


@dataclass(frozen=True)
class Descent:
    """How to descend; static.

    Attributes:
        chain: makes the optax chain of the number of steps, None for Adam with cosine decay.
        steps: of that chain.
        polish: steps of L-BFGS behind it.
        gradient: "forward" or "reverse"; None to choose by counting the gains.
    """

    chain: Callable[[int], optax.GradientTransformation] | None = None
    steps: int = 150
    polish: int = 6
    gradient: str | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Descended:
    """Where every start ended, and how it got there; cases and starts in front.

    Attributes:
        gains: log-gains, shape (cases, starts, d).
        value, violation: smooth, of the end [-], shape (cases, starts); inf where it is unstable.
        path: log-gains on the way, shape (cases, starts, steps, d).
        path_value, path_violation: shape (cases, starts, steps).
    """

    gains: jax.Array
    value: jax.Array
    violation: jax.Array
    path: jax.Array
    path_value: jax.Array
    path_violation: jax.Array


def no_path(x: Any) -> Descended:
    """The path of a search that has none, at log-gains x, shape (d,), as that of one start."""
    nan, inf = np.full(1, np.nan), np.full((1, 1), np.inf)
    return Descended(x[None], nan, inf[0], x[None, None], inf, inf)  # type: ignore[arg-type]


def adam(steps: int) -> optax.GradientTransformation:
    """Adam with cosine decay; the gradient of a violation is clipped to that of the objective."""
    rate = optax.cosine_decay_schedule(0.12, steps, alpha=0.005)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adam(rate, b1=0.85, b2=0.95))


def descend(
    surrogate: Surrogate, data: Any, starts: jax.Array, slower: jax.Array, how: Descent
) -> Descended:
    """Descend from all starts of all cases.

    Args:
        surrogate: static; smooth objective of one point of one case; one that is a dataclass says
            all that it computes in its `repr`.
        data: of the cases, each leaf with a leading axis (cases,).
        starts: log-gains, shape (cases, starts, d).
        slower: added to log-gains that are unstable, until they are not, shape (d,).
        how: static.
    """
    return waited(
        lambda: jax.block_until_ready(
            _descended(data, starts, slower, surrogate=surrogate, how=how)
        )
    )


@Program
def _descended(
    data: Any, starts: jax.Array, slower: jax.Array, *, surrogate: Surrogate, how: Descent
) -> Descended:
    each_start = jax.vmap(
        lambda start, data: _from_one(surrogate, data, start, slower, how), (0, None)
    )
    return jax.vmap(each_start)(starts, data)


def _from_one(
    surrogate: Surrogate, data: Any, start: jax.Array, slower: jax.Array, how: Descent
) -> Descended:
    gated = getattr(surrogate, "gated", True)
    # It is called in many places, and traced in one of them.
    surrogate = jax.jit(surrogate)

    def evaluate(x: jax.Array, sharpness: jax.Array) -> tuple[jax.Array, Smooth]:
        seen = surrogate(x, data, sharpness)
        return loss(seen, sharpness), seen

    forward = (how.gradient or _by_counting(start.shape[0])) == "forward"
    known = _Known(lambda x, level: surrogate(x, data, level), evaluate, forward, gated)
    x = _slowed(surrogate, data, start, slower) if gated else start
    ladder = _DULL * (_SHARP / _DULL) ** jnp.linspace(0.0, 1.0, how.steps, dtype=x.dtype)
    x, first = _run(known, (how.chain or adam)(how.steps), x, ladder)
    ends, paths = [x], [first]
    if how.polish:
        settle = optax.lbfgs(memory_size=6, linesearch=_line_search())
        level = jnp.full((how.polish,), _SHARP, x.dtype)
        settled, second = _run(known, settle, x, level)
        ends.append(settled)
        paths.append(second)
    path, value, violation = (jnp.concatenate(p) for p in zip(*paths, strict=True))
    # Side by side, so that the surrogate is compiled once for all ends.
    x = jnp.stack(ends)
    seen = jax.vmap(lambda end: surrogate(end, data, ladder[-1]))(x)
    final = loss(seen, ladder[-1])
    # Not argmin, for which a loss that is not a number would be the lowest.
    last = (final[-1] < final[0]).astype(int) * (len(ends) - 1)
    x, seen = jax.tree.map(lambda a: a[last], (x, seen))
    lost = jnp.where(seen.stable, seen.violation, jnp.inf)
    return Descended(x, seen.value, lost, path, value, violation)


def _by_counting(gains: int) -> str:
    return "forward" if gains <= FORWARD_GAINS else "reverse"


def _line_search() -> optax.GradientTransformationExtraArgs:
    return optax.scale_by_backtracking_linesearch(max_backtracking_steps=6, decrease_factor=0.4)


def _slowed(surrogate: Surrogate, data: Any, x: jax.Array, slower: jax.Array) -> jax.Array:
    """The start, slowed down until every member is stable there."""

    def once(_: int, x: jax.Array) -> jax.Array:
        stable = surrogate(x, data, jnp.asarray(_DULL, x.dtype)).stable
        return jnp.where(stable, x, x + slower)

    return jax.lax.fori_loop(0, _SLOWDOWNS, once, x)


@dataclass(frozen=True)
class _Known:
    """What a descent follows, of one case.

    Attributes:
        look: from log-gains and sharpness to what the descent sees of them.
        evaluate: the same, and the loss before it.
        forward: whether slopes are taken forwards.
        gated: whether what is seen says if a step may be taken.
    """

    look: Callable[[jax.Array, jax.Array], Smooth]
    evaluate: Callable[[jax.Array, jax.Array], tuple[jax.Array, Smooth]]
    forward: bool
    gated: bool

    def sloped(self, x: jax.Array, level: jax.Array) -> tuple[jax.Array, Smooth, jax.Array]:
        """The loss, what is seen, and the slope of the loss."""
        if not self.forward:
            (value, seen), slope = jax.value_and_grad(self.evaluate, has_aux=True)(x, level)
            return value, seen, slope
        value, push, seen = jax.linearize(lambda y: self.evaluate(y, level), x, has_aux=True)
        return value, seen, jax.vmap(push)(jnp.eye(len(x), dtype=x.dtype))

    def losses(self, level: jax.Array) -> Callable[[jax.Array], jax.Array]:
        """The loss alone, for a search along a line."""

        def loss_of(x: jax.Array, level: jax.Array) -> jax.Array:
            return self.evaluate(x, level)[0]

        found = forward_gradient(loss_of) if self.forward else loss_of
        return lambda x: found(x, level)


def _run(
    known: _Known,
    chain: optax.GradientTransformation,
    x: jax.Array,
    sharpness: jax.Array,
) -> tuple[jax.Array, tuple[jax.Array, jax.Array, jax.Array]]:
    """Take one step of the chain for every sharpness; returns the end and the path."""
    chain = optax.with_extra_args_support(chain)

    def step(carry: tuple[jax.Array, Any, jax.Array], level: jax.Array) -> tuple[Any, Any]:
        """One step, shorter after one that was not taken; the path has where it started."""
        x, state, stride = carry
        value, seen, slope = known.sloped(x, level)
        # Where a metric has no slope, an infinite margin say, the others lead.
        slope = jnp.nan_to_num(slope, nan=0.0, posinf=0.0, neginf=0.0)
        change, state = chain.update(
            slope, state, x, value=value, grad=slope, value_fn=known.losses(level)
        )
        there = x + stride * change
        fine = jnp.all(jnp.isfinite(there))
        if known.gated:
            seen = known.look(there, level)
            fine &= seen.stable
        stride = jnp.where(fine, jnp.minimum(1.3 * stride, 1.0), 0.3 * stride)
        return (jnp.where(fine, there, x), state, stride), (x, seen.value, seen.violation)

    carry = x, chain.init(x), jnp.ones((), x.dtype)
    (x, *_), path = jax.lax.scan(step, carry, sharpness)
    return x, path
