"""Computing on the processor where JAX has a GPU: what computes little, or waits for C.

To compile for a GPU takes several times as long, and to start each operation there microseconds.
The margins of a joint took 23 s on an H200, and they take a second on its processor; the drive of
robots in C MuJoCo is called at every control period.
"""

from __future__ import annotations

import functools
from contextlib import AbstractContextManager, nullcontext
from typing import Any


def on_processor() -> AbstractContextManager[Any]:
    """What is compiled or called meanwhile is on the processor, unless a device was chosen.

    Arrays that somebody has put on another device are left there, and computed there.
    """
    import jax

    device = None if jax.config.jax_default_device is not None else _other_device()
    return nullcontext() if device is None else jax.default_device(device)


def platform() -> str:
    """Where JAX computes at the moment, "cpu" or "gpu"."""
    import jax

    device = jax.config.jax_default_device
    return jax.default_backend() if device is None else getattr(device, "platform", str(device))


@functools.cache
def _other_device() -> Any:
    """The processor; None where JAX computes there anyway, or was told to use GPUs only."""
    import jax

    if jax.default_backend() == "cpu":
        return None
    try:
        return jax.local_devices(backend="cpu")[0]
    except RuntimeError:
        return None
