"""A film of one robot moving in two ways, side by side."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxact.plotting import scene, video
from jaxact.plotting.scene import STANDARD, View
from jaxact.plotting.split_screen import Side, side_by_side

if TYPE_CHECKING:
    import mujoco


@dataclass(frozen=True)
class Motion:
    """How a robot moved.

    Attributes:
        label: said above it.
        time: of the samples [s], increasing, shape (steps,).
        qpos: positions as MuJoCo orders them, shape (steps, nq); not finite after a simulation
            that failed.
    """

    label: str
    time: np.ndarray
    qpos: np.ndarray


def film(
    model: mujoco.MjModel,
    left: Motion,
    right: Motion,
    *,
    module: str,
    view: View = STANDARD,
    fps: float = 25.0,
    speed: float = 1.0,
    caption: str = "",
) -> Iterator[np.ndarray]:
    """Frames of two motions of one model beside each other, until the shorter one ends.

    Args:
        model: the compiled model; not changed.
        left, right: the motions.
        module: of the OpenGL, from `scene.backend`.
        view: where the camera stands, and the size of one half.
        fps: frames per second.
        speed: 1 for real time, 0.25 for four times slower.
        caption: said below both, "" for nothing.

    Yields:
        RGB images, shape (height, width, 3), uint8.

    Raises:
        UserError: a motion is not finite from its start.
    """
    chosen = [video.moments(motion.time, fps=fps, speed=speed) for motion in (left, right)]
    frames = min(map(len, chosen))
    sides = []
    for motion, indices in zip((left, right), chosen, strict=True):
        indices = indices[:frames]
        swiftness = scene.joint_speed(model, motion.qpos, motion.time)
        images = scene.frames(
            model, motion.qpos[indices], step=speed / fps, module=module, view=view
        )
        # the fastest since the last frame: shaking may be faster than the film
        fastest = np.maximum.reduceat(swiftness, np.r_[0, indices[:-1] + 1].clip(max=indices))
        sides.append(Side(images, motion.label, fastest, _failed(motion)))
    times = left.time[0] + np.arange(frames) * speed / fps
    yield from side_by_side(*sides, times=times, speed=speed, unit=_unit(model), caption=caption)


def _failed(motion: Motion) -> str:
    broken = np.flatnonzero(~np.isfinite(motion.qpos).all(axis=1))
    return "" if broken.size == 0 else f"simulation failed at {motion.time[broken[0]]:.3g} s"


def _unit(model: mujoco.MjModel) -> str:
    import mujoco

    slides = bool(np.any(model.jnt_type == int(mujoco.mjtJoint.mjJNT_SLIDE)))
    turns = bool(np.any(model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE)))
    return "m/s" if slides and not turns else "rad/s" if not slides else "rad/s or m/s"
