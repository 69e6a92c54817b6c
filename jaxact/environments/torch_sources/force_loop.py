"""The closed force loop of an actuator: its exact answer to a held input.

    f'' + 2 zeta wn f' + wn^2 f = wn^2 u

Source: Astrom, Wittenmark, "Computer-Controlled Systems", 3rd ed., section 2.3.
"""

from __future__ import annotations

import math

import torch


def free_response(
    wn: torch.Tensor, zeta: torch.Tensor, t: torch.Tensor
) -> tuple[torch.Tensor, ...]:
    """How the force loop answers over a time t to an offset e = f - u and a rate g = f'.

        f(t) = u + c e + s g,    f'(t) = -w^2 s e + rate_g g,    int_0^t f = u t + Ic e + Is g

    By power series where closed forms would lose digits, smooth through zeta = 1, and for an ideal
    loop, wn = inf, the limit.

    Returns:
        c, s, Ic, Is, rate_g, w; w is wn, 1 where that is inf.
    """
    wn, zeta, t = torch.broadcast_tensors(wn, zeta, t)
    ideal = torch.isinf(wn)
    w = torch.where(ideal, 1.0, wn)
    x = w * t
    short = x * (1.0 + 2.0 * zeta) < 2.0
    near_zero = torch.where(short, x, 0.0)
    older, newer = torch.zeros_like(x), torch.ones_like(x)
    s1, s2 = torch.zeros_like(x), torch.zeros_like(x)
    for order in range(1, 26):
        s1 = s1 + newer / float(math.factorial(order))
        s2 = s2 + newer / float(math.factorial(order + 1))
        older, newer = newer * near_zero, (-2.0 * zeta * newer - older) * near_zero
    far = torch.where(short, 1.0, x)
    far_s, far_c = _closed_form(far, zeta)
    s = t * torch.where(short, s1, far_s)
    Is = t * t * torch.where(short, s2, (1.0 - far_c) / (far * far))
    c = torch.where(short, 1.0 - w * w * Is, far_c)
    gone = ideal & (t > 0.0)
    c, s, Is = (torch.where(gone, 0.0, value) for value in (c, s, Is))
    damping = 2.0 * zeta * w
    Ic = torch.where(ideal, 0.0, s + damping * Is)
    rate_g = torch.where(ideal, 0.0, c - damping * s)
    return c, s, Ic, Is, rate_g, w


def _closed_form(x: torch.Tensor, zeta: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """s/t and c in x = wn t: underdamped, overdamped, and by series where zeta is about 1."""
    y = zeta * x
    square = (zeta - 1.0) * (zeta + 1.0) * x * x
    near, ringing = square.abs() < 1.0, square < 0.0
    small = torch.where(near, square, 0.0)
    sinhc, cosh = torch.ones_like(x), torch.ones_like(x)
    for order in range(9, 0, -1):
        sinhc = 1.0 + sinhc * small / (2 * order * (2 * order + 1))
        cosh = 1.0 + cosh * small / (2 * order * (2 * order - 1))
    angle = torch.where(near | ~ringing, 1.0, -square).sqrt()
    spread = torch.where(near | ringing, 1.0, square).sqrt()
    decay = torch.exp(-y)
    # (y - spread)(y + spread) = x^2: neither exponent cancels, and neither overflows
    slow, fast = torch.exp(-x * x / (y + spread)), torch.exp(-(y + spread))
    s = torch.where(ringing, decay * torch.sin(angle) / angle, 0.5 * (slow - fast) / spread)
    half = torch.where(ringing, decay * torch.cos(angle), 0.5 * (slow + fast))
    s, half = torch.where(near, decay * sinhc, s), torch.where(near, decay * cosh, half)
    return s, half + y * s
