"""MJX-Warp: MuJoCo in NVIDIA's Warp kernels, behind MJX's interface; forward simulation only.

It computes in float32 and has no derivatives. All simulations that are stepped together share one
list of contacts, and each has a list of constraints, of sizes fixed beforehand; they are chosen
from the model and the posture. A simulation for which they did not suffice has lost contacts: its
state is not a number from then on, so that it ends as invalid and never as a wrong figure.
"""

from __future__ import annotations

import contextlib
import copy
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import fields
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
from jax.custom_batching import custom_vmap

from jaxact.errors import UserError
from jaxact.plants.mjx import step as mjx_step
from jaxact.plants.mjx.plant import mjx
from jaxact.plants.warp_room import Room

PACKAGE = "warp-lang"
_INSTALL = "pip install 'jaxact[warp]'"
_DISABLE = mujoco.mjtDisableBit


def lacking() -> str:
    """What stands in the way of MJX-Warp on this machine, and what to do; "" if nothing does."""
    from mujoco.mjx import warp as inside

    if not inside.WARP_INSTALLED:
        return f"MJX-Warp needs the package {PACKAGE}, which is not installed: {_INSTALL}"
    if inside.mujoco_warp is None:
        return (
            f"{PACKAGE} {_version(PACKAGE)} does not fit mujoco-mjx {_version('mujoco-mjx')}:"
            f" {_INSTALL} takes the one that does"
        )
    kind = jax.local_devices()[0]
    if kind.platform != "cpu" and kind not in _nvidia():
        return f"MJX-Warp runs on NVIDIA GPUs and on CPUs, not on {kind.device_kind}"
    return ""


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "(of unknown version)"


def _nvidia() -> list[jax.Device]:
    try:
        return jax.devices("cuda")
    except RuntimeError:
        return []


def demand() -> None:
    """Raise UserError, in one line, where MJX-Warp cannot be used."""
    reason = lacking()
    if reason:
        raise UserError(f"engine = 'warp': {reason}; or choose 'mjx' or 'mujoco'")


def refusal(model: mujoco.MjModel) -> str:
    """Why MJX-Warp, which must be there, does not take a model; "" if it does."""
    try:
        _put_model(model)
    except NotImplementedError as error:
        return " ".join(str(error).split()).rstrip(".")
    return ""


def put(model: mujoco.MjModel, start: mujoco.MjData, room: Room) -> tuple[Any, Any]:
    """Model and data on the device.

    Args:
        model: its driven actuators converted.
        start: at the start posture.
        room: for contacts and constraints of one simulation.

    Raises:
        UserError: there is no MJX-Warp here.
        NotImplementedError: it cannot simulate the model.
    """
    demand()
    on_device, known = _put_model(model)
    with jax.numpy_rank_promotion("allow"):
        data = mjx.put_data(
            known, start, impl="warp", device=jax.local_devices()[0],
            naconmax=room.contacts, njmax=room.rows,
        )  # fmt: skip
    # What does not fit is told by the state, not by lines on the screen.
    return on_device.tree_replace({"opt._impl.warn_overflow": 0}), data


def _put_model(model: mujoco.MjModel) -> tuple[Any, mujoco.MjModel]:
    """The model on the device, and as MJX-Warp knows it; raises NotImplementedError."""
    _start_quietly()
    known = copy.copy(model)
    # What it does not have and does not need: it never resets, and tests all pairs of geoms;
    # nothing sleeps in any engine.
    known.opt.disableflags &= ~int(_DISABLE.mjDSBL_AUTORESET | _DISABLE.mjDSBL_MIDPHASE)
    known.tree_sleep_policy[:] = mujoco.mjtSleepPolicy.mjSLEEP_AUTO_NEVER
    device = jax.local_devices()[0]
    with warnings.catch_warnings(), jax.numpy_rank_promotion("allow"):
        warnings.simplefilter("ignore", UserWarning)  # `jaxact check` tells of those of MJX
        try:
            return mjx.put_model(known, impl="warp", device=device), known
        except ValueError as error:
            raise NotImplementedError(str(error)) from error


_GIVEN = (*mjx_step.STATE, "ctrl", "xfrc_applied")


def step(model: Any, data: Any) -> Any:
    """One step: `data` after it, of which only the state means anything.

    Under `vmap` there is room for the contacts of all simulations of the batch.
    """
    # A template and what differs between simulations apart: MJX's own data would have to be
    # batched with a list of contacts that is not.
    given = {name: getattr(data, name) for name in _GIVEN}
    blank = {name: jnp.zeros(value.shape, value.dtype) for name, value in given.items()}
    return data.replace(**_stepped(model, data.replace(**blank), given))


@custom_vmap
def _stepped(model: Any, template: Any, given: dict[str, jax.Array]) -> dict[str, jax.Array]:
    return _one(model, template, given)


@_stepped.def_vmap
def _many(size, batched, model, template, given):
    axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, (batched[0], batched[2]))
    roomy = _for(template, size)
    state = jax.vmap(lambda model, given: _one(model, roomy, given), in_axes=axes)(model, given)
    return state, jax.tree.map(lambda _: True, state)


def _one(model: Any, template: Any, given: dict[str, jax.Array]) -> dict[str, jax.Array]:
    # MJX multiplies matrices by vectors as NumPy allows; a user may have forbidden that.
    with jax.numpy_rank_promotion("allow"):
        data = mjx.step(model, template.replace(**given))
    state = {name: getattr(data, name) for name in mjx_step.STATE}
    lost = jnp.where(data._impl.overflow & _lost() != 0, jnp.nan, 0.0).astype(data.qpos.dtype)
    return state | {"qpos": state["qpos"] + lost, "qvel": state["qvel"] + lost}


def _lost() -> int:
    """The bits of what costs contacts or constraints; solvers that stop early do not count."""
    from mujoco.mjx.third_party.mujoco_warp._src.types import OverflowType as Bit

    return int(
        Bit.NEFC | Bit.NJMAX_NNZ | Bit.BROADPHASE | Bit.NARROWPHASE | Bit.CCD | Bit.HFIELD
        | Bit.NVMAX | Bit.EPA_HORIZON
    )  # fmt: skip


def _for(template: Any, size: int) -> Any:
    """The data of one simulation with room for the contacts of several."""
    inner = template._impl
    each = inner.naconmax
    longer = {
        field.name: jnp.zeros((size * each, *array.shape[1:]), array.dtype)
        for field in fields(inner)
        if field.name.startswith("contact__") and (array := getattr(inner, field.name)).size
    }
    sizes = {"naconmax": size * each, "naccdmax": size * inner.naccdmax}
    return template.replace(_impl=inner.replace(**longer, **sizes))


def _start_quietly() -> None:
    """Start Warp without its greetings; a loudness that the program has chosen is left alone."""
    import warp

    if warp.config.log_level == warp.LOG_INFO:
        warp.config.log_level = warp.LOG_WARNING
    with _without_driver_notice():
        warp.init()


@contextlib.contextmanager
def _without_driver_notice() -> Iterator[None]:
    """Keep off the screen that there is no GPU, which Warp's native library writes by itself."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as caught:
        screen = os.dup(2)
        try:
            os.dup2(caught.fileno(), 2)
            yield
        finally:
            os.dup2(screen, 2)
            os.close(screen)
            caught.seek(0)
            for line in caught.read().decode(errors="replace").splitlines():
                if "Could not find or load the NVIDIA CUDA driver" not in line:
                    print(line, file=sys.stderr)
