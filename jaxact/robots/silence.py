"""MuJoCo's warnings kept off the screen and out of the current folder.

A simulation that diverges is a result here, not a mishap. MuJoCo would print a warning for each,
and append it to a file MUJOCO_LOG.TXT in the folder where the program runs.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import mujoco


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Drop MuJoCo's warnings inside the block; a handler that the program has set is left alone."""
    if mujoco.get_mju_user_warning() is not None:
        yield
        return
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)
