"""MUJOCO_GL for those who need no pictures: without OpenGL, importing MuJoCo must not fail.

MuJoCo loads the OpenGL that the variable names when it is imported, and the import fails where that
library is missing. Only `jaxact render` draws, and it loads what it needs itself.
"""

from __future__ import annotations

import os


def prepare() -> None:
    """Import MuJoCo without OpenGL where the environment names one; the variable stays as it is."""
    asked = os.environ.get("MUJOCO_GL")
    if asked is None:
        return
    os.environ["MUJOCO_GL"] = "disable"
    try:
        import mujoco  # noqa: F401 - for its side effect
    finally:
        os.environ["MUJOCO_GL"] = asked
