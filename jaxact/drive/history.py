"""What of a drive's state is state, and what is history that nothing will read again.

A measure of how a perturbation grows must look at the former only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax.numpy as jnp

from jaxact.drive import delay as _delay
from jaxact.drive.step import Coefficients, DriveState


def forget(coefficients: Coefficients, state: DriveState) -> DriveState:
    """The state between two periods with zeros for what can have no effect any more.

    A delay line may be far longer than this drive's delay; what lies beyond it is history.
    """
    commands = _delay.forget(state.commands, coefficients.command_at, pushed=True)
    measurements = state.measurements
    if measurements is not None:
        where = coefficients.measurement_at
        positions, velocities = measurements
        measurements = (
            _delay.forget(positions, where, pushed=False),
            _delay.forget(velocities, where, pushed=False),
        )
    older = jnp.zeros_like(state.older)
    return replace(state, commands=commands, measurements=measurements, older=older)


def essential(state: DriveState) -> tuple[DriveState, Callable[[DriveState], DriveState]]:
    """The state without what `forget` makes zero whatever the parameters are.

    Returns:
        The smaller state, and a function that puts the zeros back.
    """
    zero = jnp.zeros_like(state.older)
    if isinstance(state.commands, _delay.Ring):
        return replace(state, older=None), lambda kept: replace(kept, older=zero)
    # The oldest command: no reading after the next push reaches it.
    smaller = replace(state, older=None, commands=state.commands[:-1])
    return smaller, lambda kept: replace(kept, older=zero, commands=(*kept.commands, zero))
