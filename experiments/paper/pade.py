"""Gain margins of the study's loops as a tool with rational transfer functions finds them.

The delay is replaced by its Padé approximation of order n,

    exp(-s td) ~ sum_k c_k (-s td)^k / sum_k c_k (s td)^k,
    c_k = (2n - k)! n! / ((2n)! k! (n - k)!),

so that L(s) = k N(s)/D(s) is rational. Its closed loop turns unstable where a root of D + k N first
lies on the imaginary axis: at the real w > 0 for which N(jw)/D(jw) is a negative number.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Polynomial
from study import KD, KP, MASS, Cases


def gain_margins(cases: Cases, order: int) -> np.ndarray:
    """Smallest factor above 1 on both gains that makes the approximated loop unstable [-].

    Infinite where there is none; the cases' shape.

    Args:
        cases: at the nominal gains.
        order: of the Padé approximation.
    """
    found = [
        _gain_margin(*map(float, case), order) for case in zip(*cases.flat().columns, strict=True)
    ]
    return np.array(found).reshape(cases.shape)


def _gain_margin(wn: float, zeta: float, delay: float, order: int) -> float:
    n = order
    c = [
        math.factorial(2 * n - k) * math.factorial(n)
        / (math.factorial(2 * n) * math.factorial(k) * math.factorial(n - k))
        for k in range(n + 1)
    ]  # fmt: skip
    late = Polynomial([c[k] * (-delay) ** k for k in range(n + 1)])
    early = Polynomial([c[k] * delay**k for k in range(n + 1)])
    actuator = Polynomial([1.0, 2.0 * zeta / wn, wn**-2.0])
    above = Polynomial([KP, KD]) * late
    below = Polynomial([0.0, 0.0, MASS]) * actuator * early
    # N(jw) conj(D(jw)), a polynomial in w: real and negative at the phase crossovers.
    turned = _along_axis(above) * Polynomial(np.conj(_along_axis(below).coef))
    roots = Polynomial(np.trim_zeros(turned.coef.imag, "b")).roots() if delay or zeta / wn else []
    w = np.array(
        [root.real for root in roots if abs(root.imag) < 1e-9 * abs(root) and root.real > 0]
    )
    ratio = above(1j * w) / below(1j * w)
    factors = -1.0 / ratio.real[ratio.real < 0.0]
    return float(min(factors[factors > 1.0], default=math.inf))


def _along_axis(polynomial: Polynomial) -> Polynomial:
    """The same in w, at s = jw."""
    return Polynomial(polynomial.coef * 1j ** np.arange(len(polynomial.coef)))
