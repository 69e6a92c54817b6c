"""Slopes of simulated tracking by the gains of hips, thighs and knees, against differences.

    python experiments/quadruped/gradients.py

The robot is pushed, with delays, noise and limits; the slope of its mean squared tracking error by
the logarithm of each gain is computed forwards through MJX, and by central differences of MJX's own
rollouts, which know nothing of how derivatives are made. Both in float64. Takes some minutes.
"""

from __future__ import annotations

from dataclasses import replace

import cases
import jax
import jax.numpy as jnp
import numpy as np

from jaxact.loops import robots
from jaxact.tuning.rollouts.tracking import term, value_and_gradient

KINDS = ("HAA", "HFE", "KFE")
SIZE = 1e-4  # of the differences in the logarithm of a gain
DURATION = 0.2  # [s]


def slopes(situation: str) -> tuple[np.ndarray, np.ndarray]:
    """Slopes forwards and by differences, shape (6,) each: kp of every kind, then kd."""
    asked = cases.load(situation, DURATION)
    assert asked.push is not None
    asked = replace(asked, push=replace(asked.push, time=0.01, duration=0.02))
    kinds = [label.partition("_")[2] for label in robots.scene(asked.plant).labels]
    groups = [KINDS.index(kind) for kind in kinds]
    gains = [asked.parameters["kp"]] * 3 + [asked.parameters[f"kd@.*_{kind}"] for kind in KINDS]
    x = np.log(np.array(gains, float))
    # MJX's own steps in place of those with derivatives.
    own = term(asked, groups, {}, differentiable=False)
    with jax.enable_x64(True):
        value = jax.jit(own.error)
        ends = [
            [float(value(jnp.asarray(x + sign * SIZE * unit))) for sign in (1.0, -1.0)]
            for unit in np.eye(x.size)
        ]
    differences = np.array([(high - low) / (2.0 * SIZE) for high, low in ends])
    return value_and_gradient(term(asked, groups, {}), x, "forward")[1], differences


def main() -> None:
    """Print both slopes and how far they are apart, of every situation."""
    print("| situation | gain | forwards [rad^2] | differences [rad^2] | relative difference |")
    print("| --- | --- | --- | --- | --- |")
    names = [f"{gain} {kind}" for gain in ("kp", "kd") for kind in KINDS]
    for situation in cases.SITUATIONS:
        for name, found, expected in zip(names, *slopes(situation), strict=True):
            apart = abs(found / expected - 1.0)
            print(
                f"| {situation} | {name} | {found:.6e} | {expected:.6e} | {apart:.1e} |", flush=True
            )


if __name__ == "__main__":
    main()
