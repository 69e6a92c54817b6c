"""Images of a MuJoCo model without a screen: OpenGL through EGL, else OSMesa.

MuJoCo picks its OpenGL when it is imported, and a library that is there may still not work. So each
one is tried in a process of its own, and the context is made here, whatever was imported before.
The environment variable MUJOCO_GL chooses as it does for MuJoCo itself.
"""

from __future__ import annotations

import copy
import importlib
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.errors import UserError, nearest, shown
from jaxact.plotting import stand_ins

if TYPE_CHECKING:
    import mujoco

_MODULES = {
    "egl": "mujoco.egl", "osmesa": "mujoco.osmesa", "cgl": "mujoco.cgl", "glfw": "mujoco.glfw",
    "glx": "mujoco.glfw", "wgl": "mujoco.glfw",
}  # fmt: skip
_ANY = ("", "enable", "enabled", "on", "true", "1")
_NONE = ("disable", "disabled", "off", "false", "0")
_PROBE = """
import importlib, os, sys
import mujoco
context = importlib.import_module(sys.argv[1]).GLContext(8, 8)
context.make_current()
empty = mujoco.MjModel.from_xml_string("<mujoco/>")
mujoco.MjrContext(empty, mujoco.mjtFontScale.mjFONTSCALE_100.value)
os._exit(0)
"""
_SHADOW_MAP = 2048  # pixels; MuJoCo's own 4096 takes most of the time of a software renderer
_ROOM = 1.4  # height of what the camera sees around the robot, as a multiple of its extent


@dataclass(frozen=True)
class View:
    """Where the camera stands.

    Attributes:
        width, height: of an image [pixels].
        azimuth, elevation: direction the camera looks along [degrees], as MuJoCo counts them.
        distance: from the robot [m]; None for one that suits the model's extent.
        lag: time constant with which the camera follows the centre of mass [s]. Shaking is too
            fast for it, and is seen.
    """

    width: int = 480
    height: int = 360
    azimuth: float = 130.0
    elevation: float = -15.0
    distance: float | None = None
    lag: float = 0.5


STANDARD = View()


def backend() -> str:
    """The module of the first OpenGL that works here, e.g. "mujoco.egl".

    MUJOCO_GL is obeyed where it is set. Takes about half a second for each that is tried.

    Raises:
        UserError: none works, or MUJOCO_GL is not one of MuJoCo's values; with the reason.
    """
    asked = os.environ.get("MUJOCO_GL", "").strip().lower()
    if asked in _NONE:
        raise UserError(
            f"MUJOCO_GL={asked} switches OpenGL off, and a video needs it; unset it, or set it to "
            "egl or osmesa"
        )
    if asked not in (*_ANY, *_MODULES):
        raise UserError(f"MUJOCO_GL={shown(asked)} in the environment; {nearest(asked, _MODULES)}")
    names = _candidates() if asked in _ANY else (asked,)
    reasons = []
    for name in names:
        reason = _why_not(_MODULES[name])
        if reason is None:
            return _MODULES[name]
        reasons.append(f"{name}: {reason}")
    raise UserError(
        f"no OpenGL to draw with ({'; '.join(reasons)}); install Mesa's EGL or OSMesa (Debian: "
        "libegl1 or libosmesa6); everything but videos works without"
    )


def frames(
    model: mujoco.MjModel, qpos: np.ndarray, *, step: float, module: str, view: View = STANDARD
) -> Iterator[np.ndarray]:
    """Images of a model along a motion, one after the other.

    Links without a shape to look at are drawn as in `jaxact.plotting.stand_ins`.

    Args:
        model: the compiled model; not changed.
        qpos: positions as MuJoCo orders them, shape (frames, nq). From where one is not finite the
            last pose before is held.
        step: time between two frames [s].
        module: of the OpenGL, from `backend`.
        view: where the camera stands.

    Yields:
        RGB images, shape (height, width, 3), uint8.
    """
    poses = held(qpos)
    with _Studio(model, view, module) as studio:
        for pose, target in zip(poses, _targets(model, poses, step, view.lag), strict=True):
            yield studio.image(pose, target)


def held(qpos: np.ndarray) -> np.ndarray:
    """The motion with its last finite pose held from where one is not finite.

    Args:
        qpos: shape (frames, nq).
    """
    broken = np.flatnonzero(~np.isfinite(qpos).all(axis=1))
    if broken.size == 0:
        return qpos
    if broken[0] == 0:
        raise UserError("the motion is not finite from its start; there is nothing to draw")
    poses = qpos.copy()
    poses[broken[0] :] = poses[broken[0] - 1]
    return poses


def joint_speed(model: mujoco.MjModel, qpos: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Root mean square of the joint speeds between samples [rad/s or m/s], shape (steps,).

    The six of a floating base do not count.

    Args:
        model: the compiled model.
        qpos: shape (steps, nq).
        time: of the samples [s], shape (steps,).
    """
    import mujoco

    free = model.jnt_type[model.dof_jntid] == int(mujoco.mjtJoint.mjJNT_FREE)
    poses, speed = held(qpos), np.zeros(len(qpos))
    velocity = np.zeros(model.nv)
    for index in range(1, len(poses)):
        span = time[index] - time[index - 1]
        mujoco.mj_differentiatePos(model, velocity, span, poses[index - 1], poses[index])
        speed[index] = math.sqrt(float(np.mean(velocity[~free] ** 2))) if not free.all() else 0.0
    return speed


def _candidates() -> tuple[str, ...]:
    if sys.platform == "darwin":
        return ("cgl", "glfw")
    if sys.platform == "win32":
        return ("glfw",)
    return ("egl", "osmesa", "glfw") if os.environ.get("DISPLAY") else ("egl", "osmesa")


def _why_not(module: str) -> str | None:
    """None if this OpenGL draws; else the last line of what it says."""
    quiet = os.environ | {"MUJOCO_GL": "disable"}  # else the import alone may fail
    try:
        tried = subprocess.run(
            [sys.executable, "-c", _PROBE, module],
            capture_output=True, text=True, env=quiet, timeout=120, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return "hangs"
    if tried.returncode == 0:
        return None
    said = tried.stderr.strip().splitlines()
    return shown(" ".join((said[-1] if said else f"exit code {tried.returncode}").split()), 100)


def _targets(model: Any, poses: np.ndarray, step: float, lag: float) -> np.ndarray:
    """What the camera looks at: the centre of mass, low-pass filtered, shape (frames, 3) [m]."""
    import mujoco

    data = mujoco.MjData(model)
    centres = np.empty((len(poses), 3))
    for index, pose in enumerate(poses):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        centres[index] = data.subtree_com[0]
    blend = 1.0 - math.exp(-step / lag)
    for index in range(1, len(centres)):
        centres[index] = centres[index - 1] + blend * (centres[index] - centres[index - 1])
    return centres


class _Studio:
    """A model, a camera and an OpenGL context that belong together; a context manager."""

    def __init__(self, model: Any, view: View, module: str) -> None:
        import mujoco

        self._model = copy.copy(model)
        self._model.vis.global_.offwidth = view.width
        self._model.vis.global_.offheight = view.height
        self._model.vis.quality.shadowsize = min(model.vis.quality.shadowsize, _SHADOW_MAP)
        self._data = mujoco.MjData(self._model)
        self._scene = mujoco.MjvScene(self._model, maxgeom=10_000)
        self._option = mujoco.MjvOption()
        self._stand_ins = stand_ins.stand_ins(self._model)
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        self._camera.azimuth, self._camera.elevation = view.azimuth, view.elevation
        seen = math.radians(model.vis.global_.fovy) / 2.0
        around = stand_ins.extent(self._model, self._stand_ins)
        suits = _ROOM * around / (2.0 * math.tan(seen))
        self._camera.distance = suits if view.distance is None else view.distance
        self._rectangle = mujoco.MjrRect(0, 0, view.width, view.height)
        self._module = module

    def __enter__(self) -> _Studio:
        import mujoco

        module = importlib.import_module(self._module)
        self._gl = module.GLContext(self._rectangle.width, self._rectangle.height)
        self._gl.make_current()
        scale = mujoco.mjtFontScale.mjFONTSCALE_100.value
        self._context = mujoco.MjrContext(self._model, scale)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        return self

    def __exit__(self, *_: object) -> None:
        self._gl.make_current()
        self._context.free()
        self._gl.free()

    def image(self, pose: np.ndarray, target: np.ndarray) -> np.ndarray:
        """The model in a pose, with the camera on a target; (height, width, 3), uint8."""
        import mujoco

        self._gl.make_current()  # another studio may have drawn in between
        self._data.qpos[:] = pose
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        mujoco.mj_tendon(self._model, self._data)
        self._camera.lookat[:] = target
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            self._model, self._data, self._option, None, self._camera, everything, self._scene
        )
        stand_ins.add(self._scene, self._model, self._data, self._stand_ins)
        mujoco.mjr_render(self._rectangle, self._scene, self._context)
        pixels = np.empty((self._rectangle.height, self._rectangle.width, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._rectangle, self._context)
        return np.flipud(pixels)
