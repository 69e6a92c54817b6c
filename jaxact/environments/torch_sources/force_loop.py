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


def part_rows(wn: torch.Tensor, zeta: torch.Tensor, time: torch.Tensor) -> torch.Tensor:
    """What `followed` needs of the part of a step under one command, 7 rows."""
    wn, zeta, time = torch.broadcast_tensors(wn, zeta, time)
    c, s, Ic, Is, rate_g, w = free_response(wn, zeta, time)
    length = torch.where(time > 0.0, time, 1.0)
    return torch.stack([time, c, s, -w * w * s, rate_g, Ic / length, Is / length])


def followed(
    parts: torch.Tensor, state: dict[str, torch.Tensor], rate_limit: torch.Tensor,
    target: torch.Tensor, low: torch.Tensor, high: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
    """What is left of the force in a step where it changes no faster than a rate limit.

    Args:
        parts: rows of the parts of the step, under the older and the newer command.
        state: of the drive; its "applied" is the force at the beginning of the step.
        rate_limit: [N/s or N m/s], may be inf.
        target: mean without the rate limit.
        low, high: other limits of the force.

    Returns:
        Mean over the step and force at its end. The force to follow is taken as a straight line in
        each part; as far as that is followed, the mean is the force's, and in a step that is
        followed throughout the target's, within what the limits let it be.
    """
    unlimited = torch.isinf(rate_limit)
    fastest = torch.where(unlimited, 0.0, rate_limit)
    free, rate, force = state["force"], state["rate"], state["applied"]
    step, mean, off, end = parts[0] + parts[7], 0.0, 0.0, free
    held_back = torch.zeros_like(free, dtype=torch.bool)
    for row, command in ((parts[:7], state["older"]), (parts[7:], state["newer"])):
        time, c, s, rate_e, rate_g, mean_e, mean_g = row
        e = free - command
        average = (command + mean_e * e + mean_g * rate).clamp(low, high)
        start = free.clamp(low, high)
        free, rate = command + c * e + s * rate, rate_e * e + rate_g * rate
        end = free.clamp(low, high)
        first = (2.0 * average - end).clamp(torch.minimum(start, end), torch.maximum(start, end))
        rise = (end - first) / torch.where(time > 0.0, time, 1.0)
        gap = first - force
        side = torch.sign(gap)
        closing = fastest - side * rise
        meets = closing > 0.0
        until = torch.where(meets, gap.abs() / torch.where(meets, closing, 1.0), time)
        until = torch.minimum(torch.where(gap == 0.0, 0.0, until), time)
        rest = time - until
        after = rise.clamp(-fastest, fastest)
        change = side * fastest * (until * time - 0.5 * until * until) + 0.5 * after * rest * rest
        mean = mean + (force * time + change) / step
        follows = torch.where(rise.abs() <= fastest, rest, 0.0)
        held_back = held_back | (follows < time)
        off = off + follows * (average - 0.5 * (first + end)) / step
        force = force + side * fastest * until + after * rest
    least, most = reach(state["applied"], force, fastest, step)
    least, most = (
        torch.maximum(least, torch.minimum(low, mean)),
        torch.minimum(most, torch.maximum(high, mean)),
    )
    mean = torch.where(held_back, mean + off, target)
    mean = torch.minimum(torch.maximum(mean, least), most)
    return torch.where(unlimited, target, mean), torch.where(unlimited, end, force)


def reach(
    first: torch.Tensor, last: torch.Tensor, fastest: torch.Tensor, step: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Least and largest mean over a step of a force between two that changes no faster."""
    ends = []
    for rate in (-fastest, fastest):
        turn = 0.5 * (step + (last - first) / torch.where(rate == 0.0, 1.0, rate))
        turn = torch.minimum(turn.clamp(min=0.0), step)
        rest = step - turn
        mean = turn * (first + 0.5 * rate * turn) + rest * (last + 0.5 * rate * rest)
        ends.append(mean / step)
    return ends[0], ends[1]
