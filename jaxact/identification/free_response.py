"""The force loop's free response over many intervals, with derivatives that cost little.

    f(t) = u + c e + s g                 e = f - u, g = f' where the interval begins

The coefficients depend on wn, zeta and the length t alone, whatever is differentiated by: so their
partial derivatives are computed once, and each direction is a combination of them. Along t they
follow from the differential equation, and along wn from scaling time,

    c' = -wn^2 s,  s' = c - 2 zeta wn s;       s = S(wn t) / wn:  ds/dwn = (t s' - s) / wn

while along zeta the closed form itself is differentiated.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxact.drive import actuator
from jaxact.drive.actuator import Free

# What each coefficient is proportional to at a fixed wn t: wn to this power; in `Free`'s order.
_POWERS = (0.0, -1.0, 1.0, 0.0, -1.0, -2.0, -2.0, -3.0)


def coefficients(wn: jax.Array, zeta: jax.Array, length: jax.Array) -> tuple[Free, Free]:
    """The coefficients and their derivatives by zeta, for `along`; not differentiated themselves.

    Args:
        wn: natural frequency [rad/s], scalar, may be infinite.
        zeta: damping ratio, scalar.
        length: of each interval [s], shape (intervals,).
    """
    wn, zeta, length = (jax.lax.stop_gradient(jnp.asarray(a)) for a in (wn, zeta, length))
    return jax.jvp(
        lambda zeta: actuator.free_response(wn, zeta, length), (zeta,), (jnp.ones_like(zeta),)
    )


@jax.custom_jvp
def along(known: tuple[Free, Free], wn: jax.Array, zeta: jax.Array, length: jax.Array) -> Free:
    """The coefficients of one interval as a function of wn, zeta and its length.

    Args:
        known: of this interval, from `coefficients`.
        wn, zeta, length: those that `known` is of.
    """
    del wn, zeta, length
    return known[0]


@along.defjvp
def _along(primals, tangents):
    (at, by_zeta), wn, zeta, length = primals
    _, dwn, dzeta, dlength = tangents
    ideal = jnp.isinf(wn)
    w = jnp.where(ideal, 1.0, wn)
    by_length = Free(
        c=at.rate_e, s=at.rate_g, rate_e=-w * w * at.rate_g,
        rate_g=at.rate_e - 2.0 * zeta * w * at.rate_g, Ic=at.c, Is=at.s, Jc=at.Ic, Js=at.Is,
    )  # fmt: skip
    changes = [
        jnp.where(ideal, 0.0, (length * t + power * a) / w * dwn + z * dzeta + t * dlength)
        for a, z, t, power in zip(
            *map(jax.tree.leaves, (at, by_zeta, by_length)), _POWERS, strict=True
        )
    ]
    return at, Free(*changes)
