"""A robot's loop before its controllers, as its report embeds it: plants at several control rates.

    x' = A x + B f,     A = Q U Q^H,     U upper triangular,     q - q0 = C_q x,     v = C_v x

over one physics step, with f the mean force over it. With U, Q^H B and C Q the response at any
frequency is a triangular system, and all else (hold, delays, actuators, gains) has closed forms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from jaxact.errors import UserError
from jaxact.loops import robots
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.loops.template import Template
from jaxact.parameters import (
    CONTROL_RATE,
    DELAY,
    KD,
    KP,
    MEASUREMENT_DELAY,
    OUTPUT_DELAY,
    VELOCITY_FILTER,
    WN,
    ZETA,
)
from jaxact.plants import linearize
from jaxact.plants.linear import LinearPlant
from jaxact.robot_margins import whole_robot
from jaxact.simulation import kernel, plans, robot_loop

OF_DRIVES = (KP, KD, WN, ZETA, DELAY, MEASUREMENT_DELAY, OUTPUT_DELAY, VELOCITY_FILTER)
# Residue of a root, as a share of what a root could have, below which no drive moves or sees it.
_HIDDEN = 1e-10


@dataclass(frozen=True)
class OpenPlant:
    """A linearised robot over one physics step; n states, m joints.

    Attributes:
        step: physics step [s].
        substeps: physics steps in a control period.
        triangular: U, complex, shape (n, n).
        inputs: Q^H B, complex, shape (n, m).
        positions, velocities: C_q Q and C_v Q, complex, shape (m, n) each.
        hidden: roots of A that no command moves, or that no joint shows; complex.
        inertias: that forces on the joints feel [kg or kg m^2], shape (m,); 0 of one that no force
            moves.
    """

    step: float
    substeps: int
    triangular: np.ndarray
    inputs: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    hidden: np.ndarray
    inertias: np.ndarray


@dataclass(frozen=True)
class OpenLoop:
    """A robot's loop at several control rates.

    Attributes:
        drives: parameters of the joints by name, of `OF_DRIVES`, shape (m,) each.
        rate: its own control rate [Hz].
        plants: by control rate [Hz].
    """

    drives: dict[str, np.ndarray]
    rate: float
    plants: dict[float, OpenPlant]


def open_loops(
    specification: Specification, samples: Samples, rates: Sequence[float] = ()
) -> list[OpenLoop]:
    """Every loop of a robot's, opened at its controllers.

    Args:
        specification: of the robot.
        samples: its loops.
        rates: control rates that are wanted beside each loop's own [Hz].

    Raises:
        UserError: as `jaxact.robot_margins.whole_robot.evaluate`.
    """
    found = []
    rows = sorted(whole_robot.linearised(specification, samples), key=lambda row: row[0])
    others = _others(specification, rows[0][2], rates)
    for _, case, template, values, moved in rows:
        with jax.enable_x64(True):
            inputs = {name: np.asarray(value) for name, value in values.items()}
            own_model = None if moved is None else (jnp.asarray(moved[0]), jnp.asarray(moved[1]))
            plant = kernel.linear_loop(case, template, inputs, own_model).plant
            resolved: Any = kernel.resolved(template, inputs)
        shape, rate = plant.positions.shape[:1], values[CONTROL_RATE]
        drives = {name: np.broadcast_to(np.asarray(resolved[name], float), shape) for name in
                  OF_DRIVES}  # fmt: skip
        own = {rate: _opened(plant, case.step, case.drive.substeps)}
        found.append(OpenLoop(drives, rate, own | ({} if moved else others)))
    return found


def _others(
    specification: Specification, template: Template, rates: Sequence[float]
) -> dict[float, OpenPlant]:
    """The plant at other control rates, of those whose periods its physics steps divide."""
    scene, plant = template.scene, specification.plant
    assert scene is not None and plant is not None
    found: dict[float, OpenPlant] = {}
    if template.plant is not None:  # linearised by MJX
        return found
    moving = robots.linearised(scene, plant)
    for rate in rates:
        try:
            (count,) = plans.substeps(specification, np.array([rate]))
        except UserError:
            continue
        step = 1.0 / (rate * count)
        linear = linearize.linear_c(
            moving.robot, moving.posture, step, corrected=specification.setting.corrected
        )
        found[rate] = _opened(linear.plant, step, int(count))
    return found


def _opened(linear: LinearPlant, step: float, substeps: int) -> OpenPlant:
    A, B, positions, velocities = (
        np.asarray(part) for part in (linear.A, linear.B, linear.positions, linear.velocities)
    )
    with jax.enable_x64(True):
        inertias = np.asarray(robot_loop.effective_inertias(linear))
    triangular, vectors = scipy.linalg.schur(A, output="complex")
    return OpenPlant(
        step=step,
        substeps=substeps,
        triangular=triangular,
        inputs=vectors.conj().T @ B,
        positions=positions @ vectors,
        velocities=velocities @ vectors,
        hidden=_hidden(A, B, np.vstack([positions, velocities])),
        inertias=np.where(np.isfinite(inertias), inertias, 0.0),
    )


def _hidden(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Roots of A without a part in C (z - A)^-1 B."""
    roots, left, right = scipy.linalg.eig(A, left=True, right=True)
    moved = np.linalg.norm(left.conj().T @ B, axis=1) / max(np.linalg.norm(B), 1e-300)
    seen = np.linalg.norm(C @ right, axis=0) / max(np.linalg.norm(C), 1e-300)
    return roots[(moved < _HIDDEN) | (seen < _HIDDEN)]
