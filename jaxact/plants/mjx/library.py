"""MJX, and what it does not make public, imported without what it prints."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def _without_warp_notice() -> Iterator[None]:
    """MJX prints that the optional Warp is missing; keep that, and only that, off the screen."""
    captured = io.StringIO()
    with contextlib.redirect_stdout(captured):
        yield
    for line in captured.getvalue().splitlines():
        if not line.startswith(("Failed to import warp", "Failed to import mujoco_warp")):
            print(line, file=sys.stdout)


with _without_warp_notice():
    from mujoco import mjx as mjx
    from mujoco.mjx._src import derivative as derivative
    from mujoco.mjx._src import solver as solver
    from mujoco.mjx._src import support as support
    from mujoco.mjx._src import types as types
