"""Exact margins of a batch of loops against python-control, one loop at a time."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np


def rows(quick: bool) -> Iterator:
    """Lines of the table: a frequency-response model of 1000 points, and a Pade model."""
    import jax

    from benchmarks.timing import Row, alternate
    from jaxact.analysis.joint.frequency import JointLoop
    from jaxact.analysis.joint.margins import margins

    number = 256 if quick else 8192
    random = np.random.default_rng(0)
    kp, kd = 10 ** random.uniform(1.5, 3.0, number), 10 ** random.uniform(0.7, 1.5, number)
    wn, zeta = random.uniform(80, 800, number), random.uniform(0.3, 1.0, number)
    delay = random.uniform(0.0, 5e-3, number)
    with jax.enable_x64(True):
        loops = JointLoop(*(jax.numpy.asarray(a) for a in (kp, kd, 0.7 + 0 * kp, wn, zeta, delay)))
        compiled = jax.jit(margins)

        def ours() -> float:
            with jax.enable_x64(True):
                jax.block_until_ready(compiled(loops))
            return number

        few = min(20, number)
        cases = list(zip(*(a[:few] for a in (kp, kd, wn, zeta, delay)), strict=True))
        for name, rival, target in (
            ("stability_margins on 1000 frequency points", _response, 1000.0),
            ("stability_margins with a fifth-order Pade model", _pade, 20.0),
        ):

            def theirs(rival=rival) -> float:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    for case in cases:
                        rival(*case)
                return few

            yield Row(
                f"exact margins, {number} loops at once",
                f"python-control, {name}",
                *alternate(ours, theirs, 3),
                "loop",
                f"at least {target:g}",
                target,
            )


def _plant(kp: float, kd: float, wn: float, zeta: float):
    import control

    return control.tf([kd * wn**2, kp * wn**2], [0.7, 1.4 * zeta * wn, 0.7 * wn**2, 0.0, 0.0])


def _response(kp: float, kd: float, wn: float, zeta: float, delay: float) -> None:
    import control

    omega = np.geomspace(1e-1, 1e4, 1000)
    s = 1j * omega
    actuator = wn**2 / (s * s + 2 * zeta * wn * s + wn**2)
    response = (kp + kd * s) / (0.7 * s * s) * actuator * np.exp(-s * delay)
    control.stability_margins(control.frd(response, omega, smooth=True))


def _pade(kp: float, kd: float, wn: float, zeta: float, delay: float) -> None:
    import control

    numerator, denominator = control.pade(delay, 5)
    control.stability_margins(_plant(kp, kd, wn, zeta) * control.tf(numerator, denominator))
