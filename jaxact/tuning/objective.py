"""The smooth objective that the descent follows: one number from a goal and an ensemble.

    loss(x) = -value(x) + (mu / s) ln(1 + exp(s violation(x))),    x = ln of the gains

`value` and `violation` are risks over the members of smooth metrics, s is the sharpness that is
annealed. Stable or not is a gate beside it, not a term. Nothing here knows what the gains are: a
robot's vector of log-gains with smooth metrics of its own fits as well as a joint's two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

# Weight of a violation; larger than any multiplier of a constraint in logarithms.
PENALTY = 40.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Smooth:
    """What the descent sees of one point.

    Attributes:
        value: ln of the objective's metric, signed so that larger is better [-].
        violation: smooth maximum over constraints and members of ln(metric / bound) [-].
        stable: whether every member is.
    """

    value: jax.Array
    violation: jax.Array
    stable: jax.Array


Surrogate = Callable[[jax.Array, Any, jax.Array], Smooth]
"""(log-gains (d,), data of one case, sharpness) -> what the descent sees."""


def softmax(values: jax.Array, sharpness: jax.Array) -> jax.Array:
    """ln(sum exp(s x)) / s over all values: their maximum as s grows."""
    return jax.scipy.special.logsumexp(sharpness * values) / sharpness


def combine(
    metrics: Mapping[str, jax.Array],
    stable: jax.Array,
    rows: tuple[tuple[str, float], ...],
    log_bounds: jax.Array,
    objective: tuple[str, float],
    tail: jax.Array | None,
    sharpness: jax.Array,
) -> Smooth:
    """Risks over the members of ln metrics of all of them.

    Args:
        metrics: ln of each metric by name, shape (n,).
        stable: shape (n,).
        rows: (metric, sign) of every constraint, static.
        log_bounds: ln of the bounds, shape (rows,).
        objective: (metric, sign), static.
        tail: share of the members that counts, shape (); None for the worst alone.
    """
    metric, sense = objective
    value = -_risk(-sense * metrics[metric], tail, sharpness)
    excess = [sign * (metrics[name] - log_bounds[i]) for i, (name, sign) in enumerate(rows)]
    each = [jnp.atleast_1d(_risk(e, tail, sharpness)) for e in excess]
    violation = softmax(jnp.concatenate(each), sharpness) if each else jnp.full((), -jnp.inf)
    return Smooth(value, violation, jnp.all(stable))


def _risk(bad: jax.Array, tail: jax.Array | None, sharpness: jax.Array) -> jax.Array:
    """One number for all members: smooth maximum, or the mean of the worst share `tail`."""
    if tail is None:
        return softmax(bad, sharpness)
    number = bad.shape[0]
    share = jnp.clip(tail * number - jnp.arange(number, dtype=bad.dtype), 0.0, 1.0)
    share = share / jnp.sum(share)
    return jnp.sum(-jnp.sort(-bad) * share)


def loss(smooth: Smooth, sharpness: jax.Array) -> jax.Array:
    """The number to be made small; see the module."""
    exceeded = jax.nn.softplus(sharpness * smooth.violation) / sharpness
    return -smooth.value + PENALTY * jnp.where(jnp.isneginf(smooth.violation), 0.0, exceeded)


def forward_gradient(function: Callable[..., jax.Array]) -> Callable[..., jax.Array]:
    """The same scalar function of (x, ...), whose gradient by x is taken forwards.

    For a handful of gains and a function that is long or cannot be run backwards; its other
    arguments are constants.
    """

    @jax.custom_vjp
    def wrapped(x: jax.Array, *constants: Any) -> jax.Array:
        return function(x, *constants)

    def ahead(x: jax.Array, *constants: Any) -> tuple[jax.Array, Any]:
        value, push = jax.linearize(lambda y: function(y, *constants), x)
        slope = jax.vmap(push)(jnp.eye(x.shape[0], dtype=x.dtype))
        return value, (slope, jax.tree.map(jnp.zeros_like, constants))

    def back(kept: Any, cotangent: jax.Array) -> Any:
        slope, zeros = kept
        return (cotangent * slope, *zeros)

    wrapped.defvjp(ahead, back)
    return wrapped
